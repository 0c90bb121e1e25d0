"""Multipliers that bend the QP of the next iteration."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.stagewise.stage_memory import StageMemory
from uvms_ocp.solvers.stagewise import StageQpSolution


class Multipliers:
    """Of one level, where the functions of curvature read them."""

    def __init__(self, memory: StageMemory, level: int) -> None:
        n, levels = len(memory.stages), range(memory.n_levels)
        sizes = [[len(memory.residual_parts(i)[k]) for i in levels] for k in range(n)]
        self.costates = np.zeros((n, memory.tangent.n_x))
        """Of the step that leads away from each stage."""
        self.rows = [np.zeros(sum(group.n for group in memory.groups(stage)[:-1])) for stage in memory.stages]
        """Of rows that may be held."""
        self.residuals = [np.zeros(sum(own)) for own in sizes]
        """A residual is its own multiplier; those of other levels are 0."""
        self._own = [
            (whole[sum(own[:level]) : sum(own[: level + 1])], part)
            for whole, own, part in zip(self.residuals, sizes, memory.residual_parts(level), strict=True)
        ]

    def take(self, solution: StageQpSolution) -> None:
        """Those of the last QP, and the residuals of now."""
        for own, costate in zip(self.costates[:-1], solution.costate[1:], strict=True):
            own[:] = costate
        for own, y in zip(self.rows, solution.y, strict=True):
            own[: len(y)] = y
        for own, residual in self._own:
            own[:] = residual
