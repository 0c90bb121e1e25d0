/* [Gao2022] eq. (27) level by level, as `Icat.velocity` of icat.py, and the external function of CasADi. All of it is on the
   stack: 15 kB for 13 velocities. Nothing is remembered: the state stays zero. */

static const int SIZES[L] = {LEVEL_SIZES};

typedef struct {
  double v[N]; /* what the levels so far ask for */
  double free[N][N]; /* Q: what they leave of a motion */
  double rows[M][N]; /* X = J Q of the active rows of a level */
  double activation[M], missed[M]; /* of these rows, and what v misses of their rates */
  Symmetric matrix;
} Icat;

/* Prepare to multiply by the pseudo-inverse of the matrix: x -> x / (x^2 + bell(x) damping) of its eigenvalues. */
static void regularise(Symmetric *m) {
  diagonalise(m);
  for (int k = 0; k < N; ++k) {
    double x = fmax(m->diagonal[k], 0), bell = x < THRESHOLD ? 0.5 * cos(PI * x / THRESHOLD) + 0.5 : 0;
    double below = x * x + DAMPING * bell;
    m->diagonal[k] = below > 0 ? x / below : 0;
  }
}

/* The active rows of a level, which begins at row `first`; returns how many there are. */
static int read_rows(Icat *m, const double **arg, int first, int size) {
  int count = 0;
  for (int r = first; r < first + size; ++r) {
    if (arg[ACTIVATION][r] == 0) continue;
    double *row = m->rows[count], missed = arg[RATE][r];
    memset(row, 0, sizeof(m->rows[0]));
    for (int i = 0; i < N; ++i) {
      double slope = arg[JACOBIAN][i * M + r];
      missed -= slope * m->v[i];
      if (slope != 0) add_multiple(row, slope, m->free[i]);
    }
    m->activation[count] = arg[ACTIVATION][r];
    m->missed[count++] = missed;
  }
  return count;
}

static void add_rows(Icat *m, int count) {
  for (int a = 0; a < count; ++a) add_square(&m->matrix, m->activation[a], m->rows[a]);
}

/* Add what the rows ask for to v, and take what they use from what is free. */
static void use_rows(Icat *m, int count) {
  double step[N] = {0}, moved[N] = {0};
  memset(m->matrix.entry, 0, sizeof(m->matrix.entry));
  add_rows(m, count);
  for (int k = 0; k < N; ++k) {
    double used[N];
    for (int j = 0; j < N; ++j) used[j] = (j == k) - m->free[k][j];
    add_square(&m->matrix, WEIGHT, used);
  }
  for (int a = 0; a < count; ++a) add_multiple(step, m->activation[a] * m->activation[a] * m->missed[a], m->rows[a]);
  regularise(&m->matrix);
  multiply(&m->matrix, step);
  for (int a = 0; a < count; ++a)
    add_multiple(moved, m->activation[a] * m->activation[a] * dot(m->rows[a], step), m->rows[a]);
  /* The same motion of the rows by what leaves the levels above as they are. */
  memset(m->matrix.entry, 0, sizeof(m->matrix.entry));
  add_rows(m, count);
  regularise(&m->matrix);
  for (int i = 0; i < N; ++i) {
    double share[N];
    memcpy(share, m->free[i], sizeof(share));
    multiply(&m->matrix, share);
    m->v[i] += dot(share, moved);
    for (int a = 0; a < count; ++a)
      add_multiple(m->free[i], -m->activation[a] * m->activation[a] * dot(share, m->rows[a]), m->rows[a]);
  }
}

/* Finite numbers, and entries of J and activations of sensible size. */
static int is_sound(const double **arg) {
  int sound = 1;
  for (int i = 0; i < M * N; ++i) sound &= fabs(arg[JACOBIAN][i]) < LARGEST;
  for (int r = 0; r < M; ++r) sound &= isfinite(arg[RATE][r]) && fabs(arg[ACTIVATION][r]) < LARGEST;
  return sound;
}

EXPORT int solve_hierarchy(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  Icat m;
  double residual[M], report[2] = {0};
  int sound = is_sound(arg);
  (void)iw, (void)w, (void)mem;
  memset(m.v, 0, sizeof(m.v));
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) m.free[i][j] = i == j;
  for (int k = 0, first = 0; k < L && sound; first += SIZES[k++]) {
    int count = read_rows(&m, arg, first, SIZES[k]);
    if (count) use_rows(&m, count);
  }
  for (int i = 0; i < N; ++i) sound &= fabs(m.v[i]) < ENDLESS;
  if (!sound) memset(m.v, 0, sizeof(m.v));
  for (int r = 0; r < M; ++r) {
    double met = 0;
    for (int i = 0; i < N; ++i) met += arg[JACOBIAN][i * M + r] * m.v[i];
    residual[r] = sound && arg[GATE][r] > 0 ? met - fmin(fmax(met, arg[LOWER_BOUND][r]), arg[UPPER_BOUND][r]) : 0;
  }
  report[0] = sound ? REGULARISED : INVALID_INPUT;
  pass_on(m.v, N, res[VELOCITY]);
  pass_on(report, 2, res[REPORT]);
  pass_on(residual, M, res[RESIDUAL]);
  if (res[STATE_OUT]) memset(res[STATE_OUT], 0, M * sizeof(double));
  return 0;
}
