"""Levels of a horizon as the lexicographic solver calls them, each solved stage by stage."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from uvms_ocp.ocp.stagewise.level_qp import StageLevelQp
from uvms_ocp.ocp.stagewise.memory import StageMemory
from uvms_ocp.ocp.stagewise.program_variables import StageVariables
from uvms_ocp.ocp.stagewise.ranges import StageIndices, StageRanges
from uvms_ocp.ocp.stagewise.sqp import SqpOutcome, StageSqp
from uvms_ocp.solvers.nlp.level_solver import Deadline, NlpOutcome, NlpPoint
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.solvers.nlp.program import NlpStatus, RowBounds
from uvms_ocp.solvers.nlp.solve_monitor import SolveMonitor
from uvms_ocp.solvers.stage_qp.options import StageQpOptions
from uvms_ocp.solvers.stage_qp.problem import FlatSolution
from uvms_ocp.types import Array

_SQP_QP_OPTIONS = StageQpOptions(tolerance=1e-7)


class StageLevelSolver:
    """Solver of one level; call it as `uvms_ocp.solvers.nlp.level_solver.LevelSolver`."""

    def __init__(
        self,
        levels: StagewiseLevels,
        index: int,
        options: NlpOptions,
        deadline: Deadline,
        watch: SolveMonitor,
    ) -> None:
        self._levels = levels
        self._index = index
        self._options = options
        self._deadline = deadline
        self._watch = watch

    def fits(self, point: NlpPoint) -> bool:
        """Check that a start has as many variables and rows as the program."""
        transcription = self._levels.memory.whole
        if len(point.x) != transcription.n_x:
            return False
        if point.row_multipliers is None:
            return True
        return len(point.row_multipliers) == transcription.ranges().n_rows

    def __call__(self, start: NlpPoint, p: Array, bounds: RowBounds) -> NlpOutcome:
        """Solve from `start`, warm if it has a QP, with parameters p (n_p,) [unit of the
        parameter].
        """
        if self._deadline.over:
            return NlpOutcome(
                point=start, status=NlpStatus.TIME_LIMIT, iterations=0, violation=np.inf
            )
        self._levels.go_to(start.x, p)
        level = self._levels.level(self._index)
        ranges = self._levels.ranges(bounds, self._index)
        warm = start.solution if isinstance(start, StagewisePoint) else None
        if warm is not None and warm.shape != level.shape:
            warm = None
        sqp = StageSqp(level, ranges, self._options, self._deadline, self._watch)
        return self._outcome(sqp.run(warm), start)

    def _outcome(self, end: SqpOutcome, start: NlpPoint) -> NlpOutcome:
        """Return the point in the memory, or the start where that is no number."""
        x = self._levels.variables()
        if not np.isfinite(x).all():
            return NlpOutcome(
                point=start,
                status=NlpStatus.NOT_A_NUMBER,
                iterations=end.iterations,
                violation=np.inf,
            )
        return NlpOutcome(
            point=self._point(x, end.solution),
            usable=end.violation <= self._options.feasibility,
            status=end.status,
            iterations=end.iterations,
            violation=end.violation,
            cost=end.cost,
        )

    def _point(self, x: Array, solution: FlatSolution | None) -> StagewisePoint:
        if solution is None:
            return StagewisePoint(x=x)
        bounds, rows = self._levels.multipliers(self._index, solution)
        return StagewisePoint(x=x, x_multipliers=bounds, row_multipliers=rows, solution=solution)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StagewisePoint(NlpPoint):
    """Point of a program, with the multipliers of its rows and variables at the QP that ended there."""

    solution: FlatSolution | None = None
    """Solution of that QP, from which a solve nearby may start."""


class StagewiseLevels:
    """All levels of a horizon, on one memory."""

    def __init__(self, memory: StageMemory, options: StageQpOptions = _SQP_QP_OPTIONS) -> None:
        """options: options of the solver of QPs."""
        self.memory = memory
        self._variables = StageVariables(memory)
        self._options = options
        self._levels: dict[int, StageLevelQp] = {}
        self._raw = np.zeros(memory.whole.row_layout.n_rows + 1)
        """(n_rows + 1,) raw rows of the program; rows that it does not have are written to the last
        entry.
        """

    def level(self, index: int) -> StageLevelQp:
        """Return the QP of a level, which is bound to the memory when it is asked for first."""
        if index not in self._levels:
            self._levels[index] = StageLevelQp(self.memory, index, self._options)
        return self._levels[index]

    def go_to(self, x: Array, p: Array) -> None:
        """Write variables x (n_x,) [unit of x] and parameters p (n_p,) [unit of the parameter] to the
        memory.
        """
        self._variables.set_parameters(p)
        self._variables.read(x, p)

    def variables(self) -> Array:
        """Return the variables (n_x,) [unit of x] of the points in the memory."""
        return self._variables.write()

    def rows_at(self, x: Array, p: Array) -> tuple[Array, ...]:
        """Return the rows of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of
        the parameter].
        """
        self.go_to(x, p)
        self.memory.evaluate()
        return self.rows()

    def rows(self) -> tuple[Array, ...]:
        """Return the rows of every level as they were evaluated last."""
        self._raw[self._indices.raw] = self.memory.held
        return tuple(self._raw[rows] for rows in self.memory.whole.row_layout.levels)

    def ranges(self, bounds: RowBounds, level: int) -> StageRanges:
        """Return the ranges of a level, with those above it held by `bounds`."""
        return StageRanges(self._indices, bounds, level, self.level(level).held)

    def multipliers(self, level: int, solution: FlatSolution) -> tuple[Array, Array]:
        """Return the multipliers of the program's bounds (n_x,) [1/unit of x] and rows (n_rows,)
        [1/unit of the row] at the solution of the last QP of a level.
        """
        return self._indices.program_multipliers(self.level(level).held, solution)

    @cached_property
    def _indices(self) -> StageIndices:
        return StageIndices(self.memory)
