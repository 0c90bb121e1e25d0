/* The solver and its certificate as external functions of CasADi: check and gate the rows; run warm, then cold. */

#ifndef casadi_int
#define casadi_int long long int
#endif
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { JACOBIAN, LOWER_BOUND, UPPER_BOUND, GATE, ACTIVE_SET, INPUTS };
enum { VELOCITY, ACTIVE_SET_OUT, REPORT, RESIDUAL, OUTPUTS };
/* Of the certificate, whose last input is a velocity. */
enum { GIVEN_VELOCITY = ACTIVE_SET };

/* `is_valid` of gated_rows.py. Comparisons with NaN are false. */
static int is_valid(const double *const *arg) {
  int wrong = 0;
  for (int i = 0; i < M * N; ++i) wrong |= !(fabs(arg[JACOBIAN][i]) < LARGEST);
  if (wrong) return 0;
  for (int row = 0; row < M; ++row) {
    double low = arg[LOWER_BOUND][row], up = arg[UPPER_BOUND][row], gate = arg[GATE][row];
    if (!(low <= up && low < INFINITY && up > -INFINITY && gate >= 0 && gate <= 1)) return 0;
  }
  return 1;
}

/* By how much `gated` of gated_rows.py moves the bounds of a row whose entries have the sum `range`. */
static double width_of(double range, double gate) {
  return gate >= 1 ? 0 : gate > 0 ? range * (sqrt(1 - gate) / sqrt(gate)) : INFINITY;
}

static void gate_bounds(Work *k, int row, double gate) {
  if (gate >= 1) return;
  double range = 0;
  for (int c = 0; c < N; ++c) range += fabs(k->a[row][c]);
  double width = width_of(range, gate);
  k->lower[row] -= width;
  k->upper[row] += width;
}

/* `LostRows.are_missed` of scaling.py; v as given. */
static int are_missed(const Work *k, const double *const *arg, const double *v) {
  for (int row = 0; row < M; ++row) {
    if (k->lost[row] == 0) continue;
    double y = 0, range = 0;
    for (int c = 0; c < N; ++c) {
      double entry = arg[JACOBIAN][c * M + row];
      y += entry * v[c], range += fabs(entry);
    }
    double width = width_of(range, arg[GATE][row]);
    double below = arg[LOWER_BOUND][row] - width - y, above = y - arg[UPPER_BOUND][row] - width;
    double missed = larger(larger(below, above), 0), nearer = smaller(missed, REACH * k->velocity * k->lost[row]);
    if (nearer > larger(UNNOTICED, CERTIFIED * missed)) return 1;
  }
  return 0;
}

/* The rows, gated, in normal units; nothing is known of any run. */
static void load(Work *k, const double *const *arg) {
  memset(k->decisive, 0, sizeof(k->decisive));
  for (int row = 0; row < M; ++row) {
    for (int c = 0; c < N; ++c) k->a[row][c] = arg[JACOBIAN][c * M + row];
    k->lower[row] = arg[LOWER_BOUND][row];
    k->upper[row] = arg[UPPER_BOUND][row];
    gate_bounds(k, row, arg[GATE][row]);
  }
  normalise(k);
  for (int row = 0; row < M; ++row) {
    double low = fabs(k->lower[row]), up = fabs(k->upper[row]);
    double size = larger(low < ENDLESS ? low : 0, up < ENDLESS ? up : 0);
    k->tolerance[row] = FEASIBLE * (k->norm[row] + size);
  }
}

static int is_finite(const double *x) {
  for (int c = 0; c < N; ++c)
    if (!(fabs(x[c]) < ENDLESS)) return 0;
  return 1;
}

static int attempt(Work *k, const double *state, double *iterations) {
  int count, outcome;
  start(k, state);
  outcome = run(k, &count);
  *iterations += count;
  if (!is_finite(k->v)) {
    memset(k->v, 0, sizeof(k->v));
    return LIMIT;
  }
  return certificate(k) <= CERTIFIED ? SOLVED : outcome;
}

static int is_warm(const double *state) {
  for (int row = 0; row < M; ++row)
    if (state && state[row] != 0) return 1;
  return 0;
}

/* `residual` of gated_rows.py. */
static void write_residual(const double *v, const double *const *arg, double *residual) {
  double y[M] = {0};
  for (int c = 0; c < N; ++c)
    for (int row = 0; row < M; ++row) y[row] += arg[JACOBIAN][c * M + row] * v[c];
  for (int row = 0; row < M; ++row) {
    double nearest = smaller(larger(y[row], arg[LOWER_BOUND][row]), arg[UPPER_BOUND][row]);
    residual[row] = arg[GATE][row] > 0 ? y[row] - nearest : 0;
  }
}

/* J (M, N) column-major, lower, upper, gate, active set
   -> v, active set, [outcome, iterations, 1 if started anew cold], distance of J v to [lower, upper] where gated in. */
EXPORT int lexls(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  static _Thread_local Work k;
  double report[3] = {INVALID, 0, 0};
  (void)iw, (void)w, (void)mem;
  for (int i = 0; i < OUTPUTS; ++i)
    if (res[i]) memset(res[i], 0, (i == VELOCITY ? N : i == REPORT ? 3 : M) * sizeof(double));
  if (is_valid(arg)) {
    load(&k, arg);
    report[0] = attempt(&k, arg[ACTIVE_SET], &report[1]);
    if (report[0] != SOLVED && is_warm(arg[ACTIVE_SET])) {
      report[2] = 1;
      report[0] = attempt(&k, 0, &report[1]);
    }
    for (int c = 0; c < N; ++c) k.v[c] *= k.velocity;
    if (!is_finite(k.v)) {
      memset(k.v, 0, sizeof(k.v));
      report[0] = LIMIT;
    }
    if (report[0] == SOLVED && are_missed(&k, arg, k.v)) report[0] = INCOMPLETE;
    if (res[VELOCITY]) memcpy(res[VELOCITY], k.v, sizeof(k.v));
    for (int row = 0; res[ACTIVE_SET_OUT] && row < M; ++row) res[ACTIVE_SET_OUT][row] = k.state[row];
    if (res[RESIDUAL]) write_residual(k.v, arg, res[RESIDUAL]);
  }
  if (res[REPORT]) memcpy(res[REPORT], report, sizeof(report));
  return 0;
}

/* J (M, N) column-major, lower, upper, gate, v -> `normal_certificate` of certificate.py, infinite for invalid rows too. */
EXPORT int lexls_certificate(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  static _Thread_local Work k;
  (void)iw, (void)w, (void)mem;
  if (!res[0]) return 0;
  res[0][0] = INFINITY;
  if (!is_valid(arg)) return 0;
  load(&k, arg);
  for (int c = 0; c < N; ++c) k.v[c] = arg[GIVEN_VELOCITY][c] / k.velocity;
  if (is_finite(k.v) && !are_missed(&k, arg, arg[GIVEN_VELOCITY])) res[0][0] = certificate(&k);
  return 0;
}

EXPORT casadi_int lexls_n_in(void) { return INPUTS; }
EXPORT casadi_int lexls_n_out(void) { return OUTPUTS; }

EXPORT const casadi_int *lexls_sparsity_in(casadi_int i) {
  static const casadi_int jacobian[] = {M, N, 1}, rows[] = {M, 1, 1};
  return i == JACOBIAN ? jacobian : rows;
}

EXPORT const casadi_int *lexls_sparsity_out(casadi_int i) {
  static const casadi_int velocity[] = {N, 1, 1}, rows[] = {M, 1, 1}, report[] = {3, 1, 1};
  return i == VELOCITY ? velocity : i == REPORT ? report : rows;
}

EXPORT int lexls_work(casadi_int *n_arg, casadi_int *n_res, casadi_int *n_iw, casadi_int *n_w) {
  *n_arg = INPUTS, *n_res = OUTPUTS, *n_iw = 0, *n_w = 0;
  return 0;
}

EXPORT casadi_int lexls_certificate_n_in(void) { return INPUTS; }
EXPORT casadi_int lexls_certificate_n_out(void) { return 1; }

EXPORT const casadi_int *lexls_certificate_sparsity_in(casadi_int i) {
  return i == GIVEN_VELOCITY ? lexls_sparsity_out(VELOCITY) : lexls_sparsity_in(i);
}

EXPORT const casadi_int *lexls_certificate_sparsity_out(casadi_int i) {
  static const casadi_int one[] = {1, 1, 1};
  (void)i;
  return one;
}

EXPORT int lexls_certificate_work(casadi_int *n_arg, casadi_int *n_res, casadi_int *n_iw, casadi_int *n_w) {
  *n_arg = INPUTS, *n_res = 1, *n_iw = 0, *n_w = 0;
  return 0;
}
