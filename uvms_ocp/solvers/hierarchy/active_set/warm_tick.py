"""A bound active-set solver: one function of the levels and the solver in C, or in NumPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments import trusted
from uvms_ocp.arrays import Array
from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.solvers.hierarchy.active_set.codes import STATUSES
from uvms_ocp.solvers.hierarchy.active_set.fallbacks import solve_levels
from uvms_ocp.solvers.hierarchy.tick import TickResult

_result = trusted(TickResult)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ActiveSetFunctions:
    """What a tick evaluates."""

    tick: ca.Function | None
    """(inputs, active set) -> v, active set, report, residual, *extras; None without C."""
    levels: ca.Function
    """inputs -> J, lower, upper, rate, activation, gate, *extras; dense"""
    sizes: tuple[int, ...]
    """Rows of each level."""


class ActiveSetTick:
    """Warm-started from the active set of the tick before."""

    __slots__ = ("_active_set", "_functions", "_levels", "_tick")

    def __init__(self, functions: ActiveSetFunctions) -> None:
        self._functions = functions
        self._tick = None if functions.tick is None else BufferedFunction(functions.tick)
        self._levels = BufferedFunction(functions.levels)
        self._active_set = np.zeros(sum(functions.sizes))

    def reset(self) -> None:
        """Forget the active set: the next tick starts cold."""
        self._active_set[:] = 0.0

    def adopt(self, *inputs: Array) -> Callable[[], TickResult]:
        """The call with these arrays, (m,) or (m, n) [any], as they are then, without copies. No other call comes after it."""
        if self._tick is None:
            return partial(self, *inputs)
        self._tick.adopt(*inputs, self._active_set)
        return partial(self._evaluated, self._tick)

    @property
    def compiled(self) -> bool:
        """True if the whole tick is one Function with the solver in C."""
        return self._tick is not None

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        """Raises `InvalidInput` for a wrong number or shape of inputs."""
        start = perf_counter()
        if self._tick is None:
            return self._in_numpy(inputs, start)
        return self._told(self._tick(*inputs, self._active_set), start)

    def _evaluated(self, tick: BufferedFunction) -> TickResult:
        """Of inputs that are adopted."""
        start = perf_counter()
        tick.evaluate()
        return self._told([result.copy() for result in tick.results], start)

    def _told(self, results: Sequence[Array], start: float) -> TickResult:
        v, active_set, report, missed, *extras = results
        self._active_set[:] = active_set
        status = STATUSES[int(report[0])]
        return _result(v=v, status=status, residual=missed, extras=tuple(extras), solve_time=perf_counter() - start)

    def _in_numpy(self, inputs: Sequence[ArrayLike], start: float) -> TickResult:
        J, lower, upper, _, _, gate, *extras = self._levels(*inputs)
        J = J.reshape(-1, self._functions.levels.size2_out(0))
        found = solve_levels(J, lower, upper, gate, self._active_set, self._functions.sizes)
        self._active_set[:] = found.active_set
        return _result(
            v=found.v,
            status=found.status,
            residual=found.residual,
            extras=tuple(extras),
            solve_time=perf_counter() - start,
        )
