/* level.py and certificate.py in C: rows as they are given, valid or not, gated; every level divided by its largest row,
   velocities by their size, all by powers of two; which rows are missed. */

/* The power of two above a size; 1 for 0. */
static double power(double size) {
  int exponent;
  if (!(size > 0 && size < INFINITY)) return 1;
  frexp(size, &exponent);
  return ldexp(1, exponent < 1023 ? exponent : 1023);
}

static double norm_of(const double *x) {
  double square = dot(x, x, N), largest = 0;
  if (square > SMALL_SQUARE) return sqrt(square);
  for (int c = 0; c < N; ++c) largest = larger(fabs(x[c]), largest);
  return largest;
}

/* How far 0 is from the bounds of a row. */
static double asked_by(const Work *k, int row) {
  double most = larger(k->lower[row], -k->upper[row]);
  return most > 0 ? most : 0;
}

static void divide_row(Work *k, int row, double factor) {
  for (int c = 0; c < N; ++c) k->a[row][c] *= factor;
  k->norm[row] *= factor, k->lower[row] *= factor, k->upper[row] *= factor;
}

/* Rows that are what is left of a cancellation become rows of zeros; the largest rate asked for over the largest row. */
static double divide_levels(Work *k) {
  double largest = 0, asked = 0;
  for (int row = 0; row < M; ++row) {
    k->norm[row] = norm_of(k->a[row]);
    largest = larger(k->norm[row], largest);
  }
  for (int level = 0, begin = 0; level < L; begin += SIZES[level++]) {
    double size = 0;
    for (int row = begin; row < begin + SIZES[level]; ++row) {
      k->lost[row] = k->norm[row] <= VANISHED * largest ? k->norm[row] : 0;
      if (k->norm[row] <= VANISHED * largest) memset(k->a[row], 0, sizeof(k->a[row])), k->norm[row] = 0;
      else size = larger(k->norm[row], size), asked = larger(asked_by(k, row), asked);
    }
    double divisor = power(size);
    for (int row = begin; row < begin + SIZES[level] && divisor != 1; ++row) divide_row(k, row, 1 / divisor);
  }
  return largest > 0 ? asked / largest : 0;
}

/* Bounds that rows of the first level with one entry have on both sides. */
static void find_box(Work *k) {
  for (int c = 0; c < N; ++c) k->box[0][c] = -INFINITY, k->box[1][c] = INFINITY;
  for (int row = 0; row < SIZES[0]; ++row) {
    int count = 0, at = 0;
    if (!(k->lower[row] > -INFINITY && k->upper[row] < INFINITY)) continue;
    for (int c = 0; c < N; ++c)
      if (k->a[row][c] != 0) ++count, at = c;
    if (count != 1) continue;
    double low = k->lower[row] / k->a[row][at], up = k->upper[row] / k->a[row][at];
    k->box[0][at] = larger(k->box[0][at], smaller(low, up));
    k->box[1][at] = smaller(k->box[1][at], larger(low, up));
  }
}

/* The largest velocity that a row asks for, or that the box allows if that is less. */
static double size_of_velocities(const Work *k) {
  double asked = 0, allowed = -INFINITY;
  for (int row = 0; row < M; ++row)
    if (k->norm[row] > 0) asked = larger(asked_by(k, row), asked);
  for (int c = 0; c < N; ++c) allowed = larger(larger(-k->box[0][c], k->box[1][c]), allowed);
  return power(allowed > 0 ? smaller(asked, allowed) : asked);
}

/* k->a, k->lower and k->upper to normal units. */
static void normalise(Work *k) {
  double asked = divide_levels(k);
  find_box(k);
  k->velocity = size_of_velocities(k);
  k->unit = asked > 0 ? smaller(asked / k->velocity, 1) : 1;
  if (k->velocity == 1) return;
  double factor = 1 / k->velocity;
  for (int row = 0; row < M; ++row) k->lower[row] *= factor, k->upper[row] *= factor;
  for (int c = 0; c < N; ++c) k->box[0][c] *= factor, k->box[1][c] *= factor;
}

typedef struct {
  /* (M, N) column-major, then (M) each. */
  const double *jacobian, *lower, *upper, *gate;
} Rows;

/* Comparisons with NaN are false. */
static int is_valid(const Rows *rows) {
  int wrong = 0;
  for (int i = 0; i < M * N; ++i) wrong |= !(fabs(rows->jacobian[i]) < LARGEST);
  if (wrong) return 0;
  for (int row = 0; row < M; ++row) {
    double low = rows->lower[row], up = rows->upper[row], gate = rows->gate[row];
    if (!(low <= up && low < INFINITY && up > -INFINITY && gate >= 0 && gate <= 1)) return 0;
  }
  return 1;
}

/* By how much `gated` moves the bounds of a row whose entries have the sum `range`. */
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

/* The rows, gated, in normal units. */
static void load(Work *k, const Rows *rows) {
  for (int row = 0; row < M; ++row) {
    for (int c = 0; c < N; ++c) k->a[row][c] = rows->jacobian[c * M + row];
    k->lower[row] = rows->lower[row];
    k->upper[row] = rows->upper[row];
    gate_bounds(k, row, rows->gate[row]);
  }
  normalise(k);
}

/* Whether a row that counts as nothing could be noticeably nearer to its bounds; v as given. */
static int are_missed(const Work *k, const Rows *rows, const double *v) {
  for (int row = 0; row < M; ++row) {
    if (k->lost[row] == 0) continue;
    double y = 0, range = 0;
    for (int c = 0; c < N; ++c) {
      double entry = rows->jacobian[c * M + row];
      y += entry * v[c], range += fabs(entry);
    }
    double width = width_of(range, rows->gate[row]);
    double below = rows->lower[row] - width - y, above = y - rows->upper[row] - width;
    double missed = larger(larger(below, above), 0), nearer = smaller(missed, REACH * k->velocity * k->lost[row]);
    if (nearer > larger(UNNOTICED, CERTIFIED * missed)) return 1;
  }
  return 0;
}

static void write_residual(const double *v, const Rows *rows, double *residual) {
  double y[M] = {0};
  for (int c = 0; c < N; ++c)
    for (int row = 0; row < M; ++row) y[row] += rows->jacobian[c * M + row] * v[c];
  for (int row = 0; row < M; ++row) {
    double nearest = smaller(larger(y[row], rows->lower[row]), rows->upper[row]);
    residual[row] = rows->gate[row] > 0 ? y[row] - nearest : 0;
  }
}
