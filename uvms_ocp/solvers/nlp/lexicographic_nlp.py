"""Lexicographic nonlinear optimisation: level by level, what a level has reached is kept by all
levels below.

The scalar constraint "cost no worse than before" has a zero gradient at a least-squares optimum, so
that no constraint qualification holds there. The rows of a solved level are frozen instead, within
a tolerance: this keeps its cost, and the next NLP stays regular. Where rows freeze more than they
need to (other rows with the same cost) the result is still one that no level above is asked to pay
for.

Anticipation: the lowest level is tried first, with every level above required to be met in full. No
level can do better than a cost of zero, so if that NLP is feasible its solution is the answer, for
the price of one solve. Otherwise the levels are solved in order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Protocol, runtime_checkable

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, unchecked_constructor
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.nlp import (
    level_solver,
    options as nlp_options,
    program as nlp,
    solve_monitor,
)
from uvms_ocp.types import Bound, read_only

_ORDER = tuple(nlp.NlpStatus)


@checked_dataclass(eq=False)
class LexicographicResult:
    """Solution of a lexicographic program."""

    x: np.ndarray
    """(n,) [unit of x] always finite; the start where nothing better was found."""
    status: nlp.NlpStatus
    """Status of the worst level."""
    level_status: tuple[nlp.NlpStatus, ...]
    """Status of each level."""
    values: tuple[np.ndarray, ...]
    """(m,) [unit of the row] rows y of every level at x."""
    residuals: tuple[np.ndarray, ...]
    """(m,) [unit of the row] signed distance of the rows of every level to their range."""
    iterations: tuple[int, ...]
    """Per level; with anticipation all of them belong to the last."""
    anticipated: bool
    """True if all levels above the last are met in full."""
    violation: float
    """Largest violation of constraints, bounds and frozen rows at x."""
    points: tuple[level_solver.NlpPoint, ...]
    """End point of each level; a warm start for the next solve."""
    solve_time: float
    """[s] time of all solves."""

    @property
    def level_residuals(self) -> np.ndarray:
        """(levels,) Euclidean norm of each level's residual."""
        return np.array([np.linalg.norm(residual) for residual in self.residuals])


class NlpSolver(Protocol):
    """Protocol of what solves the NLP of one level, such as `LevelSolver`."""

    def fits(self, point: level_solver.NlpPoint) -> bool:
        """True for a start of this program."""

    def __call__(
        self, start: level_solver.NlpPoint, p: np.ndarray, bounds: nlp.RowBounds
    ) -> level_solver.NlpOutcome:
        """Solve from `start`, warm if it has multipliers, with parameters p (n_p,) [unit of the
        parameter].
        """


@runtime_checkable
class SelfSolving(Protocol):
    """A program that brings its own solvers."""

    @property
    def ranges(self) -> nlp.RowRanges:
        """Ranges of the rows, for solves that are given none."""

    @property
    def n_x(self) -> int:
        """Variables."""

    @property
    def n_p(self) -> int:
        """Parameters."""

    def solvers(
        self,
        options: nlp_options.NlpOptions,
        deadline: level_solver.Deadline,
        watch: solve_monitor.SolveMonitor,
    ) -> Sequence[NlpSolver]:
        """Return a solver for each level, which reports every iteration to `watch` and stops where
        it or the deadline says so.
        """

    def rows_at(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return rows y of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of
        the parameter].
        """

    def violation(self, x: np.ndarray, p: np.ndarray, bounds: nlp.RowBounds) -> float:
        """Return by how much x (n_x,) [unit of x] breaks bounds and constraints; p (n_p,) [unit of
        the parameter].
        """


@checked
class LexicographicNlp:
    """Solves one program again and again: every NLP is built once, here.

    Raises `InvalidInput` for plugin ``stagewise`` and a program that is not one of stages.
    """

    def __init__(
        self,
        program: nlp.LexicographicProgram | SelfSolving,
        options: nlp_options.NlpOptions | None = None,
    ) -> None:
        self.program = program
        requested = options or nlp_options.NlpOptions()
        if requested.plugin == nlp_options.AUTO:
            self.options = replace(requested, plugin=nlp_options.IPOPT)
        else:
            self.options = requested
        self.deadline = level_solver.Deadline()
        self.watch = solve_monitor.SolveMonitor()
        self.levels = self._solvers(program)

    def _solvers(self, program: nlp.LexicographicProgram | SelfSolving) -> Sequence[NlpSolver]:
        if isinstance(program, nlp.LexicographicProgram):
            if self.options.plugin == nlp_options.STAGEWISE:
                raise InvalidInput(
                    "plugin 'stagewise' solves problems over a horizon; give 'ipopt'"
                )
            levels = range(len(program.nlps))
            return [
                level_solver.LevelSolver(program, i, self.options, self.deadline, self.watch)
                for i in levels
            ]
        return program.solvers(self.options, self.deadline, self.watch)

    def solve(
        self,
        start: nlp.Variables | LexicographicResult,
        *,
        p: nlp.Parameters | None = None,
        x_lower: nlp.Variables | float = -np.inf,
        x_upper: nlp.Variables | float = np.inf,
        ranges: nlp.RowRanges | None = None,
        time_limit: Bound | None = None,
        progress: solve_monitor.Progress | None = None,
    ) -> LexicographicResult:
        """Solve from a start that is a guess (n,) [unit of x], cold, or an earlier result, warm in
        primal and dual variables.

        p (n_p,) [unit of the parameter]; x_lower and x_upper (n,), or one for all variables [unit
        of x]; ranges: instead of the program's, of the same kinds; time_limit [s]: at most that of
        the options, which is the default. progress: told every iteration. Ctrl-C ends the solve at
        the best point so far. Raises `InvalidInput` for a start or parameters that are not finite,
        and for a result of another program.
        """
        begin = perf_counter()
        points = self._starts(start)
        if p is None:
            parameters = np.zeros(0)
        else:
            parameters = np.asarray(p, dtype=float)
        if not np.isfinite(parameters).all():
            raise InvalidInput("parameters have NaN or infinite entries; give finite numbers")
        if time_limit is None:
            limit = self.options.time_limit
        else:
            limit = min(time_limit, self.options.time_limit)
        row_ranges = ranges or self.program.ranges
        run = _Run(
            self,
            row_ranges.levels,
            points,
            parameters,
            nlp.row_bounds(row_ranges, x_lower, x_upper, len(points[0].x)),
            begin,
        )
        # An anticipation that fails must leave time for the levels in their order.
        self.deadline.set(limit / 2)
        with self.watch.running(progress):
            met = run.anticipated(start, limit)
            self.deadline.set(limit - (perf_counter() - begin))
            return met or run.in_order()

    def _starts(self, start: np.ndarray | LexicographicResult) -> tuple[level_solver.NlpPoint, ...]:
        if isinstance(start, LexicographicResult):
            if not all(
                level.fits(point) for level, point in zip(self.levels, start.points, strict=False)
            ):
                raise InvalidInput(
                    "the earlier result is one of another program; give a guess instead"
                )
            return start.points
        x = np.asarray(start, dtype=float)
        if not np.isfinite(x).all():
            raise InvalidInput("the guess has NaN or infinite entries; give finite numbers")
        return tuple(level_solver.NlpPoint(x=x) for _ in self.levels)

    def rows_at(self, x: nlp.Variables, p: nlp.Parameters) -> tuple[np.ndarray, ...]:
        """Return rows y of every level at x (n,) [unit of x], with parameters p (n_p,) [unit of the
        parameter].
        """
        return self.program.rows_at(x, p)


class _Run:
    """Solve of all levels."""

    def __init__(
        self,
        solver: LexicographicNlp,
        levels: tuple[nlp.LevelRows, ...],
        points: tuple[level_solver.NlpPoint, ...],
        p: np.ndarray,
        bounds: nlp.RowBounds,
        begin: float,
    ) -> None:
        self._nlp = solver
        self._levels = levels
        self._begin = begin
        self._points = points
        self._p = p
        self._bounds = bounds
        self._tolerance = solver.options.tolerance
        self._spent = 0  # iterations of an anticipation that failed

    def anticipated(
        self, start: np.ndarray | LexicographicResult, limit: float
    ) -> LexicographicResult | None:
        """Return the solution in which every level above the last is met in full, if there is one:
        no order of levels gives more than that, so it is taken whether the last level came to its
        optimum or not. It may take all of the limit [s] once these levels are met.
        """
        failed_before = isinstance(start, LexicographicResult) and not start.anticipated
        above = self._levels[:-1]
        unmeetable = any(level.relax is not None for level in above)
        if not self._nlp.options.anticipate or not above or unmeetable or failed_before:
            return None
        bounds = self._bounds
        for level in above:
            bounds = bounds.with_rows(level.frozen, (level.lower, level.upper))
        outcome = self._nlp.levels[-1](self._points[-1], self._p, bounds)
        if outcome.usable and outcome.status is nlp.NlpStatus.TIME_LIMIT:
            outcome = self._continued(outcome, bounds, limit)
        if not outcome.usable:
            self._spent = outcome.iterations
            if self._nlp.watch.should_stop:
                return self._stopped(outcome)
            return None
        statuses = (nlp.NlpStatus.SOLVED,) * len(above)
        points = (outcome.point,) * len(self._levels)
        return self._result(
            outcome,
            (*statuses, outcome.status),
            (*(0,) * len(above), outcome.iterations),
            points,
            True,
        )

    def _continued(
        self, outcome: level_solver.NlpOutcome, bounds: nlp.RowBounds, limit: float
    ) -> level_solver.NlpOutcome:
        """Go on with the last level until the whole limit [s] is over."""
        self._nlp.deadline.set(limit - (perf_counter() - self._begin))
        further = self._nlp.levels[-1](outcome.point, self._p, bounds)
        if not further.usable:
            return outcome
        return replace(further, iterations=outcome.iterations + further.iterations)

    def in_order(self) -> LexicographicResult:
        """Solve level by level. Below a level that fails, all are skipped."""
        bounds = self._bounds
        best = None
        statuses = []
        iterations = []
        points = list(self._points)
        for index, level in enumerate(self._levels):
            outcome = self._nlp.levels[index](self._start(index, best), self._p, bounds)
            stalled = outcome.status.optimal and not outcome.usable
            statuses.append(nlp.NlpStatus.STALLED if stalled else outcome.status)
            iterations.append(outcome.iterations)
            if outcome.usable or best is None:
                best = outcome
                points[index] = outcome.point
            if not outcome.usable or self._nlp.deadline.over or self._nlp.watch.should_stop:
                break
            if index + 1 < len(self._levels):
                y = self._nlp.program.rows_at(best.point.x, self._p)[index]
                bounds = bounds.with_rows(
                    level.frozen, level.frozen_bounds(y, best.cost, self._tolerance)
                )
        n_unsolved = len(self._levels) - len(statuses)
        if self._nlp.deadline.over:
            statuses += [nlp.NlpStatus.TIME_LIMIT] * n_unsolved
        else:
            statuses += [nlp.NlpStatus.SKIPPED] * n_unsolved
        iterations += [0] * n_unsolved
        iterations[0] += self._spent
        assert best is not None  # as there is one level at least
        return self._result(best, tuple(statuses), tuple(iterations), tuple(points), False)

    def _stopped(self, outcome: level_solver.NlpOutcome) -> LexicographicResult:
        """Return the result of a solve stopped by hand before the first level was solved: no level
        is held.
        """
        n_unsolved = len(self._levels) - 1
        statuses = (nlp.NlpStatus.INTERRUPTED, *(nlp.NlpStatus.SKIPPED,) * n_unsolved)
        violation = self._nlp.program.violation(outcome.point.x, self._p, self._bounds)
        iterations = (outcome.iterations, *(0,) * n_unsolved)
        points = (level_solver.NlpPoint(x=outcome.point.x),) * (n_unsolved + 1)
        return self._result(
            replace(outcome, violation=violation), statuses, iterations, points, False
        )

    def _start(self, index: int, best: level_solver.NlpOutcome | None) -> level_solver.NlpPoint:
        """Return a warm start of this level if there is one; otherwise where the level above ended,
        cold.
        """
        if best is None or self._points[index].warm:
            return self._points[index]
        return level_solver.NlpPoint(x=best.point.x)

    def _result(
        self,
        best: level_solver.NlpOutcome,
        statuses: tuple[nlp.NlpStatus, ...],
        iterations: tuple[int, ...],
        points: tuple[level_solver.NlpPoint, ...],
        anticipated: bool,
    ) -> LexicographicResult:
        values = self._nlp.program.rows_at(best.point.x, self._p)
        residuals = list[np.ndarray]()
        for level, y in zip(self._levels, values, strict=True):
            residuals.append(read_only(level.distance(y)))
        return _lexicographic_result(
            x=read_only(best.point.x),
            status=max(statuses, key=_severity),
            level_status=statuses,
            values=tuple(read_only(y) for y in values),
            residuals=tuple(residuals),
            iterations=iterations,
            anticipated=anticipated,
            violation=best.violation,
            points=points,
            solve_time=perf_counter() - self._begin,
        )


_lexicographic_result = unchecked_constructor(LexicographicResult)


def _severity(status: nlp.NlpStatus) -> int:
    """Rank a status by how bad it is; SKIPPED, only ever the consequence of another one, ranks
    1.
    """
    if status is nlp.NlpStatus.SKIPPED:
        return 1
    return _ORDER.index(status)
