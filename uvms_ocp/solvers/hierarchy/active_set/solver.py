"""Strict hierarchy by a dedicated active-set method for lexicographic least squares ([Escande2014], [Dimitrov2015])."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import casadi as ca
from numpy.typing import ArrayLike

from uvms_ocp.arguments import checked, late
from uvms_ocp.functions.compile import compile_function, external_function
from uvms_ocp.solvers.hierarchy.active_set.core_source import core_source
from uvms_ocp.solvers.hierarchy.active_set.warm_tick import ActiveSetFunctions, ActiveSetTick
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.hierarchy.solution import Solution
from uvms_ocp.solvers.hierarchy.stacked import solved, tick_velocity
from uvms_ocp.solvers.hierarchy.tick import (
    Tick,
    TickResult,
    check_levels_function,
    dense,
    dense_inputs,
    dense_outputs,
)


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LexicographicActiveSet:
    """Exact lexicographic least squares, warm-started from the active set of the call before.

    In C where there is a compiler, in NumPy otherwise, with the same results. Where the method gives up it starts anew cold,
    then goes level by level, then with fewer levels, as said in `uvms_ocp.solvers.hierarchy.active_set.fallbacks`; a call
    takes ``120 + 60 M`` iterations at most for M rows of all levels, whatever the numbers.

    What a gate between 0 and 1 does is said in `uvms_ocp.solvers.hierarchy.gated_rows`. In a controller priorities stay strict
    and accelerations within their limits while gates change, and the jerk is bounded (`uvms_ocp.control.velocity.easing`);
    `Icat` keeps none of the three.
    """

    compiled: bool = True
    """False keeps to NumPy."""

    @late
    def solve(self, levels: Sequence[Level]) -> Solution:
        """From a cold start. Raises `InvalidInput` where ``levels`` is empty or of mixed width."""
        return solved(levels, partial(tick_velocity, self._bind_cold))

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> ActiveSetTick:
        """One Function of ``levels_function`` and the solver; outputs beyond the six of ``Level`` are extras."""
        check_levels_function(levels_function, sizes)
        if self.compiled:
            levels_function = compile_function(levels_function)
        function = self.function(levels_function, sizes)
        return ActiveSetTick(
            ActiveSetFunctions(
                tick=function,
                levels=dense(levels_function),
                sizes=tuple(sizes),
            )
        )

    def core(self, n: int, sizes: Sequence[int]) -> ca.Function | None:
        """(J, lower, upper, gate, active set) -> v, active set, report, residual, in machine code; None where that cannot be.

        n [-]: velocities. sizes [-]: rows of each level.
        """
        return _core(n, tuple(sizes)) if self.compiled else None

    def _bind_cold(self, levels_function: ca.Function, sizes: Sequence[int]) -> Tick:
        tick = self.bind(levels_function, sizes)

        def cold(*inputs: ArrayLike) -> TickResult:
            tick.reset()
            return tick(*inputs)

        return cold

    def function(self, levels_function: ca.Function, sizes: Sequence[int]) -> ca.Function | None:
        """(inputs, active_set) -> v, active_set, report, residual, *extras: pure, for ``map`` and export.

        ``report`` is [place of the ``Status`` among all of them, iterations]; v is 0 where the input is invalid.
        None where the solver cannot be compiled.
        """
        core = self.core(levels_function.size2_out(0), sizes)
        if core is None:
            return None
        inputs, names = dense_inputs(levels_function), levels_function.name_in()
        J, lower, upper, _, _, gate, *extras = dense_outputs(levels_function, inputs)
        active = ca.MX.sym("active_set", J.shape[0])
        outputs = [*core(J, lower, upper, gate, active), *extras]
        labels = ["v", "active_set_out", "report", "residual", *(f"extra_{i}" for i in range(len(extras)))]
        return ca.Function("tick", [*inputs, active], outputs, [*names, "active_set"], labels)


@lru_cache(maxsize=64)
def _core(n: int, sizes: tuple[int, ...]) -> ca.Function | None:
    """(J, lower, upper, gate, active set) -> v, active set, report, residual; see casadi.c."""
    if sum(sizes) == 0:
        return None
    return external_function("lexls", core_source(n, sizes))
