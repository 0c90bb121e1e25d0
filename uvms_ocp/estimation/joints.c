/* The joints, each a filter of its own. joints.py is the same; keep both in step. */

#define JP(j, a, b) (m_joint_P[((j) * JOINT_STATES + (a)) * JOINT_STATES + (b)])
#define JX(j, a) (m_joint_x[2 * (j) + (a)])
#define OF(name, j, slot) (m_joint_##name[(j) * JOINT_SLOTS + (slot)])

static int top_of_joints(const double *m) {
  int slot = JOINT_SLOTS - 1;
  while (slot >= 0 && m_joint_owner[slot] < 0) --slot;
  return 3 + slot;
}

static void clear_joint(double *m, int j, int i, double variance) {
  for (int k = 0; k < JOINT_STATES; ++k) JP(j, i, k) = JP(j, k, i) = 0;
  JP(j, i, i) = variance;
}

/* As `limit_to` of its velocity. */
static void limit_joint(double *m, int j, double variance) {
  double share = sqrt(variance / JP(j, 1, 1));
  for (int k = 0; k < JOINT_STATES; ++k) JP(j, 1, k) *= share;
  for (int k = 0; k < JOINT_STATES; ++k) JP(j, k, 1) *= share;
  JP(j, 1, 1) = variance;
}

static void predict_joints(double *m) {
  double dt = m_dt[0], h = smaller_of(dt, LONGEST_STEP), drive = m_drive[NOISE_JOINT] * m_drive[NOISE_JOINT];
  int n = top_of_joints(m);
  for (int j = 0; j < N_JOINTS; ++j) {
    if (m_has_command[0]) {
      double change = m_commanded[6 + j] - m_commanded_rates[j];
      JX(j, 1) += change, JP(j, 1, 1) += response_variance(m, change), m_commanded_rates[j] = m_commanded[6 + j];
    }
    if (!(dt > 0)) continue;
    JX(j, 0) += h * JX(j, 1);
    for (int k = 0; k < n; ++k) JP(j, 0, k) += h * JP(j, 1, k);
    for (int k = 0; k < n; ++k) JP(j, k, 0) += h * JP(j, k, 1);
    JP(j, 0, 0) += drive * (dt * dt * dt / 3), JP(j, 1, 1) += drive * dt;
    JP(j, 0, 1) += drive * (dt * dt / 2), JP(j, 1, 0) += drive * (dt * dt / 2);
    for (int i = 0; i < 2; ++i) {
      double most = m_joint_limit[i] * m_joint_limit[i];
      int lost = !isfinite(JX(j, i));
      if (!lost && is_known(JP(j, i, i), most)) continue;
      if (i == 1 && !lost && JP(j, 1, 1) > 0 && isfinite(JP(j, 1, 1))) limit_joint(m, j, most);
      else clear_joint(m, j, i, most);
      if (lost || i == 1) JX(j, i) = 0;
    }
  }
}

static void set_joint(double *m, int j) {
  int c = CHANNEL_JOINT_POSITIONS;
  double age = m_now[0] - m_stamp[c];
  JX(j, 0) = m_joint_value[j] + age * JX(j, 1);
  clear_joint(m, j, 0, m_sigma[c] * m_sigma[c] + age * age * JP(j, 1, 1));
}

static double joint_h(const double *m, int j, int k, int slot) { return slot < 0 ? JX(j, k) : OF(h, j, slot); }
static double joint_rate(const double *m, int j, int k, int slot) {
  return slot >= 0 ? OF(rate, j, slot) : k ? 0 : JX(j, 1);
}
static double joint_rate_variance(const double *m, int j, int k, int slot) {
  return slot >= 0 ? OF(rate_variance, j, slot) : k ? 0 : JP(j, 1, 1);
}

static int joint_convinces(double *m, int c, int j, double nu, double S) {
  int at = (c - CHANNEL_JOINT_POSITIONS) * N_JOINTS + j;
  double *since = m_joint_since + at, *refused = m_joint_refused + at, change = nu - *refused;
  int agrees = isfinite(*since) && change * change <= m_gate[c] * S;
  if (!agrees) *since = m_stamp[c];
  *refused = nu;
  return agrees && m_stamp[c] - *since >= m_recovery[c] - EARLY;
}

static void correct_joint(double *m, int j, int state, double nu, double own, int n) {
  double gain[JOINT_STATES], row[JOINT_STATES], S = JP(j, state, state) + own;
  for (int a = 0; a < n; ++a) row[a] = JP(j, state, a), gain[a] = JP(j, a, state) / S;
  for (int a = 0; a < n; ++a)
    for (int b = 0; b < n; ++b) JP(j, a, b) -= gain[a] * row[b];
  for (int a = 0; a < 2; ++a) JX(j, a) += gain[a] * nu;
  for (int slot = 0; slot < n - 2; ++slot) OF(h, j, slot) += gain[2 + slot] * nu;
}

static void inflate_joint(double *m, int j, int c, double variance) {
  int k = c - CHANNEL_JOINT_POSITIONS, owned[JOINT_STATES], count = 0;
  owned[count++] = k;
  for (int slot = 0; slot < JOINT_SLOTS; ++slot)
    if (m_joint_owner[slot] == c) owned[count++] = 2 + slot;
  for (int a = 0; a < count; ++a)
    for (int b = 0; b < count; ++b) JP(j, owned[a], owned[b]) += variance;
}

static void yield_joint(double *m, int j, int c, double squared) {
  for (int slot = 0; slot < JOINT_SLOTS; ++slot)
    if (m_joint_owner[slot] != c) m_joint_owner[slot] = -1;
  inflate_joint(m, j, c, GATE_RELAXATION * squared);
  m_joint_since[(c - CHANNEL_JOINT_POSITIONS) * N_JOINTS + j] = NAN;
}

static void surprise_joint(double *m, int j, int c, double squared) {
  double time = time_since_accepted(m, c);
  inflate_joint(m, j, c, squared);
  if (c == CHANNEL_JOINT_POSITIONS) JP(j, 1, 1) += squared / (time * time);
}

/* Beside what accelerations can do, a joint may stop. */
static double joint_allowance(const double *m, int c, double rate) {
  double stop = fabs(rate) * (c == CHANNEL_JOINT_POSITIONS ? time_since_accepted(m, c) : 1), granted = sqrt(gate_allowance(m, c)) + stop / 5;
  return granted * granted;
}

static void judge_joints(double *m, int c, int slot, double delta, const char *done) {
  int k = c - CHANNEL_JOINT_POSITIONS, state = slot < 0 ? k : 2 + slot, n = top_of_joints(m), all = 1, degrees = 0;
  double total = 0, walk = k ? m_drive[NOISE_JOINT] * m_drive[NOISE_JOINT] : 0;
  for (int j = 0; j < N_JOINTS; ++j) {
    if (done[j]) {
      m_joint_since[k * N_JOINTS + j] = NAN;
      continue;
    }
    double variance = joint_rate_variance(m, j, k, slot), own = m_sigma[c] * m_sigma[c] + delta * delta * larger_of(0, variance) + fabs(delta) * walk;
    double nu = m_joint_value[k * N_JOINTS + j] - joint_h(m, j, k, slot) - delta * joint_rate(m, j, k, slot);
    double S = JP(j, state, state) + own;
    double granted = joint_allowance(m, c, k ? joint_h(m, j, k, slot) : joint_rate(m, j, k, slot));
    int believed = nu * nu <= m_gate[c] * (S + granted);
    total += nu * nu / S, ++degrees;
    if (believed) {
      m_joint_since[k * N_JOINTS + j] = NAN;
      if (nu * nu / S > m_gate[c]) surprise_joint(m, j, c, nu * nu);
    } else if (joint_convinces(m, c, j, nu, S + own + granted)) believed = 1, yield_joint(m, j, c, nu * nu);
    if (believed) correct_joint(m, j, state, nu, own, n);
    all &= believed;
  }
  note(m, c, total, degrees, all);
}

static void take_joints(double *m, int c) {
  int k = c - CHANNEL_JOINT_POSITIONS, slot, count = 0;
  double delta, limit = UNKNOWN * m_joint_limit[0] * m_joint_limit[0];
  char unknown[N_JOINTS + 1] = {0};
  if (!is_of_now(m, c)) return;
  for (int j = 0; j < N_JOINTS; ++j)
    if (!(fabs(m_joint_value[k * N_JOINTS + j]) <= LARGEST)) return;
  m_last[c] = m_stamp[c];
  update_lag(m, c);
  for (int j = 0; j < N_JOINTS; ++j)
    if (!k && JP(j, 0, 0) > limit) unknown[j] = 1, ++count, set_joint(m, j);
  for (slot = 0; count && slot < JOINT_SLOTS; ++slot)
    if (m_joint_owner[slot] == c) m_joint_owner[slot] = -1;
  int near = nearest(m, c, m_joint_owner, m_joint_taken, JOINT_SLOTS, &slot, &delta);
  if (count == N_JOINTS) m_used[c] = m_stamp[c];
  else if (near) judge_joints(m, c, slot, delta, unknown);
}

static void clone_joints(double *m, int c) {
  int slot = free_slot(m_joint_owner, JOINT_SLOTS), k = c - CHANNEL_JOINT_POSITIONS, at = 2 + slot;
  if (slot < 0) return;
  m_joint_owner[slot] = c, m_joint_taken[slot] = m_now[0];
  for (int j = 0; j < N_JOINTS; ++j) {
    OF(h, j, slot) = joint_h(m, j, k, -1), OF(rate, j, slot) = joint_rate(m, j, k, -1);
    OF(rate_variance, j, slot) = joint_rate_variance(m, j, k, -1);
    for (int a = 0; a < JOINT_STATES; ++a) JP(j, at, a) = JP(j, k, a);
    for (int a = 0; a < JOINT_STATES; ++a) JP(j, a, at) = JP(j, a, k);
    JP(j, at, at) = JP(j, k, k);
  }
}

static void fuse_joints(double *m) {
  space_clones(m, CHANNEL_JOINT_POSITIONS, N_CHANNELS, JOINT_SLOTS);
  for (int c = CHANNEL_JOINT_POSITIONS; c < N_CHANNELS; ++c)
    if (m_fresh[c]) take_joints(m, c);
  for (int c = CHANNEL_JOINT_POSITIONS; c < N_CHANNELS; ++c) {
    if (m_lag[c] <= 0) continue;
    expire(m, c, m_joint_owner, m_joint_taken, JOINT_SLOTS);
    if (is_due(m, c)) clone_joints(m, c);
  }
}
