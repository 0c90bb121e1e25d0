"""Levels given as numbers: what `solve` of every solver does with them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from time import perf_counter

import casadi as ca

from uvms_ocp.arguments import trusted
from uvms_ocp.arrays import Array
from uvms_ocp.solvers.hierarchy.level import Level, stack
from uvms_ocp.solvers.hierarchy.solution import Solution, Status, row_residuals
from uvms_ocp.solvers.hierarchy.tick import LEVEL_OUTPUTS, Tick

_solution = trusted(Solution)

Bind = Callable[[ca.Function, Sequence[int]], Tick]
# Calls of one shape share one tick and its memory, and plugins share Python's stdout. Re-entrant, since the tick of one solver
# may fall back on another.
_ONE_AT_A_TIME = threading.RLock()


def solved(levels: Sequence[Level], velocity: Callable[[Sequence[Level]], tuple[Array, Status]]) -> Solution:
    """The solution that ``velocity`` finds, as v (n,) and status, with residuals and time."""
    start = perf_counter()
    v, status = velocity(levels)
    return _solution(v=v, status=status, residuals=row_residuals(levels, v), solve_time=perf_counter() - start)


def tick_velocity(bind: Bind, levels: Sequence[Level]) -> tuple[Array, Status]:
    """v (n,) and status, from a tick whose inputs are the stacked levels; it is bound once for all calls of one shape.

    ``bind`` is a method of a solver. Raises `InvalidInput` where ``levels`` is empty or of mixed width.
    """
    rows = stack(levels)
    tick = _stack_tick(bind, rows.jacobian.shape[1], rows.sizes)
    with _ONE_AT_A_TIME:
        result = tick(rows.jacobian, rows.lower, rows.upper, rows.rate, rows.activation, rows.gate)
    return result.v, result.status


@lru_cache(maxsize=128)
def _stack_tick(bind: Bind, n: int, sizes: tuple[int, ...]) -> Tick:
    m = sum(sizes)
    symbols = [ca.MX.sym(name, m, n if name == "J" else 1) for name in LEVEL_OUTPUTS]
    names = list(LEVEL_OUTPUTS)
    return bind(ca.Function("levels", symbols, symbols, [f"{name}_in" for name in names], names), sizes)
