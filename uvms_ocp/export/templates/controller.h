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
$names
/* Bytes of a Controller, of its inputs and of its outputs. */
extern const unsigned long CONTROLLER_SIZES[3];
#endif
