/* Primal-dual interior point, as interior_point.py and iteration.py have it; keep both in step.

A point is one array: z (n), costate (n_x), y (M), then s, multiplier, e, f (2 M each: lower sides, upper sides). Rows M are those
of constraints (m), then the variables. */

typedef struct {
  double *grad, *held, *defect, *value, *row, *equal, *dual;
  double stationarity, primal, complementarity, gradient, variable, linear, worst;
} Residuals;

typedef struct {
  Stages stages;
  int M, m, n, n_x;
  const double *bound, *side, *elastic, *equal, *target, *l1, *l2, *compliance, *norm; /* RowTable; flags are 0 or 1 */
  double *elasticity, *point, *best, *step, *affine, *trial;
  double *weight, *soft, *left, *gap, *pull, *rhs, *t_side, *t_elastic; /* of direction() */
  Residuals now, other;
  double curvature, tolerance, warm_mu;
  int max_iterations, iterations, corrections, status, start;
} Problem;

#define Z(p) (p)
#define COSTATE(p) ((p) + q->n)
#define Y(p) (COSTATE(p) + q->n_x)
#define S(p) (Y(p) + q->M)
#define MULTIPLIER(p) (S(p) + 2 * q->M)
#define E(p) (MULTIPLIER(p) + 2 * q->M)
#define F(p) (E(p) + 2 * q->M)
#define SIZE (q->n + q->n_x + 9 * q->M)

/* NaN wins, so that it is noticed. */
static double larger_of(double a, double b) { return a != a || a > b ? a : b; }

static double largest_of(int n, const double *a) {
  double most = 0.0;
  for (int i = 0; i < n; ++i) most = larger_of(most, fabs(a[i]));
  return most;
}

static void find_residuals(Problem *q, const double *p, Residuals *r) {
  const int M = q->M, m = q->m, n = q->n;
  double *y = q->pull, primal = 0.0, dual = 0.0, linear = 0.0, multipliers = 0.0, products = 0.0;
  for (int i = 0; i < M; ++i) y[i] = Y(p)[i] + MULTIPLIER(p)[M + i] - MULTIPLIER(p)[i];
  const double largest = evaluate_stages(&q->stages, Z(p), COSTATE(p), y, y + m, r->grad, r->defect, r->value);
  for (int i = 0; i < n; ++i) {
    r->held[i] = q->stages.fixed[i] != 0.0 ? r->grad[i] : 0.0;
    if (q->stages.fixed[i] != 0.0) r->grad[i] = 0.0;
    r->value[m + i] = Z(p)[i];
  }
  for (int i = 0; i < M; ++i) {
    double missed = 0.0;
    for (int u = 0; u < 2; ++u) {
      const int j = u * M + i;
      const double beyond = (u ? -1.0 : 1.0) * (r->value[i] - q->bound[j]);
      r->row[j] = r->dual[j] = 0.0;
      if (q->side[j] != 0.0) {
        r->row[j] = beyond + E(p)[j] + q->compliance[i] * MULTIPLIER(p)[j] - S(p)[j];
        linear = larger_of(linear, fabs(r->row[j]) / q->norm[i]);
        if (q->elastic[j] == 0.0 && q->compliance[i] == 0.0) missed = larger_of(missed, -beyond);
      }
      if (q->elastic[j] != 0.0) {
        r->dual[j] = q->l1[i] + q->l2[i] * E(p)[j] - MULTIPLIER(p)[j] - F(p)[j];
        dual = larger_of(dual, fabs(r->dual[j]) * q->norm[i]);
      }
      products = larger_of(products, larger_of(S(p)[j] * MULTIPLIER(p)[j], E(p)[j] * F(p)[j]));
    }
    r->equal[i] = q->equal[i] != 0.0 ? r->value[i] - q->target[i] - q->compliance[i] * Y(p)[i] : 0.0;
    linear = larger_of(linear, fabs(r->equal[i]) / q->norm[i]);
    primal = larger_of(primal, missed / q->norm[i]);
    multipliers = larger_of(multipliers, fabs(y[i]) * q->norm[i]);
  }
  linear = larger_of(linear, largest_of(q->n_x, r->defect));
  r->stationarity = larger_of(largest_of(n, r->grad), dual);
  r->primal = larger_of(primal, linear);
  r->complementarity = products;
  r->gradient = larger_of(largest, larger_of(multipliers, LEAST_SIZE * q->curvature));
  r->variable = 1.0 + largest_of(n, Z(p));
  r->linear = larger_of(r->stationarity / r->gradient, linear / r->variable);
  r->worst = larger_of(larger_of(r->stationarity / r->gradient, r->primal / r->variable),
                       SHARPER * r->complementarity / (r->gradient * r->variable));
}

/* Weights of the sides at p, and the factor with them. */
static int find_factor(Problem *q, const double *p, int sides) {
  const int M = q->M;
  double *total = q->pull;
  ++q->iterations;
  for (int i = 0; i < M; ++i) {
    total[i] = q->equal[i] != 0.0 ? 1.0 / (q->elasticity[i] + q->compliance[i]) : 0.0;
    for (int j = i; j < 2 * M; j += M) {
      const double e = E(p)[j], f = F(p)[j], multiplier = MULTIPLIER(p)[j];
      q->soft[j] = q->weight[j] = 0.0;
      if (!sides || !(multiplier > 0.0)) continue;
      if (f > 0.0) q->soft[j] = e / (f + e * q->l2[i]);
      q->weight[j] =
          multiplier / (multiplier * (SIDE_ELASTICITY * q->elasticity[i] + q->compliance[i] + q->soft[j]) + S(p)[j]);
      total[i] += q->weight[j];
    }
  }
  return factor_stages(&q->stages, total, total + q->m);
}

/* Of Newton's method, towards products that differ by t_side and t_elastic from those at p; 0 for no change. */
static void find_direction(Problem *q, const double *p, const Residuals *r, const double *t_side, const double *t_elastic,
                           double *out) {
  const int M = q->M, m = q->m;
  for (int i = 0; i < M; ++i) {
    q->pull[i] = q->equal[i] != 0.0 ? r->equal[i] / (q->elasticity[i] + q->compliance[i]) : 0.0;
    for (int u = 0; u < 2; ++u) {
      const int j = u * M + i;
      q->left[j] = q->gap[j] = 0.0;
      if (F(p)[j] > 0.0) q->left[j] = ((t_elastic ? t_elastic[j] : 0.0) - E(p)[j] * r->dual[j]) / (F(p)[j] + E(p)[j] * q->l2[i]);
      q->gap[j] = r->row[j] + q->left[j];
      if (t_side && MULTIPLIER(p)[j] > 0.0) q->gap[j] -= t_side[j] / MULTIPLIER(p)[j];
      q->pull[i] += (u ? -1.0 : 1.0) * q->weight[j] * q->gap[j];
    }
  }
  memcpy(q->rhs, r->grad, sizeof(double) * (size_t)q->n);
  add_transposed(&q->stages, q->pull, q->pull + m, q->rhs);
  solve_stages(&q->stages, q->rhs, r->defect, Z(out), COSTATE(out));
  constraint_values(&q->stages, Z(out), q->pull);
  memcpy(q->pull + m, Z(out), sizeof(double) * (size_t)q->n);
  for (int i = 0; i < M; ++i) {
    Y(out)[i] = q->equal[i] != 0.0 ? (q->pull[i] + r->equal[i]) / (q->elasticity[i] + q->compliance[i]) : 0.0;
    for (int u = 0; u < 2; ++u) {
      const int j = u * M + i;
      const double change = -q->weight[j] * ((u ? -1.0 : 1.0) * q->pull[i] + q->gap[j]);
      MULTIPLIER(out)[j] = change, S(out)[j] = F(out)[j] = 0.0;
      if (MULTIPLIER(p)[j] > 0.0) S(out)[j] = ((t_side ? t_side[j] : 0.0) - S(p)[j] * change) / MULTIPLIER(p)[j];
      E(out)[j] = q->soft[j] * change + q->left[j];
      if (E(p)[j] > 0.0) F(out)[j] = ((t_elastic ? t_elastic[j] : 0.0) - F(p)[j] * E(out)[j]) / E(p)[j];
    }
  }
}

static void move(const Problem *q, const double *p, const double *step, double share, double *out) {
  for (int i = 0; i < SIZE; ++i) out[i] = p[i] + share * step[i];
}

/* Share of a step after which nothing is negative. */
static double find_share(const Problem *q, const double *p, const double *step, double most) {
  double share = 1.0;
  for (const double *value = S(p), *change = S(step), *end = p + SIZE; value < end; ++value, ++change)
    if (*change < 0.0 && most * *value < -share * *change) share = most * *value / -*change;
  return share;
}

static double find_mu(const Problem *q, const double *p, int *count) {
  double sum = 0.0;
  *count = 0;
  for (int j = 0; j < 2 * q->M; ++j) {
    sum += S(p)[j] * MULTIPLIER(p)[j] + E(p)[j] * F(p)[j];
    *count += (q->side[j] != 0.0) + (q->elastic[j] != 0.0);
  }
  if (*count < 1) *count = 1;
  return sum / *count;
}

/* By how much products of p change on the way to `centre`, with `trust` in what the affine step says of the second order. */
static void aim(Problem *q, double centre, double trust) {
  const double *p = q->point, *a = q->affine;
  for (int j = 0; j < 2 * q->M; ++j) {
    const double side = centre - trust * S(a)[j] * MULTIPLIER(a)[j] - S(p)[j] * MULTIPLIER(p)[j];
    const double elastic = centre - trust * E(a)[j] * F(a)[j] - E(p)[j] * F(p)[j];
    q->t_side[j] = q->side[j] != 0.0 ? side : 0.0, q->t_elastic[j] = q->elastic[j] != 0.0 ? elastic : 0.0;
  }
}

static void correct_direction(Problem *q) {
  move(q, q->point, q->step, 1.0, q->trial);
  find_residuals(q, q->trial, &q->other);
  for (int k = 0; k < q->corrections; ++k) {
    const double before = q->other.linear;
    find_direction(q, q->point, &q->other, 0, 0, q->affine);
    move(q, q->step, q->affine, 1.0, q->affine);
    move(q, q->point, q->affine, 1.0, q->trial);
    find_residuals(q, q->trial, &q->other);
    if (!(q->other.linear <= 0.5 * before)) break;
    memcpy(q->step, q->affine, sizeof(double) * (size_t)SIZE);
  }
}

/* One iteration; the share of the step that was taken, or minus what is wrong with the factor. Weights of later iterations hide
whether the cost is convex. */
static double advance(Problem *q) {
  int count;
  double *p = q->point;
  const int wrong = find_factor(q, p, 1);
  if (wrong == 2 || (wrong && q->iterations == 1)) return -wrong;
  const double mu = larger_of(find_mu(q, p, &count), 1e-300), least = FLOOR * q->tolerance * q->now.gradient * q->now.variable;
  memset(q->affine, 0, sizeof(double) * (size_t)SIZE);
  aim(q, 0.0, 0.0);
  find_direction(q, p, &q->now, q->t_side, q->t_elastic, q->affine);
  double share = find_share(q, p, q->affine, 1.0);
  move(q, p, q->affine, share, q->trial);
  const double ratio = find_mu(q, q->trial, &count) / mu;
  aim(q, larger_of(least, mu * ratio * ratio * ratio), share);
  find_direction(q, p, &q->now, q->t_side, q->t_elastic, q->step);
  if (find_share(q, p, q->step, 1.0) < SHORT_STEP) {
    aim(q, mu, 0.0);
    find_direction(q, p, &q->now, q->t_side, q->t_elastic, q->step);
  }
  if (q->corrections) correct_direction(q);
  share = find_share(q, p, q->step, TO_BOUNDARY);
  move(q, p, q->step, share, p);
  return share;
}

/* The optimum without inequalities, from the z that is given: one factor, and corrections. */
static int solve_equalities(Problem *q) {
  double *p = q->point;
  memset(p + q->n, 0, sizeof(double) * (size_t)(SIZE - q->n));
  const int wrong = find_factor(q, p, 0);
  if (wrong) return wrong;
  for (int k = 0;; ++k) {
    find_residuals(q, p, &q->now);
    const Residuals *r = &q->now;
    double equal = largest_of(q->n_x, r->defect);
    for (int i = 0; i < q->M; ++i) equal = larger_of(equal, fabs(r->equal[i]) / q->norm[i]);
    const double left = larger_of(largest_of(q->n, r->grad) / r->gradient, equal / r->variable);
    if (k == MOST_CORRECTIONS || !(left > 0.1 * q->tolerance)) break;
    memset(q->now.row, 0, sizeof(double) * (size_t)(2 * q->M));
    memset(q->now.dual, 0, sizeof(double) * (size_t)(2 * q->M));
    find_direction(q, p, &q->now, 0, 0, q->step);
    move(q, p, q->step, 1.0, p);
  }
  for (int i = 0; i < q->M; ++i)
    for (int u = 0; u < 2; ++u) {
      const int j = u * q->M + i;
      const double beyond = (u ? -1.0 : 1.0) * (q->now.value[i] - q->bound[j]);
      S(p)[j] = q->side[j] != 0.0 && beyond > 0.0 ? beyond : 0.0;
      F(p)[j] = q->elastic[j] != 0.0 ? q->l1[i] : 0.0;
    }
  find_residuals(q, p, &q->now);
  return 0;
}

/* Largest violation of a side relative to the norm of its row, `value` given; -1 where there is none. */
static double side_missed(const Problem *q, const double *value) {
  double most = -1.0;
  for (int i = 0; i < q->M; ++i)
    for (int u = 0; u < 2; ++u) {
      const int j = u * q->M + i;
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
  const double mu = COLD_MU * missed * larger_of(q->curvature * missed, q->now.stationarity);
  for (int i = 0; i < q->M; ++i)
    for (int u = 0; u < 2; ++u) {
      const int j = u * q->M + i;
      const double beyond = (u ? -1.0 : 1.0) * (q->now.value[i] - q->bound[j]);
      if (q->side[j] == 0.0) continue;
      S(p)[j] = larger_of(beyond, missed * q->norm[i]);
      MULTIPLIER(p)[j] = mu / S(p)[j];
      if (q->elastic[j] == 0.0) continue;
      if (MULTIPLIER(p)[j] > 0.5 * q->l1[i]) MULTIPLIER(p)[j] = 0.5 * q->l1[i];
      E(p)[j] = missed * q->norm[i], F(p)[j] = q->l1[i] - MULTIPLIER(p)[j];
    }
}

/* A start near a point whose z, costate and y are given; y of all rows. */
static void start_warm(Problem *q) {
  double *p = q->point;
  const double room = sqrt(q->warm_mu), mu = q->warm_mu * q->curvature;
  constraint_values(&q->stages, Z(p), q->now.value);
  memcpy(q->now.value + q->m, Z(p), sizeof(double) * (size_t)q->n);
  for (int i = 0; i < q->M; ++i) {
    const double y = Y(p)[i];
    if (q->equal[i] == 0.0) Y(p)[i] = 0.0;
    for (int u = 0; u < 2; ++u) {
      const int j = u * q->M + i;
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
  find_residuals(q, q->point, &q->now);
  first = q->now.gradient;
  for (;;) {
    const double left = q->now.worst, stationarity = q->now.stationarity, primal = q->now.primal;
    ++vain;
    if (left < least || least == INFINITY) vain = 0, least = left, memcpy(q->best, q->point, sizeof(double) * (size_t)SIZE);
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
    share = advance(q);
    if (share == -1.0) status = NOT_CONVEX;
    if (share < 0.0) break;
    find_residuals(q, q->point, &q->now);
    if (q->corrections < 3 && (q->now.stationarity > 2.0 * (1.0 - share) * stationarity + 0.1 * q->tolerance * q->now.gradient ||
                               q->now.primal > 2.0 * (1.0 - share) * primal + 0.1 * q->tolerance * q->now.variable))
      ++q->corrections;
  }
  memcpy(q->point, q->best, sizeof(double) * (size_t)SIZE);
  find_residuals(q, q->point, &q->now);
  return status;
}

/* The optimum without inequalities, 1 where that is the end: z starts anew if it misses any. */
static int start_from_equalities(Problem *q) {
  const Residuals *r = &q->now;
  memcpy(q->best, q->point, sizeof(double) * (size_t)q->n);
  const int wrong = solve_equalities(q);
  q->status = wrong == 2 ? NOT_A_NUMBER : wrong == 1 ? NOT_CONVEX : SOLVED;
  if (!wrong && r->stationarity <= q->tolerance * r->gradient && r->primal <= q->tolerance * r->variable &&
      !(side_missed(q, r->value) > 0.0))
    return 1;
  memcpy(q->point, q->best, sizeof(double) * (size_t)q->n);
  start_cold(q);
  return wrong;
}

/* Status, iterations, `point` and the residuals `now`, from what `point` holds: z, where fixed variables have their values, and for a warm start costates and multipliers too; without its cost if it is costless. */
void solve_qp(Problem *q, int costless) {
  load_stages(&q->stages, costless);
  q->curvature = costless ? 1.0 : q->stages.most;
  q->iterations = q->corrections = 0;
  for (int i = 0; i < q->M; ++i) q->elasticity[i] = ELASTICITY * q->norm[i] * q->norm[i] / q->curvature;
  if (q->start == START_WARM) start_warm(q);
  if (q->start == START_COLD) start_cold(q);
  if (q->start == START_EQUALITIES && start_from_equalities(q)) return;
  q->status = descend(q);
}
