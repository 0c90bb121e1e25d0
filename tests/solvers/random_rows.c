/* Calls `solve_levels`, in front of which this is put, with 10,000 random hierarchies and checks what it promises of any.

   Every second one holds numbers that are none, or endless, or larger or smaller than squares can be; many rows are copies and
   combinations of others, which cycle. Prints how often each status came and the most iterations; exit code 1 for a broken promise. */
#include <stdio.h>

static unsigned long long seed = 88172645463325252ull;

static double uniform(void) {
  seed ^= seed << 13, seed ^= seed >> 7, seed ^= seed << 17;
  return (double)(seed >> 11) / 9007199254740992.0;
}

static int below(int n) { return (int)(uniform() * n); }

static double wild(void) {
  static const double NUMBERS[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e300, 1e15, -1e14, 1e-300, 5e-324, -0.0, 0.0, 1.0};
  return NUMBERS[below(sizeof(NUMBERS) / sizeof(*NUMBERS))];
}

static void fill_row(double *J, int row) {
  int copied = row > 0 ? below(row) : -1, kind = below(4);
  double factor = below(3) - 1, tilt = kind == 3 ? 1e-7 : 0;
  for (int c = 0; c < N; ++c)
    J[c * M + row] = kind < 2 || copied < 0 ? below(5) - 2 : factor * J[c * M + copied] + tilt * uniform();
}

static void fill_bounds(double *lower, double *upper, int row) {
  int kind = below(4);
  lower[row] = kind == 3 ? -INFINITY : below(7) - 3;
  upper[row] = kind == 0 ? lower[row] : kind == 1 ? INFINITY : kind == 2 ? lower[row] + below(3) : below(7) - 3;
}

static void spoil(double *values, int n, int every) {
  for (int i = 0; i < n; ++i)
    if (below(every) == 0) values[i] = wild();
}

int main(void) {
  static double J[M * N], lower[M], upper[M], gate[M], active_set[M], v[N], residual[M];
  int count[INVALID_INPUT + 1] = {0}, most = 0, iterations = 0;
  for (int trial = 0; trial < 10000; ++trial) {
    for (int row = 0; row < M; ++row) {
      fill_row(J, row), fill_bounds(lower, upper, row);
      gate[row] = below(4) ? 1 : below(2) ? uniform() : 0;
    }
    if (trial % 2) {
      spoil(J, M * N, 4 * M * N), spoil(lower, M, 4 * M), spoil(upper, M, 4 * M), spoil(gate, M, 8 * M);
      if (trial % 8 == 1) spoil(active_set, M, 4);
    }
    int status = solve_levels(J, lower, upper, gate, active_set, v, residual, &iterations);
    if (status < 0 || status > INVALID_INPUT || iterations < 0 || iterations > MOST_OF_ALL) return 1;
    for (int c = 0; c < N; ++c)
      if (!(fabs(v[c]) < ENDLESS) || (status == INVALID_INPUT && v[c] != 0)) return 1;
    for (int row = 0; row < M; ++row)
      if (!(fabs(active_set[row]) <= EQUAL)) return 1;
    ++count[status];
    if (iterations > most) most = iterations;
  }
  for (int status = 0; status <= INVALID_INPUT; ++status) printf("%d ", count[status]);
  printf("%d %d\n", most, MOST_OF_ALL);
  return 0;
}
