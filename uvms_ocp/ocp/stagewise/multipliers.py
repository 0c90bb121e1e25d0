"""Multipliers of one level, which bend the QP of the next iteration."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.stagewise.memory import StageMemory
from uvms_ocp.solvers.stage_qp.problem import FlatSolution, leading


class Multipliers:
    """Multipliers of one level, where the functions of curvature read them."""

    def __init__(self, memory: StageMemory, level: int) -> None:
        n = len(memory.stages)
        levels = range(memory.n_levels)
        sizes = [[len(memory.residual_parts(i)[k]) for i in levels] for k in range(n)]
        self.costates = np.zeros((n, memory.tangent.n_x))
        """Costates of the step that leads away from each stage."""
        rows = [sum(own[:-1]) for own in memory.group_sizes]
        self._rows = np.zeros(sum(rows))
        self.rows = np.split(self._rows, np.cumsum(rows)[:-1])
        """Multipliers of rows that may be held."""
        self._held = leading(rows, [sum(own[: level + 1]) for own in memory.group_sizes])
        self.residuals = [np.zeros(sum(own)) for own in sizes]
        """A residual is its own multiplier; those of other levels are 0."""
        self._own = [
            (whole[sum(own[:level]) : sum(own[: level + 1])], part)
            for whole, own, part in zip(
                self.residuals, sizes, memory.residual_parts(level), strict=True
            )
        ]

    def update(self, solution: FlatSolution) -> None:
        """Update: the multipliers of the last QP, and the present residuals."""
        self.costates[:-1] = solution.costate.reshape(self.costates.shape)[1:]
        self._rows[self._held] = solution.y[: len(self._held)]
        for multipliers, residual in self._own:
            multipliers[:] = residual
