/* One tick: the levels of the tasks at the measured state, then the hierarchy solver. No allocation; libm only. */
#include "tick.h"

#include <math.h>
#include <string.h>

int levels(const double **arg, double **res, long long int *iw, double *w, int mem);

/* One tick nearer to rest, as the controller in Python does where it has no solution. */
static void brake(const double *previous, double v[TICK_N_V]) {
  for (int i = 0; i < TICK_N_V; ++i) {
    double change = fmin(fmax(previous[i], -TICK_STEP[i]), TICK_STEP[i]);
    v[i] = isfinite(previous[i]) ? previous[i] - change : 0;
  }
}

int tick(const double *const in[TICK_N_IN], double active_set[TICK_N_ROWS], double v[TICK_N_V],
         double quantities[TICK_N_QUANTITIES]) {
  static _Thread_local double J[TICK_N_ROWS * TICK_N_V], lower[TICK_N_ROWS], upper[TICK_N_ROWS], gate[TICK_N_ROWS];
  static _Thread_local double residual[TICK_N_ROWS], w[TICK_SZ_W];
  static _Thread_local long long int iw[TICK_SZ_IW];
  const double *arg[TICK_SZ_ARG] = {0};
  double *res[TICK_SZ_RES] = {J, lower, upper, 0, 0, gate, quantities};
  int status = TICK_INVALID_INPUT, iterations;
  for (int i = 0; i < TICK_N_IN; ++i) arg[i] = in[i];
  if (levels(arg, res, iw, w, 0) == 0) status = solve_levels(J, lower, upper, gate, active_set, v, residual, &iterations);
  if (status == TICK_INVALID_INPUT) brake(in[TICK_PREVIOUS], v);
  return status;
}
