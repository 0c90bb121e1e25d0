/* Replays the recorded ticks of ticks.h, counts what they come to, and compares.

   Exit code 0 if every velocity that is exact in Python and found here agrees to 1e-9; ticks that are not solved are told. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tick.h"
#include "ticks.h"

int main(void) {
  double active_set[TICK_N_ROWS] = {0}, v[TICK_N_V], quantities[TICK_N_QUANTITIES], worst = 0, apart = 0;
  int count[TICK_N_STATUSES] = {0}, compared = 0;
  for (int k = 0; k < TICKS; ++k) {
    const double *in[TICK_N_IN], *at = TICK_INPUTS[k];
    double difference = 0;
    for (int i = 0; i < TICK_N_IN; at += TICK_SIZE_IN[i++]) in[i] = at;
    if (TICK_STARTS[k]) memset(active_set, 0, sizeof(active_set));
    int status = tick(in, active_set, v, quantities);
    for (int i = 0; i < TICK_N_V; ++i) difference = fmax(difference, fabs(v[i] - TICK_VELOCITIES[k][i]));
    ++count[status];
    if (status != TICK_INVALID_INPUT && TICK_EXACT[k])
      ++compared, worst = fmax(worst, difference);
    else
      apart = fmax(apart, difference);
  }
  for (int status = 0; status < TICK_N_STATUSES; ++status)
    if (count[status]) printf("%d of %d ticks %s\n", count[status], TICKS, TICK_MEANING[status]);
  printf("largest difference from Python: %.3g of the %d that are exact", worst, compared);
  if (compared < TICKS) printf(", %.3g of the others", apart);
  printf("\n");
  return worst <= 1e-9 ? 0 : 1;
}
