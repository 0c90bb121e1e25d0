$exact
#include <math.h>
#include "NAME_controller.h"
$declarations
$numbers
const NAME_Controller SYMBOL_CONTROLLER_INITIAL = $value;
