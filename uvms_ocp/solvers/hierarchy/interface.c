/* A solver of hierarchies, `solve_hierarchy` for N velocities and M rows, as an external function of CasADi:
   J (M, N), lower, upper, rate, activation, gate, state -> v, state, [code of the status, iterations], residual. */

#ifndef casadi_int
#define casadi_int long long int
#endif
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { JACOBIAN, LOWER_BOUND, UPPER_BOUND, RATE, ACTIVATION, GATE, STATE, INPUTS };
enum { VELOCITY, STATE_OUT, REPORT, RESIDUAL, OUTPUTS };

static void pass_on(const double *found, int n, double *to) {
  if (to) memcpy(to, found, n * sizeof(double));
}

EXPORT casadi_int solve_hierarchy_n_in(void) { return INPUTS; }
EXPORT casadi_int solve_hierarchy_n_out(void) { return OUTPUTS; }

EXPORT const casadi_int *solve_hierarchy_sparsity_in(casadi_int i) {
  static const casadi_int jacobian[] = {M, N, 1}, rows[] = {M, 1, 1};
  return i == JACOBIAN ? jacobian : rows;
}

EXPORT const casadi_int *solve_hierarchy_sparsity_out(casadi_int i) {
  static const casadi_int velocity[] = {N, 1, 1}, rows[] = {M, 1, 1}, report[] = {2, 1, 1};
  return i == VELOCITY ? velocity : i == REPORT ? report : rows;
}

EXPORT int solve_hierarchy_work(casadi_int *n_arg, casadi_int *n_res, casadi_int *n_iw, casadi_int *n_w) {
  *n_arg = INPUTS, *n_res = OUTPUTS, *n_iw = 0, *n_w = 0;
  return 0;
}
