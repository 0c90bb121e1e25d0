"""Small dense least squares as kernels: positive definite systems, least norm of any rank, and
bounds by an active set with a weighted norm.

`solve_bounded` has two strict levels: among the x in [lower, upper] that minimise ``|A x - b|``,
the one that minimises ``x' diag(weight) x``. The answer is unique. The active set is found on the
regularised problem ``|A x - b|^2 + epsilon^2 x' diag(weight) x`` [Stark1995] and the levels are
then separated exactly. `[x]` is the unit of a variable, `[b]` that of the rows. Inputs are trusted:
finite, lower <= upper, weight > 0.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector

# A row that adds less than this to those before it, relative to the largest, adds no rank.
_RANK_TOLERANCE = 1e-9
_RIDGE = 1e-4  # share of the norm while the active set is sought; its square is the loss of wrench
_SIGN_TOLERANCE = 1e-9  # of the signs of gradients, relative to the largest
_SMALLEST_NORMAL = 2.2250738585072014e-308  # the smallest double with all of its digits
_SIZE_STEP = 8  # a compiled kernel has room for a multiple of so many variables


class LeastSquaresRows(Layout):
    """Memory of `solve_positive`, `least_norm` and `row_space`, for up to m rows and n
    variables.
    """

    K: Annotated[list[Vector], Sized("n", "n")]
    """Matrix of a positive definite system; overwritten."""
    W: Annotated[list[Vector], Sized("m", "n")]
    """Matrix of any other system; overwritten by the remainder of its rows beside the basis."""
    b: Annotated[Vector, Sized("m")]
    """Right side of that system; overwritten."""
    y: Annotated[Vector, Sized("n")]
    """The solution; before, the right side of a positive definite system."""
    basis: Annotated[list[Vector], Sized("m", "n")]
    """Orthonormal, of the rows."""
    L: Annotated[list[Vector], Sized("m", "m")]
    """The rows in that basis; then its columns made orthonormal."""
    R: Annotated[list[Vector], Sized("m", "m")]
    """Triangular factor: those columns in the orthonormal ones."""
    z: Annotated[Vector, Sized("m")]
    """The solution in the basis."""


def solve_positive(s: LeastSquaresRows, n: int) -> None:
    """Solve ``K x = y`` for n variables by Cholesky's factors; x takes the place of y."""
    for j in range(n):
        for i in range(j, n):
            total = s.K[i][j]
            for k in range(j):
                total -= s.K[i][k] * s.K[j][k]
            if i == j:
                s.K[i][j] = math.sqrt(max(total, 0.0))
            else:
                s.K[i][j] = total / s.K[j][j]
    for i in range(n):
        for k in range(i):
            s.y[i] -= s.K[i][k] * s.y[k]
        s.y[i] /= s.K[i][i]
    for back in range(n):
        i = n - 1 - back
        for k in range(i + 1, n):
            s.y[i] -= s.K[k][i] * s.y[k]
        s.y[i] /= s.K[i][i]


def least_norm(s: LeastSquaresRows, m: int, n: int) -> None:
    """Find the y (n,) of least norm among those that minimise ``|W y - b|``.

    W = L Q with an orthonormal basis Q of its rows, taken in the order of what is left of them;
    then L z = b by least squares with L = U R. Both by Gram and Schmidt, twice, which is as good as
    reflections.
    """
    rank = row_space(s, m, n)
    for k in range(rank):
        _orthonormal_column(s, m, k)
        s.z[k] = 0.0
        for i in range(m):
            s.z[k] += s.L[i][k] * s.b[i]
        for i in range(m):
            s.b[i] -= s.L[i][k] * s.z[k]
    for back in range(rank):
        k = rank - 1 - back
        for j in range(k + 1, rank):
            s.z[k] -= s.R[k][j] * s.z[j]
        s.z[k] /= s.R[k][k]
    for j in range(n):
        s.y[j] = 0.0
        for k in range(rank):
            s.y[j] += s.z[k] * s.basis[k][j]


def row_space(s: LeastSquaresRows, m: int, n: int) -> int:
    """Factor the m rows (m, n) of W [any] into L and an orthonormal basis; return the rank."""
    largest = 0.0
    for k in range(min(m, n)):
        row = _longest(s, m, n)
        size = _row_length(s.W[row], n)
        largest = max(largest, size)
        if size <= _RANK_TOLERANCE * largest:
            return k
        for j in range(n):
            s.basis[k][j] = s.W[row][j] / size
        _orthogonal_to_the_others(s, k, n)
        for i in range(m):
            # Of rows that are in the basis nothing is left, and what they were before is added
            # where it was taken.
            along = dot(s.W[i], s.basis[k], n)
            s.L[i][k] = along
            for j in range(n):
                s.W[i][j] -= along * s.basis[k][j]
    return min(m, n)


def _longest(s: LeastSquaresRows, m: int, n: int) -> int:
    longest = 0
    for i in range(1, m):
        if dot(s.W[i], s.W[i], n) > dot(s.W[longest], s.W[longest], n):
            longest = i
    return longest


def _orthogonal_to_the_others(s: LeastSquaresRows, k: int, n: int) -> None:
    """Make basis vector k orthogonal to the others a second time, to the last bit."""
    for earlier in range(k):
        along = dot(s.basis[k], s.basis[earlier], n)
        for j in range(n):
            s.basis[k][j] -= along * s.basis[earlier][j]
    size = _row_length(s.basis[k], n)
    for j in range(n):
        s.basis[k][j] /= size


def _orthonormal_column(s: LeastSquaresRows, m: int, k: int) -> None:
    """Make column k of L orthonormal to those before it, and write column k of R."""
    for earlier in range(k):
        s.R[earlier][k] = 0.0
    for _ in range(2):
        for earlier in range(k):
            along = 0.0
            for i in range(m):
                along += s.L[i][earlier] * s.L[i][k]
            s.R[earlier][k] += along
            for i in range(m):
                s.L[i][k] -= along * s.L[i][earlier]
    total = 0.0
    for i in range(m):
        total += s.L[i][k] * s.L[i][k]
    s.R[k][k] = math.sqrt(total)
    for i in range(m):
        s.L[i][k] /= s.R[k][k]


def dot(x: Vector, y: Vector, n: int) -> float:
    """Sum products of the first n entries of x (n,) [any] and y (n,) [any]."""
    total = 0.0
    for j in range(n):
        total += x[j] * y[j]
    return total


def _row_length(x: Vector, n: int) -> float:
    return math.sqrt(dot(x, x, n))


class BoundedProblem(Layout):
    """Memory of `solve_bounded`, for up to m rows and n variables."""

    rows: int
    columns: int
    A: Annotated[list[Vector], Sized("m", "n")]
    """[b/x]"""
    b: Annotated[Vector, Sized("m")]
    """[b]"""
    lower: Annotated[Vector, Sized("n")]
    """[x]"""
    upper: Annotated[Vector, Sized("n")]
    """[x]"""
    weight: Annotated[Vector, Sized("n")]
    """[1/x^2]"""
    started: bool
    """X is inside the bounds, and near the answer."""
    x: Annotated[Vector, Sized("n")]
    """[x] the answer."""
    # Of variables that have the weight 1.
    scale: Annotated[Vector, Sized("n")]
    M: Annotated[list[Vector], Sized("m", "n")]
    low: Annotated[Vector, Sized("n")]
    high: Annotated[Vector, Sized("n")]
    hessian: Annotated[list[Vector], Sized("n", "n")]
    linear: Annotated[Vector, Sized("n")]
    free: Annotated[list[bool], Sized("n")]
    optimum: Annotated[Vector, Sized("n")]
    """Optimum of the free variables."""
    blocking: int
    """The variable that stops a step; -1 for none."""
    inner: LeastSquaresRows
    """System solved for the free variables."""


def solve_bounded(p: BoundedProblem) -> int:
    """Find x; return the number of active-set rounds, at most ten for each variable."""
    _unit_weights(p)
    _normal_equations(p)
    _start(p)
    rounds = 0
    while rounds < 10 * p.columns:
        _advance(p, False)
        released = _most_wrong(p)
        if released < 0:
            break
        p.free[released] = True
        rounds += 1
    _advance(p, True)
    for j in range(p.columns):
        p.x[j] = min(max(p.x[j] / p.scale[j], p.lower[j]), p.upper[j])
    return rounds


def _unit_weights(p: BoundedProblem) -> None:
    for j in range(p.columns):
        p.scale[j] = math.sqrt(p.weight[j])
        p.low[j] = p.lower[j] * p.scale[j]
        p.high[j] = p.upper[j] * p.scale[j]
        for i in range(p.rows):
            p.M[i][j] = p.A[i][j] / p.scale[j]


def _normal_equations(p: BoundedProblem) -> None:
    """Write the Hessian ``M' M``, with a ridge on its diagonal, and ``M' b``."""
    trace = 0.0
    for j in range(p.columns):
        for k in range(p.columns):
            total = 0.0
            for i in range(p.rows):
                total += p.M[i][j] * p.M[i][k]
            p.hessian[j][k] = total
        total = 0.0
        for i in range(p.rows):
            total += p.M[i][j] * p.b[i]
        p.linear[j] = total
        trace += p.hessian[j][j]
    ridge = _RIDGE * _RIDGE * max(trace / max(p.columns, 1), _SMALLEST_NORMAL)
    for j in range(p.columns):
        p.hessian[j][j] += ridge


def _start(p: BoundedProblem) -> None:
    for j in range(p.columns):
        p.free[j] = True
        p.x[j] *= p.scale[j]
    if not p.started:
        _ridge_optimum(p)
        p.x[: p.columns] = p.optimum[: p.columns]
    for j in range(p.columns):
        p.x[j] = min(max(p.x[j], p.low[j]), p.high[j])
        p.free[j] = p.low[j] < p.x[j] < p.high[j]


def _advance(p: BoundedProblem, exact: bool) -> None:
    """Move to the optimum of the free variables, fixing those that meet a bound on the way."""
    while _free_ones(p) > 0:
        if exact:
            _exact_optimum(p)
        else:
            _ridge_optimum(p)
        share = _share_of_step(p)
        k = p.blocking
        rises = k >= 0 and p.optimum[k] > p.x[k]
        for j in range(p.columns):
            p.x[j] += share * (p.optimum[j] - p.x[j])
        if k < 0:
            break
        p.x[k] = p.high[k] if rises else p.low[k]
        p.free[k] = False


def _free_ones(p: BoundedProblem) -> int:
    count = 0
    for j in range(p.columns):
        count += p.free[j]
    return count


def _share_of_step(p: BoundedProblem) -> float:
    """Return the largest share <= 1 of the step to the optimum that keeps all bounds; `blocking` is
    the variable that ends it.
    """
    share = math.inf
    p.blocking = -1
    for j in range(p.columns):
        step = p.optimum[j] - p.x[j]
        if step != 0.0:
            room = (p.high[j] if step > 0.0 else p.low[j]) - p.x[j]
            if room / step < share:
                share = room / step
                p.blocking = j
    if share >= 1.0:
        p.blocking = -1
        return 1.0
    return max(share, 0.0)


def _ridge_optimum(p: BoundedProblem) -> None:
    count = 0
    for j in range(p.columns):
        if p.free[j]:
            rest = p.linear[j]
            column = 0
            for k in range(p.columns):
                if p.free[k]:
                    p.inner.K[count][column] = p.hessian[j][k]
                    column += 1
                else:
                    rest -= p.hessian[j][k] * p.x[k]
            p.inner.y[count] = rest
            count += 1
    solve_positive(p.inner, count)
    _spread(p)


def _exact_optimum(p: BoundedProblem) -> None:
    """Solve for the free variables without the ridge: least residual, then least norm."""
    count = 0
    for i in range(p.rows):
        rest = p.b[i]
        count = 0
        for j in range(p.columns):
            if p.free[j]:
                p.inner.W[i][count] = p.M[i][j]
                count += 1
            else:
                rest -= p.M[i][j] * p.x[j]
        p.inner.b[i] = rest
    least_norm(p.inner, p.rows, count)
    _spread(p)


def _spread(p: BoundedProblem) -> None:
    """Copy the solution of the free variables to their places among all variables."""
    count = 0
    for j in range(p.columns):
        p.optimum[j] = p.x[j]
        if p.free[j]:
            p.optimum[j] = p.inner.y[count]
            count += 1


def _most_wrong(p: BoundedProblem) -> int:
    """The fixed variable whose release lowers the cost most; -1 where none does."""
    worst = -1
    largest_gain = 0.0
    largest = 0.0
    for j in range(p.columns):
        gradient = -p.linear[j]
        for k in range(p.columns):
            gradient += p.hessian[j][k] * p.x[k]
        largest = max(largest, abs(gradient))
        gain = -gradient if p.x[j] <= p.low[j] else gradient
        if not p.free[j] and p.low[j] != p.high[j] and gain > largest_gain:
            worst = j
            largest_gain = gain
    if largest_gain > _SIGN_TOLERANCE * _RIDGE * (1.0 + largest):
        return worst
    return -1


def room_for(n: int) -> int:
    """Variables n rounded up, so that problems of nearly one size share a compiled kernel."""
    return max(_SIZE_STEP, -(-n // _SIZE_STEP) * _SIZE_STEP)
