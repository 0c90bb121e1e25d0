"""A solver that keeps what it was asked and what it found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import casadi as ca
import numpy as np

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.solvers.hierarchy.solution import Tick, TickResult

_WINDOW = 25  # ticks recorded from the start and from every change of the gates


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecordedTick:
    inputs: tuple[np.ndarray, ...]
    v: np.ndarray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecordingSolver:
    """Keeps the first ticks of every phase of a run."""

    solver: HierarchySolver
    ticks: list[RecordedTick] = field(default_factory=list)

    def bind(
        self, levels_function: ca.Function, sizes: tuple[int, ...]
    ) -> Callable[..., TickResult]:
        return partial(
            _recorded,
            self.solver.bind(levels_function, sizes),
            self.ticks,
            {"gates": np.zeros(0), "left": 0},
        )


def _recorded(tick: Tick, ticks: list[RecordedTick], seen: dict, *inputs: np.ndarray) -> TickResult:
    result = tick(*inputs)
    gates = np.sign(inputs[-1])
    changed = not np.array_equal(gates, seen["gates"])
    seen["gates"], seen["left"] = gates, _WINDOW if changed else seen["left"] - 1
    if seen["left"] > 0:
        ticks.append(
            RecordedTick(inputs=tuple(np.array(value, dtype=float) for value in inputs), v=result.v)
        )
    return result
