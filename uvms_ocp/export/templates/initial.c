#include <math.h>
#include "controller.h"
$declarations
const Controller CONTROLLER_INITIAL = $value;
