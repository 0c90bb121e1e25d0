$exact
#include "NAME_controller.h"
$declarations
$kernels
extern const NAME_Controller NAME_CONTROLLER_INITIAL;
void NAME_controller_reset(NAME_Controller *controller) { *controller = NAME_CONTROLLER_INITIAL; }
void NAME_controller_step(NAME_Controller *controller, const NAME_ControllerInputs *in, NAME_ControllerOutputs *out) {
  NAME_ControllerInputs inputs = *in;
  NAME_k_$kernel(controller, &inputs, out);
}
double NAME_controller_numbers[] = {$values};
const NAME_ControllerParameter NAME_CONTROLLER_PARAMETERS[] = {${parameters}{0, 0}};
$names
const unsigned long NAME_CONTROLLER_SIZES[3] = {
    sizeof(NAME_Controller), sizeof(NAME_ControllerInputs), sizeof(NAME_ControllerOutputs)};
