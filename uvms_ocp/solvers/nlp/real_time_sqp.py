"""Sequential quadratic programming for control in real time: few steps, each of them complete.

An interior-point solver of NLPs that is stopped early stands somewhere between its start and the constraints. A QP that
is solved to its end obeys the linearised constraints, all of them: from a start near the solution, such as the last one
moved on in time, one step is nearly feasible and nearly optimal (real-time iteration [Diehl2005]).

Within one step levels take their turns. Each is linearised where those above it left the point, so that a level also mends
what curvature did to the constraints, and keeps their rows as they truly are there. The first takes its step whole; those
below are damped and searched along (`proximal.py`, `acceptance.py`), and none of them takes what costs a level above
more than the tolerance. Where a whole step would, because rows above are curved, a second one from its end brings them back
[Fletcher1982], and both are taken if they lead further than the share that is allowed. A level whose QP fails, or for
which no time is left, stays where it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Protocol, runtime_checkable

import numpy as np

from uvms_ocp.arguments import Bound, checked, late
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.nlp.level_turns import LevelModel, LevelTurns, TimeBudget
from uvms_ocp.solvers.nlp.nlp_options import STAGEWISE
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.program import LexicographicProgram, Parameters, RowRanges, Variables
from uvms_ocp.solvers.nlp.row_bounds import row_bounds
from uvms_ocp.solvers.nlp.sparse_levels import SparseLevels
from uvms_ocp.solvers.nlp.sqp_options import SqpOptions


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpResult:
    """The best point of all steps: the first that keeps the constraints, or else the one that breaks them least."""

    x: np.ndarray
    """(n,) [unit of x] finite."""
    status: NlpStatus
    """SOLVED where x keeps the constraints to `SqpOptions.accuracy`; no word on optimality."""
    violation: float
    """[-] Largest, of scaled rows."""
    steps: int
    """Made, the one that failed included."""
    solve_time: float
    """[s] by the clock that was given."""
    reached: tuple[float, ...] = ()
    """(n,) [-] norm of the residual of each level after its own turn in the step that led to x; levels below may have raised
    it by `SqpOptions.tolerance`, and levels that had no turn are missing."""


@runtime_checkable
class StagedProgram(Protocol):
    """A program whose levels are solved stage by stage."""

    @property
    def ranges(self) -> RowRanges: ...
    @property
    def n_x(self) -> int: ...
    @property
    def n_p(self) -> int: ...
    def turning(self, slack: float) -> LevelModel:
        """slack [unit of the row]: half the width of what frozen rows keep."""


def _model(program: LexicographicProgram | StagedProgram, options: SqpOptions) -> LevelModel:
    if isinstance(program, LexicographicProgram):
        if options.plugin == STAGEWISE:
            raise InvalidInput("the program has no stages; transcribe it stage by stage, or give another plugin")
        return SparseLevels(program, options)
    return program.turning(options.tolerance)


@checked
class RealTimeSqp:
    """Steps of one program: its QPs are built once, here.

    Raises `InvalidInput` for a program without derivative functions, and for one that has no stages where the options ask for
    them. The Hessian must not be indefinite: Gauss-Newton.
    """

    def __init__(self, program: LexicographicProgram | StagedProgram, options: SqpOptions | None = None) -> None:
        self.program, self.options = program, options or SqpOptions()
        self._model = _model(program, self.options)
        self._turns = LevelTurns(self._model, self.options, len(program.ranges.levels))

    @late
    def solve(
        self,
        x: Variables,
        *,
        p: Parameters,
        x_lower: Variables | float = -np.inf,
        x_upper: Variables | float = np.inf,
        time_limit: Bound = np.inf,
        clock: Callable[[], float] = perf_counter,
    ) -> SqpResult:
        """From x (n,) [unit of x]: one step, and more while the constraints are broken and `time_limit` [s] allows another.

        p (n_p,) [unit of the parameter]; x_lower and x_upper (n,), or one for all variables [unit of x].
        """
        budget, ranges = TimeBudget(time_limit, clock), self.program.ranges
        bounds = row_bounds(ranges, x_lower, x_upper, len(x))
        best, violation, reached = None, np.inf, tuple[float, ...]()
        status, steps, point = NlpStatus.ITERATION_LIMIT, 0, self._model.begin(x, p, bounds)
        while steps < self.options.max_steps:
            point, failure = self._turns.step(point, ranges.levels, bounds, budget)
            steps += 1
            if failure is not None:
                status = failure
                break
            if point.merit.violation < violation:
                best, violation, reached = point, point.merit.violation, point.reached
            if violation <= self.options.accuracy:
                status = NlpStatus.SOLVED
                break
            if budget.over:
                status = NlpStatus.TIME_LIMIT
                break
        return SqpResult(
            x=x if best is None else self._model.variables(best),
            status=status,
            violation=violation,
            steps=steps,
            solve_time=budget.elapsed,
            reached=reached,
        )
