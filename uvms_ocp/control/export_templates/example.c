/* Replays the recorded ticks of ticks.h and compares: exit code 0 if every velocity agrees to 1e-12. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tick.h"
#include "ticks.h"

int main(void) {
  double active_set[TICK_N_ROWS] = {0}, v[TICK_N_V], quantities[TICK_N_QUANTITIES], worst = 0;
  for (int k = 0; k < TICKS; ++k) {
    const double *in[TICK_N_IN], *at = TICK_INPUTS[k];
    for (int i = 0; i < TICK_N_IN; at += TICK_SIZE_IN[i++]) in[i] = at;
    if (TICK_STARTS[k]) memset(active_set, 0, sizeof(active_set));
    int status = tick(in, active_set, v, quantities);
    if (status == TICK_INVALID_INPUT) return 2;
    for (int i = 0; i < TICK_N_V; ++i) worst = fmax(worst, fabs(v[i] - TICK_VELOCITIES[k][i]));
  }
  printf("%d ticks, largest difference of a velocity %.3g\n", TICKS, worst);
  return worst <= 1e-12 ? 0 : 1;
}
