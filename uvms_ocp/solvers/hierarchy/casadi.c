/* The solver and its certificate as external functions of CasADi. */

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

static void pass_on(const double *found, int n, double *to) {
  if (to) memcpy(to, found, n * sizeof(double));
}

/* J (M, N), lower, upper, gate, active set -> v, active set, [code of the status, iterations], residual: `solve_levels`. */
EXPORT int active_set(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  double state[M] = {0}, v[N], residual[M], report[2];
  int iterations;
  (void)iw, (void)w, (void)mem;
  if (arg[ACTIVE_SET]) memcpy(state, arg[ACTIVE_SET], sizeof(state));
  report[0] = solve_levels(arg[JACOBIAN], arg[LOWER_BOUND], arg[UPPER_BOUND], arg[GATE], state, v, residual, &iterations);
  report[1] = iterations;
  pass_on(v, N, res[VELOCITY]);
  pass_on(state, M, res[ACTIVE_SET_OUT]);
  pass_on(report, 2, res[REPORT]);
  pass_on(residual, M, res[RESIDUAL]);
  return 0;
}

/* J (M, N), lower, upper, gate, v -> `normal_certificate` of certificate.py, infinite for invalid rows too. */
EXPORT int active_set_certificate(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  Solver s;
  Rows rows = {arg[JACOBIAN], arg[LOWER_BOUND], arg[UPPER_BOUND], arg[GATE]};
  (void)iw, (void)w, (void)mem;
  if (!res[0]) return 0;
  res[0][0] = INFINITY;
  if (!is_valid(&rows)) return 0;
  load(&s.work, &rows);
  memset(s.work.decisive, 0, sizeof(s.work.decisive));
  for (int c = 0; c < N; ++c) s.work.v[c] = arg[GIVEN_VELOCITY][c] / s.work.velocity;
  if (is_finite(s.work.v) && !are_missed(&s.work, &rows, arg[GIVEN_VELOCITY]))
    res[0][0] = certificate(&s.proof, &s.work);
  return 0;
}

EXPORT casadi_int active_set_n_in(void) { return INPUTS; }
EXPORT casadi_int active_set_n_out(void) { return OUTPUTS; }

EXPORT const casadi_int *active_set_sparsity_in(casadi_int i) {
  static const casadi_int jacobian[] = {M, N, 1}, rows[] = {M, 1, 1};
  return i == JACOBIAN ? jacobian : rows;
}

EXPORT const casadi_int *active_set_sparsity_out(casadi_int i) {
  static const casadi_int velocity[] = {N, 1, 1}, rows[] = {M, 1, 1}, report[] = {2, 1, 1};
  return i == VELOCITY ? velocity : i == REPORT ? report : rows;
}

EXPORT int active_set_work(casadi_int *n_arg, casadi_int *n_res, casadi_int *n_iw, casadi_int *n_w) {
  *n_arg = INPUTS, *n_res = OUTPUTS, *n_iw = 0, *n_w = 0;
  return 0;
}

EXPORT casadi_int active_set_certificate_n_in(void) { return INPUTS; }
EXPORT casadi_int active_set_certificate_n_out(void) { return 1; }

EXPORT const casadi_int *active_set_certificate_sparsity_in(casadi_int i) {
  return i == GIVEN_VELOCITY ? active_set_sparsity_out(VELOCITY) : active_set_sparsity_in(i);
}

EXPORT const casadi_int *active_set_certificate_sparsity_out(casadi_int i) {
  static const casadi_int one[] = {1, 1, 1};
  (void)i;
  return one;
}

EXPORT int active_set_certificate_work(casadi_int *n_arg, casadi_int *n_res, casadi_int *n_iw, casadi_int *n_w) {
  *n_arg = INPUTS, *n_res = 1, *n_iw = 0, *n_w = 0;
  return 0;
}
