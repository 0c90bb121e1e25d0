/* Products and factors of small dense matrices, row-major, in blocks of 4 x 4 that stay in registers.

A matrix of n columns has rows of PADDED(n) numbers where it is our own. Blocks may read up to three numbers beyond the end of
a row of data; what comes of them is overwritten or never read. */

#define PADDED(n) (((n) + 3) & ~3)

/* Whether four numbers are all 0, or -0. */
INLINE int are_zero(const double *a) {
  unsigned long long any = 0, bits;
  for (int i = 0; i < 4; ++i) memcpy(&bits, a + i, sizeof bits), any |= bits;
  return !(any << 1);
}

/* c -= a' b for the rows k of a (4 numbers each) and b, c in rows of ld numbers of which the first `rows` are wanted. */
INLINE void subtract_product(int n, const double *restrict a, int lda, const double *restrict b, int ldb, double *restrict c, int ld,
                             int rows) {
  double c0[4] = {0}, c1[4] = {0}, c2[4] = {0}, c3[4] = {0};
  for (int k = 0; k < n; ++k, a += lda, b += ldb) {
    const double a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
    for (int j = 0; j < 4; ++j) c0[j] += a0 * b[j];
    for (int j = 0; j < 4; ++j) c1[j] += a1 * b[j];
    for (int j = 0; j < 4; ++j) c2[j] += a2 * b[j];
    for (int j = 0; j < 4; ++j) c3[j] += a3 * b[j];
  }
  for (int j = 0; j < 4; ++j) c[j] -= c0[j];
  if (rows > 1)
    for (int j = 0; j < 4; ++j) c[ld + j] -= c1[j];
  if (rows > 2)
    for (int j = 0; j < 4; ++j) c[2 * ld + j] -= c2[j];
  if (rows > 3)
    for (int j = 0; j < 4; ++j) c[3 * ld + j] -= c3[j];
}

/* The same of 8 columns: twice as many sums on the way hide how long each of them takes. */
INLINE void subtract_wide_product(int n, const double *restrict a, int lda, const double *restrict b, int ldb, double *restrict c,
                                  int ld, int rows) {
  double c0[4] = {0}, c1[4] = {0}, c2[4] = {0}, c3[4] = {0}, d0[4] = {0}, d1[4] = {0}, d2[4] = {0}, d3[4] = {0};
  for (int k = 0; k < n; ++k, a += lda, b += ldb) {
    const double a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
    for (int j = 0; j < 4; ++j) c0[j] += a0 * b[j];
    for (int j = 0; j < 4; ++j) d0[j] += a0 * b[4 + j];
    for (int j = 0; j < 4; ++j) c1[j] += a1 * b[j];
    for (int j = 0; j < 4; ++j) d1[j] += a1 * b[4 + j];
    for (int j = 0; j < 4; ++j) c2[j] += a2 * b[j];
    for (int j = 0; j < 4; ++j) d2[j] += a2 * b[4 + j];
    for (int j = 0; j < 4; ++j) c3[j] += a3 * b[j];
    for (int j = 0; j < 4; ++j) d3[j] += a3 * b[4 + j];
  }
  for (int j = 0; j < 4; ++j) c[j] -= c0[j], c[4 + j] -= d0[j];
  if (rows > 1)
    for (int j = 0; j < 4; ++j) c[ld + j] -= c1[j], c[ld + 4 + j] -= d1[j];
  if (rows > 2)
    for (int j = 0; j < 4; ++j) c[2 * ld + j] -= c2[j], c[2 * ld + 4 + j] -= d2[j];
  if (rows > 3)
    for (int j = 0; j < 4; ++j) c[3 * ld + j] -= c3[j], c[3 * ld + 4 + j] -= d3[j];
}

/* A row of a Gram matrix, and its weight. */
typedef struct {
  const double *row;
  double weight, part[4]; /* the last: weight * row[i..] of the block that is looked at */
  int first;              /* column with an entry */
} WeightedRow;

/* c += sum of part' row[j..], c in rows of ld numbers. */
INLINE void block_gram(int n, const WeightedRow *restrict rows, int j, double *restrict c, int ld) {
  double c0[4], c1[4], c2[4], c3[4];
  for (int l = 0; l < 4; ++l) c0[l] = c[0 * ld + l], c1[l] = c[1 * ld + l], c2[l] = c[2 * ld + l], c3[l] = c[3 * ld + l];
  for (int k = 0; k < n; ++k) {
    const double *restrict a = rows[k].part, *restrict b = rows[k].row + j;
    const double a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
    for (int l = 0; l < 4; ++l) c0[l] += a0 * b[l];
    for (int l = 0; l < 4; ++l) c1[l] += a1 * b[l];
    for (int l = 0; l < 4; ++l) c2[l] += a2 * b[l];
    for (int l = 0; l < 4; ++l) c3[l] += a3 * b[l];
  }
  for (int l = 0; l < 4; ++l) c[0 * ld + l] = c0[l], c[1 * ld + l] = c1[l], c[2 * ld + l] = c2[l], c[3 * ld + l] = c3[l];
}

/* The same of 8 columns. */
INLINE void wide_gram(int n, const WeightedRow *restrict rows, int j, double *restrict c, int ld) {
  double c0[4], c1[4], c2[4], c3[4], d0[4], d1[4], d2[4], d3[4];
  for (int l = 0; l < 4; ++l) c0[l] = c[0 * ld + l], c1[l] = c[1 * ld + l], c2[l] = c[2 * ld + l], c3[l] = c[3 * ld + l];
  for (int l = 0; l < 4; ++l) d0[l] = c[4 + l], d1[l] = c[ld + 4 + l], d2[l] = c[2 * ld + 4 + l], d3[l] = c[3 * ld + 4 + l];
  for (int k = 0; k < n; ++k) {
    const double *restrict a = rows[k].part, *restrict b = rows[k].row + j;
    const double a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
    for (int l = 0; l < 4; ++l) c0[l] += a0 * b[l];
    for (int l = 0; l < 4; ++l) d0[l] += a0 * b[4 + l];
    for (int l = 0; l < 4; ++l) c1[l] += a1 * b[l];
    for (int l = 0; l < 4; ++l) d1[l] += a1 * b[4 + l];
    for (int l = 0; l < 4; ++l) c2[l] += a2 * b[l];
    for (int l = 0; l < 4; ++l) d2[l] += a2 * b[4 + l];
    for (int l = 0; l < 4; ++l) c3[l] += a3 * b[l];
    for (int l = 0; l < 4; ++l) d3[l] += a3 * b[4 + l];
  }
  for (int l = 0; l < 4; ++l) c[0 * ld + l] = c0[l], c[1 * ld + l] = c1[l], c[2 * ld + l] = c2[l], c[3 * ld + l] = c3[l];
  for (int l = 0; l < 4; ++l) c[4 + l] = d0[l], c[ld + 4 + l] = d1[l], c[2 * ld + 4 + l] = d2[l], c[3 * ld + 4 + l] = d3[l];
}

/* NaN wins, so that it is noticed. */
INLINE double larger_of(double a, double b) { return a != a || a > b ? a : b; }

INLINE double largest_of(int n, const double *a) {
  double most[4] = {0};
  int k = 0;
  for (; k + 4 <= n; k += 4)
    for (int l = 0; l < 4; ++l) most[l] = larger_of(most[l], fabs(a[k + l]));
  for (; k < n; ++k) most[0] = larger_of(most[0], fabs(a[k]));
  return larger_of(larger_of(most[0], most[1]), larger_of(most[2], most[3]));
}

INLINE double dot(int n, const double *restrict a, const double *restrict b) {
  double s[4] = {0};
  int k = 0;
  for (; k + 4 <= n; k += 4)
    for (int l = 0; l < 4; ++l) s[l] += a[k + l] * b[k + l];
  for (; k < n; ++k) s[0] += a[k] * b[k];
  return (s[0] + s[1]) + (s[2] + s[3]);
}

/* y += t a. */
INLINE void add_multiple(int n, double t, const double *restrict a, double *restrict y) {
  for (int k = 0; k < n; ++k) y[k] += t * a[k];
}

/* M += A' diag(weight) A below the diagonal, blocks of columns without an entry left out; A (m, n), M (n, n) padded. q += A' r.

Rows of weight 0 cost nothing, rows of one entry next to nothing. weight may be 0 for ones, r and q for none; rows: room for 2 m. */
WIDE static void add_gram(int m, int n, const double *A, const double *weight, const double *r, double *restrict q,
                          double *restrict M, WeightedRow *rows) {
  const int ld = PADDED(n);
  WeightedRow *dense = rows, *here = rows + m;
  int n_dense = 0;
  for (int k = 0; k < m; ++k) {
    const double *row = A + (size_t)k * n, w = weight ? weight[k] : 1.0;
    int first = 0, last = n - 1;
    if (w == 0.0) continue;
    while (first + 4 <= n && are_zero(row + first)) first += 4;
    while (first < n && row[first] == 0.0) ++first;
    if (first == n) {
      if (r && n) q[0] += 0.0 * r[k]; /* What is no number is noticed. */
      continue;
    }
    while (last - 3 > first && are_zero(row + last - 3)) last -= 4;
    while (row[last] == 0.0) --last;
    if (r && r[k] != 0.0) add_multiple(last - first + 1, r[k], row + first, q + first);
    if (first == last)
      M[first * ld + first] += w * row[first] * row[first];
    else
      dense[n_dense].row = row, dense[n_dense].weight = w, dense[n_dense].first = first, ++n_dense;
  }
  for (int i = 0; i < n; i += 4) {
    int n_here = 0, first = i;
    for (int k = 0; k < n_dense; ++k) {
      const double *row = dense[k].row;
      if (are_zero(row + i)) continue;
      here[n_here].row = row;
      for (int l = 0; l < 4; ++l) here[n_here].part[l] = dense[k].weight * row[i + l];
      ++n_here, first = dense[k].first < first ? dense[k].first : first;
    }
    if (!n_here) continue;
    int j = first & ~3;
    for (; j + 4 <= i; j += 8) wide_gram(n_here, here, j, M + i * ld + j, ld);
    if (j <= i) block_gram(n_here, here, j, M + i * ld + j, ld);
  }
}

/* Rows top to top + 4 of M, of which the first `rows` are wanted, less a' b for n rows `done` of L: a are their columns from top on, b
those before `end`. */
WIDE static void subtract_rows(int n, const double *done, int ld, int top, int rows, int end, double *restrict M) {
  int j = 0;
  for (; j + 4 < end; j += 8) subtract_wide_product(n, done + top, ld, done + j, ld, M + top * ld + j, ld, rows);
  if (j < end) subtract_product(n, done + top, ld, done + j, ld, M + top * ld + j, ld, rows);
}

/* Eliminates the rows of M (n, n) from the last one to `state`, in place: they become rows of L, M = L' L with L lower, and what
they leave of the first `state` rows stands there, both triangles of it.

inverse (n) gets 1 / L_kk. Where a pivot is rounding only it is damped. Returns 1 where one is negative, 2 for NaN. */
WIDE static int eliminate(int n, int state, double least, double *restrict M, double *restrict inverse) {
  const int ld = PADDED(n);
  for (int end = n; end > state; end -= 4) {
    const int top = end - 4 > state ? end - 4 : state;
    double given[4];
    for (int p = 0; p < end - top; ++p) given[p] = M[(top + p) * ld + top + p];
    if (end < n) subtract_rows(n - end, M + end * ld, ld, top, end - top, end, M);
    for (int k = end - 1; k >= top; --k) {
      double *restrict row = M + k * ld;
      for (int later = end - 1; later > k; --later) add_multiple(k + 1, -M[later * ld + k], M + later * ld, row);
      double pivot = row[k], before = given[k - top];
      if (!(pivot == pivot)) return 2;
      if (pivot < -INDEFINITE * (fabs(before) + least)) return 1;
      /* A direction without curvature. */
      if (pivot <= ROUNDING * before + TINY) pivot = DAMPED * (before > least ? before : least);
      inverse[k] = 1.0 / sqrt(pivot);
      for (int j = 0; j < k; ++j) row[j] *= inverse[k];
      row[k] = pivot * inverse[k];
    }
  }
  for (int i = 0; i < state; i += 4) subtract_rows(n - state, M + state * ld, ld, i, state - i, i + 4, M);
  for (int i = 0; i < state; ++i)
    for (int j = 0; j < i; ++j) M[j * ld + i] = M[i * ld + j];
  return 0;
}

/* b = a' of a block. */
INLINE void transpose(const double *restrict a, int lda, double *restrict b, int ldb) {
  const double *restrict a1 = a + lda, *restrict a2 = a1 + lda, *restrict a3 = a2 + lda;
  for (int p = 0; p < 4; ++p, b += ldb) b[0] = a[p], b[1] = a1[p], b[2] = a2[p], b[3] = a3[p];
}

/* M += F' P F below the diagonal: entries first[k] to first[k + 1] of F (m, n) stand in row k, P (m, m) has both triangles in rows of
ld_P numbers, M (n, n) is padded; PF: room for 2 PADDED(n) PADDED(m). */
WIDE static void add_transformed(int m, int n, const int *first, const int *column, const double *entry, const double *P, int ld_P,
                                 double *restrict M, double *restrict PF) {
  const int ld = PADDED(n), ld_T = PADDED(m);
  double *T = PF + ld * ld_T;
  for (int i = 0; i < ld * ld_T; ++i) T[i] = 0.0;
  for (int k = 0; k < m; ++k)
    for (int e = first[k]; e < first[k + 1]; ++e) add_multiple(m, entry[e], P + k * ld_P, T + column[e] * ld_T);
  for (int k = 0; k < ld_T; k += 4)
    for (int j = 0; j < ld; j += 4) transpose(T + j * ld_T + k, ld_T, PF + k * ld + j, ld);
  for (int k = 0; k < m; ++k)
    for (int e = first[k]; e < first[k + 1]; ++e) add_multiple(column[e] + 1, entry[e], PF + k * ld, M + column[e] * ld);
}

/* Where row i of a lower triangle begins whose rows lie one after the other. */
#define ROW(i) ((i) * ((i) + 1) / 2)

/* h += T v for the symmetric matrix (n, n) of such a triangle. */
INLINE void add_symmetric(int n, const double *restrict T, const double *restrict v, double *restrict h) {
  for (int i = 0; i < n; ++i, T += i) {
    h[i] += dot(i + 1, T, v);
    add_multiple(i, v[i], T, h);
  }
}
