$exact
#include <math.h>
#include "NAME_controller.h"
$declarations
$numbers
const NAME_Controller NAME_CONTROLLER_INITIAL = $value;
