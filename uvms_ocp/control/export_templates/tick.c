/* One tick: the levels of the tasks at the measured state, then the hierarchy solver. No allocation; libm only. */
#include "tick.h"

#include <string.h>

int levels(const double **arg, double **res, long long int *iw, double *w, int mem);
int lexls(const double **arg, double **res, long long int *iw, double *w, int mem);

int tick(const double *const in[TICK_N_IN], double active_set[TICK_N_ROWS], double v[TICK_N_V],
         double quantities[TICK_N_QUANTITIES]) {
  static _Thread_local double J[TICK_N_ROWS * TICK_N_V], lower[TICK_N_ROWS], upper[TICK_N_ROWS], gate[TICK_N_ROWS];
  static _Thread_local double reached[TICK_N_ROWS], w[TICK_SZ_W];
  static _Thread_local long long int iw[TICK_SZ_IW];
  const double *arg[TICK_SZ_ARG] = {0}, *rows[5] = {J, lower, upper, gate, active_set};
  double *res[TICK_SZ_RES] = {J, lower, upper, 0, 0, gate, quantities};
  double report[3], *solution[4] = {v, reached, report, 0};
  for (int i = 0; i < TICK_N_IN; ++i) arg[i] = in[i];
  memset(v, 0, TICK_N_V * sizeof(double));
  if (levels(arg, res, iw, w, 0) != 0) return TICK_INVALID_INPUT;
  lexls(rows, solution, 0, 0, 0);
  if (report[0] == TICK_CORE_INVALID) return TICK_INVALID_INPUT;
  memcpy(active_set, reached, sizeof(reached));
  return report[0] == TICK_CORE_SOLVED ? TICK_SOLVED : TICK_NOT_CERTAIN;
}
