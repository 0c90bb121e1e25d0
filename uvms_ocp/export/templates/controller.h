#ifndef NAME_CONTROLLER_H
#define NAME_CONTROLLER_H
/* All that the controller remembers is a NAME_Controller; its parts are nobody else's business. */
$types
typedef $memory NAME_Controller;
$inputs
$outputs
/* Begin the mission. */
void NAME_controller_reset(NAME_Controller *controller);
/* One tick. */
void NAME_controller_step(NAME_Controller *controller, const NAME_ControllerInputs *in, NAME_ControllerOutputs *out);
/* A gain, saturation or margin of a task, as its documentation has it, by the name of the task and its own. */
typedef struct {
  const char *name;
  double *value;
} NAME_ControllerParameter;
/* They can be set at any time between two steps, and hold for all controllers of this export until they are set anew.
   The last one has no name. */
extern const NAME_ControllerParameter NAME_CONTROLLER_PARAMETERS[];
$names
/* Bytes of a NAME_Controller, of its inputs and of its outputs. */
extern const unsigned long NAME_CONTROLLER_SIZES[3];
#endif
