"""Small linear programs with bounded variables as a kernel: a dense simplex by Bland's rule
[Bland1977].
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.solvers.bounded_least_squares import dot

_SMALLEST_PIVOT = 1e-9  # of prices and pivots of about 1, and of rows relative to what is in them
_ROUNDS_PER_VARIABLE = 50  # pivots after which a program counts as without an optimum


class LinearProgram(Layout):
    """Memory of `solve_program`: maximise ``c' x`` with ``A x = b`` and ``lower <= x <= upper``,
    for m rows and n_x variables, n_all with those that stand for what is missing in the rows.
    """

    A: Annotated[list[Vector], Sized("m", "n_x")]
    """(m, n_x) """
    b: Annotated[Vector, Sized("m")]
    """(m,) [x]"""
    c: Annotated[Vector, Sized("n_x")]
    """(n_x,) [c/x]"""
    lower: Annotated[Vector, Sized("n_all")]
    """(n_x,) [x]; behind them those of what is missing in each row."""
    upper: Annotated[Vector, Sized("n_all")]
    """(n_x,) [x] likewise; infinity for none."""
    x: Annotated[Vector, Sized("n_all")]
    """(n_x,) [x] the answer; behind it what is missing in each row."""
    tableau: Annotated[list[Vector], Sized("m", "n_all")]
    basis: Annotated[list[int], Sized("m")]
    """Variable of each row."""
    basic: Annotated[list[bool], Sized("n_all")]
    cost: Annotated[Vector, Sized("n_all")]


def program_sizes(m: int, n: int) -> dict[str, int]:
    """Return the array sizes of a `LinearProgram` with m rows and n variables."""
    return {"m": m, "n_x": n, "n_all": n + m}


def solve_program(p: LinearProgram) -> bool:
    """Find x by the simplex method; return whether a finite optimum exists."""
    size = 1.0
    missing = 0.0
    n = len(p.c)
    for i in range(len(p.b)):
        _begin_row(p, i)
        size += abs(p.b[i]) + p.x[n + i]
    if not _improve(p):
        return False
    for i in range(len(p.b)):
        missing += p.x[n + i]
    if missing > _SMALLEST_PIVOT * size:
        return False
    _count_what_counts(p)
    return _improve(p)


def _begin_row(p: LinearProgram, i: int) -> None:
    """Start with all variables at their lower bound, and an artificial variable of the row, at a
    cost, as its basis.
    """
    n = len(p.c)
    rest = p.b[i]
    for j in range(n):
        p.x[j] = p.lower[j]
        p.cost[j] = 0.0
        p.basic[j] = False
        rest -= p.A[i][j] * p.x[j]
    for j in range(len(p.x)):
        missing = 1.0 if j == n + i else 0.0
        if j < n:
            p.tableau[i][j] = math.copysign(1.0, rest) * p.A[i][j]
        else:
            p.tableau[i][j] = missing
    p.x[n + i] = abs(rest)
    p.upper[n + i] = math.inf
    p.lower[n + i] = 0.0
    p.cost[n + i] = -1.0
    p.basic[n + i] = True
    p.basis[i] = n + i


def _count_what_counts(p: LinearProgram) -> None:
    """Fix the artificial variables at 0, and take the costs of the program itself."""
    n = len(p.c)
    for i in range(len(p.b)):
        p.x[n + i] = p.upper[n + i] = p.cost[n + i] = 0.0
    p.cost[:n] = p.c[:n]


def value_of(p: LinearProgram) -> float:
    """Return ``c' x`` [c]."""
    return dot(p.c, p.x, len(p.c))


def _improve(p: LinearProgram) -> bool:
    """Move to the vertex of the largest value; return whether there is one."""
    for _ in range(_ROUNDS_PER_VARIABLE * len(p.x)):
        entering = _entering(p)
        if entering < 0:
            return True
        if not _move(p, entering, 1.0 if p.x[entering] <= p.lower[entering] else -1.0):
            return False
    return False


def _entering(p: LinearProgram) -> int:
    """The first variable at a bound that pays to leave it; -1 for none."""
    for j in range(len(p.x)):
        if not p.basic[j] and p.lower[j] < p.upper[j]:
            if p.x[j] <= p.lower[j]:
                price = _price(p, j)
            else:
                price = -_price(p, j)
            if price > _SMALLEST_PIVOT:
                return j
    return -1


def _price(p: LinearProgram, j: int) -> float:
    price = p.cost[j]
    for i in range(len(p.b)):
        price -= p.cost[p.basis[i]] * p.tableau[i][j]
    return price


def _move(p: LinearProgram, entering: int, up: float) -> bool:
    """Move a variable until another one meets a bound; return whether any does. The first of those
    leaves the basis.
    """
    step = p.upper[entering] - p.lower[entering]
    leaving = -1
    for i in range(len(p.b)):
        rate = -up * p.tableau[i][entering]
        k = p.basis[i]
        if abs(rate) > _SMALLEST_PIVOT:
            room = max(
                (p.upper[k] - p.x[k]) / rate if rate > 0.0 else (p.lower[k] - p.x[k]) / rate, 0.0
            )
            first = room == step and leaving >= 0 and k < p.basis[max(leaving, 0)]
            if room < step or first:
                step = room
                leaving = i
    if math.isinf(step):
        return False
    for i in range(len(p.b)):
        p.x[p.basis[i]] -= step * up * p.tableau[i][entering]
    _to_bound(p, entering, up, step, leaving)
    return True


def _to_bound(p: LinearProgram, entering: int, up: float, step: float, leaving: int) -> None:
    if leaving < 0:
        p.x[entering] = p.upper[entering] if up > 0.0 else p.lower[entering]
        return
    k = p.basis[leaving]
    p.x[k] = p.upper[k] if up * p.tableau[leaving][entering] < 0.0 else p.lower[k]
    p.x[entering] += up * step
    p.basic[k] = False
    p.basic[entering] = True
    p.basis[leaving] = entering
    _pivot(p, leaving, entering)


def _pivot(p: LinearProgram, row: int, column: int) -> None:
    pivot = p.tableau[row][column]
    for j in range(len(p.x)):
        p.tableau[row][j] /= pivot
    for i in range(len(p.b)):
        factor = p.tableau[i][column]
        if i != row and factor != 0.0:
            for j in range(len(p.x)):
                p.tableau[i][j] -= factor * p.tableau[row][j]
