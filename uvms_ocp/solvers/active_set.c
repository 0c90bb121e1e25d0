/* Lexicographic least squares with equalities and inequalities on every level, by an active-set method.

   Rows lower <= a v <= upper in LEX_L levels of LEX_SIZES rows. Every iteration solves the hierarchy of the active
   rows as equalities (level by level: pivoted Householder reduction of the rows in the space that the levels above
   left free, least squares where rows depend on each other), goes there until a free row blocks, and else drops a
   row whose multipliers are lexicographically wrong. Invariant: every row violated at v is active.

   The reduction is an LQ factorisation with reflectors shared by all levels: a row a becomes t = a H_0 H_1 ..., and
   y are the coordinates of v behind the same reflectors. active_set.py is the same algorithm; keep both in step.

   Compiled with LEX_N, LEX_M, LEX_L and LEX_SIZES, in one piece with certificate.c and entry.c; needs libm only. */
#include <math.h>
#include <string.h>

#define N LEX_N
#define M LEX_M
#define L LEX_L
#define RANK_TOLERANCE 1e-8
/* Directions carry the rounding error of their own pivot: a small pivot makes dependent rows look independent. */
#define RANK_NOISE 1e-14
/* Rows smaller than this part of the largest row are what is left of a cancellation: nothing. */
#define VANISHED 1e-13
#define FEASIBLE 1e-12
#define CONSISTENT 1e-10
#define BALANCED 5e-8
/* Pivots below CLEAR and dependent rows above NOTHING leave open what depends on what. */
#define CLEAR 1e-5
#define NOTHING 1e-11
/* Largest over smallest row; beyond, what is rounding to one row decides about another. */
#define EVEN 1e3
/* Of a multiplier, relative to MULTIPLIER. */
#define DECISIVE 1e4
/* Far below FEASIBLE: else a row dropped for the sake of lower levels blocks at once for the sake of this slack. */
#define SIGNIFICANT 1e-14
#define MOVED 1e-9
#define MULTIPLIER 1e-10
/* Multipliers smaller than this are rounding, however small the slack they balance. */
#define WRONG 1e-12

enum { FREE = 0, LOWER = -1, UPPER = 1, EQUAL = 2 };
enum { GREEDY = 0, BLAND = 1, TABU = 2 };
enum { OPEN = 0, WEAKLY = 1, FIRMLY = 2 };
enum { SOLVED = 0, STALLED = 1, LIMIT = 2, DOUBTFUL = 3, INVALID = 4 };

static const int SIZES[L] = {LEX_SIZES};

typedef struct {
  double a[M][N], lower[M], upper[M], norm[M], tolerance[M];
  int state[M];
  double t[M][N], reflector[N][N], beta[N], slack[M];
  int order[M], first[L + 1], column[L + 1];
  /* Least independent part of a pivot and largest part of a row taken for dependent. */
  double smallest, rejected;
  double v[N], target[N], unbalanced;
  char decided[M], tabu[M];
  int skipped, contradicted, uneven;
} Work;

static double dot(const double *x, const double *y, int n) {
  double sum = 0;
  for (int i = 0; i < n; ++i) sum += x[i] * y[i];
  return sum;
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
  double floor = fmax(RANK_TOLERANCE, RANK_NOISE / k->smallest), best = floor * floor, largest = 0;
  int chosen = -1;
  for (int j = begin; j < end; ++j) {
    int row = k->order[j];
    double part = dot(k->t[row] + c, k->t[row] + c, N - c) / (k->norm[row] * k->norm[row]);
    largest = fmax(largest, part);
    if (part > best) best = part, chosen = j;
  }
  if (chosen >= 0) k->smallest = fmin(k->smallest, sqrt(best));
  else k->rejected = fmax(k->rejected, sqrt(largest));
  return chosen;
}

static void factorise(Work *k) {
  int count = 0, c = 0, row = 0;
  k->smallest = 1;
  k->rejected = 0;
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

/* min |B y - r| for B (m, n) of full column rank; overwrites B and r, y in r[0..n). */
static void least_squares(double (*B)[N], double *r, int m, int n) {
  for (int c = 0; c < n; ++c) {
    double size = 0;
    for (int i = c; i < m; ++i) size += B[i][c] * B[i][c];
    size = sqrt(size);
    double alpha = B[c][c] > 0 ? -size : size, head = B[c][c] - alpha, uu = head * head;
    for (int i = c + 1; i < m; ++i) uu += B[i][c] * B[i][c];
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
  double B[M][N];
  for (int j = 0; j < m; ++j) memcpy(B[j], k->t[k->order[begin + j]] + c0, rank * sizeof(double));
  least_squares(B, r, m, rank);
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

static int activate_violated(Work *k) {
  int count = 0;
  for (int row = 0; row < M; ++row) {
    if (k->state[row] != FREE) continue;
    double y = dot(k->a[row], k->v, N);
    if (y > k->upper[row] + k->tolerance[row]) k->state[row] = UPPER, ++count;
    else if (y < k->lower[row] - k->tolerance[row]) k->state[row] = LOWER, ++count;
  }
  return count;
}

/* Goes to k->target until a free row blocks, which becomes active; true if v has moved. */
static int step(Work *k, int *blocked) {
  double length = 1, moved = 0, size = 1;
  int side = FREE;
  *blocked = -1;
  for (int row = 0; row < M; ++row) {
    if (k->state[row] != FREE) continue;
    double end = dot(k->a[row], k->target, N), limit;
    int at;
    if (end > k->upper[row] + k->tolerance[row]) limit = k->upper[row], at = UPPER;
    else if (end < k->lower[row] - k->tolerance[row]) limit = k->lower[row], at = LOWER;
    else continue;
    double y = dot(k->a[row], k->v, N), t = (limit - y) / (end - y);
    if (t < 0 || (at == UPPER ? y >= limit : y <= limit)) t = 0;
    if (t < length || *blocked < 0) length = t < length ? t : length, *blocked = row, side = at;
  }
  for (int i = 0; i < N; ++i) {
    double change = length * (k->target[i] - k->v[i]);
    k->v[i] += change;
    moved = fmax(moved, fabs(change)), size = fmax(size, fabs(k->v[i]));
  }
  if (*blocked < 0) memcpy(k->v, k->target, sizeof(k->v));
  else k->state[*blocked] = side;
  return moved > MOVED * size;
}

typedef struct { int row; double value; } Worst;

static void judge(Work *k, int row, double multiplier, double tolerance, int rule, Worst *worst) {
  double value = multiplier * k->state[row] * k->norm[row];
  if (k->decided[row] == WEAKLY && value < -tolerance) k->contradicted = 1;
  if (k->state[row] == EQUAL || k->decided[row]) return;
  if (value > tolerance) k->decided[row] = value > DECISIVE * tolerance ? FIRMLY : WEAKLY;
  if (value >= -tolerance) return;
  if (k->tabu[row]) {
    k->skipped = 1;
    return;
  }
  if (rule == GREEDY ? value < worst->value : worst->row < 0 || row < worst->row)
    worst->row = row, worst->value = value;
}

static int is_significant(const Work *k, int row) {
  return fabs(k->slack[row]) > SIGNIFICANT / FEASIBLE * k->tolerance[row];
}

static void add(double *sum, double factor, const double *x) {
  for (int c = 0; c < N; ++c) sum[c] += factor * x[c];
}

/* Multipliers of level `level` on its own rows and on the pivots above; the worst row, -1 where all signs hold. */
static int wrong_row(Work *k, int level, int rule) {
  Worst worst = {-1, 0};
  double g[N], balance[N], scale = 0, multiplier[N];
  int c0 = k->column[level], significant = 0;
  memset(g, 0, sizeof(g));
  memset(balance, 0, sizeof(balance));
  for (int j = k->first[level]; j < k->first[level + 1]; ++j) {
    int row = k->order[j];
    scale += fabs(k->slack[row]) * k->norm[row];
    significant |= is_significant(k, row);
    const double *x = c0 == N ? k->a[row] : k->t[row];
    for (int c = 0; c < c0; ++c) g[c] += k->slack[row] * x[c];
    add(balance, k->slack[row], k->a[row]);
  }
  /* A slack that an exact solution could not tell from zero decides nothing for the levels below. */
  if (!significant) return -1;
  if (c0 == N)
    for (int c = 0; c < N; ++c) reflect(k, c, g);
  double tolerance = fmax(MULTIPLIER * scale, WRONG);
  for (int j = k->first[level]; j < k->first[level + 1]; ++j)
    if (is_significant(k, k->order[j])) judge(k, k->order[j], k->slack[k->order[j]], tolerance, rule, &worst);
  for (int above = level - 1; above >= 0; --above) {
    int begin = k->first[above], c1 = k->column[above], rank = k->column[above + 1] - c1;
    for (int j = rank - 1; j >= 0; --j) {
      double sum = -g[c1 + j];
      for (int i = j + 1; i < rank; ++i) sum -= k->t[k->order[begin + i]][c1 + j] * multiplier[i];
      multiplier[j] = sum / k->t[k->order[begin + j]][c1 + j];
    }
    for (int j = 0; j < rank; ++j) {
      int row = k->order[begin + j];
      for (int c = 0; c < c1; ++c) g[c] += multiplier[j] * k->t[row][c];
      judge(k, row, multiplier[j], tolerance, rule, &worst);
      add(balance, multiplier[j], k->a[row]);
    }
  }
  k->unbalanced = fmax(k->unbalanced, sqrt(dot(balance, balance, N)) / (scale + 1));
  return worst.row;
}

static int drop_row(Work *k, int rule) {
  memset(k->decided, 0, sizeof(k->decided));
  k->skipped = 0;
  k->unbalanced = 0;
  k->contradicted = 0;
  for (int level = 0; level < L; ++level) {
    int row = wrong_row(k, level, rule);
    if (row >= 0) {
      k->state[row] = FREE;
      return row;
    }
  }
  return -1;
}

static void start(Work *k, const double *state) {
  for (int row = 0; row < M; ++row) {
    int given = !state ? FREE : state[row] > 0 ? UPPER : state[row] < 0 ? LOWER : FREE;
    if (given == UPPER && k->upper[row] == INFINITY) given = FREE;
    if (given == LOWER && k->lower[row] == -INFINITY) given = FREE;
    /* A flag of equality must never be inherited: the row may have become an inequality. */
    k->state[row] = k->lower[row] >= k->upper[row] ? EQUAL : given;
  }
}

/* True if v does to the active rows what the factorisation promised, and the multipliers, applied to the rows as given,
   balance every level. False where that cannot be known, because rows are nearly but not quite dependent, or of very
   different size. */
static int is_consistent(const Work *k) {
  if (k->uneven) return 0;
  if (!(k->unbalanced <= BALANCED) || k->contradicted || k->smallest < CLEAR || k->rejected > NOTHING) return 0;
  for (int j = 0; j < k->first[L]; ++j) {
    int row = k->order[j];
    double error = dot(k->a[row], k->v, N) - bound(k, row) - k->slack[row];
    if (!(fabs(error) <= CONSISTENT * (k->tolerance[row] / FEASIBLE))) return 0;
  }
  return 1;
}

/* v and the active set of k; the number of iterations in *iterations. */
static int run(Work *k, int limit, int *iterations) {
  int stalled = 0, rule = GREEDY, blocked, dropped = -1;
  memset(k->tabu, 0, sizeof(k->tabu));
  solve_equalities(k);
  memcpy(k->v, k->target, sizeof(k->v));
  int pending = activate_violated(k) > 0;
  for (*iterations = 1; *iterations <= limit; ++*iterations) {
    if (pending) {
      solve_equalities(k);
      if (!step(k, &blocked)) {
        ++stalled;
        /* A row that blocks at once where it was dropped was dropped for rounding, and would be again: it stays. */
        if (blocked == dropped && blocked >= 0) k->tabu[blocked] = 1;
      } else if (rule != TABU) {
        stalled = 0, rule = GREEDY;
        memset(k->tabu, 0, sizeof(k->tabu));
      }
      dropped = -1;
      if (blocked >= 0) continue;
    }
    dropped = drop_row(k, rule);
    if (dropped < 0) return k->skipped ? STALLED : is_consistent(k) ? SOLVED : DOUBTFUL;
    ++stalled;
    /* A row dropped under TABU stays, once active again: that ends every cycle, at the price of optimality. */
    if (stalled > 2 * M || *iterations > 20 + 3 * M) rule = TABU;
    else if (stalled > M / 2 + 10) rule = BLAND;
    if (rule == TABU) k->tabu[dropped] = 1;
    pending = 1;
  }
  return LIMIT;
}
