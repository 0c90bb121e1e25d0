/* The hierarchy of equalities: least squares of the active rows, level by level.

   An LQ factorisation with reflectors shared by all levels: a row a becomes t = a H_0 H_1 ..., and y are the coordinates of
   v behind the same reflectors. Every level is reduced by pivoted Householder reflections in the space that the levels above
   left free, and solved by least squares where its rows depend on each other.

   First of the sources of one solver: equalities.c, active_set.c, scaling.c, certificate.c, fallbacks.c, compiled in one
   piece behind what active_set.py writes: N velocities, M rows in L levels of LEVEL_SIZES rows, the tolerances of
   tolerances.py, the states of rows and the statuses; needs libm only. active_set_numpy.py is the same algorithm; keep both in
   step. */

static const int SIZES[L] = {LEVEL_SIZES};

/* Which rows are too dependent to be pivots, and which multipliers are rounding. */
typedef struct { double rank_tolerance, rank_noise, multiplier; } Manner;

typedef struct {
  /* In normal units; v as given is `velocity` times v. */
  double a[M][N], lower[M], upper[M], norm[M], tolerance[M], box[2][N], velocity, unit;
  /* Size of the rows, as given, that count as nothing; 0 of all others. */
  double lost[M];
  int state[M];
  double t[M][N], reflector[N][N], beta[N], slack[M];
  /* The one entry of each reflector beside its head, as that of a simple bound; 0 where there are more. */
  int partner[N];
  int order[M], first[L + 1], column[L + 1];
  /* Least independent part of a pivot, of all levels above each. */
  double smallest[L + 1];
  /* Square of what is left of each row beside the pivots, and what it was when it was last computed. */
  double part[M], computed[M];
  /* Rows that were active in the last factorisation, of levels above `factorised`. */
  char factor[M];
  int factorised;
  double v[N], target[N];
  /* What balances the slack of each level that has one, itself included, and how large a multiplier decides there. */
  double multiplier[L][M], decisive[L];
  char decided[M], tabu[M];
  Manner manner;
  /* Iterations that are left to all runs together. */
  int left;
} Work;

/* In four sums, which go on at the same time. */
INLINE double dot(const double *x, const double *y, int n) {
  double sum[4] = {0};
  int i = 0;
  for (; i + 4 <= n; i += 4)
    for (int l = 0; l < 4; ++l) sum[l] += x[i + l] * y[i + l];
  for (int l = 0; i < n; ++i, ++l) sum[l] += x[i] * y[i];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* fmax and fmin are calls into libm. */
static double larger(double x, double y) { return x > y ? x : y; }
static double smaller(double x, double y) { return x < y ? x : y; }

static void add(double *sum, double factor, const double *x) {
  for (int c = 0; c < N; ++c) sum[c] += factor * x[c];
}

INLINE void reflect_one(const Work *k, int c, double *x) {
  const double *u = k->reflector[c];
  const int partner = k->partner[c];
  if (partner) {
    double f = k->beta[c] * (u[c] * x[c] + u[partner] * x[partner]);
    x[c] -= f * u[c], x[partner] -= f * u[partner];
    return;
  }
  double f = k->beta[c] * dot(u + c, x + c, N - c);
  for (int i = c; i < N; ++i) x[i] -= f * u[i];
}

/* Four rows by one reflector, which is read once for all of them. */
INLINE void reflect_four(const Work *k, int c, double *const *rows) {
  const double *restrict u = k->reflector[c] + c;
  double *restrict x0 = rows[0] + c, *restrict x1 = rows[1] + c, *restrict x2 = rows[2] + c, *restrict x3 = rows[3] + c;
  double f[4] = {dot(u, x0, N - c), dot(u, x1, N - c), dot(u, x2, N - c), dot(u, x3, N - c)};
  for (int l = 0; l < 4; ++l) f[l] *= k->beta[c];
  for (int i = 0; i < N - c; ++i) {
    double head = u[i];
    x0[i] -= f[0] * head, x1[i] -= f[1] * head, x2[i] -= f[2] * head, x3[i] -= f[3] * head;
  }
}

/* Rows order[at..end) by reflectors first..last-1, one after the other. */
WIDE static void reflect_rows(Work *k, int first, int last, int at, int end) {
  for (; M >= 4 && at + 4 <= end; at += 4) {
    double *rows[4];
    for (int l = 0; l < 4; ++l) rows[l] = k->t[k->order[at + l]];
    for (int c = first; c < last; ++c) {
      if (!k->partner[c]) reflect_four(k, c, rows);
      else for (int l = 0; l < 4; ++l) reflect_one(k, c, rows[l]);
    }
  }
  for (; at < end; ++at)
    for (int c = first; c < last; ++c) reflect_one(k, c, k->t[k->order[at]]);
}

WIDE static void reflect(const Work *k, int c, double *x) { reflect_one(k, c, x); }

static double bound(const Work *k, int row) {
  return k->state[row] == LOWER ? k->lower[row] : k->upper[row];
}

/* Makes row order[at] a pivot: zero beyond column c. */
static void pivot(Work *k, int c, int at, int end) {
  double *x = k->t[k->order[at]], *u = k->reflector[c];
  double size = sqrt(dot(x + c, x + c, N - c)), alpha = x[c] > 0 ? -size : size;
  memcpy(u + c, x + c, (N - c) * sizeof(double));
  u[c] -= alpha;
  double uu = dot(u + c, u + c, N - c);
  k->beta[c] = uu > 0 ? 2 / uu : 0;
  memset(x + c, 0, (N - c) * sizeof(double));
  x[c] = alpha;
  int entries = 0;
  for (int i = c + 1; i < N; ++i)
    if (u[i] != 0) ++entries, k->partner[c] = i;
  if (entries != 1) k->partner[c] = 0;
  reflect_rows(k, c, c + 1, at + 1, end);
}

static double part_of(const Work *k, int row, int c) {
  return dot(k->t[row] + c, k->t[row] + c, N - c) / (k->norm[row] * k->norm[row]);
}

/* Row with the largest part in the free space, relative to its size; -1 where all depend on pivots. */
static int best_pivot(const Work *k, double smallest, int begin, int end) {
  double floor = fmax(k->manner.rank_tolerance, k->manner.rank_noise / smallest), best = floor * floor;
  int chosen = -1;
  for (int j = begin; j < end; ++j)
    if (k->part[k->order[j]] > best) best = k->part[k->order[j]], chosen = j;
  return chosen;
}

/* Without what column c holds of the rows; computed anew before so much is gone that rounding would count. */
static void reduce_parts(Work *k, int c, int begin, int end) {
  for (int j = begin; j < end; ++j) {
    int row = k->order[j];
    double gone = k->t[row][c] / k->norm[row];
    k->part[row] -= gone * gone;
    if (k->part[row] < RECOMPUTED * k->computed[row]) k->part[row] = k->computed[row] = part_of(k, row, c + 1);
  }
}

static void forget_factor(Work *k) {
  k->factorised = k->first[0] = k->column[0] = 0;
  k->smallest[0] = 1;
}

/* The first level with another active row than in the last factorisation. */
static int first_change(const Work *k) {
  for (int level = 0, row = 0; level < k->factorised; ++level)
    for (int i = 0; i < SIZES[level]; ++i, ++row)
      if (k->factor[row] != (k->state[row] != FREE)) return level;
  return k->factorised;
}

/* From the first level that changes: pivots of those above stay. */
static void factorise(Work *k) {
  int level = first_change(k), count = k->first[level], c = k->column[level], row = 0;
  for (int above = 0; above < level; ++above) row += SIZES[above];
  for (; level < L; ++level) {
    double smallest = k->smallest[level];
    k->first[level] = count;
    k->column[level] = c;
    for (int i = 0; i < SIZES[level]; ++i, ++row) {
      k->factor[row] = k->state[row] != FREE;
      if (k->state[row] == FREE || k->norm[row] == 0) continue;
      /* Where no column is left only the slack of these rows is needed, and the sum of their gradients. */
      if (c < N) memcpy(k->t[row], k->a[row], sizeof(k->a[row]));
      k->order[count++] = row;
    }
    if (c < N) reflect_rows(k, 0, c, k->first[level], count);
    for (int j = k->first[level]; j < count && c < N; ++j)
      k->part[k->order[j]] = k->computed[k->order[j]] = part_of(k, k->order[j], c);
    for (int at = k->first[level]; at < count && c < N; ++at, ++c) {
      int chosen = best_pivot(k, smallest, at, count);
      if (chosen < 0) break;
      int swap = k->order[at];
      k->order[at] = k->order[chosen];
      k->order[chosen] = swap;
      smallest = fmin(smallest, sqrt(k->part[k->order[at]]));
      pivot(k, c, at, count);
      reduce_parts(k, c, at + 1, count);
    }
    k->smallest[level + 1] = smallest;
  }
  k->first[L] = count;
  k->column[L] = c;
  k->factorised = L;
}

/* B to R by reflectors, whose heads are kept beside their tails below R; r behind them. */
WIDE static void triangulate(double (*B)[N + 1], double *r, double *heads, int m, int n) {
  double f[N + 1];
  for (int c = 0; c < n; ++c) {
    double size = 0;
    for (int i = c; i < m; ++i) size += B[i][c] * B[i][c];
    size = sqrt(size);
    double alpha = B[c][c] > 0 ? -size : size, head = B[c][c] - alpha, uu = head * head, of_r = 0;
    for (int i = c + 1; i < m; ++i) uu += B[i][c] * B[i][c];
    heads[c] = head;
    if (uu == 0) continue;
    B[c][c] = head;
    memset(f, 0, sizeof(f));
    for (int i = c; i < m; ++i) {
      for (int j = c + 1; j < n; ++j) f[j] += B[i][c] * B[i][j];
      of_r += B[i][c] * r[i];
    }
    of_r *= 2 / uu;
    for (int j = c + 1; j < n; ++j) f[j] *= 2 / uu;
    for (int i = c; i < m; ++i) {
      for (int j = c + 1; j < n; ++j) B[i][j] -= f[j] * B[i][c];
      r[i] -= of_r * B[i][c];
    }
    B[c][c] = alpha;
  }
}

/* min |B y - r| for B (m, n) of full column rank, n <= N + 1; overwrites B and r, y in r[0..n). */
static void least_squares(double (*B)[N + 1], double *r, double *heads, int m, int n) {
  triangulate(B, r, heads, m, n);
  for (int c = n - 1; c >= 0; --c) {
    for (int j = c + 1; j < n; ++j) r[c] -= B[c][j] * r[j];
    r[c] /= B[c][c];
  }
}

/* Coordinates y[c0..c1) of one level and the slack of its active rows. */
static void solve_level(Work *k, int level, double *y) {
  int begin = k->first[level], m = k->first[level + 1] - begin;
  int c0 = k->column[level], rank = k->column[level + 1] - c0;
  if (c0 == N) return;
  double r[M];
  for (int j = 0; j < m; ++j) {
    int row = k->order[begin + j];
    r[j] = bound(k, row) - dot(k->t[row], y, c0);
    k->slack[row] = -r[j];
  }
  if (rank == m) {
    for (int j = 0; j < m; ++j) {
      const double *t = k->t[k->order[begin + j]] + c0;
      y[c0 + j] = (r[j] - dot(t, y + c0, j)) / t[j];
      k->slack[k->order[begin + j]] = 0;
    }
    return;
  }
  if (rank == 0) return;
  double B[M][N + 1], heads[N + 1];
  for (int j = 0; j < m; ++j) memcpy(B[j], k->t[k->order[begin + j]] + c0, rank * sizeof(double));
  least_squares(B, r, heads, m, rank);
  memcpy(y + c0, r, rank * sizeof(double));
  for (int j = 0; j < m; ++j) {
    int row = k->order[begin + j];
    k->slack[row] += dot(k->t[row] + c0, y + c0, rank);
  }
}

/* k->target, the optimum of the active rows as equalities; of least norm. */
static void solve_equalities(Work *k) {
  factorise(k);
  memset(k->target, 0, sizeof(k->target));
  for (int level = 0; level < L; ++level) solve_level(k, level, k->target);
  for (int c = k->column[L] - 1; c >= 0; --c) reflect(k, c, k->target);
  for (int level = 0; level < L; ++level) {
    if (k->column[level] < N) continue;
    for (int j = k->first[level]; j < k->first[level + 1]; ++j) {
      int row = k->order[j];
      k->slack[row] = dot(k->a[row], k->target, N) - bound(k, row);
    }
  }
}
