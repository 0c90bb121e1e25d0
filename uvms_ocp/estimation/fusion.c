/* Readings of the vehicle's channels. fusion.py is the same; keep both in step. */

static const int own_part[] = {PART_TURN, PART_SPIN, PART_PLACE, PART_PLACE + 2, PART_SPEED, PART_ACCELERATION, PART_FLOOR};

static int is_turning(int c) { return c >= CHANNEL_LINEAR_VELOCITY; }
static int is_body(int c) { return c == CHANNEL_LINEAR_VELOCITY || c == CHANNEL_SPECIFIC_FORCE; }
static int sets(int c) {
  return c == CHANNEL_ATTITUDE || c == CHANNEL_POSITION || c == CHANNEL_DEPTH || c == CHANNEL_ALTIMETER_RANGE;
}

static int is_usable(const double *m, int c) {
  const double *value = m_value + 4 * c;
  if (!is_of_now(m, c)) return 0;
  if (c == CHANNEL_ALTIMETER_RANGE) return isnan(value[0]) || (value[0] >= 0 && value[0] <= LARGEST);
  for (int i = 0; i < rows_of[c]; ++i)
    if (!(fabs(value[i]) <= LARGEST)) return 0;
  return c != CHANNEL_ATTITUDE || fabs(norm4(value) - 1) <= UNIT;
}

/* Second derivative of what a channel that sets a part sees. */
static double second_derivative(const double *m, int c, int i) {
  if (c == CHANNEL_ATTITUDE) return X(PART_SPIN_UP)[i];
  return X(PART_ACCELERATION)[rows_of[c] == 3 ? i : 2];
}

/* Variance of the way since a reading of that age. */
static double process_variance(const double *m, int c, const PredictedMeasurement *s, double age) {
  int turns = c == CHANNEL_ATTITUDE;
  double drive = m_drive[turns ? NOISE_ANGULAR_JERK : NOISE_JERK], squared = age * age;
  double second = mean_variance(m, turns ? PART_SPIN_UP : PART_ACCELERATION);
  return squared * s->rate_variance + squared * squared / 4 * second + drive * drive * squared * squared * age / 20;
}

static void set_floor(double *m, const PredictedMeasurement *s, double age, int n) {
  int at = PART_FLOOR, c = CHANNEL_ALTIMETER_RANGE;
  double cosine = s->h[1], row[STATES], noise = cosine * m_sigma[c], R[9], arm = 0;
  if (cosine <= STEEP) return;
  matrix_of(m_turn, R);
  for (int i = 0; i < 3; ++i) arm += R[6 + i] * m_beam_at[i];
  double late = process_variance(m, c, s, age), moved = age * s->rate[0] - age * age / 2 * second_derivative(m, c, 0);
  X(at)[0] = X(PART_PLACE)[2] + arm - (cosine * m_value[4 * c] + moved);
  double own = s->S[0][0] + 2 * s->HP[0][at] + AT(at, at);
  for (int j = 0; j < n; ++j) row[j] = s->HP[0][j] + ENTRY(at, j);
  for (int j = 0; j < at; ++j) AT(j, at) = row[j];
  for (int j = at; j < n; ++j) AT(at, j) = row[j];
  AT(at, at) = own + noise * noise + late;
  m_echo[0] = m_stamp[CHANNEL_ALTIMETER_RANGE];
}

/* The first reading is taken for the truth, unless it is too old to be; nothing that was cloned before can be right. */
static void set(double *m, int c, PredictedMeasurement *s) {
  int n = active(m), first = own_part[c];
  double age = m_now[0] - m_stamp[c], noise = m_sigma[c] * m_sigma[c], *value = m_value + 4 * c;
  predict_measurement(m, c, n, s);
  if (noise + process_variance(m, c, s, age) > UNKNOWN * m_limit[first] * m_limit[first]) return;
  for (int slot = 0; slot < SLOTS; ++slot) m_owner[slot] = -1;
  n = active(m), predict_measurement(m, c, n, s);
  m_used[c] = m_stamp[c];
  if (c == CHANNEL_ALTIMETER_RANGE) {
    set_floor(m, s, age, n);
    return;
  }
  double moved[3], late = process_variance(m, c, s, age);
  for (int i = 0; i < 3; ++i) moved[i] = age * s->rate[i] - age * age / 2 * second_derivative(m, c, i);
  for (int i = 0; i < rows_of[c]; ++i) clear(m, first + i, n, noise + late);
  if (c == CHANNEL_ATTITUDE) {
    double norm = norm4(value);
    for (int i = 0; i < 4; ++i) m_turn[i] = value[i] / norm;
    turn_by(m_turn, moved);
    return;
  }
  for (int i = 0; i < rows_of[c]; ++i) X(first)[i] = value[i] + moved[i];
}

/* Innovation: measured minus predicted, extrapolated by delta. */
static void innovation(const double *m, int c, const PredictedMeasurement *s, double delta, double *nu) {
  const double *value = m_value + 4 * c;
  if (c != CHANNEL_ATTITUDE) {
    double scale = c == CHANNEL_ALTIMETER_RANGE ? s->h[1] : 1;
    for (int i = 0; i < rows_of[c]; ++i) nu[i] = value[i] * scale - s->h[i] - delta * s->rate[i];
    return;
  }
  double by[3], h[4], back[4], error[4];
  memcpy(h, s->h, sizeof(h));
  for (int i = 0; i < 3; ++i) by[i] = delta * s->rate[i];
  turn_by(h, by);
  for (int i = 0; i < 4; ++i) back[i] = i < 3 ? -h[i] : h[i];
  multiply(back, value, error);
  double sign = error[3] < 0 ? -1 : 1, norm = norm4(value);
  for (int i = 0; i < 4; ++i) error[i] *= sign / norm;
  double sine = sqrt(error[0] * error[0] + error[1] * error[1] + error[2] * error[2]);
  double share = sine > 1e-6 ? 2 * atan2(sine, error[3]) / sine : 2;
  for (int i = 0; i < 3; ++i) nu[i] = share * error[i];
}

static double noise_of(const double *m, int c, const PredictedMeasurement *s, double delta) {
  double sigma = m_sigma[c] * (c == CHANNEL_ALTIMETER_RANGE ? s->h[1] : 1);
  double walk = c == CHANNEL_SPECIFIC_FORCE ? m_drive[NOISE_JERK] * m_drive[NOISE_JERK] : 0;
  return sigma * sigma + delta * delta * larger_of(0, s->rate_variance) + fabs(delta) * walk;
}

static double squared_of(const PredictedMeasurement *s, double more, int n, const double *nu) {
  double L[3][3], x[3] = {0}, sum = 0;
  memcpy(x, nu, n * sizeof(double));
  factor(s, more, n, L), divide(L, n, x);
  for (int i = 0; i < n; ++i) sum += x[i] * x[i];
  return sum;
}

static int is_convincing(double *m, int c, const PredictedMeasurement *s, double more, const double *nu) {
  double change[3], *refused = m_refused + 3 * c;
  int rows = rows_of[c];
  for (int i = 0; i < rows; ++i) change[i] = nu[i] - refused[i];
  int agrees = isfinite(m_since[c]) && squared_of(s, more, rows, change) <= m_gate[c];
  if (!agrees) m_since[c] = m_stamp[c];
  memcpy(refused, nu, rows * sizeof(double));
  if (c == CHANNEL_ALTIMETER_RANGE && nu[0] < 0) return 1;
  return agrees && m_stamp[c] - m_since[c] >= m_recovery[c] - EARLY;
}

/* An error of that variance of what the channel alone can put right, now and in its clones. */
static void inflate_own(double *m, int c, double variance) {
  double G[STATES][3], R[9];
  int rows = rows_of[c], n = active(m);
  matrix_of(m_turn, R), memset(G, 0, sizeof(G));
  for (int i = 0; i < rows; ++i) G[own_part[c] + i][i] = 1;
  for (int slot = 0; slot < SLOTS; ++slot)
    for (int i = 0; m_owner[slot] == c && i < rows; ++i)
      for (int j = 0; j < rows; ++j)
        G[MAIN + 3 * slot + i][j] = is_body(c) ? R[3 * j + i] : i != j ? 0 : c == CHANNEL_ALTIMETER_RANGE ? -1 : 1;
  for (int i = 0; i < n; ++i)
    for (int j = i; j < n; ++j) AT(i, j) += variance * (G[i][0] * G[j][0] + G[i][1] * G[j][1] + G[i][2] * G[j][2]);
}

/* That is wrong by an unknown amount. */
static void yield_to(double *m, int c, double squared) {
  for (int slot = 0; slot < SLOTS; ++slot)
    if (m_owner[slot] != c) m_owner[slot] = -1;
  m_since[c] = NAN;
  inflate_own(m, c, GATE_RELAXATION * squared);
  if (c != CHANNEL_POSITION && c != CHANNEL_DEPTH) return;
  /* It took the time of recovery to go so far: with a speed that nobody knew of, or an acceleration. */
  double time = m_recovery[c], speed = smaller_of(GATE_RELAXATION * squared / (time * time), EXPOSED * EXPOSED);
  for (int i = own_part[c]; i < own_part[c] + rows_of[c]; ++i) {
    AT(i + 3, i + 3) += speed;
    AT(i + 6, i + 6) += speed / (time * time);
  }
}

/* The robot has done what it can and the process model did not expect, or what carries the estimate is biased. */
static void be_surprised(double *m, int c, double squared) {
  double time = orders_of[c] > 1 ? time_since_accepted(m, c) : 1;
  int bias = c <= CHANNEL_ANGULAR_VELOCITY ? PART_GYRO_BIAS : PART_DVL_BIAS;
  if (c == CHANNEL_LINEAR_VELOCITY) return; /* which tells of accelerations, to go on with */
  inflate_own(m, c, squared);
  for (int i = 0; c <= CHANNEL_DEPTH && i < 3; ++i) AT(bias + i, bias + i) += squared / (time * time);
}

static void apply(double *m, const double *dx) {
  turn_by(m_turn, dx);
  for (int i = PART_PLACE; i < MAIN; ++i) X(i)[0] += dx[i];
  for (int slot = 0; slot < SLOTS; ++slot) {
    int c = (int)m_owner[slot];
    if (c < 0) continue;
    double *h = m_h + 4 * slot;
    const double *change = dx + MAIN + 3 * slot;
    if (c == CHANNEL_ATTITUDE) turn_by(h, change);
    else
      for (int i = 0; i < rows_of[c]; ++i) h[i] += change[i];
  }
}

/* Echoes move the floor alone, and its clones: they cannot locate the vehicle. */
static void correct_floor(double *m, const double *w, double nu, int n) {
  double dx[STATES] = {0};
  char moved[STATES] = {0};
  moved[PART_FLOOR] = 1;
  for (int slot = 0; slot < SLOTS; ++slot)
    if (m_owner[slot] == CHANNEL_ALTIMETER_RANGE) moved[MAIN + 3 * slot] = 1;
  for (int i = 0; i < n; ++i) {
    if (moved[i]) dx[i] = w[i] * nu;
    for (int j = i; j < n; ++j)
      if (moved[i] || moved[j]) AT(i, j) -= w[i] * w[j];
  }
  apply(m, dx);
}

WIDE static void lose(double *restrict m, const double *restrict u, const double *restrict v, const double *restrict w, int n) {
  for (int i = 0; i < n; ++i) {
    double *restrict row = &AT(i, 0), a = u[i], b = v[i], d = w[i];
    for (int j = i; j < n; ++j) row[j] -= a * u[j] + b * v[j] + d * w[j];
  }
}

static void correct(double *restrict m, int c, PredictedMeasurement *restrict s, double *nu, double own, int n) {
  double L[3][3], dx[STATES];
  int rows = rows_of[c];
  factor(s, own, rows, L), divide(L, rows, nu);
  double *restrict u = s->HP[0], *restrict v = s->HP[1], *restrict w = s->HP[2];
  for (int j = 0; j < n; ++j) u[j] /= L[0][0];
  if (c == CHANNEL_ALTIMETER_RANGE) {
    correct_floor(m, u, nu[0], n);
    return;
  }
  if (rows == 1) {
    for (int j = 0; j < n; ++j) dx[j] = u[j] * nu[0];
    for (int i = 0; i < n; ++i)
      for (int j = i; j < n; ++j) AT(i, j) -= u[i] * u[j];
    apply(m, dx);
    return;
  }
  for (int j = 0; j < n; ++j) {
    v[j] = (v[j] - L[1][0] * u[j]) / L[1][1];
    w[j] = (w[j] - L[2][0] * u[j] - L[2][1] * v[j]) / L[2][2];
    dx[j] = u[j] * nu[0] + v[j] * nu[1] + w[j] * nu[2];
  }
  lose(m, u, v, w, n);
  apply(m, dx);
}

static void judge(double *m, int c, int slot, double delta, PredictedMeasurement *s) {
  double nu[3] = {0};
  int n = active(m), rows = rows_of[c];
  recall_measurement(m, c, slot, n, s);
  if (c == CHANNEL_ALTIMETER_RANGE && s->h[1] <= STEEP) return;
  innovation(m, c, s, delta, nu);
  double own = noise_of(m, c, s, delta), granted = gate_allowance(m, c), squared = squared_of(s, own, rows, nu);
  double size = nu[0] * nu[0] + nu[1] * nu[1] + nu[2] * nu[2];
  int believed = squared_of(s, own + granted, rows, nu) <= m_gate[c];
  if (believed) {
    m_since[c] = NAN;
    if (squared > m_gate[c]) be_surprised(m, c, size), recall_measurement(m, c, slot, n, s);
  } else if (isfinite(squared) && isfinite(size) && is_convincing(m, c, s, 2 * own + granted, nu)) {
    believed = 1;
    yield_to(m, c, size);
    n = active(m), recall_measurement(m, c, slot, n, s);
  }
  note(m, c, squared, rows, believed);
  if (!believed) return;
  if (c == CHANNEL_ALTIMETER_RANGE) m_echo[0] = m_stamp[c];
  correct(m, c, s, nu, own, n);
}

static void take(double *m, int c, PredictedMeasurement *s) {
  int slot;
  double delta;
  if (!is_usable(m, c)) return;
  m_last[c] = m_stamp[c];
  if (c == CHANNEL_ALTIMETER_RANGE && isnan(m_value[4 * c])) {
    m_used[c] = m_stamp[c];
    return;
  }
  update_lag(m, c);
  if (is_turning(c) && is_unknown(m, PART_TURN, 3)) return;
  if (sets(c) && is_unknown(m, own_part[c], rows_of[c])) set(m, c, s);
  else if (nearest(m, c, m_owner, m_taken, SLOTS, &slot, &delta)) judge(m, c, slot, delta, s);
}

static void clone(double *m, int c, PredictedMeasurement *s) {
  int slot = free_slot(m_owner, SLOTS), before = active(m), rows = rows_of[c], at = MAIN + 3 * slot;
  if (slot < 0 || (is_turning(c) && is_unknown(m, PART_TURN, 3))) return;
  if (sets(c) && is_unknown(m, own_part[c], rows)) return;
  predict_measurement(m, c, before, s);
  m_owner[slot] = c, m_taken[slot] = m_now[0], m_rate_variance[slot] = s->rate_variance;
  memcpy(m_h + 4 * slot, s->h, sizeof(s->h)), memcpy(m_rate + 3 * slot, s->rate, sizeof(s->rate));
  int n = active(m);
  for (int i = 0; i < 3; ++i) {
    clear(m, at + i, n, 0);
    for (int j = 0; i < rows && j < before; ++j)
      if (j < at) AT(j, at + i) = s->HP[i][j];
      else AT(at + i, j) = s->HP[i][j];
  }
  for (int i = 0; i < rows; ++i)
    for (int j = i; j < rows; ++j) AT(at + i, at + j) = s->S[i][j];
}

static void fuse(double *m) {
  static _Thread_local PredictedMeasurement s;
  space_clones(m, 0, N_VEHICLE, SLOTS);
  for (int c = 0; c < N_VEHICLE; ++c)
    if (m_fresh[c]) take(m, c, &s);
  for (int c = 0; c < N_VEHICLE; ++c) {
    if (m_lag[c] <= 0) continue;
    expire(m, c, m_owner, m_taken, SLOTS);
    if (is_due(m, c)) clone(m, c, &s);
  }
}
