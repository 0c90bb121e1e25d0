#include "controller.h"
$declarations
$kernels
extern const Controller CONTROLLER_INITIAL;
void controller_reset(Controller *controller) { *controller = CONTROLLER_INITIAL; }
void controller_step(Controller *controller, const ControllerInputs *in, ControllerOutputs *out) {
  ControllerInputs inputs = *in;
  k_$kernel(controller, &inputs, out);
}
double controller_numbers[] = {$values};
const ControllerParameter CONTROLLER_PARAMETERS[] = {${parameters}{0, 0}};
$names
const unsigned long CONTROLLER_SIZES[3] = {
    sizeof(Controller), sizeof(ControllerInputs), sizeof(ControllerOutputs)};
