"""The program of a transcription, solved stage by stage: to convergence, or by lexicographic SQP in
real time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from uvms_ocp.codegen.bound_calls import calls_library
from uvms_ocp.codegen.compile import (
    finish_compiling,
    has_compiler,
    start_beside,
    waits_for_compiler,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.ocp.stagewise.level_qp import StageLevelQp
from uvms_ocp.ocp.stagewise.memory import StageIndices, StageMemory, StageRanges, StageVariables
from uvms_ocp.ocp.stagewise.sqp import SqpOutcome, StageSqp
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.level_solver import STAGEWISE, Deadline, NlpOptions, NlpOutcome, NlpPoint
from uvms_ocp.solvers.nlp.program import LexicographicProgram, NlpStatus, RowBounds, RowRanges
from uvms_ocp.solvers.nlp.real_time_sqp import LevelMerit, SqpPoint
from uvms_ocp.solvers.nlp.solve_monitor import SolveMonitor
from uvms_ocp.solvers.stage_qp.compiled import qp_library
from uvms_ocp.solvers.stage_qp.problem import FlatSolution, StageQpOptions, WarmStart
from uvms_ocp.types import Array

_SQP_QP_OPTIONS = StageQpOptions(tolerance=1e-7)

# Rough: steps are searched along, and made again at the next tick.
_REAL_TIME_QP_OPTIONS = StageQpOptions(tolerance=3e-4)
# iterations, after which a QP is given up that may be: those that it takes more have up to 25
_BRIEF = 6
_WEIGHTS = (1e2, 1e4, 1e8)
"""[1/unit of the row^2] Least, first and largest weight of rows of levels above."""


# Levels of a horizon as the lexicographic solver calls them.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StagewisePoint(NlpPoint):
    """With the QP that ended there, whose multipliers are those by the rows and variables of the
    program.
    """

    solution: FlatSolution | None = None


class StagewiseLevels:
    """All levels, on one memory."""

    def __init__(self, memory: StageMemory, options: StageQpOptions = _SQP_QP_OPTIONS) -> None:
        """options: of the QPs."""
        self.memory = memory
        self._point = StageVariables(memory)
        self._options = options
        self._levels: dict[int, StageLevelQp] = {}
        self._raw = np.zeros(memory.whole.row_layout.n_rows + 1)

    def level(self, index: int) -> StageLevelQp:
        """Bound to the memory when it is called for first."""
        if index not in self._levels:
            self._levels[index] = StageLevelQp(self.memory, index, self._options)
        return self._levels[index]

    def rows_at(self, x: Array, p: Array) -> tuple[Array, ...]:
        """Rows of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the
        parameter].
        """
        self.go_to(x, p)
        self.memory.evaluate()
        return self.rows()

    def go_to(self, x: Array, p: Array) -> None:
        """Take variables x (n_x,) [unit of x] and parameters p (n_p,) [unit of the parameter] into
        the memory.
        """
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
        """Return the ranges of a level, where those above it are held as in `bounds`."""
        return StageRanges(self._places, bounds, level, self.level(level).held)

    def multipliers(self, level: int, solution: FlatSolution) -> tuple[Array, Array]:
        """Return multipliers by the last QP of a level: of bounds (n_x,) [1/unit of x] and rows
        (n_rows,) [1/unit of the row] of the program.
        """
        return self._places.program_multipliers(self.level(level).held, solution)

    @cached_property
    def _places(self) -> StageIndices:
        return StageIndices(self.memory)


class StageLevelSolver:
    """One level; call it as `uvms_ocp.solvers.nlp.level_solver.LevelSolver`."""

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
        """True for a start with as many variables and rows as the program has."""
        transcription = self._levels.memory.whole
        rows = point.row_multipliers
        return len(point.x) == transcription.n_x and (
            rows is None or len(rows) == transcription.ranges().n_rows
        )

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
        return self._outcome(
            StageSqp(level, ranges, self._options, self._deadline, self._watch).run(warm), start
        )

    def _outcome(self, end: SqpOutcome, start: NlpPoint) -> NlpOutcome:
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


# The levels of a horizon for steps in real time, stage by stage.


class StagewiseLevelModel:
    """A `uvms_ocp.solvers.nlp.real_time_sqp.LevelModel` on the memory of a horizon, whose points
    are those of all stages.

    QPs start from the last one of their level: the bounds that are reached are mostly the same.
    Frozen rows are kept by a weight, with which the last QP would have missed them by an eighth of
    the tolerance: where limits bind there is often no motion that keeps them as they are, and of
    slabs it would be guessed in vain which sides are reached. Levels below the first whose
    residuals have no forces take the slopes of forces from where the first was linearised.
    """

    slack = 0.0

    def __init__(self, memory: StageMemory, tolerance: float) -> None:
        """Tolerance [unit of the row]: by which the norm of frozen rows may rise."""
        self._levels = StagewiseLevels(memory, _REAL_TIME_QP_OPTIONS)
        self._memory = memory
        self._tolerance = tolerance
        self._kept = [_WEIGHTS[1]] * memory.n_levels
        """Weight [1/unit of the row^2] by which each level keeps those above."""
        self._last: dict[int, WarmStart] = {}
        """Warm start of the next QP of each level."""
        self._ranges: tuple[RowBounds, int, StageRanges] | None = None
        """Bounds and level of the ranges that were asked for last, and these."""
        self._own_ranges: StageRanges | None = None
        """Ranges of the constraints alone."""

    def begin(self, x: Array, p: Array, bounds: RowBounds) -> SqpPoint:
        """Begin as `LevelModel.begin`; x (n_x,) [unit of x], p (n_p,) [unit of the parameter]."""
        self._levels.go_to(x, p)
        self._own_ranges = self._ranges_of(bounds, 0)
        self._memory.evaluate()
        return self._point()

    def step(
        self, level: int, point: SqpPoint, bounds: RowBounds, damping: float
    ) -> NlpStatus | None:
        """Solve the QP of a level as `LevelModel.step`; damping [1/unit of z^2]."""
        memory = self._memory
        level_qp = self._levels.level(level)
        memory.z[:] = point.x.reshape(memory.z.shape)
        memory.z_from[:] = memory.z
        (level_qp.relinearize if level else level_qp.linearize)()
        if not np.isfinite(memory.residuals(level)).all():
            return NlpStatus.NOT_A_NUMBER
        before = self._ranges
        ranges = self._ranges_of(bounds, level)
        warm_start = self._last.get(level)
        # A second step of a level, which mends the first, is welcome, but not at the price of many
        # iterations.
        if level and self._ranges is before:
            level_qp.most = _BRIEF
        else:
            level_qp.most = None
        solution = level_qp.solve(ranges, damping, 0.0, warm_start, kept=self._kept[level])
        if not solution.status.usable:
            return NlpStatus.STALLED
        self._last[level] = solution.warm_start()
        pull = float(np.linalg.norm(level_qp.multipliers_above(solution)))
        self._kept[level] = min(max(8.0 * pull / self._tolerance, _WEIGHTS[0]), _WEIGHTS[2])
        return None

    def _ranges_of(self, bounds: RowBounds, level: int) -> StageRanges:
        """Return the ranges of a level; those of its first step again for the second."""
        if self._ranges is None or self._ranges[0] is not bounds or self._ranges[1] != level:
            self._ranges = bounds, level, self._levels.ranges(bounds, level)
        return self._ranges[2]

    def moved(self, share: float) -> SqpPoint:
        """Return the point after a share of the step, as `LevelModel.moved`."""
        self._memory.share[0] = share
        self._memory.move()
        self._memory.evaluate()
        return self._point()

    def variables(self, point: SqpPoint) -> Array:
        """Return the variables of a point, as `LevelModel.variables`."""
        self._memory.z[:] = point.x.reshape(self._memory.z.shape)
        return self._levels.variables()

    def _point(self) -> SqpPoint:
        memory = self._memory
        rows = self._levels.rows()
        assert self._own_ranges is not None
        pairs = zip(memory.whole.ranges().levels, rows, strict=True)
        residuals = [float(np.linalg.norm(level.distance(y))) for level, y in pairs]
        violation = float(self._own_ranges.excess().max(initial=0.0))
        return SqpPoint(
            x=memory.z.ravel().copy(),
            rows=rows,
            merit=LevelMerit(
                violation=violation if np.isfinite(violation) else np.inf,
                residuals=np.array(residuals),
            ),
        )


# The program of a transcription, solved stage by stage.


class StagewiseProgram:
    """Program that `LexicographicNlp` solves stage by stage; its variables, parameters and rows are
    numbered as in the sparse program.

    Compiled where there is a compiler. Not for use from two threads at once.
    """

    def __init__(self, transcription: Transcription) -> None:
        """Raises `InvalidInput` for what couples all stages: a level above others with `relax`; and
        for a start that is free.
        """
        relaxed = _relaxed(transcription.problem)
        if relaxed:
            raise InvalidInput(
                f"level {relaxed[0]!r} has relax; plugin 'stagewise' takes none: leave it out, or"
                " use 'ipopt'"
            )
        if not transcription.problem.fixed_start:
            raise InvalidInput(
                "start_freedom is given; plugin 'stagewise' starts at the start: leave it out, or"
                " use 'ipopt'"
            )
        if has_compiler():
            start_beside(
                qp_library
            )  # what all programs share, before the functions of this one take all processors
        self._whole = transcription
        self.levels = StagewiseLevels(StageMemory(transcription))
        if transcription.problem.hessian is HessianKind.EXACT:
            self.levels.memory.compile_curvature()
        if has_compiler():
            qp_library(), calls_library()  # before any clock runs
        if waits_for_compiler():
            finish_compiling()

    @property
    def ranges(self) -> RowRanges:
        """Ranges of the rows, for solves that are given none."""
        return self._whole.ranges()

    @property
    def n_x(self) -> int:
        """Variables."""
        return self._whole.n_x

    @property
    def n_p(self) -> int:
        """Parameters."""
        return self._whole.parameter_layout.n

    def solvers(
        self, options: NlpOptions, deadline: Deadline, watch: SolveMonitor
    ) -> Sequence[StageLevelSolver]:
        """One for each level."""
        return [
            StageLevelSolver(self.levels, i, options, deadline, watch)
            for i in range(self.levels.memory.n_levels)
        ]

    def level_model(self, tolerance: float) -> StagewiseLevelModel:
        """Its levels for steps in real time; tolerance as `StagedProgram` has it."""
        return StagewiseLevelModel(self.levels.memory, tolerance)

    def rows_at(self, x: Array, p: Array) -> tuple[Array, ...]:
        """Rows of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the
        parameter].
        """
        return self.levels.rows_at(x, p)

    def violation(self, x: Array, p: Array, bounds: RowBounds) -> float:
        """Return by how much x (n_x,) [unit of x] breaks bounds and constraints; p (n_p,) [unit of
        the parameter].
        """
        self.levels.rows_at(x, p)
        return float(self.levels.ranges(bounds, 0).excess().max(initial=0.0))


def program_for(
    plugin: str, transcription: Transcription
) -> LexicographicProgram | StagewiseProgram:
    """The program of a transcription as a solver of that name takes it. Raises `InvalidInput` as
    `StagewiseProgram` does.
    """
    if plugin == STAGEWISE:
        return StagewiseProgram(transcription)
    return transcription.program


def stagewise_or(other_solver: str, problem: OcpProblem) -> str:
    """Return the name of the solver stage by stage where it takes a problem and there is a
    compiler, else the other.
    """
    coupled = (
        bool(_relaxed(problem))
        or problem.periodic
        or problem.limits_total
        or not problem.fixed_start
    )
    if has_compiler() and not coupled:
        return STAGEWISE
    return other_solver


def _relaxed(problem: OcpProblem) -> list[str]:
    return [level.name for level in problem.levels[:-1] if level.relax is not None]
