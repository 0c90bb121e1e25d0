"""Levels of a horizon as the lexicographic solver calls them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.ocp.stagewise.level_stages import LevelStages
from uvms_ocp.ocp.stagewise.stage_memory import StageMemory
from uvms_ocp.ocp.stagewise.stage_point import StagePoint
from uvms_ocp.ocp.stagewise.stage_ranges import Places, StageRanges
from uvms_ocp.ocp.stagewise.stage_sqp import SqpEnd, StageSqp
from uvms_ocp.solvers.nlp.level_solver import Deadline, NlpPoint, Outcome
from uvms_ocp.solvers.nlp.nlp_options import NlpOptions
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.row_bounds import RowBounds
from uvms_ocp.solvers.stagewise import StageQpOptions
from uvms_ocp.solvers.stagewise.solution import Found


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WarmStages(NlpPoint):
    """With the QP that ended there, whose multipliers are those by the rows and variables of the program."""

    solution: Found | None = None


_QP_OPTIONS = StageQpOptions(tolerance=1e-7)


class StageLevels:
    """All levels, on one memory."""

    def __init__(self, memory: StageMemory, options: StageQpOptions = _QP_OPTIONS) -> None:
        """options: of the QPs."""
        self.memory, self._point, self._options = memory, StagePoint(memory), options
        self._levels: dict[int, LevelStages] = {}
        self._raw = np.zeros(memory.whole.row_layout.n_rows + 1)

    def made(self, options: NlpOptions, deadline: Deadline) -> list[StageLevel]:
        """One for each level."""
        return [StageLevel(self, i, options, deadline) for i in range(self.memory.n_levels)]

    def level(self, index: int) -> LevelStages:
        """Bound to the memory when it is called for first."""
        if index not in self._levels:
            self._levels[index] = LevelStages(self.memory, index, self._options)
        return self._levels[index]

    def rows_at(self, x: Array, p: Array) -> tuple[Array, ...]:
        """Rows of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the parameter]."""
        self.go_to(x, p)
        self.memory.evaluate()
        return self.rows()

    def go_to(self, x: Array, p: Array) -> None:
        """Take variables x (n_x,) [unit of x] and parameters p (n_p,) [unit of the parameter] into the memory."""
        self._point.set_parameters(p)
        self._point.read(x, p)

    def variables(self) -> Array:
        """Variables (n_x,) [unit of x] of the points in the memory."""
        return self._point.write()

    def rows(self) -> tuple[Array, ...]:
        """Rows of every level as they were evaluated last."""
        self._raw[self._places.raw] = self.memory.held
        return tuple(self._raw[rows] for rows in self.memory.whole.row_layout.levels)

    def ranges(self, bounds: RowBounds, level: int) -> StageRanges:
        """Of a level [-], where those above it are held as `bounds` has it."""
        return StageRanges(self._places, bounds, level)

    def multipliers(self, level: int, solution: Found) -> tuple[Array, Array]:
        """By the last QP of a level [-]: of bounds (n_x,) [1/unit of x] and rows (n_rows,) [1/unit of the row] of the program."""
        return self._places.program_multipliers(self.level(level).held, solution)

    @cached_property
    def _places(self) -> Places:
        return Places(self.memory)


class StageLevel:
    """One level; call it as `uvms_ocp.solvers.nlp.level_solver.LevelSolver`."""

    def __init__(self, levels: StageLevels, index: int, options: NlpOptions, deadline: Deadline) -> None:
        self._levels, self._index, self._options, self._deadline = levels, index, options, deadline

    def fits(self, point: NlpPoint) -> bool:
        """True for a start with as many variables as the program has."""
        return len(point.x) == self._levels.memory.whole.variables.n_x

    def __call__(self, start: NlpPoint, p: Array, bounds: RowBounds) -> Outcome:
        """Solve from `start`, warm if it has a QP, with parameters p (n_p,) [unit of the parameter]."""
        if self._deadline.over:
            return Outcome(point=start, status=NlpStatus.TIME_LIMIT, iterations=0, violation=np.inf)
        levels = self._levels
        levels.go_to(start.x, p)
        ranges = levels.ranges(bounds, self._index)
        warm = start.solution if isinstance(start, WarmStages) else None
        if warm is not None and not levels.level(self._index).fits(warm):
            warm = None
        return self._outcome(
            StageSqp(levels.level(self._index), ranges, self._options, self._deadline).run(warm), start
        )

    def _outcome(self, end: SqpEnd, start: NlpPoint) -> Outcome:
        x = self._levels.variables()
        if not np.isfinite(x).all():
            return Outcome(point=start, status=NlpStatus.NOT_A_NUMBER, iterations=end.iterations, violation=np.inf)
        return Outcome(
            point=self._point(x, end.solution),
            usable=end.violation <= self._options.feasibility,
            status=end.status,
            iterations=end.iterations,
            violation=end.violation,
            cost=end.cost,
        )

    def _point(self, x: Array, solution: Found | None) -> WarmStages:
        if solution is None:
            return WarmStages(x=x)
        bounds, rows = self._levels.multipliers(self._index, solution)
        return WarmStages(x=x, x_multipliers=bounds, row_multipliers=rows, solution=solution)
