"""Multipliers that bend the QP of the next iteration."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.stagewise.stage_memory import StageMemory
from uvms_ocp.solvers.stagewise.solution import Found


class Multipliers:
    """Of one level, where the functions of curvature read them."""

    def __init__(self, memory: StageMemory, level: int) -> None:
        n, levels = len(memory.stages), range(memory.n_levels)
        sizes = [[len(memory.residual_parts(i)[k]) for i in levels] for k in range(n)]
        self.costates = np.zeros((n, memory.tangent.n_x))
        """Of the step that leads away from each stage."""
        groups = [memory.groups(stage) for stage in memory.stages]
        rows = [sum(group.n for group in own[:-1]) for own in groups]
        self._rows = np.zeros(sum(rows))
        self.rows = np.split(self._rows, np.cumsum(rows)[:-1])
        """Of rows that may be held."""
        held = [sum(group.n for group in own[: level + 1]) for own in groups]
        starts = np.cumsum([0, *rows[:-1]])
        self._held = np.concatenate([first + np.arange(count) for first, count in zip(starts, held, strict=True)])
        self.residuals = [np.zeros(sum(own)) for own in sizes]
        """A residual is its own multiplier; those of other levels are 0."""
        self._own = [
            (whole[sum(own[:level]) : sum(own[: level + 1])], part)
            for whole, own, part in zip(self.residuals, sizes, memory.residual_parts(level), strict=True)
        ]

    def take(self, found: Found) -> None:
        """Those of the last QP, and the residuals of now."""
        self.costates[:-1] = found.costate.reshape(self.costates.shape)[1:]
        self._rows[self._held] = found.y[: len(self._held)]
        for own, residual in self._own:
            own[:] = residual
