/* The replay, after parameters are set: recorded.bin, then names and values. */
#include <stdlib.h>
#include <string.h>

#define main replay
#include "c_replay.c"
#undef main

int main(int argc, char **argv) {
  for (int k = 2; k + 1 < argc; k += 2) {
    const c_ControllerParameter *parameter = c_CONTROLLER_PARAMETERS;
    while (parameter->name && strcmp(parameter->name, argv[k])) parameter++;
    if (!parameter->name) return 3;
    *parameter->value = atof(argv[k + 1]);
  }
  return replay(2, argv);
}
