/* A QP from nothing but its data, or from the solution of another one nearby: which bounds it reaches, and its optimum there, as
iteration.py has it; keep both in step. */

/* Everything of a row as row_table.py has it; 0 where an entry of the QP is none. */
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
    for (int u = 0, j = i; u < 2; ++u, j += q->M) {
      const int side = counts && !equal && bound[u] < INFINITY && bound[u] > -INFINITY;
      q->side[j] = side, q->elastic[j] = side && elastic, q->bound[j] = side ? bound[u] : 0.0;
    }
  }
  find_norms(&q->stages, q->norm);
  return valid;
}

/* Sides that hold the solution of a QP nearby where it is; where none is without a multiplier, as an interior point leaves them,
those with a large one. */
static void find_reached(Problem *q, const double *near) {
  int none = 0;
  for (int j = 0; j < 2 * q->M; ++j) none |= q->side[j] != 0.0 && Y(near)[j % q->M] == 0.0;
  const double most = none ? 0.0 : COUNTS * larger_of(largest_of(q->M, Y(near)), largest_of(q->n_x, COSTATE(near)));
  for (int j = 0; j < 2 * q->M; ++j) {
    const int i = j % q->M;
    q->active[j] = q->side[j] != 0.0 && (j < q->M ? -1.0 : 1.0) * Y(near)[i] * q->norm[i] > most;
  }
}

/* Sides that the last step of an interior point approached: what is left of them fell more than their multipliers did. */
static void find_approached(Problem *q) {
  const double *p = q->point, *d = q->step;
  for (int j = 0; j < 2 * q->M; ++j) {
    const double s = S(p)[j], y = MULTIPLIER(p)[j];
    q->active[j] = q->side[j] != 0.0 && s * (y - q->share * MULTIPLIER(d)[j]) < y * (s - q->share * S(d)[j]);
  }
}

/* The optimum with active sides as equalities and without all others, from the point that is given; 0 where there is none. */
static int solve_held(Problem *q) {
  double *side = q->side, *equal = q->equal, *target = q->target;
  for (int i = 0; i < q->M; ++i) {
    const double lower = q->active[i], upper = q->active[q->M + i];
    const int any = lower != 0.0 || upper != 0.0;
    q->held_equal[i] = any ? 1.0 : equal[i];
    q->held_target[i] = any ? lower * q->bound[i] + upper * q->bound[q->M + i] : target[i];
    if (q->held_equal[i] == 0.0) Y(q->point)[i] = 0.0;
  }
  q->side = q->no_side, q->equal = q->held_equal, q->target = q->held_target;
  find_bounded(q);
  const int wrong = solve_equalities(q);
  q->side = side, q->equal = equal, q->target = target;
  q->status = SOLVED;
  return !wrong && q->now.stationarity <= q->tolerance * q->now.gradient && q->now.primal <= q->tolerance * q->now.variable;
}

/* Sides that pull are let go, those that are missed are held; how many change. */
static int mend(Problem *q) {
  const double room = SHARP * q->tolerance * (1.0 + largest_of(q->n, Z(q->point)));
  int changes = 0;
  for (int j = 0; j < 2 * q->M; ++j) {
    const int i = j % q->M, held = q->active[j] != 0.0;
    if (q->side[j] == 0.0) continue;
    const double sign = j < q->M ? 1.0 : -1.0, missed = sign * (q->bound[j] - q->now.value[i]);
    const int holds = held ? sign * Y(q->point)[i] <= 0.0 : missed > room * q->norm[i];
    changes += holds != held, q->active[j] = holds;
  }
  return changes;
}

/* The optimum where the bounds that it reaches are found soon, starting with active ones; 0 leaves the point as it was. */
static int solve_active(Problem *q) {
  int fewest = 2 * q->M, vain = 0;
  memcpy(q->trial, q->point, sizeof(double) * (size_t)SIZE);
  while (solve_held(q)) {
    const int changes = mend(q);
    if (changes == 0) return 1;
    vain = changes < fewest ? 0 : vain + 1;
    if (vain > (changes > MANY_CHANGES ? 0 : VAIN_CHANGES)) break;
    if (!vain) fewest = changes;
  }
  memcpy(q->point, q->trial, sizeof(double) * (size_t)SIZE);
  find_bounded(q);
  return 0;
}

/* The optimum near that of another QP, whose costates and multipliers are in `point`. */
static int solve_near(Problem *q) {
  double *p = q->point;
  memcpy(q->best, p, sizeof(double) * (size_t)q->n);
  memset(S(p), 0, sizeof(double) * (size_t)(8 * q->M));
  find_reached(q, p);
  rest(q);
  const int found = solve_active(q);
  if (!found) memcpy(p, q->best, sizeof(double) * (size_t)q->n);
  return found;
}

/* What an interior point comes close to, to all digits: with the sides that it approaches as equalities, where those are right. */
static void finish(Problem *q) {
  const int iterations = q->iterations;
  double *p = q->point;
  memcpy(q->best, p, sizeof(double) * (size_t)SIZE);
  find_approached(q);
  for (int i = 0; i < q->M; ++i) Y(p)[i] += MULTIPLIER(p)[q->M + i] - MULTIPLIER(p)[i];
  if (solve_active(q)) return;
  memcpy(p, q->best, sizeof(double) * (size_t)SIZE);
  find_residuals(q, p, &q->now);
  q->status = SOLVED, q->iterations = iterations;
}

/* The same as solve_qp from nothing but the QP, or from z, costates and multipliers in `point` that are those of a QP nearby. */
void solve_whole(Problem *q, int near) {
  q->status = NOT_A_NUMBER;
  if (!make_table(q)) return;
  begin(q, 0, 0);
  if (!has_numbers(&q->stages)) return;
  const int hard = !(largest_of(2 * q->M, q->elastic) > 0.0);
  q->start = near ? START_WARM : START_EQUALITIES;
  if (!near) memset(q->point, 0, sizeof(double) * (size_t)SIZE);
  if (near && hard && solve_near(q)) return;
  q->iterations = q->corrections = 0;
  for (int v = 0; v < q->n; ++v)
    if (q->stages.fixed[v] != 0.0) Z(q->point)[v] = q->z_lower[v];
  if (run(q) && hard && q->tolerance <= FINISHED && q->status == SOLVED && q->share > 0.0) finish(q);
}
