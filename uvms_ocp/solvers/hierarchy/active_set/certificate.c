/* certificate.py in C: how far v is from lexicographic optimality, whatever the run that found v says of itself. */

typedef struct {
  /* Unit directions of the multipliers that the levels so far lend to the next. */
  double push[2 * M][N], multiplier[2 * M];
  int count, used, set[N];
  char is_used[2 * M], refused[2 * M];
} Pushes;

static double size_of(const double *x) { return sqrt(dot(x, x, N)); }

/* min |sum x push - b| over the first `used` pushes of the set, x of any sign; 0 where they are dependent. */
static int fit(const Pushes *p, const double *b, double *x) {
  double B[N][N];
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < p->used; ++j) B[i][j] = p->push[p->set[j]][i];
  double r[N];
  memcpy(r, b, sizeof(r));
  least_squares(B, r, N, p->used);
  memcpy(x, r, p->used * sizeof(double));
  for (int j = 0; j < p->used; ++j)
    if (!(fabs(x[j]) < ENDLESS)) return 0;
  return 1;
}

/* b without what the multipliers explain of it. */
static void remainder_of(const Pushes *p, const double *b, double *rest) {
  memcpy(rest, b, N * sizeof(double));
  for (int j = 0; j < p->used; ++j) add(rest, -p->multiplier[p->set[j]], p->push[p->set[j]]);
}

static int steepest(const Pushes *p, const double *rest, double least) {
  int chosen = -1;
  for (int j = 0; j < p->count; ++j) {
    if (p->is_used[j] || p->refused[j]) continue;
    double descent = dot(p->push[j], rest, N);
    if (descent > least) least = descent, chosen = j;
  }
  return chosen;
}

/* From the multipliers towards x until the first is 0, which leaves the set; true if x is reached. */
static int retreat(Pushes *p, const double *x) {
  double length = 1;
  int left = -1;
  for (int j = 0; j < p->used; ++j) {
    double now = p->multiplier[p->set[j]], part = now > 0 ? now / (now - x[j]) : 0;
    if (x[j] <= 0 && (left < 0 || part < length)) length = part, left = j;
  }
  for (int j = 0; j < p->used; ++j) {
    double *now = &p->multiplier[p->set[j]];
    *now = fmax(0, *now + length * (x[j] - *now));
  }
  if (left < 0) return 1;
  p->multiplier[p->set[left]] = 0;
  p->is_used[p->set[left]] = 0;
  memmove(p->set + left, p->set + left + 1, (p->used - left - 1) * sizeof(int));
  --p->used;
  return 0;
}

/* min |gradient + sum x push| over x >= 0 (Lawson and Hanson); an upper bound of it where that does not end. */
static double unbalanced(Pushes *p, const double *gradient) {
  double b[N], rest[N], x[N], least = DESCENT * size_of(gradient), smallest;
  for (int c = 0; c < N; ++c) b[c] = -gradient[c];
  memcpy(rest, b, sizeof(b));
  memset(p->multiplier, 0, sizeof(p->multiplier));
  memset(p->is_used, 0, sizeof(p->is_used));
  memset(p->refused, 0, sizeof(p->refused));
  p->used = 0;
  smallest = size_of(rest);
  for (int round = 0; round < 6 * M && p->used < N; ++round) {
    int chosen = steepest(p, rest, least);
    if (chosen < 0) break;
    p->set[p->used++] = chosen;
    if (!fit(p, b, x) || x[p->used - 1] <= 0) {
      p->refused[chosen] = 1;
      --p->used;
      continue;
    }
    p->is_used[chosen] = 1;
    while (!retreat(p, x) && p->used > 0)
      if (!fit(p, b, x)) return smallest;
    remainder_of(p, b, rest);
    smallest = fmin(smallest, size_of(rest));
    memset(p->refused, 0, sizeof(p->refused));
  }
  return smallest;
}

static double clipped(const Work *k, int row, double y) { return fmin(fmax(y, k->lower[row]), k->upper[row]); }

static double noise_of(const Work *k, int row) { return N * ROUNDING * k->norm[row] * size_of(k->v); }

static void push(Pushes *p, const Work *k, int row, double sign) {
  for (int c = 0; c < N; ++c) p->push[p->count][c] = sign * k->a[row][c] / k->norm[row];
  ++p->count;
}

static void add_pushes(Pushes *p, const Work *k, int row, double least) {
  double y = dot(k->a[row], k->v, N), at = clipped(k, row, y), size = k->norm[row] + fabs(at), noise = noise_of(k, row);
  int fixed = k->lower[row] >= k->upper[row] || fabs(y - at) > least * size + noise;
  if (k->norm[row] == 0) return;
  if (fixed || y >= k->upper[row] - ACTIVE * size - noise) push(p, k, row, 1);
  if (fixed || y <= k->lower[row] + ACTIVE * size + noise) push(p, k, row, -1);
}

/* Largest |J' s + C' x| / (|J| |s| + 1) of any level, x >= 0; see certificate.py. */
static double certificate(const Work *k, double enough) {
  static _Thread_local Pushes p;
  double worst = 0;
  p.count = 0;
  for (int level = 0, begin = 0; level < L && worst <= enough; begin += SIZES[level++]) {
    double gradient[N] = {0}, rows = 0, slacks = 0;
    for (int row = begin; row < begin + SIZES[level]; ++row) {
      double y = dot(k->a[row], k->v, N), slack = y - clipped(k, row, y);
      if (fabs(slack) <= noise_of(k, row)) slack = 0;
      add(gradient, slack, k->a[row]);
      rows += dot(k->a[row], k->a[row], N), slacks += slack * slack;
    }
    double size = sqrt(rows * slacks), left = size_of(gradient);
    if (left > NO_GRADIENT) left = unbalanced(&p, gradient);
    double part = left / (size + 1);
    if (!(part <= worst)) worst = part < INFINITY ? part : INFINITY;
    double least = left <= SLIGHTLY_BALANCED * size ? SLIGHT : ACTIVE;
    for (int row = begin; row < begin + SIZES[level]; ++row) add_pushes(&p, k, row, least);
  }
  return worst;
}
