"""Small linear programs with bounded variables as a kernel: a dense simplex by Bland's rule [Bland1977].

`[x]` is the unit of the variables and of the rows, `[c]` that of the costs. Inputs are trusted: finite but for upper bounds.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.solvers.bounded_least_squares import dot

_TOLERANCE = 1e-9  # of prices and pivots of about 1, and of rows relative to what is in them
_ROUNDS = 50  # for every variable


class LinearProgram(Layout):
    """The largest ``c' x`` with ``A x = b`` and ``lower <= x <= upper``: m rows and n_x variables, n_all together."""

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
    """Find x; whether there is any, and its value has an end."""
    size, missing, n = 1.0, 0.0, len(p.c)
    for i in range(len(p.b)):
        _begin_row(p, i)
        size += abs(p.b[i]) + p.x[n + i]
    if not _improve(p):
        return False
    for i in range(len(p.b)):
        missing += p.x[n + i]
    if missing > _TOLERANCE * size:
        return False
    _count_what_counts(p)
    return _improve(p)


def _begin_row(p: LinearProgram, i: int) -> None:
    """All variables at their lower bound, and what is missing in a row the only one to rest on, at its cost."""
    n, rest = len(p.c), p.b[i]
    for j in range(n):
        p.x[j], p.cost[j], p.basic[j] = p.lower[j], 0.0, False
        rest -= p.A[i][j] * p.x[j]
    for j in range(len(p.x)):
        missing = 1.0 if j == n + i else 0.0
        p.tableau[i][j] = math.copysign(1.0, rest) * p.A[i][j] if j < n else missing
    p.x[n + i], p.upper[n + i], p.lower[n + i] = abs(rest), math.inf, 0.0
    p.cost[n + i], p.basic[n + i], p.basis[i] = -1.0, True, n + i


def _count_what_counts(p: LinearProgram) -> None:
    """With nothing missing any more, and what counts."""
    n = len(p.c)
    for i in range(len(p.b)):
        p.x[n + i] = p.upper[n + i] = p.cost[n + i] = 0.0
    for j in range(n):
        p.cost[j] = p.c[j]


def value_of(p: LinearProgram) -> float:
    """[c] of x."""
    return dot(p.c, p.x, len(p.c))


def _improve(p: LinearProgram) -> bool:
    """To the vertex of the largest cost; whether there is one."""
    for _ in range(_ROUNDS * len(p.x)):
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
            price = _price(p, j) if p.x[j] <= p.lower[j] else -_price(p, j)
            if price > _TOLERANCE:
                return j
    return -1


def _price(p: LinearProgram, j: int) -> float:
    price = p.cost[j]
    for i in range(len(p.b)):
        price -= p.cost[p.basis[i]] * p.tableau[i][j]
    return price


def _move(p: LinearProgram, entering: int, up: float) -> bool:
    """A variable as far as the others let it; whether anything stops it. Of those that do, the first leaves the basis."""
    step, leaving = p.upper[entering] - p.lower[entering], -1
    for i in range(len(p.b)):
        rate = -up * p.tableau[i][entering]
        k = p.basis[i]
        if abs(rate) > _TOLERANCE:
            room = max((p.upper[k] - p.x[k]) / rate if rate > 0.0 else (p.lower[k] - p.x[k]) / rate, 0.0)
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
    p.basic[k], p.basic[entering], p.basis[leaving] = False, True, entering
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
