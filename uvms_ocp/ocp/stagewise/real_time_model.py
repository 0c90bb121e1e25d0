"""Levels of a horizon for steps in real time, each with a QP that is solved stage by stage."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.stagewise.levels import StagewiseLevels
from uvms_ocp.ocp.stagewise.memory import StageMemory
from uvms_ocp.ocp.stagewise.ranges import StageRanges
from uvms_ocp.solvers.nlp.program import NlpStatus, RowBounds
from uvms_ocp.solvers.nlp.real_time_sqp import LevelMerit, SqpPoint
from uvms_ocp.solvers.stage_qp.options import StageQpOptions
from uvms_ocp.solvers.stage_qp.problem import WarmStart
from uvms_ocp.types import Array

# A rough tolerance: a line search follows each step, and the next tick makes another.
_QP_OPTIONS = StageQpOptions(tolerance=3e-4)
# Iterations after which the QP of a second step is given up: the step may be left out, and QPs that
# need more need up to 25.
_FEW_ITERATIONS = 6
# [1/unit of the row^2] weights of rows of levels above
_SMALLEST_WEIGHT = 1e2
_FIRST_WEIGHT = 1e4
_LARGEST_WEIGHT = 1e8


class StagewiseLevelModel:
    """A `uvms_ocp.solvers.nlp.real_time_sqp.LevelModel` on the memory of a horizon; a point holds the
    variables of all stages.

    A QP starts from the solution of the last one of its level, as it mostly reaches the same bounds.

    Rows of levels above are kept by a penalty, not as constraints: those would often have no
    solution where limits bind, and of two narrow bounds a warm start would mostly guess the wrong
    one. The weight is chosen such that the last QP would have violated them by an eighth of the
    tolerance.

    Levels below the first whose residuals have no forces reuse the derivatives of the forces at the
    point where the first was linearised.
    """

    slack = 0.0
    """Allowed rise of the norm of frozen rows in a QP, which are kept by a penalty here."""

    def __init__(self, memory: StageMemory, tolerance: float) -> None:
        """tolerance [unit of the row]: allowed rise of the norm of frozen rows."""
        self._levels = StagewiseLevels(memory, _QP_OPTIONS)
        self._memory = memory
        self._tolerance = tolerance
        self._weight_above = [_FIRST_WEIGHT] * memory.n_levels
        """[1/unit of the row^2] weight of the rows of levels above in the QP of each level."""
        self._warm_starts: dict[int, WarmStart] = {}
        """Warm start of the next QP of each level."""
        self._last_ranges: tuple[RowBounds, int, StageRanges] | None = None
        """Last bounds and level for which ranges were computed, and these ranges."""
        self._constraint_ranges: StageRanges | None = None
        """Ranges of the constraints alone."""

    def begin(self, x: Array, p: Array, bounds: RowBounds) -> SqpPoint:
        """Return the point of variables x (n_x,) [unit of x]; p (n_p,) [unit of the parameter]
        holds from then on.
        """
        self._levels.go_to(x, p)
        self._constraint_ranges = self._ranges(bounds, 0)
        self._memory.evaluate()
        return self._point()

    def step(
        self, level: int, point: SqpPoint, bounds: RowBounds, damping: float
    ) -> NlpStatus | None:
        """Solve the QP of a level for the step from a point; return `None`, or why there is no step.

        damping [1/unit of z^2]: weight of the square of the step.
        """
        memory = self._memory
        level_qp = self._levels.level(level)
        memory.z[:] = point.x.reshape(memory.z.shape)
        memory.z_from[:] = memory.z
        if level == 0:
            level_qp.linearize()
        else:
            level_qp.relinearize()
        if not np.isfinite(memory.residuals(level)).all():
            return NlpStatus.NOT_A_NUMBER
        ranges_before = self._last_ranges
        ranges = self._ranges(bounds, level)
        is_second_step = self._last_ranges is ranges_before
        # A second step of a level corrects the first, which is not worth many iterations.
        if level and is_second_step:
            level_qp.max_iterations = _FEW_ITERATIONS
        else:
            level_qp.max_iterations = None
        solution = level_qp.solve(
            ranges,
            damping,
            0.0,
            self._warm_starts.get(level),
            l2_above=self._weight_above[level],
        )
        if not solution.status.usable:
            return NlpStatus.STALLED
        self._warm_starts[level] = solution.warm_start()
        force_above = float(np.linalg.norm(level_qp.multipliers_above(solution)))
        weight = max(8.0 * force_above / self._tolerance, _SMALLEST_WEIGHT)
        self._weight_above[level] = min(weight, _LARGEST_WEIGHT)
        return None

    def moved(self, share: float) -> SqpPoint:
        """Return the point after the last step, shortened to `share` of its length."""
        self._memory.step_length[0] = share
        self._memory.move()
        self._memory.evaluate()
        return self._point()

    def variables(self, point: SqpPoint) -> Array:
        """Return the variables (n_x,) [unit of x] of a point."""
        self._memory.z[:] = point.x.reshape(self._memory.z.shape)
        return self._levels.variables()

    def _ranges(self, bounds: RowBounds, level: int) -> StageRanges:
        """Return the ranges of a level; a second step gets those of the first again."""
        if self._last_ranges is not None:
            last_bounds, last_level, last_ranges = self._last_ranges
            if last_bounds is bounds and last_level == level:
                return last_ranges
        ranges = self._levels.ranges(bounds, level)
        self._last_ranges = bounds, level, ranges
        return ranges

    def _point(self) -> SqpPoint:
        """Return the point in the memory, as it was evaluated."""
        memory = self._memory
        rows = self._levels.rows()
        residuals = []
        for level, values in zip(memory.whole.ranges().levels, rows, strict=True):
            residuals.append(float(np.linalg.norm(level.distance(values))))
        assert self._constraint_ranges is not None
        violation = float(self._constraint_ranges.excess().max(initial=0.0))
        if not np.isfinite(violation):
            violation = np.inf
        merit = LevelMerit(violation=violation, residuals=np.array(residuals))
        return SqpPoint(x=memory.z.ravel().copy(), rows=rows, merit=merit)
