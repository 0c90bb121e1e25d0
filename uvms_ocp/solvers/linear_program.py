"""Small linear programs with bounded variables as a kernel: a dense simplex by Bland's rule
[Bland1977].
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, structure_of
from uvms_ocp.solvers.bounded_least_squares import dot

_SMALLEST_PIVOT = 1e-9  # for prices and pivots of about 1, and rows relative to their largest entry
_ROUNDS_PER_VARIABLE = 50  # pivots after which a program counts as without an optimum


class LinearProgram(Layout):
    """Memory of `solve_program`: maximise ``c' x`` with ``A x = b`` and ``lower <= x <= upper``,
    for m rows and n_x variables, n_all with those that stand for what is missing in the rows.
    """

    A: Annotated[list[Vector], Sized("m", "n_x")]
    """(m, n_x) [-] coefficients of the rows."""
    b: Annotated[Vector, Sized("m")]
    """(m,) [x] right-hand sides of the rows."""
    c: Annotated[Vector, Sized("n_x")]
    """(n_x,) [c/x] value of a unit of each variable."""
    lower: Annotated[Vector, Sized("n_all")]
    """(n_x,) [x] lower bounds; behind them those of what is missing in each row."""
    upper: Annotated[Vector, Sized("n_all")]
    """(n_x,) [x] upper bounds, infinity for none; behind them those of what is missing in each row."""
    x: Annotated[Vector, Sized("n_all")]
    """(n_x,) [x] values of the variables; behind them what is missing in each row."""
    tableau: Annotated[list[Vector], Sized("m", "n_all")]
    """(m, n_x + m) rows in terms of the variables that are not basic."""
    basis: Annotated[list[int], Sized("m")]
    """(m,) basic variable of each row."""
    basic: Annotated[list[bool], Sized("n_all")]
    """(n_x + m,) true for variables that are in the basis."""
    cost: Annotated[Vector, Sized("n_all")]
    """(n_x + m,) value of a unit of each variable in the phase that is being solved."""


def linear_program(m: int, n: int) -> type[LinearProgram]:
    """Return the type of a `LinearProgram` with m rows and n variables."""
    return structure_of(LinearProgram, m=m, n_x=n, n_all=n + m)


def solve_program(program: LinearProgram) -> bool:
    """Find x by the simplex method; return whether a finite optimum exists."""
    size = 1.0
    missing = 0.0
    n = len(program.c)
    for i in range(len(program.b)):
        _begin_row(program, i)
        size += abs(program.b[i]) + program.x[n + i]
    if not _improve(program):
        return False
    for i in range(len(program.b)):
        missing += program.x[n + i]
    if missing > _SMALLEST_PIVOT * size:
        return False
    _count_what_counts(program)
    return _improve(program)


def _begin_row(program: LinearProgram, i: int) -> None:
    """Start with all variables at their lower bound, and an artificial variable of the row, at a
    cost, as its basis.
    """
    n = len(program.c)
    rest = program.b[i]
    for j in range(n):
        program.x[j] = program.lower[j]
        program.cost[j] = 0.0
        program.basic[j] = False
        rest -= program.A[i][j] * program.x[j]
    for j in range(len(program.x)):
        missing = 1.0 if j == n + i else 0.0
        if j < n:
            program.tableau[i][j] = math.copysign(1.0, rest) * program.A[i][j]
        else:
            program.tableau[i][j] = missing
    program.x[n + i] = abs(rest)
    program.upper[n + i] = math.inf
    program.lower[n + i] = 0.0
    program.cost[n + i] = -1.0
    program.basic[n + i] = True
    program.basis[i] = n + i


def _count_what_counts(program: LinearProgram) -> None:
    """Fix the artificial variables at 0, and take the costs of the program itself."""
    n = len(program.c)
    for i in range(len(program.b)):
        program.x[n + i] = program.upper[n + i] = program.cost[n + i] = 0.0
    program.cost[:n] = program.c[:n]


def value_of(program: LinearProgram) -> float:
    """Return ``c' x`` [c]."""
    return dot(program.c, program.x, len(program.c))


def _improve(program: LinearProgram) -> bool:
    """Move to the vertex of the largest value; return whether there is one."""
    for _ in range(_ROUNDS_PER_VARIABLE * len(program.x)):
        entering = _entering(program)
        if entering < 0:
            return True
        if not _move(
            program, entering, 1.0 if program.x[entering] <= program.lower[entering] else -1.0
        ):
            return False
    return False


def _entering(program: LinearProgram) -> int:
    """Return the first variable at a bound that pays to leave it; -1 for none."""
    for j in range(len(program.x)):
        if not program.basic[j] and program.lower[j] < program.upper[j]:
            if program.x[j] <= program.lower[j]:
                price = _price(program, j)
            else:
                price = -_price(program, j)
            if price > _SMALLEST_PIVOT:
                return j
    return -1


def _price(program: LinearProgram, j: int) -> float:
    price = program.cost[j]
    for i in range(len(program.b)):
        price -= program.cost[program.basis[i]] * program.tableau[i][j]
    return price


def _move(program: LinearProgram, entering: int, up: float) -> bool:
    """Move a variable until another one meets a bound; return whether any does. The first of those
    leaves the basis.
    """
    step = program.upper[entering] - program.lower[entering]
    leaving = -1
    for i in range(len(program.b)):
        rate = -up * program.tableau[i][entering]
        k = program.basis[i]
        if abs(rate) > _SMALLEST_PIVOT:
            room = max(
                (program.upper[k] - program.x[k]) / rate
                if rate > 0.0
                else (program.lower[k] - program.x[k]) / rate,
                0.0,
            )
            first = room == step and leaving >= 0 and k < program.basis[max(leaving, 0)]
            if room < step or first:
                step = room
                leaving = i
    if math.isinf(step):
        return False
    for i in range(len(program.b)):
        program.x[program.basis[i]] -= step * up * program.tableau[i][entering]
    _to_bound(program, entering, up, step, leaving)
    return True


def _to_bound(program: LinearProgram, entering: int, up: float, step: float, leaving: int) -> None:
    if leaving < 0:
        program.x[entering] = program.upper[entering] if up > 0.0 else program.lower[entering]
        return
    k = program.basis[leaving]
    program.x[k] = (
        program.upper[k] if up * program.tableau[leaving][entering] < 0.0 else program.lower[k]
    )
    program.x[entering] += up * step
    program.basic[k] = False
    program.basic[entering] = True
    program.basis[leaving] = entering
    _pivot(program, leaving, entering)


def _pivot(program: LinearProgram, row: int, column: int) -> None:
    pivot = program.tableau[row][column]
    for j in range(len(program.x)):
        program.tableau[row][j] /= pivot
    for i in range(len(program.b)):
        factor = program.tableau[i][column]
        if i != row and factor != 0.0:
            for j in range(len(program.x)):
                program.tableau[i][j] -= factor * program.tableau[row][j]
