/* certificate.py in C: by how much any level can be above its least, whatever the run that found v says of itself.

   Multipliers are signed here: positive ones belong to upper bounds, negative ones to lower ones. */

typedef struct {
  double y[M], slack[M], noise[M], down[N], up[N];
  /* Columns of the multipliers in the search of least squares: their share of the gradient and of the gaps, of length 1. */
  double column[2 * M][N + 1], length[2 * M], multiplier[2 * M];
  int row[2 * M], count, used, set[N + 1];
  char is_used[2 * M], refused[2 * M];
} Proof;

static double size_of(const double *x, int n) { return sqrt(dot(x, x, n)); }

/* What is left of r behind the reflectors of B, in the coordinates before them: however large the x are, it has no part of
   the columns but rounding of r. */
static void turn_back(double (*B)[N + 1], const double *heads, double *r, int n) {
  for (int c = n - 1; c >= 0; --c) {
    double uu = heads[c] * heads[c], f = heads[c] * r[c];
    for (int i = c + 1; i <= N; ++i) uu += B[i][c] * B[i][c], f += B[i][c] * r[i];
    if (uu == 0) continue;
    f *= 2 / uu;
    r[c] -= f * heads[c];
    for (int i = c + 1; i <= N; ++i) r[i] -= f * B[i][c];
  }
}

/* min |sum x column - b| over the columns of the set, x of any sign, and what is left of b; 0 where they are dependent. */
static int fit(const Proof *p, const double *b, double *x, double *rest) {
  double B[N + 1][N + 1], heads[N + 1];
  for (int i = 0; i <= N; ++i)
    for (int j = 0; j < p->used; ++j) B[i][j] = p->column[p->set[j]][i];
  memcpy(rest, b, (N + 1) * sizeof(double));
  least_squares(B, rest, heads, N + 1, p->used);
  memcpy(x, rest, p->used * sizeof(double));
  memset(rest, 0, p->used * sizeof(double));
  turn_back(B, heads, rest, p->used);
  for (int j = 0; j < p->used; ++j)
    if (!(fabs(x[j]) < ENDLESS)) return 0;
  return 1;
}

static int steepest(const Proof *p, const double *rest, double least) {
  int chosen = -1;
  for (int j = 0; j < p->count; ++j) {
    if (p->is_used[j] || p->refused[j]) continue;
    double descent = dot(p->column[j], rest, N + 1);
    if (descent > least) least = descent, chosen = j;
  }
  return chosen;
}

/* From the multipliers towards x until the first is 0, which leaves the set; true if x is reached. */
static int retreat(Proof *p, const double *x) {
  double length = 1;
  int left = -1;
  for (int j = 0; j < p->used; ++j) {
    double now = p->multiplier[p->set[j]], part = now > 0 ? now / (now - x[j]) : 0;
    if (x[j] <= 0 && (left < 0 || part < length)) length = part, left = j;
  }
  for (int j = 0; j < p->used; ++j) {
    double *now = &p->multiplier[p->set[j]];
    *now = larger(0, *now + length * (x[j] - *now));
  }
  if (left < 0) return 1;
  p->multiplier[p->set[left]] = 0;
  p->is_used[p->set[left]] = 0;
  memmove(p->set + left, p->set + left + 1, (p->used - left - 1) * sizeof(int));
  --p->used;
  return 0;
}

/* Multipliers >= 0 of the columns that leave little of b (Lawson and Hanson), none of which reduces it by less than `least`. */
static void search(Proof *p, const double *b, double least) {
  double rest[N + 1], trial[N + 1], x[N + 1];
  memcpy(rest, b, sizeof(rest));
  memset(p->multiplier, 0, sizeof(p->multiplier));
  memset(p->is_used, 0, sizeof(p->is_used));
  memset(p->refused, 0, sizeof(p->refused));
  p->used = 0;
  for (int round = 0; round < 6 * M && p->used <= N; ++round) {
    int chosen = steepest(p, rest, least);
    if (chosen < 0) return;
    p->set[p->used++] = chosen;
    if (!fit(p, b, x, trial) || x[p->used - 1] <= 0) {
      p->refused[chosen] = 1;
      --p->used;
      continue;
    }
    p->is_used[chosen] = 1;
    while (!retreat(p, x) && p->used > 0)
      if (!fit(p, b, x, trial)) return;
    memcpy(rest, p->used > 0 ? trial : b, sizeof(rest));
    memset(p->refused, 0, sizeof(p->refused));
  }
}

/* Distance of a row from the bound that a multiplier of this sign belongs to, as held at what it misses. */
static double gap(const Work *k, const Proof *p, int row, double sign) {
  double distance = sign > 0 ? k->upper[row] - p->y[row] : p->y[row] - k->lower[row];
  return distance > p->noise[row] ? distance : 0;
}

static void add_column(Proof *p, const Work *k, int row, double sign) {
  double *column = p->column[p->count];
  column[N] = gap(k, p, row, sign);
  for (int c = 0; c < N; ++c) column[c] = sign * k->a[row][c] * larger(p->down[c], p->up[c]);
  double length = size_of(column, N + 1);
  if (!(length > 0 && length < INFINITY)) return;
  for (int i = 0; i <= N; ++i) column[i] /= length;
  p->row[p->count] = sign > 0 ? row : -1 - row;
  p->length[p->count++] = length;
}

/* Multipliers x of the rows above `begin`, for a level of this gradient, of which `descent` is rounding. */
static void search_multipliers(Proof *p, const Work *k, const double *gradient, int begin, double descent, double *x) {
  double b[N + 1] = {0};
  for (int c = 0; c < N; ++c) b[c] = -gradient[c] * larger(p->down[c], p->up[c]);
  p->count = 0;
  for (int row = 0; row < begin; ++row) add_column(p, k, row, 1), add_column(p, k, row, -1);
  search(p, b, descent * size_of(b, N + 1));
  memset(x, 0, M * sizeof(double));
  for (int j = 0; j < p->used; ++j) {
    int at = p->set[j], row = p->row[at];
    x[row >= 0 ? row : -1 - row] += (row >= 0 ? 1 : -1) * p->multiplier[at] / p->length[at];
  }
}

/* The bound for multipliers x of a level of this gradient, where so much rounding is left out. */
static double evaluate(const Proof *p, const Work *k, const double *gradient, int begin, const double *x, double left_out) {
  double r[N], bound = 0, rounding = 0;
  memcpy(r, gradient, sizeof(r));
  for (int row = 0; row < begin; ++row) {
    if (x[row] == 0) continue;
    add(r, x[row], k->a[row]);
    bound += fabs(x[row]) * gap(k, p, row, x[row]);
    rounding += fabs(x[row]) * p->noise[row];
  }
  for (int c = 0; c < N; ++c) bound += fabs(r[c]) * (r[c] > 0 ? p->down[c] : p->up[c]);
  return rounding > left_out ? bound + rounding : bound;
}

/* Multipliers of a level, from those of the run. They may have the wrong sign where a level between has fixed a row: what
   balances that level is added until the sign is right, unless the wrong one costs next to nothing. */
static void suggested_multipliers(const Proof *p, const Work *k, int level, int begin, double size, double *x) {
  memset(x, 0, M * sizeof(double));
  for (int row = 0; row < begin; ++row) x[row] = k->multiplier[level][row] / size;
  for (int above = level - 1, end = begin; above >= 0; end -= SIZES[above--]) {
    const double *fixing = k->multiplier[above];
    double share = 0;
    if (k->decisive[above] == 0) continue;
    for (int row = 0; row < end; ++row)
      if (x[row] * fixing[row] < 0 && fabs(fixing[row]) * k->norm[row] > k->decisive[above] &&
          fabs(x[row]) * gap(k, p, row, x[row]) > NEGLIGIBLE * k->unit)
        share = larger(share, -x[row] / fixing[row]);
    if (share > 0)
      for (int row = 0; row < end; ++row) x[row] += share * fixing[row];
  }
}

/* Relative to the residual of the level, or to the unit if that is more. */
static double level_excess(Proof *p, const Work *k, int level, int begin) {
  double gradient[N] = {0}, x[M], size = size_of(p->slack + begin, SIZES[level]), scale = larger(size, k->unit);
  double bound = size, enough = CERTIFIED * scale;
  if (!(size < INFINITY)) return INFINITY;
  if (size <= enough) return size / scale;
  for (int row = begin; row < begin + SIZES[level]; ++row) add(gradient, p->slack[row] / size, k->a[row]);
  if (k->decisive[level] > 0) {
    suggested_multipliers(p, k, level, begin, size, x);
    bound = smaller(bound, evaluate(p, k, gradient, begin, x, RESOLVED * scale));
  }
  /* Where rows are nearly dependent, large multipliers of hardly any descent may explain what is left. */
  for (int i = 0; i < 2 && bound > enough; ++i) {
    search_multipliers(p, k, gradient, begin, i == 0 ? DESCENT : LEAST_DESCENT, x);
    bound = smaller(bound, evaluate(p, k, gradient, begin, x, RESOLVED * scale));
  }
  return bound / scale;
}

/* y may be in the box, where there is one, but no farther from v than REACH. */
static void keep_in_box(Proof *p, const Work *k) {
  for (int c = 0; c < N; ++c) {
    int boxed = k->box[0][c] > -INFINITY && k->box[1][c] < INFINITY;
    p->down[c] = boxed ? smaller(larger(k->v[c] - k->box[0][c], 0), REACH) : REACH;
    p->up[c] = boxed ? smaller(larger(k->box[1][c] - k->v[c], 0), REACH) : REACH;
  }
}

/* The box is made of rows of the first level, which may contradict each other: its own optimum may be outside. */
static void let_out_of_box(Proof *p) {
  for (int c = 0; c < N; ++c) p->down[c] = p->up[c] = REACH;
}

static void begin_proof(Proof *p, const Work *k) {
  double length = size_of(k->v, N), far = 0;
  keep_in_box(p, k);
  for (int c = 0; c < N; ++c) far += larger(p->down[c], p->up[c]) * larger(p->down[c], p->up[c]);
  for (int row = 0; row < M; ++row) {
    p->y[row] = dot(k->a[row], k->v, N);
    p->slack[row] = p->y[row] - smaller(larger(p->y[row], k->lower[row]), k->upper[row]);
    p->noise[row] = N * ROUNDING * k->norm[row] * (length + sqrt(far));
  }
}

/* `normal_certificate` of certificate.py at k->v. */
static double certificate(Proof *p, const Work *k) {
  double worst = 0;
  begin_proof(p, k);
  for (int level = 0, begin = 0; level < L; begin += SIZES[level++]) {
    if (begin == 0) let_out_of_box(p);
    else keep_in_box(p, k);
    double excess = level_excess(p, k, level, begin);
    if (!(excess <= worst)) worst = excess < INFINITY ? excess : INFINITY;
  }
  return worst;
}
