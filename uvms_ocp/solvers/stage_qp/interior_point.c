/* Primal-dual interior point, one iteration.

A point is one array: z (n), costate (n_x), y (M), then s, multiplier, e, f (2 M each: of each row its lower and its upper side).
Rows M are those of constraints (m), then the variables. Only rows with a bound are looked at: of all others these are 0, and stay so. */

typedef struct {
  double *grad, *held, *defect, *value, *row, *equal, *dual;
  double stationarity, primal, complementarity, steepest, gradient, variable, linear, worst, along[3];
} Residuals;

typedef struct {
  Stages stages;
  int M, m, n, n_x;
  double *bound, *side, *elastic, *equal, *target, *l1, *l2, *compliance, *norm; /* RowTable; flags are 0 or 1 */
  const double *lower, *upper, *c_l1, *c_l2, *z_lower, *z_upper, *z_l1, *z_l2;   /* of rows and of variables, as given */
  const double *loose; /* of each variable: 1 where the dynamics do not determine it */
  double *active, *no_side, *held_equal, *held_target; /* which sides are held, and the table then */
  double *elasticity, *point, *best, *step, *affine, *trial;
  double *weight, *soft, *left, *gap, *pull, *rhs, *t_side, *t_elastic; /* of direction() */
  int *bounded; /* rows with a bound, n_bounded of them */
  Residuals now, other;
  double curvature, tolerance, warm_mu, cold_mu, slow, share; /* the last: of the step that was taken last */
  int n_bounded;
  int max_iterations, iterations, corrections, status, start, is_elastic;
} Problem;

#define Z(p) (p)
#define COSTATE(p) ((p) + q->n)
#define Y(p) (COSTATE(p) + q->n_x)
#define S(p) (Y(p) + q->M)
#define MULTIPLIER(p) (S(p) + 2 * q->M)
#define E(p) (MULTIPLIER(p) + 2 * q->M)
#define F(p) (E(p) + 2 * q->M)
#define SIGN(j) ((j) & 1 ? -1.0 : 1.0) /* of what is left to a side */
#define SIZE (q->n + q->n_x + 9 * q->M)

/* What of a point is not 0: without elastic sides neither e nor f, without any neither s nor multipliers. */
#define USED (SIZE - (q->is_elastic ? 0 : 4 * q->M))
#define SIDELESS (q->n + q->n_x + q->M)

/* Which rows have a bound; of those that had one before nothing is left over that is looked at where there is none. */
static void find_bounded(Problem *q) {
  const int blocks = q->is_elastic ? 4 : 2;
  for (int k = 0; k < q->n_bounded; ++k) {
    const int i = q->bounded[k];
    q->pull[i] = q->now.equal[i] = q->other.equal[i] = 0.0;
    Y(q->step)[i] = Y(q->affine)[i] = 0.0;
    for (int b = 0; b < blocks; ++b)
      for (int j = 2 * (b * q->M + i), last = j + 1; j <= last; ++j) S(q->step)[j] = S(q->affine)[j] = 0.0;
  }
  q->n_bounded = 0;
  for (int i = 0; i < q->M; ++i)
    if (q->side[2 * i] != 0.0 || q->side[2 * i + 1] != 0.0 || q->equal[i] != 0.0) q->bounded[q->n_bounded++] = i;
}

/* Everything of a row as `row_table` of problem.py has it; 0 where an entry of the QP is none. */
static int make_table(Problem *q) {
  int valid = 1;
  for (int i = 0; i < q->M; ++i) {
    const int v = i - q->m;
    const double bound[2] = {v < 0 ? q->lower[i] : q->z_lower[v], v < 0 ? q->upper[i] : q->z_upper[v]};
    const double l1 = v < 0 ? q->c_l1[i] : q->z_l1[v], l2 = v < 0 ? q->c_l2[i] : q->z_l2[v];
    const int fixed = v >= 0 && q->loose[v] != 0.0 && bound[0] == bound[1] && l1 == INFINITY;
    const int hard = l1 == INFINITY, counts = !fixed && (hard || l1 > 0.0 || l2 > 0.0);
    const int elastic = counts && !hard && l1 > 0.0, equal = counts && bound[0] == bound[1] && !elastic;
    valid &= bound[0] < INFINITY && bound[1] > -INFINITY && l1 >= 0.0 && l2 >= 0.0 && l2 < INFINITY;
    if (v >= 0) q->stages.fixed[v] = fixed;
    q->equal[i] = equal, q->target[i] = equal ? bound[0] : 0.0, q->norm[i] = 1.0;
    q->l1[i] = elastic ? l1 : 0.0, q->l2[i] = elastic ? l2 : 0.0;
    q->compliance[i] = counts && !hard && !elastic ? 1.0 / l2 : 0.0;
    for (int u = 0, j = 2 * i; u < 2; ++u, ++j) {
      const int side = counts && !equal && bound[u] < INFINITY && bound[u] > -INFINITY;
      q->side[j] = side, q->elastic[j] = side && elastic, q->bound[j] = side ? bound[u] : 0.0;
    }
  }
  find_norms(&q->stages, q->norm);
  return valid;
}

/* What rows with bounds leave, at p, where the value of rows is known. */
static void judge_rows(Problem *q, const double *p, Residuals *r, double largest) {
  const int n = q->n;
  double primal = 0.0, dual = 0.0, linear = 0.0, multipliers = 0.0, products = 0.0;
  for (int k = 0; k < q->n_bounded; ++k) {
    const int i = q->bounded[k];
    double missed = 0.0;
    for (int j = 2 * i; j <= 2 * i + 1; ++j) {
      if (q->side[j] == 0.0) continue;
      const double beyond = SIGN(j) * (r->value[i] - q->bound[j]);
      r->row[j] = beyond + q->compliance[i] * MULTIPLIER(p)[j] - S(p)[j];
      if (q->is_elastic) r->row[j] += E(p)[j];
      linear = larger_of(linear, fabs(r->row[j]) / q->norm[i]);
      const int elastic = q->is_elastic && q->elastic[j] != 0.0;
      if (!elastic && q->compliance[i] == 0.0) missed = larger_of(missed, -beyond);
      products = larger_of(products, S(p)[j] * MULTIPLIER(p)[j]);
      if (!elastic) continue;
      r->dual[j] = q->l1[i] + q->l2[i] * E(p)[j] - MULTIPLIER(p)[j] - F(p)[j];
      dual = larger_of(dual, fabs(r->dual[j]) * q->norm[i]);
      products = larger_of(products, E(p)[j] * F(p)[j]);
    }
    if (q->equal[i] != 0.0) {
      r->equal[i] = r->value[i] - q->target[i] - q->compliance[i] * Y(p)[i];
      linear = larger_of(linear, fabs(r->equal[i]) / q->norm[i]);
    }
    primal = larger_of(primal, missed / q->norm[i]);
    multipliers = larger_of(multipliers, fabs(Y(p)[i] + MULTIPLIER(p)[2 * i + 1] - MULTIPLIER(p)[2 * i]) * q->norm[i]);
  }
  linear = larger_of(linear, largest_of(q->n_x, r->defect));
  r->stationarity = larger_of(largest_of(n, r->grad), dual);
  r->primal = larger_of(primal, linear);
  r->complementarity = products;
  r->steepest = largest;
  r->gradient = larger_of(largest, larger_of(multipliers, LEAST_SIZE * q->curvature));
  r->variable = 1.0 + largest_of(n, Z(p));
  r->linear = larger_of(r->stationarity / r->gradient, linear / r->variable);
  r->worst = larger_of(larger_of(r->stationarity / r->gradient, r->primal / r->variable),
                       SHARPER * r->complementarity / (r->gradient * r->variable));
}

static void find_residuals(Problem *q, const double *p, Residuals *r) {
  const int m = q->m, n = q->n;
  double *y = q->pull;
  for (int k = 0; k < q->n_bounded; ++k) {
    const int i = q->bounded[k];
    y[i] = Y(p)[i] + MULTIPLIER(p)[2 * i + 1] - MULTIPLIER(p)[2 * i];
  }
  const double largest = evaluate_stages(&q->stages, Z(p), COSTATE(p), y, y + m, r->grad, r->defect, r->value, r->along);
  for (int i = 0; i < n; ++i) {
    r->held[i] = q->stages.fixed[i] != 0.0 ? r->grad[i] : 0.0;
    if (q->stages.fixed[i] != 0.0) r->grad[i] = 0.0;
  }
  memcpy(r->value + m, Z(p), sizeof(double) * (size_t)n);
  judge_rows(q, p, r, largest);
}

/* Weights of the sides at p, and the factor with them. */
static int find_factor(Problem *q, const double *p, int sides) {
  const double slow = sides ? q->slow * q->now.gradient / q->now.variable : 0.0;
  double *total = q->pull;
  ++q->iterations;
  for (int k = 0; k < q->n_bounded; ++k) {
    const int i = q->bounded[k];
    total[i] = q->equal[i] != 0.0 ? 1.0 / (q->elasticity[i] + q->compliance[i]) : 0.0;
    for (int j = 2 * i; j <= 2 * i + 1; ++j) {
      if (q->side[j] == 0.0) continue;
      const double multiplier = MULTIPLIER(p)[j];
      double soft = 0.0;
      q->weight[j] = 0.0;
      if (q->is_elastic) {
        if (sides && multiplier > 0.0 && F(p)[j] > 0.0) soft = E(p)[j] / (F(p)[j] + E(p)[j] * q->l2[i]);
        q->soft[j] = soft;
      }
      if (!sides || !(multiplier > 0.0)) continue;
      q->weight[j] = multiplier / (multiplier * (SIDE_ELASTICITY * q->elasticity[i] + q->compliance[i] + soft) + S(p)[j]);
      total[i] += q->weight[j];
    }
  }
  return factor_stages(&q->stages, total, total + q->m, slow);
}

/* Of Newton's method, towards products that differ by t_side and t_elastic from those at p; 0 for no change. */
static void find_direction(Problem *q, const double *p, const Residuals *r, const double *t_side, const double *t_elastic,
                           double *out) {
  const int m = q->m;
  for (int k = 0; k < q->n_bounded; ++k) {
    const int i = q->bounded[k];
    q->pull[i] = q->equal[i] != 0.0 ? r->equal[i] / (q->elasticity[i] + q->compliance[i]) : 0.0;
    for (int j = 2 * i; j <= 2 * i + 1; ++j) {
      if (q->side[j] == 0.0) continue;
      q->gap[j] = r->row[j];
      if (q->is_elastic) {
        q->left[j] = 0.0;
        if (F(p)[j] > 0.0) q->left[j] = ((t_elastic ? t_elastic[j] : 0.0) - E(p)[j] * r->dual[j]) / (F(p)[j] + E(p)[j] * q->l2[i]);
        q->gap[j] += q->left[j];
      }
      if (t_side && MULTIPLIER(p)[j] > 0.0) q->gap[j] -= t_side[j] / MULTIPLIER(p)[j];
      q->pull[i] += SIGN(j) * q->weight[j] * q->gap[j];
    }
  }
  memcpy(q->rhs, r->grad, sizeof(double) * (size_t)q->n);
  add_transposed(&q->stages, q->pull, q->pull + m, q->rhs);
  solve_stages(&q->stages, q->rhs, r->defect, Z(out), COSTATE(out));
  constraint_values(&q->stages, Z(out), q->other.value);
  for (int k = 0; k < q->n_bounded; ++k) {
    const int i = q->bounded[k];
    const double value = i < m ? q->other.value[i] : Z(out)[i - m];
    if (q->equal[i] != 0.0) Y(out)[i] = (value + r->equal[i]) / (q->elasticity[i] + q->compliance[i]);
    for (int j = 2 * i; j <= 2 * i + 1; ++j) {
      if (q->side[j] == 0.0) continue;
      const double change = -q->weight[j] * (SIGN(j) * value + q->gap[j]);
      MULTIPLIER(out)[j] = change, S(out)[j] = 0.0;
      if (MULTIPLIER(p)[j] > 0.0) S(out)[j] = ((t_side ? t_side[j] : 0.0) - S(p)[j] * change) / MULTIPLIER(p)[j];
      if (!q->is_elastic) continue;
      F(out)[j] = 0.0;
      E(out)[j] = q->soft[j] * change + q->left[j];
      if (E(p)[j] > 0.0) F(out)[j] = ((t_elastic ? t_elastic[j] : 0.0) - F(p)[j] * E(out)[j]) / E(p)[j];
    }
  }
}

/* Of the first `size` numbers of a point. */
WIDE static void move(int size, const double *p, const double *step, double share, double *out) {
  for (int i = 0; i < size; ++i) out[i] = p[i] + share * step[i];
}

/* Share of a step after which nothing is negative. */
static double find_share(const Problem *q, const double *p, const double *step, double most) {
  double share = 1.0;
  for (const double *value = S(p), *change = S(step), *end = p + USED; value < end; ++value, ++change)
    if (*change < 0.0 && most * *value < -share * *change) share = most * *value / -*change;
  return share;
}

static double find_mu(const Problem *q, const double *p, int *count) {
  double sum = 0.0;
  *count = 0;
  for (int k = 0; k < q->n_bounded; ++k)
    for (int j = 2 * q->bounded[k], last = j + 1; j <= last; ++j) {
      if (q->side[j] == 0.0) continue;
      sum += S(p)[j] * MULTIPLIER(p)[j];
      ++*count;
      if (q->is_elastic && q->elastic[j] != 0.0) sum += E(p)[j] * F(p)[j], ++*count;
    }
  if (*count < 1) *count = 1;
  return sum / *count;
}

/* By how much products of p change on the way to `centre`, with `trust` in what the affine step says of the second order. */
static void aim(Problem *q, double centre, double trust) {
  const double *p = q->point, *a = q->affine;
  for (int k = 0; k < q->n_bounded; ++k)
    for (int j = 2 * q->bounded[k], last = j + 1; j <= last; ++j) {
      if (q->side[j] == 0.0) continue;
      q->t_side[j] = centre - trust * S(a)[j] * MULTIPLIER(a)[j] - S(p)[j] * MULTIPLIER(p)[j];
      if (q->is_elastic)
        q->t_elastic[j] = q->elastic[j] != 0.0 ? centre - trust * E(a)[j] * F(a)[j] - E(p)[j] * F(p)[j] : 0.0;
    }
}

static void correct_direction(Problem *q) {
  move(USED, q->point, q->step, 1.0, q->trial);
  find_residuals(q, q->trial, &q->other);
  for (int k = 0; k < q->corrections; ++k) {
    const double before = q->other.linear;
    find_direction(q, q->point, &q->other, 0, 0, q->affine);
    move(USED, q->step, q->affine, 1.0, q->affine);
    move(USED, q->point, q->affine, 1.0, q->trial);
    find_residuals(q, q->trial, &q->other);
    if (!(q->other.linear <= 0.5 * before)) break;
    memcpy(q->step, q->affine, sizeof(double) * (size_t)USED);
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
  aim(q, 0.0, 0.0);
  find_direction(q, p, &q->now, q->t_side, q->t_elastic, q->affine);
  double share = find_share(q, p, q->affine, 1.0);
  move(USED, p, q->affine, share, q->trial);
  const double ratio = find_mu(q, q->trial, &count) / mu;
  aim(q, larger_of(least, mu * ratio * ratio * ratio), share);
  find_direction(q, p, &q->now, q->t_side, q->t_elastic, q->step);
  if (find_share(q, p, q->step, 1.0) < SHORT_STEP) {
    aim(q, mu, 0.0);
    find_direction(q, p, &q->now, q->t_side, q->t_elastic, q->step);
  }
  if (q->corrections) correct_direction(q);
  share = find_share(q, p, q->step, TO_BOUNDARY);
  move(USED, p, q->step, share, p);
  return share;
}
