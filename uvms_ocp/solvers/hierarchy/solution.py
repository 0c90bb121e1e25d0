"""Results of hierarchy solvers, and the interface of a solver bound to the function of its levels.

`[rate]` is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from time import perf_counter
from typing import Annotated, Protocol, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass, unchecked_constructor
from uvms_ocp.errors import AdvisedStatus, InvalidInput
from uvms_ocp.record.display import FieldTable
from uvms_ocp.solvers.hierarchy.certificate import certificate
from uvms_ocp.solvers.hierarchy.level import Level, residual, stack
from uvms_ocp.types import Array, Shape

LEVEL_OUTPUTS = ("J", "lower", "upper", "rate", "activation", "gate")
# Calls of one shape share one tick and its memory, and plugins share Python's stdout. Re-entrant,
# since the tick of one solver may fall back on another.
_ONE_AT_A_TIME = threading.RLock()


class Status(AdvisedStatus):
    """Outcome of a solve."""

    SOLVED = "solved", "nothing to do"
    COLD_STARTED = (
        "solved from a cold start",
        "nothing to do; the active set of the previous call was of no use",
    )
    CASCADED = (
        "solved level by level",
        "nothing to do, unless it is frequent: then look for nearly dependent rows",
    )
    INEXACT = (
        "inexact",
        (
            "a level was left at the best velocity found for the levels above it; look for nearly"
            " dependent rows or rows of very different scale, or choose another solver"
        ),
    )
    INVALID_INPUT = (
        "invalid input",
        (
            "the levels contain NaN, an entry of a Jacobian of 1e15 and more, or lower > upper, so"
            " v is zero; check the measurements and references of this tick"
        ),
    )
    REGULARISED = (
        "regularised",
        (
            "nothing to do, if a compromise will do: the velocity is smooth and near the optimum of"
            " the levels, never at it; for the optimum choose another solver"
        ),
    )

    @property
    def exact(self) -> bool:
        """True if every level is at its lexicographic optimum: `certificate.normal_certificate` has
        proven it to 1e-7.

        That is of rows as doubles know them: what rounding leaves open of nearly dependent ones is
        in the proof from 1e-3 on (`tolerances.RESOLVED`). Rows below 1e-13 of the largest one of
        all levels count as nothing (`tolerances.VANISHED`): nothing is exact where one of them
        could be nearer to its bounds by more than 1e-12 (`tolerances.UNNOTICED`).
        """
        return self in (Status.SOLVED, Status.COLD_STARTED, Status.CASCADED)

    @property
    def usable(self) -> bool:
        """True if v is the best velocity that was found, always finite; that no level was given up
        for a lower one is proven where it is `exact`, and only there.
        """
        return self is not Status.INVALID_INPUT


@checked_dataclass(eq=False, repr=False)
class Solution(FieldTable):
    """Velocity that solves a hierarchy of levels."""

    v: Annotated[Array, Shape("n")]
    """(n,) [velocity] always finite."""
    status: Status
    """Reliability of v."""
    residuals: tuple[Array, ...]
    """(m,) [rate] per level: signed distance of J v to [lower, upper]; 0 where the gate is 0."""
    solve_time: float
    """[s] time of the solver."""

    @property
    def level_residuals(self) -> Array:
        """(levels,) [rate] Euclidean norm of each level's residual."""
        # Unlike a sum of squares it overflows only where the norm does.
        return np.array([math.hypot(*residual) for residual in self.residuals])

    def certificate(self, levels: Sequence[Level], radius: ArrayLike | None = None) -> float:
        """Bound by how much [rate] any level exceeds its optimum, proven; see
        ``certificate.level_excesses``.

        radius () or (n,) [velocity]: how far the least is looked for, by default in the velocity
        limits of the first level. Raises `InvalidInput` for a radius that is not positive.
        """
        return certificate(levels, self.v, radius)


def row_residuals(levels: Sequence[Level], v: Array) -> tuple[Array, ...]:
    """Return the signed distance of ``J v`` to [lower, upper] at v (n,) [velocity], (m,) [rate] per
    level; 0 where the gate is 0.
    """
    residuals = list[Array]()
    for level in levels:
        distance = residual(level.jacobian, v, level.lower, level.upper, level.gate)
        residuals.append(read_only(distance))
    return tuple(residuals)


def read_only(array: Array) -> Array:
    """Lock an array (...) [any] against writing, and return it."""
    array.flags.writeable = False
    return array


@checked_dataclass(eq=False)
class TickResult:
    """Outcome of one tick; the arrays belong to the caller."""

    v: Annotated[Array, Shape("n")]
    """(n,) [velocity] always finite."""
    status: Status
    """Reliability of v."""
    residual: Annotated[Array, Shape("M")]
    """(M,) [rate] signed distance of J v to [lower, upper], 0 where the gate is 0."""
    extras: tuple[Array, ...]
    """(m,) or (m, n) [any] outputs of the levels' Function after the six of the levels, in its
    order.
    """
    solve_time: float
    """[s], evaluation of the levels included."""


tick_result = unchecked_constructor(TickResult)
"""Constructor without argument checks, of arrays that belong to the result."""


class Tick(Protocol):
    """A solver bound to a Function that computes the levels."""

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        """Inputs in the order of the levels' Function. Raises `InvalidInput` for a wrong number or
        shape.
        """


@runtime_checkable
class InPlaceTick(Tick, Protocol):
    """A `Tick` that can read its inputs in place, without copies."""

    def adopt(self, *inputs: Array) -> Callable[[], TickResult]:
        """Return the call with these arrays, (m,) or (m, n) [any], as they are then, without
        copies. No other call comes after it.
        """


def check_levels_function(levels: ca.Function, sizes: Sequence[int]) -> None:
    """Raise `InvalidInput` unless ``levels`` starts with ``LEVEL_OUTPUTS`` and has the rows of
    ``sizes``.
    """
    outputs = tuple(levels.name_out()[: len(LEVEL_OUTPUTS)])
    if outputs != LEVEL_OUTPUTS:
        raise InvalidInput(
            f"levels function returns {outputs}; its first outputs must be {LEVEL_OUTPUTS}"
        )
    if levels.size1_out(0) != sum(sizes) or any(size < 0 for size in sizes):
        raise InvalidInput(
            f"sizes {tuple(sizes)} sum to {sum(sizes)}; the levels have {levels.size1_out(0)} rows"
        )


def dense_inputs(function: ca.Function) -> list[ca.MX]:
    """Make a dense symbol for every input of ``function``, with its name."""
    return [ca.MX.sym(name, *function.size_in(i)) for i, name in enumerate(function.name_in())]


def dense_outputs(function: ca.Function, symbols: Sequence[ca.MX]) -> list[ca.MX]:
    """Return the outputs of ``function`` at ``symbols``, without structural zeros."""
    return [ca.densify(output) for output in function.call(list(symbols))]


@lru_cache(maxsize=8)
def dense(function: ca.Function) -> ca.Function:
    """Return ``function`` with the same names and dense inputs and outputs."""
    inputs = dense_inputs(function)
    outputs = dense_outputs(function, inputs)
    names_in = function.name_in()
    names_out = function.name_out()
    return ca.Function(function.name(), inputs, outputs, names_in, names_out)


_solution = unchecked_constructor(Solution)

Bind = Callable[[ca.Function, Sequence[int]], Tick]


def timed_solution(
    levels: Sequence[Level], velocity: Callable[[Sequence[Level]], tuple[Array, Status]]
) -> Solution:
    """Return the solution with v (n,) and status of ``velocity``, its residuals, and the time it
    took.
    """
    start = perf_counter()
    v, status = velocity(levels)
    return _solution(
        v=v, status=status, residuals=row_residuals(levels, v), solve_time=perf_counter() - start
    )


def solve_stacked(bind: Bind, levels: Sequence[Level]) -> tuple[Array, Status]:
    """Return v (n,) and status, from a tick whose inputs are the stacked levels; it is bound once
    for all calls of one shape.

    ``bind`` is a method of a solver. Raises `InvalidInput` where ``levels`` is empty or of mixed
    width.
    """
    rows = stack(levels)
    tick = _stack_tick(bind, rows.jacobian.shape[1], rows.sizes)
    with _ONE_AT_A_TIME:
        result = tick(rows.jacobian, rows.lower, rows.upper, rows.rate, rows.activation, rows.gate)
    return result.v, result.status


@lru_cache(maxsize=128)
def _stack_tick(bind: Bind, n: int, sizes: tuple[int, ...]) -> Tick:
    symbols = list[ca.MX]()
    for name in LEVEL_OUTPUTS:
        n_columns = n if name == "J" else 1
        symbols.append(ca.MX.sym(name, sum(sizes), n_columns))
    names_in = [f"{name}_in" for name in LEVEL_OUTPUTS]
    levels = ca.Function("levels", symbols, symbols, names_in, list(LEVEL_OUTPUTS))
    return bind(levels, sizes)
