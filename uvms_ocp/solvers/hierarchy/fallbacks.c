/* What is tried one after the other until a velocity is certified.

   The core from a warm start, then cold; level by level, ordinarily and with more care; with fewer levels. All runs together
   have MOST_OF_ALL iterations. Where nothing is certified the best velocity counts, by the levels in their order. */

typedef struct {
  Work work;
  Proof proof;
  /* Bounds of all rows; those of `work` are what a run is about. */
  double lower[M], upper[M];
  /* The best so far, once there is one. */
  double v[N], missed[L];
  int state[M], found;
} Solver;

static const Manner ORDINARY = {RANK_TOLERANCE, RANK_NOISE, MULTIPLIER};
static const Manner CAREFUL = {CAREFUL_RANK, CAREFUL_NOISE, CAREFUL_MULTIPLIER};

static int is_finite(const double *x) {
  for (int c = 0; c < N; ++c)
    if (!(fabs(x[c]) < ENDLESS)) return 0;
  return 1;
}

static int is_warm(const double *state) {
  for (int row = 0; row < M; ++row)
    if (state && state[row] != 0) return 1;
  return 0;
}

/* Without the rows from `end` on. */
static void restore_bounds(Solver *s, int end) {
  for (int row = 0; row < M; ++row) {
    s->work.lower[row] = row < end ? s->lower[row] : -INFINITY;
    s->work.upper[row] = row < end ? s->upper[row] : INFINITY;
  }
}

/* Of two velocities, levels whose residuals differ by rounding are equal, and the next one decides. */
static int is_better(const double *missed, const double *than) {
  for (int level = 0; level < L; ++level)
    if (fabs(missed[level] - than[level]) > TIED * (1 + than[level])) return missed[level] < than[level];
  return 0;
}

static void keep(Solver *s, const double *missed) {
  memcpy(s->v, s->work.v, sizeof(s->v));
  memcpy(s->state, s->work.state, sizeof(s->state));
  memcpy(s->missed, missed, sizeof(s->missed));
  s->found = 1;
}

static double miss(const Solver *s, int row) {
  double y = dot(s->work.a[row], s->work.v, N);
  return y - smaller(larger(y, s->lower[row]), s->upper[row]);
}

/* Whether the velocity of the run is certified; else it is kept if it is the best so far. */
static int is_proven(Solver *s) {
  double missed[L] = {0}, of_row[M];
  restore_bounds(s, M);
  if (!is_finite(s->work.v)) return 0;
  for (int row = 0; row < M; ++row) of_row[row] = miss(s, row);
  for (int level = 0, begin = 0; level < L; begin += SIZES[level++]) missed[level] = size_of(of_row + begin, SIZES[level]);
  int proven = certificate(&s->proof, &s->work) <= CERTIFIED;
  if (proven || !s->found || is_better(missed, s->missed)) keep(s, missed);
  return proven;
}

/* No multipliers of another run may be taken for those of this one. */
static void attempt(Solver *s, const double *state) {
  memset(s->work.decisive, 0, sizeof(s->work.decisive));
  run(&s->work, state);
}

/* Bounds for the level of rows begin..end: those above may miss theirs by as much as they do at v, those below are free. */
static void hold(Solver *s, const double *v, int begin, int end) {
  restore_bounds(s, end);
  for (int row = 0; row < begin; ++row) {
    double y = dot(s->work.a[row], v, N);
    s->work.lower[row] = smaller(y, s->lower[row]);
    s->work.upper[row] = larger(y, s->upper[row]);
  }
}

static double near(const Solver *s, int row) {
  double sum = 1;
  for (int c = 0; c < N; ++c) sum += fabs(s->work.a[row][c]);
  return TOUCHING * sum;
}

/* Whether the run has left the levels above where they were held. */
static int is_held(const Solver *s, int begin) {
  if (!is_finite(s->work.v)) return 0;
  for (int row = 0; row < begin; ++row) {
    double y = dot(s->work.a[row], s->work.v, N), most = near(s, row);
    if (!(y >= s->work.lower[row] - most && y <= s->work.upper[row] + most)) return 0;
  }
  return 1;
}

/* Bounds that v touches. */
static void touch(const Solver *s, double *state) {
  for (int row = 0; row < M; ++row) {
    double y = dot(s->work.a[row], s->work.v, N), most = near(s, row);
    state[row] = y >= s->upper[row] - most ? UPPER : y <= s->lower[row] + most ? LOWER : FREE;
  }
}

/* Every level on its own, with those above held, then a run that starts where they end. */
static int by_levels(Solver *s, const Manner *manner) {
  double v[N] = {0}, state[M];
  s->work.manner = *manner;
  for (int level = 0, begin = 0; level < L && s->work.left > 0; begin += SIZES[level++]) {
    hold(s, v, begin, begin + SIZES[level]);
    attempt(s, 0);
    if (is_held(s, begin)) memcpy(v, s->work.v, sizeof(v));
  }
  memcpy(s->work.v, v, sizeof(v));
  memset(s->work.decisive, 0, sizeof(s->work.decisive));
  touch(s, state);
  for (int row = 0; row < M; ++row) s->work.state[row] = (int)state[row];
  if (is_proven(s)) return 1;
  attempt(s, state);
  return is_proven(s);
}

/* As many of the first levels as can be solved: what is given up is given up from the bottom. */
static int by_fewer_levels(Solver *s) {
  s->work.manner = ORDINARY;
  for (int level = L - 1, end = M; level > 0 && s->work.left > 0; --level) {
    end -= SIZES[level];
    restore_bounds(s, end);
    attempt(s, 0);
    if (is_finite(s->work.v) && certificate(&s->proof, &s->work) <= CERTIFIED) return is_proven(s);
  }
  return 0;
}

/* s->v and s->state, for the rows that are loaded; which `Status` that is. */
static int solve(Solver *s, const double *state) {
  memcpy(s->lower, s->work.lower, sizeof(s->lower));
  memcpy(s->upper, s->work.upper, sizeof(s->upper));
  memset(s->v, 0, sizeof(s->v));
  memset(s->state, 0, sizeof(s->state));
  s->found = 0;
  s->work.manner = ORDINARY;
  s->work.left = MOST_OF_ALL;
  attempt(s, state);
  if (is_proven(s)) return SOLVED;
  if (is_warm(state)) {
    attempt(s, 0);
    if (is_proven(s)) return COLD_STARTED;
  }
  return by_levels(s, &ORDINARY) || by_levels(s, &CAREFUL) || by_fewer_levels(s) ? CASCADED : INEXACT;
}

/* The solver: rows as they are given in, velocity and code of the `Status` out.

   jacobian (M, N) column-major, lower, upper and gate (M): the rows. active_set (M): 0 before the first call, then what the
   call before left there. v (N): finite, 0 where the input is invalid. residual (M): signed distance of J v to [lower, upper],
   0 where the gate is 0. iterations: of all runs, MOST_OF_ALL at most. No allocation: what it works with is on the stack. */
int solve_levels(const double *jacobian, const double *lower, const double *upper, const double *gate, double *active_set,
                 double *v, double *residual, int *iterations) {
  Solver s;
  Rows rows = {jacobian, lower, upper, gate};
  int status = INVALID_INPUT;
  *iterations = 0;
  memset(v, 0, N * sizeof(double));
  memset(residual, 0, M * sizeof(double));
  if (is_valid(&rows)) {
    load(&s.work, &rows);
    status = solve(&s, active_set);
    *iterations = MOST_OF_ALL - s.work.left;
    for (int c = 0; c < N; ++c) v[c] = s.v[c] * s.work.velocity;
    if (!is_finite(v)) memset(v, 0, N * sizeof(double)), status = INEXACT;
    if (are_missed(&s.work, &rows, v)) status = INEXACT;
    write_residual(v, &rows, residual);
  }
  for (int row = 0; row < M; ++row) active_set[row] = status == INVALID_INPUT ? 0 : s.state[row];
  return status;
}
