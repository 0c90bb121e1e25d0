/* Functions of symmetric matrices, f(M) x by the eigenvalues of M (N, N): M = H R D R' H', where reflections H of Householder
   make it tridiagonal, and rotations R of implicit QL steps then diagonal. */

#define RESOLVED 1e-16 /* of the largest entry: less beside the diagonal is rounding */
#define VANISHING 1e-280 /* squares below it have no digits left */
enum { TURNS = 3 * N * N }; /* twice as many as matrices of any kind have been seen to need; what is left counts as zero */

typedef struct {
  double entry[N][N]; /* M; then, right of its diagonal, the vector of each reflection */
  double scale[N]; /* of each reflection I - scale v v' */
  double diagonal[N], beside[N]; /* D, or f of it; entries beside it until they are gone */
  double cosine[TURNS], sine[TURNS];
  int turned[TURNS], turns; /* first of the two neighbours that each rotation turns */
} Symmetric;

static double dot(const double *x, const double *y) {
  double sum = 0;
  for (int i = 0; i < N; ++i) sum += x[i] * y[i];
  return sum;
}

static void add_multiple(double *to, double factor, const double *x) {
  for (int i = 0; i < N; ++i) to[i] += factor * x[i];
}

static void add_square(Symmetric *m, double factor, const double *x) {
  for (int i = 0; i < N; ++i)
    if (x[i] != 0) add_multiple(m->entry[i], factor * x[i], x);
}

/* Reflect what stands right of row k, and below its diagonal alike, into its first entry. */
static void reflect(Symmetric *m, int k) {
  double *row = m->entry[k], image[N] = {0}, rest = 0, half = 0;
  m->diagonal[k] = row[k];
  m->scale[k] = 0;
  m->beside[k] = k + 1 < N ? row[k + 1] : 0;
  for (int j = k + 2; j < N; ++j) rest += row[j] * row[j];
  if (rest < VANISHING) return;
  double length = sqrt(row[k + 1] * row[k + 1] + rest), scale = 1 / (length * (length + fabs(row[k + 1])));
  m->beside[k] = -copysign(length, row[k + 1]);
  m->scale[k] = scale;
  row[k + 1] -= m->beside[k];
  for (int i = k + 1; i < N; ++i)
    for (int j = k + 1; j < N; ++j) image[j] += scale * row[i] * m->entry[i][j];
  for (int j = k + 1; j < N; ++j) half += 0.5 * scale * image[j] * row[j];
  for (int j = k + 1; j < N; ++j) image[j] -= half * row[j];
  for (int i = k + 1; i < N; ++i)
    for (int j = k + 1; j < N; ++j) m->entry[i][j] -= row[i] * image[j] + image[i] * row[j];
}

/* Chase the shift of Wilkinson from the end of a block to its first row. */
static void ql_step(Symmetric *m, int first, int end) {
  double *d = m->diagonal, *e = m->beside, sine = 1, cosine = 1, moved = 0;
  double ratio = (d[first + 1] - d[first]) / (2 * e[first]);
  double bulge = d[end] - d[first] + e[first] / (ratio + copysign(sqrt(ratio * ratio + 1), ratio));
  for (int i = end - 1; i >= first; --i) {
    double f = sine * e[i], b = cosine * e[i], length = sqrt(f * f + bulge * bulge);
    e[i + 1] = length;
    sine = length > 0 ? f / length : 0;
    cosine = length > 0 ? bulge / length : 1;
    double base = d[i + 1] - moved, change = (d[i] - base) * sine + 2 * cosine * b;
    moved = sine * change;
    d[i + 1] = base + moved;
    bulge = cosine * change - b;
    m->turned[m->turns] = i, m->cosine[m->turns] = cosine, m->sine[m->turns++] = sine;
  }
  d[first] -= moved;
  e[first] = bulge;
  e[end] = 0;
}

/* The last row that is reached from the first one by entries beside the diagonal. */
static int end_of_block(const Symmetric *m, int first, double small) {
  while (first + 1 < N && fabs(m->beside[first]) > small) ++first;
  return first;
}

static void diagonalise(Symmetric *m) {
  double largest = 0;
  for (int k = 0; k < N; ++k) {
    reflect(m, k);
    largest = fmax(largest, fabs(m->diagonal[k]) + fabs(m->beside[k]));
  }
  m->turns = 0;
  for (int first = 0, end; first < N; ++first)
    while ((end = end_of_block(m, first, RESOLVED * largest)) > first && m->turns + end - first <= TURNS)
      ql_step(m, first, end);
}

static void apply_reflection(const Symmetric *m, int k, double *x) {
  double along = 0;
  if (m->scale[k] == 0) return;
  for (int j = k + 1; j < N; ++j) along += m->scale[k] * m->entry[k][j] * x[j];
  for (int j = k + 1; j < N; ++j) x[j] -= along * m->entry[k][j];
}

static void turn(const Symmetric *m, int k, double sine, double *x) {
  double *pair = x + m->turned[k], upper = pair[0];
  pair[0] = m->cosine[k] * upper - sine * pair[1];
  pair[1] = sine * upper + m->cosine[k] * pair[1];
}

/* Replace x by H R D R' H' x, with what stands in place of D. */
static void multiply(const Symmetric *m, double *x) {
  for (int k = 0; k < N; ++k) apply_reflection(m, k, x);
  for (int k = 0; k < m->turns; ++k) turn(m, k, m->sine[k], x);
  for (int k = 0; k < N; ++k) x[k] *= m->diagonal[k];
  for (int k = m->turns - 1; k >= 0; --k) turn(m, k, -m->sine[k], x);
  for (int k = N - 1; k >= 0; --k) apply_reflection(m, k, x);
}
