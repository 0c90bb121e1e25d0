/* Products and factors of small dense matrices, row-major, in blocks of 4 x 4 that stay in registers.

A matrix of n columns has rows of PADDED(n) numbers where it is our own. Blocks may read up to three numbers beyond the end of
a row of data; what comes of them is overwritten or never read. */

#define PADDED(n) (((n) + 3) & ~3)

/* c += a' b for the rows k of a (4 numbers each) and b. */
static inline void block_product(int n, const double *restrict a, int lda, const double *restrict b, int ldb,
                                 double c[restrict 4][4]) {
  double c0[4], c1[4], c2[4], c3[4];
  for (int j = 0; j < 4; ++j) c0[j] = c[0][j], c1[j] = c[1][j], c2[j] = c[2][j], c3[j] = c[3][j];
  for (int k = 0; k < n; ++k, a += lda, b += ldb) {
    const double a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
    for (int j = 0; j < 4; ++j) c0[j] += a0 * b[j];
    for (int j = 0; j < 4; ++j) c1[j] += a1 * b[j];
    for (int j = 0; j < 4; ++j) c2[j] += a2 * b[j];
    for (int j = 0; j < 4; ++j) c3[j] += a3 * b[j];
  }
  for (int j = 0; j < 4; ++j) c[0][j] = c0[j], c[1][j] = c1[j], c[2][j] = c2[j], c[3][j] = c3[j];
}

/* c += a b for 4 rows of a. */
static inline void block_rows(int n, const double *restrict a, int lda, const double *restrict b, int ldb,
                              double c[restrict 4][4]) {
  double c0[4], c1[4], c2[4], c3[4];
  for (int j = 0; j < 4; ++j) c0[j] = c[0][j], c1[j] = c[1][j], c2[j] = c[2][j], c3[j] = c[3][j];
  for (int k = 0; k < n; ++k, ++a, b += ldb) {
    const double a0 = a[0], a1 = a[lda], a2 = a[2 * lda], a3 = a[3 * lda];
    for (int j = 0; j < 4; ++j) c0[j] += a0 * b[j];
    for (int j = 0; j < 4; ++j) c1[j] += a1 * b[j];
    for (int j = 0; j < 4; ++j) c2[j] += a2 * b[j];
    for (int j = 0; j < 4; ++j) c3[j] += a3 * b[j];
  }
  for (int j = 0; j < 4; ++j) c[0][j] = c0[j], c[1][j] = c1[j], c[2][j] = c2[j], c[3][j] = c3[j];
}

/* A row of a Gram matrix, and its weight. */
typedef struct {
  const double *row;
  double weight;
} WeightedRow;

/* c += sum of weight * row[i..]' row[j..]. */
static inline void block_gram(int n, const WeightedRow *restrict rows, int i, int j, double c[restrict 4][4]) {
  double c0[4] = {0}, c1[4] = {0}, c2[4] = {0}, c3[4] = {0};
  for (int k = 0; k < n; ++k) {
    const double *restrict a = rows[k].row + i, *restrict b = rows[k].row + j, w = rows[k].weight;
    const double a0 = w * a[0], a1 = w * a[1], a2 = w * a[2], a3 = w * a[3];
    for (int l = 0; l < 4; ++l) c0[l] += a0 * b[l];
    for (int l = 0; l < 4; ++l) c1[l] += a1 * b[l];
    for (int l = 0; l < 4; ++l) c2[l] += a2 * b[l];
    for (int l = 0; l < 4; ++l) c3[l] += a3 * b[l];
  }
  for (int l = 0; l < 4; ++l) c[0][l] = c0[l], c[1][l] = c1[l], c[2][l] = c2[l], c[3][l] = c3[l];
}

static inline double dot(int n, const double *restrict a, const double *restrict b) {
  double s[4] = {0};
  int k = 0;
  for (; k + 4 <= n; k += 4)
    for (int l = 0; l < 4; ++l) s[l] += a[k + l] * b[k + l];
  for (; k < n; ++k) s[0] += a[k] * b[k];
  return (s[0] + s[1]) + (s[2] + s[3]);
}

/* y += t a. */
static inline void add_multiple(int n, double t, const double *restrict a, double *restrict y) {
  for (int k = 0; k < n; ++k) y[k] += t * a[k];
}

/* M += A' diag(weight) A below the diagonal, blocks of columns without an entry left out; A (m, n), M (n, n) padded.

Rows of weight 0 cost nothing, rows of one entry next to nothing. weight may be 0 for ones; rows: room for 2 m. */
static void add_gram(int m, int n, const double *A, const double *weight, double *restrict M, WeightedRow *rows) {
  const int ld = PADDED(n);
  WeightedRow *dense = rows, *here = rows + m;
  int n_dense = 0;
  for (int k = 0; k < m; ++k) {
    const double *row = A + (size_t)k * n, w = weight ? weight[k] : 1.0;
    int first = -1, last = -1;
    if (w == 0.0) continue;
    for (int i = 0; i < n && first < 0; ++i)
      if (row[i] != 0.0) first = i;
    for (int i = n - 1; i >= 0 && last < 0; --i)
      if (row[i] != 0.0) last = i;
    if (first < 0) continue;
    if (first == last)
      M[first * ld + first] += w * row[first] * row[first];
    else
      dense[n_dense].row = row, dense[n_dense].weight = w, ++n_dense;
  }
  for (int i = 0; i < n; i += 4) {
    int n_here = 0;
    for (int k = 0; k < n_dense; ++k) {
      const double *row = dense[k].row;
      int any = 0;
      for (int l = i; l < n && l < i + 4; ++l) any |= row[l] != 0.0;
      if (any) here[n_here++] = dense[k];
    }
    if (!n_here) continue;
    for (int j = 0; j <= i; j += 4) {
      double c[4][4];
      block_gram(n_here, here, i, j, c);
      for (int p = 0; p < 4; ++p)
        for (int q = 0; q < 4; ++q) M[(i + p) * ld + j + q] += c[p][q];
    }
  }
}

/* M = L' L with L lower, in place; from the last row to the first, so that what comes last is eliminated first.

inverse (n) gets 1 / L_kk. Where a pivot is rounding only, rows from `needed` on (those that are solved for) are damped, and the
others, of which only the product L' L counts, are 0. Returns 1 where the matrix is not positive semi-definite in these others
alone, 2 where it is not in rows that are solved for, 3 for NaN. */
static int factor_reversed(int n, int needed, double least, double *restrict M, double *restrict inverse) {
  const int ld = PADDED(n);
  int wrong = 0;
  for (int i = n; i < ld; ++i) {
    for (int j = 0; j < ld; ++j) M[i * ld + j] = 0.0;
    M[i * ld + i] = 1.0;
  }
  for (int top = ld - 4; top >= 0; top -= 4) {
    double given[4];
    for (int p = 0; p < 4; ++p) given[p] = M[(top + p) * ld + top + p];
    for (int j = 0; j <= top; j += 4) {
      double c[4][4] = {{0}};
      block_product(ld - top - 4, M + (top + 4) * ld + top, ld, M + (top + 4) * ld + j, ld, c);
      for (int p = 0; p < 4; ++p)
        for (int q = 0; q < 4; ++q) M[(top + p) * ld + j + q] -= c[p][q];
    }
    for (int p = 3; p >= 0; --p) {
      const int k = top + p;
      double *restrict row = M + k * ld;
      for (int q = 3; q > p; --q) add_multiple(k + 1, -M[(top + q) * ld + k], M + (top + q) * ld, row);
      double pivot = row[k], scale = 0.0;
      if (!(pivot == pivot)) return 3;
      if (pivot < -INDEFINITE * (fabs(given[p]) + least)) {
        if (k >= needed) return 2;
        wrong = 1;
      }
      if (pivot <= ROUNDING * given[p] + TINY) {
        /* A direction without curvature. */
        if (k >= needed) pivot = DAMPED * (given[p] > least ? given[p] : least);
        else pivot = 0.0;
      }
      if (pivot > 0.0) scale = 1.0 / sqrt(pivot);
      for (int j = 0; j < k; ++j) row[j] *= scale;
      row[k] = pivot * scale;
      for (int j = k + 1; j < top + 4; ++j) row[j] = 0.0;
      if (k < n) inverse[k] = scale;
    }
  }
  return wrong;
}
