/* One tick as an external function of CasADi: the memory in, the memory out, which may be the same. See core.py. */

#ifndef casadi_int
#define casadi_int long long int
#endif
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

static void tell_vehicle(double *m) {
  double R[9];
  static _Thread_local PredictedMeasurement s;
  matrix_of(m_turn, R);
  rotate_back(R, X(PART_SPEED), m_twist);
  for (int i = 0; i < 3; ++i) {
    m_twist[3 + i] = X(PART_SPIN)[i];
    m_std[i] = sqrt(larger_of(0, AT(PART_PLACE + i, PART_PLACE + i)));
    m_std[3 + i] = sqrt(larger_of(0, AT(PART_TURN + i, PART_TURN + i)));
  }
  predict_measurement(m, CHANNEL_ALTIMETER_RANGE, MAIN, &s);
  int has_floor = s.h[1] > STEEP && m_now[0] - m_echo[0] <= m_echo_memory[0];
  m_range[0] = has_floor ? s.h[0] / s.h[1] : NAN;
  m_range[1] = has_floor ? sqrt(larger_of(0, s.S[0][0])) / s.h[1] : NAN;
}

static void tick(double *m) {
  m_dt[0] = m_started[0] ? m_now[0] - m_before[0] : 0;
  m_started[0] = 1, m_before[0] = m_now[0];
  if (m_floating[0]) predict(m), fuse(m), tell_vehicle(m);
  predict_joints(m), fuse_joints(m);
  for (int j = 0; j < N_JOINTS; ++j) m_std[6 + j] = sqrt(larger_of(0, JP(j, 0, 0)));
  m_age[0] = 0, m_age[1] = larger_of(0, m_now[0] - m_used[CHANNEL_JOINT_POSITIONS]);
  for (int c = 0; c < N_CHANNELS; ++c) {
    if (m_needed[c] > 0) m_age[0] = larger_of(m_age[0], m_now[0] - m_used[c]);
    m_fresh[c] = 0;
  }
}

EXPORT int navigation_filter(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  (void)iw, (void)w, (void)mem;
  if (res[0] != arg[0]) memcpy(res[0], arg[0], SIZE * sizeof(double));
  tick(res[0]);
  return 0;
}

EXPORT casadi_int navigation_filter_n_in(void) { return 1; }
EXPORT casadi_int navigation_filter_n_out(void) { return 1; }

EXPORT const casadi_int *navigation_filter_sparsity_in(casadi_int i) {
  static const casadi_int memory[] = {SIZE, 1, 1};
  (void)i;
  return memory;
}

EXPORT const casadi_int *navigation_filter_sparsity_out(casadi_int i) { return navigation_filter_sparsity_in(i); }
