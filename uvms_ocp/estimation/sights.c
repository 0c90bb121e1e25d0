/* What each channel of the vehicle sees of the estimate. sights.py is the same; keep both in step. */

typedef struct {
  double h[4], rate[3], rate_variance;
  double HP[3][STATES]; /* covariance with all errors */
  double S[3][3];       /* its own */
} PredictedMeasurement;

typedef struct { double H[3][MAIN]; } Rows;

static void put(Rows *rows, int at, const double *block, double sign, int transposed) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) rows->H[i][at + j] = sign * (transposed ? block[3 * j + i] : block[3 * i + j]);
}

static void put_one(Rows *rows, int at) {
  for (int i = 0; i < 3; ++i) rows->H[i][at + i] = 1;
}

static void put_skew(Rows *rows, const double *v) {
  double K[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0};
  put(rows, PART_TURN, K, 1, 0);
}

static double mean_variance(const double *m, int first) {
  return (AT(first, first) + AT(first + 1, first + 1) + AT(first + 2, first + 2)) / 3;
}

static void see_body(const double *m, int c, PredictedMeasurement *s, Rows *rows) {
  double R[9], v[3], in_B[3], rate[3], turning[3];
  int force = c == CHANNEL_SPECIFIC_FORCE, own = force ? PART_ACCELERATION : PART_SPEED;
  int bias = force ? PART_FORCE_BIAS : PART_DVL_BIAS;
  matrix_of(m_turn, R);
  for (int i = 0; i < 3; ++i) v[i] = X(own)[i] - (force ? m_gravity[i] : 0);
  rotate_back(R, v, in_B);
  rotate_back(R, X(PART_ACCELERATION), rate);
  cross(X(PART_SPIN), in_B, turning);
  put_skew(rows, in_B), put(rows, own, R, 1, 1), put_one(rows, bias);
  for (int i = 0; i < 3; ++i) {
    s->h[i] = in_B[i] + X(bias)[i];
    s->rate[i] = (force ? 0 : rate[i]) - turning[i];
  }
  double size = in_B[0] * in_B[0] + in_B[1] * in_B[1] + in_B[2] * in_B[2];
  s->rate_variance = force ? mean_variance(m, PART_SPIN) * size : mean_variance(m, PART_ACCELERATION);
}

static void see_floor(const double *m, PredictedMeasurement *s, Rows *rows) {
  double R[9], arm[3], tilt[3], *down = R + 6;
  matrix_of(m_turn, R);
  double cosine = 0, altitude = X(PART_PLACE)[2] - X(PART_FLOOR)[0];
  for (int i = 0; i < 3; ++i) cosine += down[i] * m_beam_up[i], altitude += down[i] * m_beam_at[i];
  cross(m_beam_at, down, arm), cross(m_beam_up, down, tilt);
  for (int i = 0; i < 3; ++i)
    rows->H[0][PART_TURN + i] = arm[i] - (fabs(cosine) > STEEP ? altitude / cosine * tilt[i] : 0);
  rows->H[0][PART_PLACE + 2] = 1, rows->H[0][PART_FLOOR] = -1;
  s->h[0] = altitude, s->h[1] = cosine, s->rate[0] = X(PART_SPEED)[2];
  s->rate_variance = AT(PART_SPEED + 2, PART_SPEED + 2);
}

static void see(const double *m, int c, PredictedMeasurement *s, Rows *rows) {
  switch (c) {
  case CHANNEL_ATTITUDE:
    memcpy(s->h, m_turn, 4 * sizeof(double)), memcpy(s->rate, X(PART_SPIN), 3 * sizeof(double));
    s->rate_variance = mean_variance(m, PART_SPIN), put_one(rows, PART_TURN);
    return;
  case CHANNEL_ANGULAR_VELOCITY:
    for (int i = 0; i < 3; ++i) s->h[i] = X(PART_SPIN)[i] + X(PART_GYRO_BIAS)[i], s->rate[i] = X(PART_SPIN_UP)[i];
    s->rate_variance = mean_variance(m, PART_SPIN_UP), put_one(rows, PART_SPIN), put_one(rows, PART_GYRO_BIAS);
    return;
  case CHANNEL_POSITION:
    memcpy(s->h, X(PART_PLACE), 3 * sizeof(double)), memcpy(s->rate, X(PART_SPEED), 3 * sizeof(double));
    s->rate_variance = mean_variance(m, PART_SPEED), put_one(rows, PART_PLACE);
    return;
  case CHANNEL_DEPTH:
    s->h[0] = X(PART_PLACE)[2], s->rate[0] = X(PART_SPEED)[2], rows->H[0][PART_PLACE + 2] = 1;
    s->rate_variance = AT(PART_SPEED + 2, PART_SPEED + 2);
    return;
  case CHANNEL_ALTIMETER_RANGE: see_floor(m, s, rows); return;
  default: see_body(m, c, s, rows);
  }
}

/* What channel c sees now. */
static void predict_measurement(const double *m, int c, int n, PredictedMeasurement *s) {
  Rows rows;
  memset(&rows, 0, sizeof(rows)), memset(s->h, 0, sizeof(s->h)), memset(s->rate, 0, sizeof(s->rate));
  see(m, c, s, &rows);
  for (int i = 0; i < rows_of[c]; ++i) {
    memset(s->HP[i], 0, n * sizeof(double));
    for (int k = 0; k < MAIN; ++k) {
      double h = rows.H[i][k];
      if (h == 0) continue;
      for (int j = 0; j < k; ++j) s->HP[i][j] += h * AT(j, k);
      for (int j = k; j < n; ++j) s->HP[i][j] += h * AT(k, j);
    }
  }
  for (int i = 0; i < rows_of[c]; ++i)
    for (int j = 0; j < rows_of[c]; ++j) {
      s->S[i][j] = 0;
      for (int k = 0; k < MAIN; ++k) s->S[i][j] += s->HP[i][k] * rows.H[j][k];
    }
}

/* Lower factor of S + more on its diagonal, which bounds the pivots but for rounding. */
static void factor(const PredictedMeasurement *s, double more, int n, double L[3][3]) {
  for (int j = 0; j < n; ++j)
    for (int i = j; i < n; ++i) {
      double sum = s->S[i][j] + (i == j ? more : 0);
      for (int k = 0; k < j; ++k) sum -= L[i][k] * L[j][k];
      L[i][j] = i == j ? sqrt(sum < more ? more : sum) : sum / L[j][j];
    }
}

static void divide(double L[3][3], int n, double *x) {
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < i; ++k) x[i] -= L[i][k] * x[k];
    x[i] /= L[i][i];
  }
}

/* What it saw at the time of a clone, -1 for now. */
static void recall_measurement(const double *m, int c, int slot, int n, PredictedMeasurement *s) {
  if (slot < 0) {
    predict_measurement(m, c, n, s);
    return;
  }
  int at = MAIN + 3 * slot;
  memcpy(s->h, m_h + 4 * slot, 4 * sizeof(double)), memcpy(s->rate, m_rate + 3 * slot, 3 * sizeof(double));
  s->rate_variance = m_rate_variance[slot];
  for (int i = 0; i < rows_of[c]; ++i) {
    for (int j = 0; j < at + i; ++j) s->HP[i][j] = AT(j, at + i);
    for (int j = at + i; j < n; ++j) s->HP[i][j] = AT(at + i, j);
    for (int j = 0; j < rows_of[c]; ++j) s->S[i][j] = ENTRY(at + i, at + j);
  }
}
