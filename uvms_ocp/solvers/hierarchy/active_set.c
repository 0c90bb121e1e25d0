/* Lexicographic least squares with equalities and inequalities on every level, by an active-set method.

   Rows lower <= a v <= upper in levels. Every iteration solves the hierarchy of the active rows as equalities, goes there
   until a free row blocks, and else drops a row whose multipliers are lexicographically wrong. Invariant: every row violated
   at v is active. active_set_numpy.py finds the same optima, which tests compare. */

enum { GREEDY = 0, BLAND = 1, TABU = 2 };

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
  if (k->state[row] == EQUAL || k->decided[row]) return;
  if (value > tolerance) k->decided[row] = 1;
  if (value >= -tolerance) return;
  if (k->tabu[row]) return;
  if (rule == GREEDY ? value < worst->value : worst->row < 0 || row < worst->row)
    worst->row = row, worst->value = value;
}

static int is_significant(const Work *k, int row) {
  return fabs(k->slack[row]) > SIGNIFICANT / FEASIBLE * k->tolerance[row];
}

/* Multipliers of level `level` on its own rows and on the pivots above; the worst row, -1 where all signs hold. */
static int wrong_row(Work *k, int level, int rule) {
  Worst worst = {-1, 0};
  double g[N], scale = 0, multiplier[N], *balancing = k->multiplier[level];
  int c0 = k->column[level], significant = 0;
  memset(g, 0, sizeof(g));
  for (int j = k->first[level]; j < k->first[level + 1]; ++j) {
    int row = k->order[j];
    scale += fabs(k->slack[row]) * k->norm[row];
    significant |= is_significant(k, row);
    const double *x = c0 == N ? k->a[row] : k->t[row];
    for (int c = 0; c < c0; ++c) g[c] += k->slack[row] * x[c];
  }

  /* A slack that an exact solution could not tell from zero decides nothing for the levels below. */
  if (!significant) return -1;
  if (c0 == N)
    for (int c = 0; c < N; ++c) reflect(k, c, g);
  memset(balancing, 0, M * sizeof(double));
  for (int j = k->first[level]; j < k->first[level + 1]; ++j) balancing[k->order[j]] = k->slack[k->order[j]];
  double tolerance = fmax(k->manner.multiplier * scale, WRONG);
  k->decisive[level] = tolerance;
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
      balancing[row] = multiplier[j];
    }
  }
  return worst.row;
}

static int drop_row(Work *k, int rule) {
  memset(k->decided, 0, sizeof(k->decided));
  memset(k->decisive, 0, sizeof(k->decisive));
  for (int level = 0; level < L; ++level) {
    int row = wrong_row(k, level, rule);
    if (row >= 0) {
      k->state[row] = FREE;
      return row;
    }
  }
  return -1;
}

/* Rows that are active at first; by how much each may be violated. */
static void start(Work *k, const double *state) {
  for (int row = 0; row < M; ++row) {
    double low = fabs(k->lower[row]), up = fabs(k->upper[row]);
    int given = !state ? FREE : state[row] > 0 ? UPPER : state[row] < 0 ? LOWER : FREE;
    if (given == UPPER && k->upper[row] == INFINITY) given = FREE;
    if (given == LOWER && k->lower[row] == -INFINITY) given = FREE;
    /* A flag of equality must never be inherited: the row may have become an inequality. */
    k->state[row] = k->lower[row] >= k->upper[row] ? EQUAL : given;
    k->tolerance[row] = FEASIBLE * (k->norm[row] + larger(low < ENDLESS ? low : 0, up < ENDLESS ? up : 0));
  }
}

/* From the active set `state`, cold without one, to k->v and its active set; MOST_ITERATIONS at most, and what is left. */
static void run(Work *k, const double *state) {
  int stalled = 0, rule = GREEDY, blocked, dropped = -1;
  start(k, state);
  forget_factor(k);
  memset(k->tabu, 0, sizeof(k->tabu));
  solve_equalities(k);
  memcpy(k->v, k->target, sizeof(k->v));
  int pending = activate_violated(k) > 0;
  for (int iteration = 1; iteration <= MOST_ITERATIONS && k->left > 0; ++iteration) {
    --k->left;
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
    if (dropped < 0) return;
    ++stalled;
    /* A row dropped under TABU stays, once active again: that ends every cycle, at the price of optimality. */
    if (stalled > TABU_STALLS || iteration > TABU_ITERATIONS) rule = TABU;
    else if (stalled > BLAND_STALLS) rule = BLAND;
    if (rule == TABU) k->tabu[dropped] = 1;
    pending = 1;
  }
}
