/* A horizon of stages: its Hessian, the Riccati recursion, and solutions with the factor that it leaves.

Sizes and places of stage k are entries k of integer arrays; `compiled.py` makes them, and the structure. */

typedef struct {
  int N, squares; /* the last: whether the cost is one of squares and damping alone */
  const int *n_x, *n_u, *n_r, *n_c; /* sizes */
  const int *x, *z, *r, *c;         /* places of vectors */
  const int *F, *J, *H, *C, *T;     /* places of matrices, the last: of lower triangles */
  const double *dynamics, *offset, *rows, *residual, *hessian, *gradient, *damping, *constraints;
  double *fixed; /* of each variable: 1 where it never moves */
  double *Q, *q;       /* Hessian, a triangle, and gradient at 0 */
  double *L, *inverse; /* of each stage a triangle: the cost-to-go of its state and, below it, the rows of the factor of the rest */
  int *first, *column; /* of each state the first entry of its dynamics that is not 0, and the column of each entry */
  double *entry;
  double *W;           /* room for twice the largest dynamics, padded */
  double *two;         /* room for 2 matrices of the largest stage, padded */
  double *v;           /* room for 2 vectors of the largest stage, padded */
  WeightedRow *list;   /* room for twice the largest number of rows */
  double most, least;  /* the largest curvature, and one that counts as none beside it */
} Stages;

INLINE int n_z(const Stages *s, int k) { return s->n_x[k] + s->n_u[k]; }

/* Numbers in the padded matrix of the largest stage. */
static int largest_matrix(const Stages *s) {
  int most = 0;
  for (int k = 0; k <= s->N; ++k) most = n_z(s, k) > most ? n_z(s, k) : most;
  return PADDED(most) * PADDED(most);
}

/* Asks for what is looked at next: of long horizons it is far away. */
INLINE void fetch(const double *a, int n) {
#ifdef __GNUC__
  for (int i = 0; i < n; i += 8) __builtin_prefetch(a + i);
#else
  (void)a, (void)n;
#endif
}

/* The same of stage k: of M a triangle, and its dynamics. */
INLINE void fetch_stage(const Stages *s, const double *M, int k) {
  if (k < 0 || k > s->N) return;
  fetch(M + s->T[k], s->T[k + 1] - s->T[k]);
  if (k == s->N) return;
  const int first = s->first[s->x[k + 1]], count = s->first[s->x[k + 2]] - first;
  fetch(s->entry + first, count);
  fetch((const double *)(s->column + first), (count + 1) / 2);
}

/* The triangle of a padded matrix, row after row. */
static void pack(int n, const double *M, double *T) {
  for (int i = 0; i < n; ++i) memcpy(T + ROW(i), M + i * PADDED(n), sizeof(double) * (size_t)(i + 1));
}

/* Entries of the dynamics that are not 0, of each state of later stages. */
static void find_entries(Stages *s) {
  int count = 0;
  for (int k = 0; k < s->N; ++k)
    for (int i = 0, n = n_z(s, k); i < s->n_x[k + 1]; ++i) {
      const double *row = s->dynamics + s->F[k] + (size_t)i * n;
      s->first[s->x[k + 1] + i] = count;
      for (int j = 0; j < n; j += 4) {
        if (j + 4 <= n && are_zero(row + j)) continue;
        for (int l = j; l < j + 4 && l < n; ++l)
          if (row[l] != 0.0) s->column[count] = l, s->entry[count++] = row[l];
      }
    }
  s->first[s->x[s->N + 1]] = count;
}

/* h += F' t, of stage k; t of the states of the next. */
INLINE void add_backward(const Stages *s, int k, const double *restrict t, double *restrict h) {
  const int *first = s->first + s->x[k + 1];
  for (int i = 0; i < s->n_x[k + 1]; ++i)
    for (int e = first[i]; e < first[i + 1]; ++e) h[s->column[e]] += t[i] * s->entry[e];
}

/* Row i of F times z. */
INLINE double forward(const Stages *s, int k, int i, const double *z) {
  const int *first = s->first + s->x[k + 1] + i;
  double sum = 0.0;
  for (int e = first[0]; e < first[1]; ++e) sum += s->entry[e] * z[s->column[e]];
  return sum;
}

/* Hessian and gradient from residual rows, Hessians and damping; of a costless QP next to nothing. */
WIDE static void load_stages(Stages *s, int costless) {
  double most = 0.0, *Q = s->two;
  s->squares = !costless;
  find_entries(s);
  for (int k = 0; k <= s->N; ++k) {
    const int n = n_z(s, k), ld = PADDED(n), m = s->n_r[k];
    const double *J = s->rows + s->J[k], *r = s->residual + s->r[k], *H = s->hessian + s->H[k];
    double *q = s->q + s->z[k];
    for (int i = 0; i < ld * ld; ++i) Q[i] = 0.0;
    if (costless) {
      for (int i = 0; i < n; ++i) Q[i * ld + i] = most = PHASE_ONE, q[i] = 0.0;
      pack(n, Q, s->Q + s->T[k]);
      continue;
    }
    for (int i = 0; i < n; ++i) {
      memcpy(Q + i * ld, H + i * n, sizeof(double) * (size_t)(i + 1));
      if (dot(i + 1, Q + i * ld, Q + i * ld) != 0.0) s->squares = 0;
    }
    for (int i = 0; i < n; ++i) Q[i * ld + i] += s->damping[s->z[k] + i], q[i] = s->gradient[s->z[k] + i];
    add_gram(m, n, J, 0, r, q, Q, s->list);
    for (int i = 0; i < n; ++i)
      if (Q[i * ld + i] > most) most = Q[i * ld + i];
    pack(n, Q, s->Q + s->T[k]);
  }
  s->most = most > 0.0 ? most : 1.0;
  s->least = SMALLEST_CURVATURE * s->most;
}

/* Factor with `weight` on constraint rows, weight_z and `all` on variables; 1 where no step is a minimum, 2 for NaN, else 0. */
WIDE static int factor_stages(Stages *s, const double *weight, const double *weight_z, double all) {
  double *L = s->two, *P = L + largest_matrix(s);
  for (int k = s->N; k >= 0; --k) {
    const int n = n_z(s, k), ld = PADDED(n), after = k < s->N ? s->n_x[k + 1] : 0;
    const double *fixed = s->fixed + s->z[k];
    const double *Q = s->Q + s->T[k];
    fetch_stage(s, s->Q, k - 1);
    for (int i = 0; i < n; ++i) memcpy(L + i * ld, Q + ROW(i), sizeof(double) * (size_t)(i + 1));
    add_gram(s->n_c[k], n, s->constraints + s->C[k], weight + s->c[k], 0, 0, L, s->list);
    for (int i = 0; i < n; ++i) L[i * ld + i] += weight_z[s->z[k] + i] + all;
    if (after) add_transformed(after, n, s->first + s->x[k + 1], s->column, s->entry, P, PADDED(n_z(s, k + 1)), L, s->W);
    for (int i = 0; i < n; ++i)
      if (fixed[i] != 0.0) {
        for (int j = 0; j < n; ++j) L[(i > j ? i : j) * ld + (i > j ? j : i)] = 0.0;
        L[i * ld + i] = 1.0;
      }
    const int failed = eliminate(n, k ? s->n_x[k] : 0, s->least, L, s->inverse + s->z[k]);
    if (failed) return failed;
    pack(n, L, s->L + s->T[k]);
    double *after_this = P;
    P = L, L = after_this;
  }
  return 0;
}

/* The step dz that minimises 1/2 dz' Q dz + g' dz along dx_+ = F dz + d, and its costates; g (z), d (x, that of stage 0 unused),
dz (z), costate (x); g and dz, d and costate must differ. */
WIDE static void solve_stages(Stages *s, const double *g, const double *d, double *dz, double *costate) {
  double *p = s->v;
  for (int k = s->N; k >= 0; --k) {
    const int n = n_z(s, k), n_x = s->n_x[k], after = k < s->N ? s->n_x[k + 1] : 0;
    const double *L = s->L + s->T[k], *inverse = s->inverse + s->z[k], *fixed = s->fixed + s->z[k];
    double *h = dz + s->z[k];
    fetch_stage(s, s->L, k - 1);
    for (int i = 0; i < n; ++i) h[i] = g[s->z[k] + i];
    if (after) {
      memcpy(p, dz + s->z[k + 1], sizeof(double) * (size_t)after);
      add_symmetric(after, s->L + s->T[k + 1], d + s->x[k + 1], p);
      add_backward(s, k, p, h);
    }
    for (int i = 0; i < n; ++i)
      if (fixed[i] != 0.0) h[i] = 0.0;
    for (int i = n - 1; i >= (k ? n_x : 0); --i) {
      h[i] *= inverse[i];
      add_multiple(i, -h[i], L + ROW(i), h);
    }
  }
  for (int k = 0; k <= s->N; ++k) {
    const int n = n_z(s, k), n_x = s->n_x[k], after = k < s->N ? s->n_x[k + 1] : 0;
    const double *L = s->L + s->T[k], *inverse = s->inverse + s->z[k];
    double *h = dz + s->z[k], *own = costate + s->x[k];
    fetch_stage(s, s->L, k + 1);
    if (k) {
      /* h holds p of the state; what dx is stands in costate. */
      for (int i = 0; i < n_x; ++i) p[i] = h[i], h[i] = own[i], own[i] = p[i];
      add_symmetric(n_x, L, h, own);
    } else
      for (int i = 0; i < n_x; ++i) own[i] = 0.0;
    for (int i = k ? n_x : 0; i < n; ++i) h[i] = -(h[i] + dot(i, L + ROW(i), h)) * inverse[i];
    for (int i = 0; i < after; ++i) costate[s->x[k + 1] + i] = forward(s, k, i, h) + d[s->x[k + 1] + i];
  }
}

/* grad = Q z + q + F' costate_+ - costate + C' y + y_z; defect = F z + b - x_+; value = C z. Returns the largest entry of Q z + q;
along: what `products` finds, where the cost is one of squares. */
WIDE static double evaluate_stages(const Stages *s, const double *z, const double *costate, const double *y, const double *y_z,
                              double *grad, double *defect, double *value, double *restrict along) {
  double most = 0.0, *change = s->v;
  along[0] = along[1] = along[2] = 0.0;
  for (int k = 0; k <= s->N; ++k) {
    const int n = n_z(s, k), after = k < s->N ? s->n_x[k + 1] : 0, m = s->n_c[k];
    const double *C = s->constraints + s->C[k], *v = z + s->z[k];
    double *restrict own = grad + s->z[k];
    fetch_stage(s, s->Q, k + 1);
    const int moves = largest_of(n, v) != 0.0;
    for (int i = 0; i < n; ++i) own[i] = 0.0;
    if (moves) add_symmetric(n, s->Q + s->T[k], v, own);
    if (moves) {
      for (int i = 0; i < n; ++i) change[i] = own[i] - s->damping[s->z[k] + i] * v[i];
      along[0] += dot(n, v, s->q + s->z[k]) - dot(n, v, s->gradient + s->z[k]), along[1] += dot(n, v, change);
      along[2] = larger_of(along[2], largest_of(n, change));
    }
    for (int i = 0; i < n; ++i) own[i] += s->q[s->z[k] + i];
    for (int i = 0; i < n; ++i) most = fabs(own[i]) > most ? fabs(own[i]) : most;
    if (after) add_backward(s, k, costate + s->x[k + 1], own);
    for (int i = 0, at = s->x[k + 1]; i < after; ++i, ++at)
      defect[at] = (moves ? forward(s, k, i, v) : 0.0) + s->offset[at - s->x[1]] - z[s->z[k + 1] + i];
    if (k)
      for (int i = 0; i < s->n_x[k]; ++i) own[i] -= costate[s->x[k] + i];
    for (int i = 0; i < m; ++i) {
      const double *row = C + (size_t)i * n;
      value[s->c[k] + i] = dot(n, row, v);
      if (y[s->c[k] + i] != 0.0) add_multiple(n, y[s->c[k] + i], row, own);
    }
    for (int i = 0; i < n; ++i) own[i] += y_z[s->z[k] + i];
  }
  for (int i = 0; i < s->n_x[0]; ++i) defect[i] = 0.0;
  return most;
}

/* grad += C' y + y_z. */
WIDE static void add_transposed(const Stages *s, const double *y, const double *y_z, double *grad) {
  for (int k = 0; k <= s->N; ++k) {
    const int n = n_z(s, k);
    double *own = grad + s->z[k];
    for (int i = 0; i < s->n_c[k]; ++i)
      if (y[s->c[k] + i] != 0.0) add_multiple(n, y[s->c[k] + i], s->constraints + s->C[k] + (size_t)i * n, own);
    for (int i = 0; i < n; ++i) own[i] += y_z[s->z[k] + i];
  }
}

/* value = C z. */
WIDE static void constraint_values(const Stages *s, const double *z, double *value) {
  for (int k = 0; k <= s->N; ++k)
    for (int i = 0, n = n_z(s, k); i < s->n_c[k]; ++i)
      value[s->c[k] + i] = dot(n, s->constraints + s->C[k] + (size_t)i * n, z + s->z[k]);
}

/* Largest entry of each row of constraints, where there is any. */
static void find_norms(const Stages *s, double *norm) {
  for (int k = 0; k <= s->N; ++k)
    for (int i = 0, n = n_z(s, k); i < s->n_c[k]; ++i) {
      double most = 0.0;
      for (int j = 0; j < n; ++j) {
        const double entry = fabs(s->constraints[s->C[k] + i * n + j]);
        most = entry > most ? entry : most;
      }
      norm[s->c[k] + i] = most > 0.0 ? most : 1.0;
    }
}

static int are_finite(int n, const double *a) {
  double nothing[4] = {0};
  int k = 0;
  for (; k + 4 <= n; k += 4)
    for (int l = 0; l < 4; ++l) nothing[l] += 0.0 * a[k + l];
  for (; k < n; ++k) nothing[0] += 0.0 * a[k];
  return (nothing[0] + nothing[1]) + (nothing[2] + nothing[3]) == 0.0;
}

/* Whether all entries are finite but bounds; those of residuals and Hessians are in what was made of them. */
static int has_numbers(const Stages *s) {
  const int N = s->N;
  return are_finite(s->first[s->x[N + 1]], s->entry) && are_finite(s->x[N + 1] - s->x[1], s->offset) && are_finite(s->T[N + 1], s->Q) &&
         are_finite(s->z[N + 1], s->q) && are_finite(s->C[N + 1], s->constraints);
}

/* Of the residuals' rows along z: r' J z, |J z|^2 and the largest entry of J' J z. */
void products(const Stages *s, const double *z, double *restrict found) {
  for (int i = 0; i < 3; ++i) found[i] = 0.0;
  for (int k = 0; k <= s->N; ++k) {
    const int n = n_z(s, k);
    const double *v = z + s->z[k];
    for (int i = 0; i < n; ++i) s->v[i] = 0.0;
    for (int i = 0; i < s->n_r[k]; ++i) {
      const double *row = s->rows + s->J[k] + (size_t)i * n;
      int first = 0;
      while (first + 4 <= n && are_zero(row + first)) first += 4;
      const double along = dot(n - first, row + first, v + first);
      found[0] += s->residual[s->r[k] + i] * along, found[1] += along * along;
      add_multiple(n - first, along, row + first, s->v + first);
    }
    for (int i = 0; i < n; ++i) found[2] = fabs(s->v[i]) > found[2] ? fabs(s->v[i]) : found[2];
  }
}

/* Largest entry of J' r. */
double steepest(const Stages *s) {
  double most = 0.0, *h = s->v;
  for (int k = 0; k <= s->N; ++k) {
    const int n = n_z(s, k);
    for (int i = 0; i < n; ++i) h[i] = 0.0;
    for (int i = 0; i < s->n_r[k]; ++i) add_multiple(n, s->residual[s->r[k] + i], s->rows + s->J[k] + (size_t)i * n, h);
    most = larger_of(most, largest_of(n, h));
  }
  return most;
}

/* Largest entry of J' r + g + F' costate_+ - costate + C' y + y_z, but for fixed variables; y of rows, then of variables. */
double stationarity(const Stages *s, const double *costate, const double *y, int m) {
  double most = 0.0, *h = s->v;
  for (int k = 0; k <= s->N; ++k) {
    const int n = n_z(s, k), after = k < s->N ? s->n_x[k + 1] : 0;
    for (int i = 0; i < n; ++i) h[i] = s->gradient[s->z[k] + i] + y[m + s->z[k] + i] - (k && i < s->n_x[k] ? costate[s->x[k] + i] : 0.0);
    for (int i = 0; i < s->n_r[k]; ++i) add_multiple(n, s->residual[s->r[k] + i], s->rows + s->J[k] + (size_t)i * n, h);
    for (int i = 0; i < after; ++i) add_multiple(n, costate[s->x[k + 1] + i], s->dynamics + s->F[k] + (size_t)i * n, h);
    for (int i = 0; i < s->n_c[k]; ++i)
      if (y[s->c[k] + i] != 0.0) add_multiple(n, y[s->c[k] + i], s->constraints + s->C[k] + (size_t)i * n, h);
    for (int i = 0; i < n; ++i)
      if (s->fixed[s->z[k] + i] == 0.0) most = larger_of(most, fabs(h[i]));
  }
  return most;
}
