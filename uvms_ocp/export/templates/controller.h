#ifndef NAME_CONTROLLER_H
#define NAME_CONTROLLER_H
#define SYMBOL_CONTROLLER_H
/* Linkers see each function and array with a digest of all sources before its name: what is compiled with this header is linked
   to this controller, or not at all. */
#define NAME_controller_reset SYMBOL_controller_reset
#define NAME_controller_step SYMBOL_controller_step
#define NAME_CONTROLLER_PARAMETERS SYMBOL_CONTROLLER_PARAMETERS
#define NAME_CONTROLLER_PHASES SYMBOL_CONTROLLER_PHASES
#define NAME_CONTROLLER_STATUSES SYMBOL_CONTROLLER_STATUSES
#define NAME_CONTROLLER_QUANTITIES SYMBOL_CONTROLLER_QUANTITIES
#define NAME_CONTROLLER_CHANNELS SYMBOL_CONTROLLER_CHANNELS
#define NAME_CONTROLLER_SIZES SYMBOL_CONTROLLER_SIZES
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
/* Without a digest: two exports of one name in one program define it twice, and linkers say so. */
extern const int NAME_IS_TAKEN_TWICE_EXPORT_ONE_ANEW_WITH_ANOTHER_NAME;
#elif !defined SYMBOL_CONTROLLER_H
#error "NAME_controller.h is of two exports: export one of them anew with another --name"
#endif
