/* One tick: the levels of the tasks at the measured state, then the hierarchy solver. No allocation; libm only. */
#include "tick.h"

#include <math.h>
#include <string.h>

int levels(const double **arg, double **res, long long int *iw, double *w, int mem);
int lexls(const double **arg, double **res, long long int *iw, double *w, int mem);

/* One tick nearer to rest, as the controller in Python does where it has no solution. */
static void brake(const double *previous, double v[TICK_N_V]) {
  for (int i = 0; i < TICK_N_V; ++i) {
    double change = fmin(fmax(previous[i], -TICK_STEP[i]), TICK_STEP[i]);
    v[i] = isfinite(previous[i]) ? previous[i] - change : 0;
  }
}

/* Gives up level after level from below until the rest is solved, each time from a cold start. */
static int shorten(const double **rows, double **solution, double gate[TICK_N_ROWS]) {
  static const double cold[TICK_N_ROWS] = {0};
  const double *arg[5] = {rows[0], rows[1], rows[2], gate, cold};
  for (int level = TICK_N_LEVELS - 1; level > 0; --level) {
    for (int row = TICK_LEVEL_ENDS[level - 1]; row < TICK_LEVEL_ENDS[level]; ++row) gate[row] = 0;
    lexls(arg, solution, 0, 0, 0);
    if (solution[2][0] == TICK_CORE_SOLVED || solution[2][0] == TICK_CORE_INCOMPLETE) return TICK_SHORTENED;
  }
  return TICK_BRAKED;
}

int tick(const double *const in[TICK_N_IN], double active_set[TICK_N_ROWS], double v[TICK_N_V],
         double quantities[TICK_N_QUANTITIES]) {
  static _Thread_local double J[TICK_N_ROWS * TICK_N_V], lower[TICK_N_ROWS], upper[TICK_N_ROWS], gate[TICK_N_ROWS];
  static _Thread_local double reached[TICK_N_ROWS], w[TICK_SZ_W];
  static _Thread_local long long int iw[TICK_SZ_IW];
  const double *arg[TICK_SZ_ARG] = {0}, *rows[5] = {J, lower, upper, gate, active_set};
  double *res[TICK_SZ_RES] = {J, lower, upper, 0, 0, gate, quantities};
  double report[3] = {TICK_CORE_INVALID, 0, 0}, *solution[4] = {v, reached, report, 0};
  int status = TICK_INVALID_INPUT;
  for (int i = 0; i < TICK_N_IN; ++i) arg[i] = in[i];
  memset(reached, 0, sizeof(reached));
  if (levels(arg, res, iw, w, 0) == 0) lexls(rows, solution, 0, 0, 0);
  if (report[0] == TICK_CORE_SOLVED)
    status = TICK_SOLVED;
  else if (report[0] == TICK_CORE_INCOMPLETE)
    status = TICK_INCOMPLETE;
  else if (report[0] != TICK_CORE_INVALID)
    status = shorten(rows, solution, gate);
  if (status == TICK_BRAKED || status == TICK_INVALID_INPUT) brake(in[TICK_PREVIOUS], v);
  memcpy(active_set, reached, sizeof(reached));
  return status;
}
