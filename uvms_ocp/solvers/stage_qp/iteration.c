/* From a start to the optimum, or to where it cannot go on. */

/* Where few digits are asked for. */
#define ROUGH(q) ((q)->tolerance > FINISHED)

/* How far corrections go in the end. */
#define DIGITS(q) (ROUGH(q) ? ROUGHLY : EXACT)

/* The optimum without inequalities, from the z, costates and y that are given: one factor, unless it is there, and corrections
down to a share `exact` of the tolerance. */
static int solve_equalities(Problem *q, double exact, int factored) {
  double *p = q->point, before = INFINITY;
  memset(S(p), 0, sizeof(double) * (size_t)(USED - SIDELESS));
  const int wrong = factored ? 0 : find_factor(q, p, 0);
  if (wrong) return wrong;
  for (int k = 0;; ++k) {
    find_residuals(q, p, &q->now);
    const Residuals *r = &q->now;
    double equal = largest_of(q->n_x, r->defect);
    for (int j = 0; j < q->n_bounded; ++j) equal = larger_of(equal, fabs(r->equal[q->bounded[j]]) / q->norm[q->bounded[j]]);
    const double left = larger_of(largest_of(q->n, r->grad) / r->gradient, equal / r->variable);
    const int enough = left <= 0.1 * q->tolerance && !(left <= 0.5 * before);
    if (k == MOST_CORRECTIONS || enough || !(left > exact * q->tolerance)) break;
    if (left > q->tolerance && left > HOPELESSLY * before) break;
    before = left;
    find_direction(q, p, &q->now, 0, 0, q->step);
    move(SIDELESS, p, q->step, 1.0, p);
  }
  for (int k = 0; k < q->n_bounded; ++k)
    for (int u = 0, i = q->bounded[k]; u < 2; ++u) {
      const int j = 2 * i + u;
      const double beyond = (u ? -1.0 : 1.0) * (q->now.value[i] - q->bound[j]);
      S(p)[j] = q->side[j] != 0.0 && beyond > 0.0 ? beyond : 0.0;
      F(p)[j] = q->elastic[j] != 0.0 ? q->l1[i] : 0.0;
    }
  judge_rows(q, p, &q->now, q->now.steepest);
  return 0;
}

/* Fixed variables where they are to be, all others at 0. */
static void rest(Problem *q) {
  for (int v = 0; v < q->n; ++v) Z(q->point)[v] = q->stages.fixed[v] != 0.0 ? q->z_lower[v] : 0.0;
}

/* Largest violation of a side relative to the norm of its row, `value` given; -1 where there is none. */
static double side_missed(const Problem *q, const double *value) {
  double most = -1.0;
  for (int k = 0; k < q->n_bounded; ++k)
    for (int u = 0, i = q->bounded[k]; u < 2; ++u) {
      const int j = 2 * i + u;
      const double missed = (u ? 1.0 : -1.0) * (value[i] - q->bound[j]) / q->norm[i];
      if (q->side[j] != 0.0 && missed > most) most = missed;
    }
  return most;
}

/* A start inside, from z alone. */
static void start_cold(Problem *q) {
  double *p = q->point;
  memset(p + q->n, 0, sizeof(double) * (size_t)(SIZE - q->n));
  find_residuals(q, p, &q->now);
  const double missed = larger_of(side_missed(q, q->now.value), LEAST_MISSED);
  const double mu = q->cold_mu * missed * larger_of(q->curvature * missed, q->now.stationarity);
  for (int k = 0; k < q->n_bounded; ++k)
    for (int u = 0, i = q->bounded[k]; u < 2; ++u) {
      const int j = 2 * i + u;
      const double beyond = (u ? -1.0 : 1.0) * (q->now.value[i] - q->bound[j]);
      if (q->side[j] == 0.0) continue;
      S(p)[j] = larger_of(beyond, missed * q->norm[i]);
      MULTIPLIER(p)[j] = mu / S(p)[j];
      if (q->elastic[j] == 0.0) continue;
      if (MULTIPLIER(p)[j] > 0.5 * q->l1[i]) MULTIPLIER(p)[j] = 0.5 * q->l1[i];
      E(p)[j] = missed * q->norm[i], F(p)[j] = q->l1[i] - MULTIPLIER(p)[j];
    }
}

/* By how much conditions fail at z, costate and y that are given, sides aside that are kept. */
static double how_far(Problem *q) {
  const Residuals *r = &q->now;
  const double missed = larger_of(side_missed(q, r->value), largest_of(q->n_x, r->defect));
  return larger_of(r->stationarity / r->gradient, missed / r->variable);
}

/* A start near a point whose z, costate and y are given, y of all rows; a cold one where bounds are hard and the point is far. */
static void start_warm(Problem *q) {
  double *p = q->point, warm_mu = q->warm_mu;
  memset(S(p), 0, sizeof(double) * (size_t)(8 * q->M));
  find_residuals(q, p, &q->now);
  if (!q->is_elastic) {
    const double far = how_far(q);
    if (far > FAR) {
      rest(q);
      start_cold(q);
      return;
    }
    warm_mu = far * far < NEARER * warm_mu ? larger_of(far * far, warm_mu / NEARER) : NEARER * warm_mu;
  }
  const double room = sqrt(warm_mu), mu = warm_mu * q->curvature;
  for (int i = 0; i < q->M; ++i) {
    const double y = Y(p)[i];
    if (q->equal[i] == 0.0) Y(p)[i] = 0.0;
    for (int u = 0; u < 2; ++u) {
      const int j = 2 * i + u;
      const double beyond = (u ? -1.0 : 1.0) * (q->now.value[i] - q->bound[j]), given = u ? y : -y;
      S(p)[j] = MULTIPLIER(p)[j] = E(p)[j] = F(p)[j] = 0.0;
      if (q->side[j] == 0.0) continue;
      S(p)[j] = larger_of(beyond, room * q->norm[i]);
      MULTIPLIER(p)[j] = larger_of(given, mu / S(p)[j]);
      if (q->elastic[j] == 0.0) continue;
      if (MULTIPLIER(p)[j] > 0.999 * q->l1[i]) MULTIPLIER(p)[j] = 0.999 * q->l1[i];
      F(p)[j] = q->l1[i] - MULTIPLIER(p)[j];
      E(p)[j] = larger_of(-beyond, mu / F(p)[j]);
    }
  }
}

/* From a start inside to the optimum, or to where it cannot go on; the best point is left in `point`, with its residuals. */
static int descend(Problem *q) {
  double share = 1.0, least = INFINITY, lowest = INFINITY, first;
  int stuck = 0, vain = 0, high = 0, status;
  q->share = 0.0;
  find_residuals(q, q->point, &q->now);
  first = q->now.gradient;
  for (;;) {
    const double left = q->now.worst, stationarity = q->now.stationarity, primal = q->now.primal;
    ++vain;
    if (left < least || least == INFINITY) vain = 0, least = left, memcpy(q->best, q->point, sizeof(double) * (size_t)USED);
    status = SOLVED;
    if (left <= q->tolerance) break;
    status = UNBOUNDED;
    stuck = share < STUCK ? stuck + 1 : 0;
    /* Where a direction has no curvature, steps are endless long before the point is. */
    if (larger_of(q->now.variable, stuck > 2 ? largest_of(q->n, Z(q->step)) : 0.0) > ENDLESS) break;
    status = ITERATION_LIMIT;
    ++high;
    if (q->now.primal < 0.9 * lowest) high = 0, lowest = q->now.primal;
    if (high > MOST_HIGH && lowest > q->tolerance * q->now.variable) break;
    if (vain > MOST_VAIN && least <= INEXACT_TOLERANCES * q->tolerance) break;
    if (stuck > 2 || q->now.gradient > HOPELESS * first || !(left < INFINITY) || q->iterations >= q->max_iterations) break;
    share = q->share = advance(q);
    if (share == -1.0) status = NOT_CONVEX;
    if (share < 0.0) break;
    find_residuals(q, q->point, &q->now);
    if (q->corrections < 3 && (q->now.stationarity > 2.0 * (1.0 - share) * stationarity + 0.1 * q->tolerance * q->now.gradient ||
                               q->now.primal > 2.0 * (1.0 - share) * primal + 0.1 * q->tolerance * q->now.variable))
      ++q->corrections;
  }
  if (!vain) return status; /* The last point is the best, and `now` is of it. */
  memcpy(q->point, q->best, sizeof(double) * (size_t)USED);
  find_residuals(q, q->point, &q->now);
  return status;
}

/* The optimum without inequalities, 1 where that is the end: z starts anew if it misses any. */
static int start_from_equalities(Problem *q) {
  const Residuals *r = &q->now;
  memcpy(q->best, q->point, sizeof(double) * (size_t)q->n);
  memset(q->point + q->n, 0, sizeof(double) * (size_t)(SIZE - q->n));
  const int wrong = solve_equalities(q, DIGITS(q), 0);
  q->status = wrong == 2 ? NOT_A_NUMBER : wrong == 1 ? NOT_CONVEX : SOLVED;
  if (!wrong && r->stationarity <= q->tolerance * r->gradient && r->primal <= q->tolerance * r->variable &&
      !(side_missed(q, r->value) > 0.0))
    return 1;
  memcpy(q->point, q->best, sizeof(double) * (size_t)q->n);
  start_cold(q);
  return wrong;
}

static void begin(Problem *q, int costless, int damped) {
  double *points[] = {q->point, q->best, q->step, q->affine, q->trial};
  const int was_elastic = q->is_elastic;
  q->is_elastic = largest_of(2 * q->M, q->elastic) > 0.0;
  for (int a = 0; a < 5 && was_elastic && !q->is_elastic; ++a) memset(E(points[a]), 0, sizeof(double) * (size_t)(4 * q->M));
  load_stages(&q->stages, costless);
  q->curvature = costless ? 1.0 : q->stages.most;
  q->slow = damped ? SLOW : 0.0;
  q->iterations = q->corrections = 0;
  for (int i = 0; i < q->M; ++i) q->elasticity[i] = ELASTICITY * q->norm[i] * q->norm[i] / q->curvature;
  find_bounded(q);
}

/* Whether it went through an interior. */
static int run(Problem *q) {
  if (q->start == START_WARM) start_warm(q);
  if (q->start == START_COLD) start_cold(q);
  if (q->start == START_EQUALITIES && start_from_equalities(q)) return 0;
  q->status = descend(q);
  return 1;
}

/* Status, iterations, `point` and the residuals `now`, from what `point` holds: z, where fixed variables have their values, and for a warm start costates and multipliers too; without its cost if it is costless, with steps that are damped. */
void solve_qp(Problem *q, int costless, int damped) {
  begin(q, costless, damped);
  run(q);
}

/* Sides that hold the solution of a QP nearby where it is; 0 where none is without a multiplier, as an interior point leaves them
that did not find which they are. */
static int find_reached(Problem *q, const double *near) {
  int known = 0;
  for (int j = 0; j < 2 * q->M; ++j) {
    const double y = Y(near)[j / 2];
    q->active[j] = q->side[j] != 0.0 && (j & 1 ? y > 0.0 : y < 0.0);
    known |= q->side[j] != 0.0 && y == 0.0;
  }
  return known || largest_of(2 * q->M, q->side) == 0.0;
}

/* Sides that the last step of an interior point approached: what is left of them fell more than their multipliers did; where it
changed neither, those whose multipliers are large beside what is left. */
static void find_approached(Problem *q) {
  const double *p = q->point, *d = q->step, *norm = q->norm;
  for (int j = 0; j < 2 * q->M; ++j) {
    const double s = S(p)[j], y = MULTIPLIER(p)[j], more = y * S(d)[j] - s * MULTIPLIER(d)[j];
    const int i = j / 2, large = s * q->now.gradient < y * norm[i] * norm[i] * q->now.variable;
    q->active[j] = q->side[j] != 0.0 && (fabs(more) < UNCLEAR * s * y ? large : more < 0.0);
  }
}

/* The optimum with active sides as equalities and without all others, from the point that is given; 0 where there is none. */
static int solve_held(Problem *q, double exact, int factored) {
  double *side = q->side, *equal = q->equal, *target = q->target;
  for (int i = 0; i < q->M; ++i) {
    const double lower = q->active[2 * i], upper = q->active[2 * i + 1];
    const int any = lower != 0.0 || upper != 0.0;
    q->held_equal[i] = any ? 1.0 : equal[i];
    q->held_target[i] = any ? lower * q->bound[2 * i] + upper * q->bound[2 * i + 1] : target[i];
    if (q->held_equal[i] == 0.0) Y(q->point)[i] = 0.0;
  }
  q->side = q->no_side, q->equal = q->held_equal, q->target = q->held_target;
  find_bounded(q);
  const int wrong = solve_equalities(q, exact, factored);
  q->side = side, q->equal = equal, q->target = target;
  q->status = SOLVED;
  return !wrong && q->now.stationarity <= q->tolerance * q->now.gradient && q->now.primal <= q->tolerance * q->now.variable;
}

/* Sides that pull are let go, those that are missed are held; how many change. */
static int mend(Problem *q, double sharp) {
  const double room = sharp * q->tolerance * (1.0 + largest_of(q->n, Z(q->point)));
  int changes = 0;
  for (int j = 0; j < 2 * q->M; ++j) {
    const int i = j / 2, held = q->active[j] != 0.0;
    if (q->side[j] == 0.0) continue;
    const double sign = SIGN(j), missed = sign * (q->bound[j] - q->now.value[i]);
    const int holds = held ? sign * Y(q->point)[i] <= 0.0 : missed > room * q->norm[i];
    changes += holds != held, q->active[j] = holds;
  }
  return changes;
}

/* The optimum where the bounds that it reaches are found soon, starting with active ones; 0 leaves the point as it was. */
static int solve_active(Problem *q) {
  int fewest = 4 * MANY_CHANGES, vain = 0, last = ROUGH(q) || !q->n_bounded, changes = 1;
  memcpy(q->trial, q->point, sizeof(double) * (size_t)SIDELESS);
  /* Few digits tell which sides change; all of them are found where none does. */
  while (solve_held(q, last ? DIGITS(q) : ROUND, !changes)) {
    changes = mend(q, last && !ROUGH(q) ? SHARP : 1.0);
    if (!changes && last) return 1;
    if (!changes) {
      last = 1;
      continue;
    }
    vain = 2 * changes <= fewest ? 0 : vain + 1;
    if (vain > (changes > MANY_CHANGES ? 0 : VAIN_CHANGES)) break;
    if (!vain) fewest = changes;
  }
  memcpy(q->point, q->trial, sizeof(double) * (size_t)SIDELESS);
  find_bounded(q);
  return 0;
}

/* The optimum near that of another QP, whose costates and multipliers are in `point`. */
static int solve_near(Problem *q) {
  double *p = q->point;
  memcpy(q->best, p, sizeof(double) * (size_t)q->n);
  const int known = find_reached(q, p);
  rest(q);
  const int found = known && solve_active(q);
  if (!found) memcpy(p, q->best, sizeof(double) * (size_t)q->n);
  return found;
}

/* What an interior point comes close to, to all digits: with the sides that it approaches as equalities, where those are right. */
static void finish(Problem *q) {
  const int iterations = q->iterations;
  double *p = q->point;
  memcpy(q->best, p, sizeof(double) * (size_t)USED);
  find_approached(q);
  for (int i = 0; i < q->M; ++i) Y(p)[i] += MULTIPLIER(p)[2 * i + 1] - MULTIPLIER(p)[2 * i];
  if (solve_active(q)) return;
  memcpy(p, q->best, sizeof(double) * (size_t)USED);
  find_residuals(q, p, &q->now);
  q->status = SOLVED, q->iterations = iterations;
}

/* Multipliers of sides that an interior point keeps off would be taken for those of sides that it reaches. */
static void forget(Problem *q) {
  find_approached(q);
  for (int j = 0; j < 2 * q->M; ++j)
    if (q->active[j] == 0.0) MULTIPLIER(q->point)[j] = 0.0;
}

/* The same as solve_qp from nothing but the QP, or from z, costates and multipliers in `point` that are those of a QP nearby. */
void solve_whole(Problem *q, int near) {
  q->status = NOT_A_NUMBER;
  if (!make_table(q)) return;
  begin(q, 0, 0);
  if (!has_numbers(&q->stages)) return;
  const int hard = !q->is_elastic;
  q->start = near ? START_WARM : START_EQUALITIES;
  if (!near) memset(q->point, 0, sizeof(double) * (size_t)SIZE);
  if (near && hard && solve_near(q)) return;
  q->iterations = q->corrections = 0;
  for (int v = 0; v < q->n; ++v)
    if (q->stages.fixed[v] != 0.0) Z(q->point)[v] = q->z_lower[v];
  if (!run(q) || !hard || q->status != SOLVED || !(q->share > 0.0)) return;
  if (ROUGH(q))
    forget(q);
  else
    finish(q);
}
