"""The levels of a horizon for steps in real time, stage by stage."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.ocp.stagewise.stage_levels import StageLevels
from uvms_ocp.ocp.stagewise.stage_memory import StageMemory
from uvms_ocp.ocp.stagewise.stage_ranges import StageRanges
from uvms_ocp.solvers.nlp.acceptance import Merit
from uvms_ocp.solvers.nlp.level_turns import Point
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.row_bounds import RowBounds
from uvms_ocp.solvers.stagewise import StageQpOptions
from uvms_ocp.solvers.stagewise.solution import Near

# An interior point that ends early keeps off the bounds: curvature then costs levels above less, and whole steps can be taken
# more often than at the exact optimum.
# Many of the slabs that levels above leave are reached: more complementarity to begin with saves a third of the factors.
_QP_OPTIONS = StageQpOptions(tolerance=1e-4, cold_mu=10.0)


class TurningStages:
    """A `uvms_ocp.solvers.nlp.level_turns.LevelModel` on the memory of a horizon, whose points are those of all stages.

    Frozen rows are slabs: where limits bind there is often no motion that keeps them as they are. QPs of the first level start
    from the last one; of so many slabs as those below have it would be guessed in vain which of them bind.
    """

    def __init__(self, memory: StageMemory, slack: float) -> None:
        """slack [unit of the row]: half the width of what frozen rows keep."""
        self._levels, self._memory = StageLevels(memory, _QP_OPTIONS), memory
        self.slack = slack
        self._last: Near | None = None
        """QP of the first level."""
        self._ranges: StageRanges | None = None
        """Of the constraints alone."""

    def begin(self, x: Array, p: Array, bounds: RowBounds) -> Point:
        """As `LevelModel.begin`; x (n_x,) [unit of x], p (n_p,) [unit of the parameter]."""
        self._levels.go_to(x, p)
        self._ranges = self._levels.ranges(bounds, 0)
        self._memory.evaluate()
        return self._point()

    def step(self, level: int, point: Point, bounds: RowBounds, damping: float) -> NlpStatus | None:
        """As `LevelModel.step`; damping [1/unit of z^2]."""
        memory, own = self._memory, self._levels.level(level)
        memory.z[:] = point.x.reshape(memory.z.shape)
        memory.z_from[:] = memory.z
        own.linearize()
        if not np.isfinite(memory.residuals(level)).all():
            return NlpStatus.NOT_A_NUMBER
        own.bend(None)
        solution = own.solve(self._levels.ranges(bounds, level), damping, np.inf, None if level else self._last)
        if not solution.status.usable:
            return NlpStatus.STALLED
        if level == 0:
            self._last = solution.near()
        return None

    def moved(self, share: float) -> Point:
        """As `LevelModel.moved`; share [-]."""
        self._memory.share[0] = share
        self._memory.move()
        self._memory.evaluate()
        return self._point()

    def variables(self, point: Point) -> Array:
        """As `LevelModel.variables`."""
        self._memory.z[:] = point.x.reshape(self._memory.z.shape)
        return self._levels.variables()

    def _point(self) -> Point:
        memory, rows = self._memory, self._levels.rows()
        assert self._ranges is not None
        pairs = zip(memory.whole.ranges().levels, rows, strict=True)
        residuals = [float(np.linalg.norm(level.distance(y))) for level, y in pairs]
        violation = float(self._levels.level(0).broken(self._ranges).max(initial=0.0))
        return Point(
            x=memory.z.ravel().copy(),
            rows=rows,
            merit=Merit(violation=violation if np.isfinite(violation) else np.inf, residuals=np.array(residuals)),
        )
