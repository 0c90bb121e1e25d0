"""Bounded least squares whose free directions minimise a weighted norm: small, dense, by an active set, as kernels.

Two strict levels: among the x in [lower, upper] that minimise ``|A x - b|``, the one that minimises
``x' diag(weight) x``. The answer is unique. The active set is found on the regularised problem
``|A x - b|^2 + epsilon^2 x' diag(weight) x`` [Stark1995] and the levels are then separated exactly. `[x]` is the unit of
a variable, `[b]` that of the rows. Inputs are trusted: finite, lower <= upper, weight > 0.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from uvms_ocp.functions.kernels.binding import bind_kernels
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, structure_of
from uvms_ocp.solvers.least_norm import Rows, least_norm, solve_positive

_EPSILON = 1e-4  # share of the norm while the active set is sought; its square is the loss of wrench
_TOLERANCE = 1e-9  # of signs, relative
_SMALLEST = 2.2250738585072014e-308  # that is not rounded
_ROOM = 8  # variables that a compiled kernel has room for, or a multiple of it


class BoundedProblem(Layout):
    """Room for m rows and n variables, of which some are used."""

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
    """x is inside the bounds, and near the answer."""
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
    """Of the free variables."""
    blocking: int
    """The variable that stops a step; -1 for none."""
    inner: Rows
    """What is solved for the free variables."""


def solve_bounded(p: BoundedProblem) -> int:
    """Find x; the rounds that it took, ten for every variable at most."""
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
    """With a ridge."""
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
    ridge = _EPSILON * _EPSILON * max(trace / max(p.columns, 1), _SMALLEST)
    for j in range(p.columns):
        p.hessian[j][j] += ridge


def _start(p: BoundedProblem) -> None:
    for j in range(p.columns):
        p.free[j] = True
        p.x[j] *= p.scale[j]
    if not p.started:
        _ridge_optimum(p)
        for j in range(p.columns):
            p.x[j] = p.optimum[j]
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
    """Largest share <= 1 of the step to the optimum that stays inside; the variable that stops it is `blocking`."""
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
        p.optimum[j] = p.x[j]
        if p.free[j]:
            rest, column = p.linear[j], 0
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
    """Free part: least residual, then least norm."""
    count = 0
    for i in range(p.rows):
        rest, count = p.b[i], 0
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
    """The solution for the free variables to where they are."""
    count = 0
    for j in range(p.columns):
        p.optimum[j] = p.x[j]
        if p.free[j]:
            p.optimum[j] = p.inner.y[count]
            count += 1


def _most_wrong(p: BoundedProblem) -> int:
    """The fixed variable whose release lowers the cost most; -1 where none does."""
    worst, most, largest = -1, 0.0, 0.0
    for j in range(p.columns):
        gradient = -p.linear[j]
        for k in range(p.columns):
            gradient += p.hessian[j][k] * p.x[k]
        largest = max(largest, abs(gradient))
        gain = -gradient if p.x[j] <= p.low[j] else gradient
        if not p.free[j] and p.low[j] != p.high[j] and gain > most:
            worst = j
            most = gain
    return worst if most > _TOLERANCE * _EPSILON * (1.0 + largest) else -1


def room_for(n: int) -> int:
    """Variables n [-] rounded up, so that problems of nearly one size share a compiled kernel."""
    return max(_ROOM, -(-n // _ROOM) * _ROOM)


def bounded_least_squares(
    A: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray, weight: np.ndarray, *, compiled: bool = True
) -> np.ndarray:
    """Return x (n,) [x] for A (m, n) [b/x], b (m,) [b], lower, upper (n,) [x] and weight (n,) [1/x^2]; in C unless `compiled` is
    false or there is no compiler."""
    (m, n), sizes = A.shape, (A.shape[0], room_for(A.shape[1]))
    problem, solve = _bound(*sizes, compiled)
    p: Any = problem()
    p.rows, p.columns, p.b[:] = m, n, b.tolist()
    for i in range(m):
        p.A[i][:n] = A[i].tolist()
    for name, values in (("lower", lower), ("upper", upper), ("weight", weight)):
        getattr(p, name)[:n] = values.tolist()
    solve(p)
    return np.array(p.x[:n])


@lru_cache(maxsize=16)
def _bound(m: int, n: int, compiled: bool) -> tuple[type[ctypes.Structure], Callable[..., Any]]:
    problem, inner = structure_of(BoundedProblem, m=m, n=n), structure_of(Rows, m=m, n=n)
    return problem, bind_kernels((solve_bounded,), (inner, problem), compiled=compiled)[0]
