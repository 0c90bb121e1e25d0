/* The motion of the vehicle and its covariance, of which the upper triangle counts. vehicle.py is the same; keep both in step. */

/* Wider registers where the processor has them; the numbers are the same. */
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

#define AT(i, j) (m_P[(i) * STATES + (j)])
#define ENTRY(i, j) ((i) <= (j) ? AT(i, j) : AT(j, i))
#define X(part) (m_x + (part) - PART_PLACE)

static const int rows_of[] = {ROW_COUNTS}, orders_of[] = {ORDER_COUNTS};

static double smaller_of(double a, double b) { return a < b ? a : b; }
static double larger_of(double a, double b) { return a > b ? a : b; }

/* y = R x, or R' x. */
static void rotate(const double *R, const double *x, double *y) {
  for (int i = 0; i < 3; ++i) y[i] = R[3 * i] * x[0] + R[3 * i + 1] * x[1] + R[3 * i + 2] * x[2];
}

static void rotate_back(const double *R, const double *x, double *y) {
  for (int i = 0; i < 3; ++i) y[i] = R[i] * x[0] + R[3 + i] * x[1] + R[6 + i] * x[2];
}

static void cross(const double *a, const double *b, double *c) {
  double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
  c[0] = x, c[1] = y, c[2] = z;
}

static void matrix_of(const double *q, double *R) {
  double x = q[0], y = q[1], z = q[2], w = q[3];
  R[0] = 1 - 2 * (y * y + z * z), R[1] = 2 * (x * y - w * z), R[2] = 2 * (x * z + w * y);
  R[3] = 2 * (x * y + w * z), R[4] = 1 - 2 * (x * x + z * z), R[5] = 2 * (y * z - w * x);
  R[6] = 2 * (x * z - w * y), R[7] = 2 * (y * z + w * x), R[8] = 1 - 2 * (x * x + y * y);
}

/* c = a b, quaternions; c may be a. */
static void multiply(const double *a, const double *b, double *c) {
  double x = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1];
  double y = a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2];
  double z = a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0];
  double w = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2];
  c[0] = x, c[1] = y, c[2] = z, c[3] = w;
}

static double norm4(const double *q) { return sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]); }

/* q = q exp(by), of norm 1. */
static void turn_by(double *q, const double *by) {
  double squared = by[0] * by[0] + by[1] * by[1] + by[2] * by[2], angle = sqrt(squared), e[4];
  double share = angle > 1e-4 ? sin(angle / 2) / angle : 0.5 - squared / 48;
  for (int i = 0; i < 3; ++i) e[i] = share * by[i];
  e[3] = cos(angle / 2);
  multiply(q, e, q);
  double norm = norm4(q);
  for (int i = 0; i < 4; ++i) q[i] /= norm;
}

/* exp(-angle) and the right Jacobian of exp at the angle. */
static void turn_maps(const double *angle, double *E, double *J) {
  double x = angle[0], y = angle[1], z = angle[2], squared = x * x + y * y + z * z, size = sqrt(squared);
  int small = size < 1e-2;
  double sine = small ? 1 - squared / 6 + squared * squared / 120 : sin(size) / size;
  double cosine = small ? 0.5 - squared / 24 + squared * squared / 720 : (1 - cos(size)) / squared;
  double third = small ? 1.0 / 6 - squared / 120 + squared * squared / 5040 : (size - sin(size)) / (squared * size);
  double K[9] = {0, -z, y, z, 0, -x, -y, x, 0}, v[3] = {x, y, z};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      double K2 = v[i] * v[j] - (i == j ? squared : 0), one = i == j;
      E[3 * i + j] = one - sine * K[3 * i + j] + cosine * K2;
      J[3 * i + j] = one - cosine * K[3 * i + j] + third * K2;
    }
}

static int active(const double *m) {
  int slot = SLOTS - 1;
  while (slot >= 0 && m_owner[slot] < 0) --slot;
  return MAIN + 3 * (slot + 1);
}

/* Fills both triangles of the vehicle's own block. */
static void mirror(double *m) {
  for (int i = 1; i < MAIN; ++i)
    for (int j = 0; j < i; ++j) AT(i, j) = AT(j, i);
}

static void clear(double *m, int i, int n, double variance) {
  for (int j = 0; j < i; ++j) AT(j, i) = 0;
  for (int j = i; j < n; ++j) AT(i, j) = 0;
  AT(i, i) = variance;
}

/* Less variance and no less correlation: clones whose readings are on their way still depend on it. */
static void limit_to(double *m, int i, int n, double variance) {
  double share = sqrt(variance / AT(i, i));
  for (int j = 0; j < i; ++j) AT(j, i) *= share;
  for (int j = i; j < n; ++j) AT(i, j) *= share;
  AT(i, i) = variance;
}

static int is_unknown(const double *m, int first, int n) {
  for (int i = first; i < first + n; ++i)
    if (AT(i, i) > UNKNOWN * m_limit[i] * m_limit[i]) return 1;
  return 0;
}

/* Variance of a velocity after a tick in which the commanded one changed by so much: the faster, the less it follows. */
static double response_variance(const double *m, double change) {
  double drive = m_drive[NOISE_REPLY] * change;
  return m_dt[0] > 0 ? drive * drive / m_dt[0] : 0;
}

static void change_by(double *m, int i, double change) {
  X(i)[0] += change, AT(i, i) += response_variance(m, change);
}

static void follow(double *m) {
  double R[9], commanded[3];
  matrix_of(m_turn, R);
  rotate(R, m_commanded, commanded);
  for (int i = 0; i < 3; ++i) {
    if (m_guided[0]) change_by(m, PART_SPEED + i, commanded[i] - m_commanded_W[i]);
    change_by(m, PART_SPIN + i, m_commanded[3 + i] - m_commanded_spin[i]);
    m_commanded_W[i] = commanded[i], m_commanded_spin[i] = m_commanded[3 + i];
  }
}

/* Rows of F P, columns 0 to n; then the same on the columns of the vehicle's own block. */
WIDE static void move_rows(double *restrict m, int n, double h, const double *E, const double *hJ, const double *hhJ) {
  double half = h * h / 2;
  for (int j = 0; j < n; ++j) {
    double t[3];
    for (int i = 0; i < 3; ++i) {
      t[i] = 0;
      for (int k = 0; k < 3; ++k)
        t[i] += E[3 * i + k] * AT(PART_TURN + k, j) + hJ[3 * i + k] * AT(PART_SPIN + k, j) + hhJ[3 * i + k] * AT(PART_SPIN_UP + k, j);
    }
    for (int i = 0; i < 3; ++i) AT(PART_TURN + i, j) = t[i];
  }
  for (int i = 0; i < 3; ++i) {
    double *place = &AT(PART_PLACE + i, 0), *speed = &AT(PART_SPEED + i, 0), *spin = &AT(PART_SPIN + i, 0);
    const double *acceleration = &AT(PART_ACCELERATION + i, 0), *spin_up = &AT(PART_SPIN_UP + i, 0);
    for (int j = 0; j < n; ++j) {
      place[j] += h * speed[j] + half * acceleration[j];
      speed[j] += h * acceleration[j];
      spin[j] += h * spin_up[j];
    }
  }
}

static void move_columns(double *restrict m, double h, const double *E, const double *hJ, const double *hhJ) {
  double half = h * h / 2;
  for (int j = 0; j < MAIN; ++j) {
    double t[3], *row = &AT(j, 0);
    for (int i = 0; i < 3; ++i) {
      t[i] = 0;
      for (int k = 0; k < 3; ++k) t[i] += E[3 * i + k] * row[PART_TURN + k] + hJ[3 * i + k] * row[PART_SPIN + k] + hhJ[3 * i + k] * row[PART_SPIN_UP + k];
    }
    for (int i = 0; i < 3; ++i) {
      row[PART_TURN + i] = t[i];
      row[PART_PLACE + i] += h * row[PART_SPEED + i] + half * row[PART_ACCELERATION + i];
      row[PART_SPEED + i] += h * row[PART_ACCELERATION + i];
      row[PART_SPIN + i] += h * row[PART_SPIN_UP + i];
    }
  }
}

static double relief(const double *m, const double *R) {
  double arm[3], velocity[3], rough = m_drive[NOISE_ROUGHNESS], settling = m_drive[NOISE_SETTLING];
  cross(X(PART_SPIN), m_beam_at, arm);
  rotate(R, arm, velocity);
  for (int i = 0; i < 2; ++i) velocity[i] += X(PART_SPEED)[i];
  return settling * settling + rough * rough * (velocity[0] * velocity[0] + velocity[1] * velocity[1]);
}

static void diffuse(double *m, double dt, const double *J) {
  double dt2 = dt * dt, jerk = m_drive[NOISE_JERK], spin = m_drive[NOISE_ANGULAR_JERK], R[9];
  double third[9] = {dt2 * dt2 * dt / 20, dt2 * dt2 / 8, dt2 * dt / 6, 0, dt2 * dt / 3, dt2 / 2, 0, 0, dt};
  jerk *= jerk, spin *= spin;
  for (int i = 0; i < 3; ++i) {
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b) AT(PART_PLACE + 3 * a + i, PART_PLACE + 3 * b + i) += jerk * third[3 * a + b];
    for (int j = 0; j < 3; ++j) {
      double JJ = J[3 * i] * J[3 * j] + J[3 * i + 1] * J[3 * j + 1] + J[3 * i + 2] * J[3 * j + 2];
      if (j >= i) AT(PART_TURN + i, PART_TURN + j) += spin * third[0] * JJ;
      AT(PART_TURN + i, PART_SPIN + j) += spin * third[1] * J[3 * i + j];
      AT(PART_TURN + i, PART_SPIN_UP + j) += spin * third[2] * J[3 * i + j];
    }
    AT(PART_SPIN + i, PART_SPIN + i) += spin * third[4];
    AT(PART_SPIN + i, PART_SPIN_UP + i) += spin * third[5];
    AT(PART_SPIN_UP + i, PART_SPIN_UP + i) += spin * third[8];
    for (int k = 0; k < 3; ++k) {
      double drift = m_drive[NOISE_GYRO + k];
      AT(PART_GYRO_BIAS + 3 * k + i, PART_GYRO_BIAS + 3 * k + i) += dt * drift * drift;
    }
  }
  matrix_of(m_turn, R);
  AT(PART_FLOOR, PART_FLOOR) += dt * relief(m, R);
}

/* A variance below zero is one that rounding has eaten. */
static int is_known(double variance, double most) { return variance >= 0 && variance <= most; }

static void forget_unknown(double *m, int n) {
  for (int i = 0; i < MAIN; ++i) {
    double most = m_limit[i] * m_limit[i];
    int lost = !isfinite(i < PART_PLACE ? norm4(m_turn) : X(i)[0]);
    if (!lost && is_known(AT(i, i), most)) continue;
    if (!lost && i >= PART_SPEED && i < PART_FLOOR && AT(i, i) > 0 && isfinite(AT(i, i))) limit_to(m, i, n, most);
    else clear(m, i, n, most);
    if (i >= PART_PLACE && (lost || (i >= PART_SPEED && i < PART_GYRO_BIAS))) X(i)[0] = 0;
  }
  if (isfinite(norm4(m_turn))) return;
  for (int i = 0; i < 4; ++i) m_turn[i] = i == 3;
}

static void predict(double *m) {
  if (m_has_command[0]) follow(m);
  double dt = m_dt[0], h = smaller_of(dt, LONGEST_STEP), angle[3], E[9], J[9], hJ[9], hhJ[9];
  if (!(dt > 0)) return;
  int n = active(m);
  for (int i = 0; i < 3; ++i) angle[i] = h * X(PART_SPIN)[i] + h * h / 2 * X(PART_SPIN_UP)[i];
  turn_maps(angle, E, J);
  for (int i = 0; i < 9; ++i) hJ[i] = h * J[i], hhJ[i] = h * h / 2 * J[i];
  mirror(m);
  move_rows(m, n, h, E, hJ, hhJ);
  move_columns(m, h, E, hJ, hhJ);
  diffuse(m, dt, J);
  forget_unknown(m, n);
  turn_by(m_turn, angle);
  for (int i = 0; i < 3; ++i) {
    X(PART_PLACE)[i] += h * X(PART_SPEED)[i] + h * h / 2 * X(PART_ACCELERATION)[i];
    X(PART_SPEED)[i] += h * X(PART_ACCELERATION)[i];
    X(PART_SPIN)[i] += h * X(PART_SPIN_UP)[i];
  }
}
