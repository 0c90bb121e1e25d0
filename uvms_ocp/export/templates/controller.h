#ifndef CONTROLLER_H
#define CONTROLLER_H
/* All that the controller remembers is a Controller; its parts are nobody else's business. */
$types
typedef $memory Controller;
$inputs
$outputs
/* Begin the mission. */
void controller_reset(Controller *controller);
/* One tick. */
void controller_step(Controller *controller, const ControllerInputs *in, ControllerOutputs *out);
/* A gain, saturation or margin of a task, as its documentation has it, by the name of the task and its own. */
typedef struct {
  const char *name;
  double *value;
} ControllerParameter;
/* They can be set at any time between two steps, and hold for all controllers of the program until they are set anew.
   The last one has no name. */
extern const ControllerParameter CONTROLLER_PARAMETERS[];
$names
/* Bytes of a Controller, of its inputs and of its outputs. */
extern const unsigned long CONTROLLER_SIZES[3];
#endif
