/* The active set as `solve_hierarchy`, whose state it is, and its certificate as external functions of CasADi. */

EXPORT int solve_hierarchy(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  double state[M] = {0}, v[N], residual[M], report[2];
  int iterations;
  (void)iw, (void)w, (void)mem;
  if (arg[STATE]) memcpy(state, arg[STATE], sizeof(state));
  report[0] = solve_levels(arg[JACOBIAN], arg[LOWER_BOUND], arg[UPPER_BOUND], arg[GATE], state, v, residual, &iterations);
  report[1] = iterations;
  pass_on(v, N, res[VELOCITY]);
  pass_on(state, M, res[STATE_OUT]);
  pass_on(report, 2, res[REPORT]);
  pass_on(residual, M, res[RESIDUAL]);
  return 0;
}

/* J (M, N), lower, upper, gate, v -> `normal_certificate` of certificate.py, infinite for invalid rows too. */
enum { GIVEN_GATE = UPPER_BOUND + 1, GIVEN_VELOCITY, CERTIFICATE_INPUTS };

EXPORT int active_set_certificate(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  Solver s;
  Rows rows = {arg[JACOBIAN], arg[LOWER_BOUND], arg[UPPER_BOUND], arg[GIVEN_GATE]};
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

EXPORT casadi_int active_set_certificate_n_in(void) { return CERTIFICATE_INPUTS; }
EXPORT casadi_int active_set_certificate_n_out(void) { return 1; }

EXPORT const casadi_int *active_set_certificate_sparsity_in(casadi_int i) {
  return i == GIVEN_VELOCITY ? solve_hierarchy_sparsity_out(VELOCITY) : solve_hierarchy_sparsity_in(i);
}

EXPORT const casadi_int *active_set_certificate_sparsity_out(casadi_int i) {
  static const casadi_int one[] = {1, 1, 1};
  (void)i;
  return one;
}

EXPORT int active_set_certificate_work(casadi_int *n_arg, casadi_int *n_res, casadi_int *n_iw, casadi_int *n_w) {
  *n_arg = CERTIFICATE_INPUTS, *n_res = 1, *n_iw = 0, *n_w = 0;
  return 0;
}
