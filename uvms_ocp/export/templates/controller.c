$exact
#include "NAME_controller.h"
$declarations
$kernels
extern const NAME_Controller SYMBOL_CONTROLLER_INITIAL;
void NAME_controller_reset(NAME_Controller *controller) { *controller = SYMBOL_CONTROLLER_INITIAL; }
void NAME_controller_step(NAME_Controller *controller, const NAME_ControllerInputs *in, NAME_ControllerOutputs *out) {
  NAME_ControllerInputs inputs = *in;
  SYMBOL_k_$kernel(controller, &inputs, out);
}
double SYMBOL_controller_numbers[] = {$values};
const NAME_ControllerParameter NAME_CONTROLLER_PARAMETERS[] = {${parameters}{0, 0}};
$names
const int NAME_IS_TAKEN_TWICE_EXPORT_ONE_ANEW_WITH_ANOTHER_NAME = 1;
const unsigned long NAME_CONTROLLER_SIZES[3] = {
    sizeof(NAME_Controller), sizeof(NAME_ControllerInputs), sizeof(NAME_ControllerOutputs)};
