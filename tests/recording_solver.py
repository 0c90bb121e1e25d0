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
            {"gates": np.zeros(0), "remaining": 0},
        )


def _recorded(
    tick: Tick, ticks: list[RecordedTick], memory: dict, *inputs: np.ndarray
) -> TickResult:
    result = tick(*inputs)
    gates = np.sign(inputs[-1])
    if np.array_equal(gates, memory["gates"]):
        memory["remaining"] -= 1
    else:
        memory["remaining"] = _WINDOW
    memory["gates"] = gates
    if memory["remaining"] > 0:
        copies = tuple(np.array(value, dtype=float) for value in inputs)
        ticks.append(RecordedTick(inputs=copies, v=result.v))
    return result
