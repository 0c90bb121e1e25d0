/* One tick: the levels of the tasks at the measured state, then the hierarchy solver. No allocation; libm only. */
#include "tick.h"

#include <string.h>

int levels(const double **arg, double **res, long long int *iw, double *w, int mem);
int lexls(const double **arg, double **res, long long int *iw, double *w, int mem);

int tick(const double *const in[TICK_N_IN], double active_set[TICK_N_ROWS], double v[TICK_N_V],
         double quantities[TICK_N_QUANTITIES]) {
  static _Thread_local double valid[1], J[TICK_N_ROWS * TICK_N_V], low[TICK_N_ROWS], up[TICK_N_ROWS];
  static _Thread_local double reached[TICK_N_ROWS], w[TICK_SZ_W];
  static _Thread_local long long int iw[TICK_SZ_IW];
  const double *arg[TICK_SZ_ARG] = {0}, *rows[4] = {J, low, up, active_set};
  double *res[TICK_SZ_RES] = {valid, J, low, up, 0, 0, 0, quantities}, report[3], *solution[3] = {v, reached, report};
  for (int i = 0; i < TICK_N_IN; ++i) arg[i] = in[i];
  if (levels(arg, res, iw, w, 0) != 0 || valid[0] == 0) {
    memset(v, 0, TICK_N_V * sizeof(double));
    return TICK_INVALID_INPUT;
  }
  lexls(rows, solution, 0, 0, 0);
  memcpy(active_set, reached, sizeof(reached));
  return report[0] == 0 ? TICK_SOLVED : TICK_NOT_CERTAIN;
}
