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


def solve_positive(rows: LeastSquaresRows, n: int) -> None:
    """Solve ``K x = y`` for n variables by Cholesky's factors; x takes the place of y."""
    for j in range(n):
        for i in range(j, n):
            total = rows.K[i][j]
            for k in range(j):
                total -= rows.K[i][k] * rows.K[j][k]
            if i == j:
                rows.K[i][j] = math.sqrt(max(total, 0.0))
            else:
                rows.K[i][j] = total / rows.K[j][j]
    for i in range(n):
        for k in range(i):
            rows.y[i] -= rows.K[i][k] * rows.y[k]
        rows.y[i] /= rows.K[i][i]
    for back in range(n):
        i = n - 1 - back
        for k in range(i + 1, n):
            rows.y[i] -= rows.K[k][i] * rows.y[k]
        rows.y[i] /= rows.K[i][i]


def least_norm(rows: LeastSquaresRows, m: int, n: int) -> None:
    """Find the y (n,) of least norm among those that minimise ``|W y - b|``.

    W = L Q with an orthonormal basis Q of its rows, taken in the order of what is left of them;
    then L z = b by least squares with L = U R. Both by Gram and Schmidt, twice, which is as good as
    reflections.
    """
    rank = row_space(rows, m, n)
    for k in range(rank):
        _orthonormal_column(rows, m, k)
        rows.z[k] = 0.0
        for i in range(m):
            rows.z[k] += rows.L[i][k] * rows.b[i]
        for i in range(m):
            rows.b[i] -= rows.L[i][k] * rows.z[k]
    for back in range(rank):
        k = rank - 1 - back
        for j in range(k + 1, rank):
            rows.z[k] -= rows.R[k][j] * rows.z[j]
        rows.z[k] /= rows.R[k][k]
    for j in range(n):
        rows.y[j] = 0.0
        for k in range(rank):
            rows.y[j] += rows.z[k] * rows.basis[k][j]


def row_space(rows: LeastSquaresRows, m: int, n: int) -> int:
    """Factor the m rows (m, n) of W [any] into L and an orthonormal basis; return the rank."""
    largest = 0.0
    for k in range(min(m, n)):
        row = _longest(rows, m, n)
        size = _row_length(rows.W[row], n)
        largest = max(largest, size)
        if size <= _RANK_TOLERANCE * largest:
            return k
        for j in range(n):
            rows.basis[k][j] = rows.W[row][j] / size
        _orthogonal_to_the_others(rows, k, n)
        for i in range(m):
            # Of rows that are in the basis nothing is left, and what they were before is added
            # where it was taken.
            along = dot(rows.W[i], rows.basis[k], n)
            rows.L[i][k] = along
            for j in range(n):
                rows.W[i][j] -= along * rows.basis[k][j]
    return min(m, n)


def _longest(rows: LeastSquaresRows, m: int, n: int) -> int:
    longest = 0
    for i in range(1, m):
        if dot(rows.W[i], rows.W[i], n) > dot(rows.W[longest], rows.W[longest], n):
            longest = i
    return longest


def _orthogonal_to_the_others(rows: LeastSquaresRows, k: int, n: int) -> None:
    """Make basis vector k orthogonal to the others a second time, to the last bit."""
    for earlier in range(k):
        along = dot(rows.basis[k], rows.basis[earlier], n)
        for j in range(n):
            rows.basis[k][j] -= along * rows.basis[earlier][j]
    size = _row_length(rows.basis[k], n)
    for j in range(n):
        rows.basis[k][j] /= size


def _orthonormal_column(rows: LeastSquaresRows, m: int, k: int) -> None:
    """Make column k of L orthonormal to those before it, and write column k of R."""
    for earlier in range(k):
        rows.R[earlier][k] = 0.0
    for _ in range(2):
        for earlier in range(k):
            along = 0.0
            for i in range(m):
                along += rows.L[i][earlier] * rows.L[i][k]
            rows.R[earlier][k] += along
            for i in range(m):
                rows.L[i][k] -= along * rows.L[i][earlier]
    total = 0.0
    for i in range(m):
        total += rows.L[i][k] * rows.L[i][k]
    rows.R[k][k] = math.sqrt(total)
    for i in range(m):
        rows.L[i][k] /= rows.R[k][k]


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
    """[b/x] matrix."""
    b: Annotated[Vector, Sized("m")]
    """[b] right sides."""
    lower: Annotated[Vector, Sized("n")]
    """[x] lower bounds."""
    upper: Annotated[Vector, Sized("n")]
    """[x] upper bounds."""
    weight: Annotated[Vector, Sized("n")]
    """[1/x^2] weights of the squares of x."""
    started: bool
    """True where x is inside the bounds and near the answer."""
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


def solve_bounded(problem: BoundedProblem) -> int:
    """Find x; return the number of active-set rounds, at most ten for each variable."""
    _unit_weights(problem)
    _normal_equations(problem)
    _start(problem)
    rounds = 0
    while rounds < 10 * problem.columns:
        _advance(problem, False)
        released = _most_wrong(problem)
        if released < 0:
            break
        problem.free[released] = True
        rounds += 1
    _advance(problem, True)
    for j in range(problem.columns):
        problem.x[j] = min(max(problem.x[j] / problem.scale[j], problem.lower[j]), problem.upper[j])
    return rounds


def _unit_weights(problem: BoundedProblem) -> None:
    for j in range(problem.columns):
        problem.scale[j] = math.sqrt(problem.weight[j])
        problem.low[j] = problem.lower[j] * problem.scale[j]
        problem.high[j] = problem.upper[j] * problem.scale[j]
        for i in range(problem.rows):
            problem.M[i][j] = problem.A[i][j] / problem.scale[j]


def _normal_equations(problem: BoundedProblem) -> None:
    """Write the Hessian ``M' M``, with a ridge on its diagonal, and ``M' b``."""
    trace = 0.0
    for j in range(problem.columns):
        for k in range(problem.columns):
            total = 0.0
            for i in range(problem.rows):
                total += problem.M[i][j] * problem.M[i][k]
            problem.hessian[j][k] = total
        total = 0.0
        for i in range(problem.rows):
            total += problem.M[i][j] * problem.b[i]
        problem.linear[j] = total
        trace += problem.hessian[j][j]
    ridge = _RIDGE * _RIDGE * max(trace / max(problem.columns, 1), _SMALLEST_NORMAL)
    for j in range(problem.columns):
        problem.hessian[j][j] += ridge


def _start(problem: BoundedProblem) -> None:
    for j in range(problem.columns):
        problem.free[j] = True
        problem.x[j] *= problem.scale[j]
    if not problem.started:
        _ridge_optimum(problem)
        problem.x[: problem.columns] = problem.optimum[: problem.columns]
    for j in range(problem.columns):
        problem.x[j] = min(max(problem.x[j], problem.low[j]), problem.high[j])
        problem.free[j] = problem.low[j] < problem.x[j] < problem.high[j]


def _advance(problem: BoundedProblem, exact: bool) -> None:
    """Move to the optimum of the free variables, fixing those that meet a bound on the way."""
    while _free_ones(problem) > 0:
        if exact:
            _exact_optimum(problem)
        else:
            _ridge_optimum(problem)
        share = _share_of_step(problem)
        k = problem.blocking
        rises = k >= 0 and problem.optimum[k] > problem.x[k]
        for j in range(problem.columns):
            problem.x[j] += share * (problem.optimum[j] - problem.x[j])
        if k < 0:
            break
        problem.x[k] = problem.high[k] if rises else problem.low[k]
        problem.free[k] = False


def _free_ones(problem: BoundedProblem) -> int:
    count = 0
    for j in range(problem.columns):
        count += problem.free[j]
    return count


def _share_of_step(problem: BoundedProblem) -> float:
    """Return the largest share <= 1 of the step to the optimum that keeps all bounds; `blocking` is
    the variable that ends it.
    """
    share = math.inf
    problem.blocking = -1
    for j in range(problem.columns):
        step = problem.optimum[j] - problem.x[j]
        if step != 0.0:
            room = (problem.high[j] if step > 0.0 else problem.low[j]) - problem.x[j]
            if room / step < share:
                share = room / step
                problem.blocking = j
    if share >= 1.0:
        problem.blocking = -1
        return 1.0
    return max(share, 0.0)


def _ridge_optimum(problem: BoundedProblem) -> None:
    count = 0
    for j in range(problem.columns):
        if problem.free[j]:
            rest = problem.linear[j]
            column = 0
            for k in range(problem.columns):
                if problem.free[k]:
                    problem.inner.K[count][column] = problem.hessian[j][k]
                    column += 1
                else:
                    rest -= problem.hessian[j][k] * problem.x[k]
            problem.inner.y[count] = rest
            count += 1
    solve_positive(problem.inner, count)
    _spread(problem)


def _exact_optimum(problem: BoundedProblem) -> None:
    """Solve for the free variables without the ridge: least residual, then least norm."""
    count = 0
    for i in range(problem.rows):
        rest = problem.b[i]
        count = 0
        for j in range(problem.columns):
            if problem.free[j]:
                problem.inner.W[i][count] = problem.M[i][j]
                count += 1
            else:
                rest -= problem.M[i][j] * problem.x[j]
        problem.inner.b[i] = rest
    least_norm(problem.inner, problem.rows, count)
    _spread(problem)


def _spread(problem: BoundedProblem) -> None:
    """Copy the solution of the free variables to their places among all variables."""
    count = 0
    for j in range(problem.columns):
        problem.optimum[j] = problem.x[j]
        if problem.free[j]:
            problem.optimum[j] = problem.inner.y[count]
            count += 1


def _most_wrong(problem: BoundedProblem) -> int:
    """Return the fixed variable whose release lowers the cost most; -1 where none does."""
    worst = -1
    largest_gain = 0.0
    largest = 0.0
    for j in range(problem.columns):
        gradient = -problem.linear[j]
        for k in range(problem.columns):
            gradient += problem.hessian[j][k] * problem.x[k]
        largest = max(largest, abs(gradient))
        gain = -gradient if problem.x[j] <= problem.low[j] else gradient
        if not problem.free[j] and problem.low[j] != problem.high[j] and gain > largest_gain:
            worst = j
            largest_gain = gain
    if largest_gain > _SIGN_TOLERANCE * _RIDGE * (1.0 + largest):
        return worst
    return -1


def room_for(n: int) -> int:
    """Round a number n of variables up, so that problems of nearly one size share a compiled
    kernel.
    """
    return max(_SIZE_STEP, -(-n // _SIZE_STEP) * _SIZE_STEP)
