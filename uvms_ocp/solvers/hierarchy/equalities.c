/* The hierarchy of equalities: least squares of the active rows, level by level.

   An LQ factorisation with reflectors shared by all levels: a row a becomes t = a H_0 H_1 ..., and y are the coordinates of
   v behind the same reflectors. Every level is reduced by pivoted Householder reflections in the space that the levels above
   left free, and solved by least squares where its rows depend on each other.

   First of the sources of one solver: equalities.c, active_set.c, scaling.c, certificate.c, fallbacks.c, compiled in one
   piece behind what core_source.py writes: N velocities, M rows in L levels of LEVEL_SIZES rows, the tolerances of
   tolerances.py, the states of rows and the statuses; needs libm only. equalities.py is the same algorithm; keep both in
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
  int order[M], first[L + 1], column[L + 1];
  /* Least independent part of a pivot. */
  double smallest;
  double v[N], target[N];
  /* What balances the slack of each level that has one, itself included, and how large a multiplier decides there. */
  double multiplier[L][M], decisive[L];
  char decided[M], tabu[M];
  Manner manner;
  /* Iterations that are left to all runs together. */
  int left;
} Work;

static double dot(const double *x, const double *y, int n) {
  double sum = 0;
  for (int i = 0; i < n; ++i) sum += x[i] * y[i];
  return sum;
}

/* In four sums, which may go on at the same time. */
static double row_at(const double *a, const double *v) {
  double sum[4] = {0};
  for (int c = 0; c < N; ++c) sum[c % 4] += a[c] * v[c];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* fmax and fmin are calls into libm. */
static double larger(double x, double y) { return x > y ? x : y; }
static double smaller(double x, double y) { return x < y ? x : y; }

static void add(double *sum, double factor, const double *x) {
  for (int c = 0; c < N; ++c) sum[c] += factor * x[c];
}

static void reflect(const Work *k, int c, double *x) {
  double f = k->beta[c] * dot(k->reflector[c] + c, x + c, N - c);
  for (int i = c; i < N; ++i) x[i] -= f * k->reflector[c][i];
}

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
  for (int j = at + 1; j < end; ++j) reflect(k, c, k->t[k->order[j]]);
}

/* Row with the largest part in the free space, relative to its size; -1 where all depend on pivots. */
static int best_pivot(Work *k, int c, int begin, int end) {
  double floor = fmax(k->manner.rank_tolerance, k->manner.rank_noise / k->smallest), best = floor * floor;
  int chosen = -1;
  for (int j = begin; j < end; ++j) {
    int row = k->order[j];
    double part = dot(k->t[row] + c, k->t[row] + c, N - c) / (k->norm[row] * k->norm[row]);
    if (part > best) best = part, chosen = j;
  }
  if (chosen >= 0) k->smallest = fmin(k->smallest, sqrt(best));
  return chosen;
}

static void factorise(Work *k) {
  int count = 0, c = 0, row = 0;
  k->smallest = 1;
  for (int level = 0; level < L; ++level) {
    k->first[level] = count;
    k->column[level] = c;
    for (int i = 0; i < SIZES[level]; ++i, ++row) {
      if (k->state[row] == FREE || k->norm[row] == 0) continue;
      if (c == N) {
        /* Nothing is left to these rows: only their slack is needed, and the sum of their gradients. */
        k->order[count++] = row;
        continue;
      }
      memcpy(k->t[row], k->a[row], sizeof(k->a[row]));
      for (int q = 0; q < c; ++q) reflect(k, q, k->t[row]);
      k->order[count++] = row;
    }
    for (int at = k->first[level]; at < count && c < N; ++at, ++c) {
      int chosen = best_pivot(k, c, at, count);
      if (chosen < 0) break;
      int swap = k->order[at];
      k->order[at] = k->order[chosen];
      k->order[chosen] = swap;
      pivot(k, c, at, count);
    }
  }
  k->first[L] = count;
  k->column[L] = c;
}

/* B to R by reflectors, whose heads are kept beside their tails below R; r behind them. */
static void triangulate(double (*B)[N + 1], double *r, double *heads, int m, int n) {
  for (int c = 0; c < n; ++c) {
    double size = 0;
    for (int i = c; i < m; ++i) size += B[i][c] * B[i][c];
    size = sqrt(size);
    double alpha = B[c][c] > 0 ? -size : size, head = B[c][c] - alpha, uu = head * head;
    for (int i = c + 1; i < m; ++i) uu += B[i][c] * B[i][c];
    heads[c] = head;
    if (uu == 0) continue;
    B[c][c] = head;
    for (int j = c + 1; j <= n; ++j) {
      double f = 0;
      for (int i = c; i < m; ++i) f += B[i][c] * (j < n ? B[i][j] : r[i]);
      f *= 2 / uu;
      for (int i = c; i < m; ++i) {
        if (j < n) B[i][j] -= f * B[i][c];
        else r[i] -= f * B[i][c];
      }
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
