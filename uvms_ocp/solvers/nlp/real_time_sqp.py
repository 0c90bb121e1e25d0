"""Sequential quadratic programming for control in real time: few steps, each of them complete, QPs by CasADi.

An interior-point solver of NLPs that is stopped early stands somewhere between its start and the constraints. A QP that
is solved to its end obeys the linearised constraints, all of them: from a start near the solution, such as the last one
moved on in time, one step is nearly feasible and nearly optimal (real-time iteration [Diehl2005]).

Within one step levels take their turns. Each is linearised where those above it left the point, so that a level also mends
what curvature did to the constraints, and keeps their rows as they truly are there. The first takes its step whole; those
below are damped and searched along (`lexicographic_sqp.py`), and none of them takes what costs a level above
more than the tolerance. Where a whole step would, because rows above are curved, a second one from its end brings them back
[Fletcher1982], and both are taken if they lead further than the share that is allowed. A level whose QP fails, or for
which no time is left, stays where it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Protocol, runtime_checkable

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.nlp.level_solver import SPARSE_PLUGIN, STAGEWISE, SqpOptions
from uvms_ocp.solvers.nlp.lexicographic_sqp import LevelMerit, LevelModel, LexicographicSqp, SqpPoint, TimeBudget
from uvms_ocp.solvers.nlp.program import (
    LevelNlp,
    LexicographicProgram,
    NlpStatus,
    Parameters,
    RowBounds,
    RowRanges,
    Variables,
    row_bounds,
)
from uvms_ocp.types import Bound

# The QP of one level at a point: least squares of its rows, subject to linearised constraints and rows of the levels above.

_FUNCTIONS = ("nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
_OPTIONS: dict[str, dict[str, object]] = {
    # Starts are near the solution: a small barrier saves two of nine iterations. Frozen rows leave slabs so thin that the
    # QPs of lower levels take up to 30. With its own 1e8 in the place of infinite bounds hpipm ends far from the solution.
    "hpipm": {"inf": 1e6, "hpipm": {"mu0": 1e-2, "iter_max": 60}},
    "proxqp": {"proxqp": {"eps_abs": 1e-7}},
    "piqp": {},
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Linear:
    """Rows, and derivatives of rows and cost, at one point."""

    gradient: np.ndarray
    """(n,) [1/unit of x] of the cost."""
    H: ca.DM
    """(n, n) Gauss-Newton Hessian, damped."""
    g: np.ndarray
    """(m,) [unit of the row] rows."""
    A: ca.DM
    """(m, n) their Jacobian."""

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.g).all() and np.isfinite(self.gradient).all())


class LevelQp:
    """Built once; raises `InvalidInput` for a level without derivative functions."""

    def __init__(self, nlp: LevelNlp, index: int, options: SqpOptions) -> None:
        missing = [name for name in _FUNCTIONS if name not in nlp.functions]
        if missing:
            raise InvalidInput(f"the program has no derivatives {', '.join(missing)}; transcribe it for IPOPT")
        self._rows = nlp.rows
        n, m = nlp.nlp["x"].numel(), len(nlp.rows)
        x, p, damping = ca.MX.sym("x", n), ca.MX.sym("p", nlp.nlp["p"].numel()), ca.MX.sym("damping")
        _, gradient = nlp.functions["nlp_grad_f"](x, p)
        g, A = nlp.functions["nlp_jac_g"](x, p)
        upper = nlp.functions["nlp_hess_l"](x, p, 1, ca.MX.zeros(m))
        H = ca.triu2symm(upper) + damping * ca.MX.eye(n)
        self._linearize = ca.Function(f"linear_{index}", [x, p, damping], [gradient, H, g, A])
        shape, plugin = {"h": H.sparsity(), "a": A.sparsity()}, options.plugin or SPARSE_PLUGIN
        self._qp = ca.conic(f"qp_{index}", plugin, shape, {"error_on_fail": False, **_OPTIONS[plugin]})

    def step(
        self, x: np.ndarray, p: np.ndarray, bounds: RowBounds, damping: float
    ) -> tuple[np.ndarray, NlpStatus | None]:
        """Step (n,) from x (n,) [unit of x], and why there is none.

        p (n_p,) [unit of the parameter]. damping [1/unit of x^2]: weight of the square of the step.
        """
        gradient, H, g, A = self._linearize.call([x, p, damping])
        linear = _Linear(gradient=np.array(gradient).ravel(), H=H, g=np.array(g).ravel(), A=A)
        if not linear.finite:
            return np.zeros_like(x), NlpStatus.NOT_A_NUMBER
        step = self._solved(linear, x, bounds)
        if not (self._qp.stats()["success"] and np.isfinite(step).all()):
            return np.zeros_like(x), NlpStatus.STALLED
        return step, None

    def _solved(self, linear: _Linear, x: np.ndarray, bounds: RowBounds) -> np.ndarray:
        solution = self._qp(
            h=linear.H,
            g=linear.gradient,
            a=linear.A,
            lba=bounds.lower[self._rows] - linear.g,
            uba=bounds.upper[self._rows] - linear.g,
            lbx=bounds.x_lower - x,
            ubx=bounds.x_upper - x,
        )
        return np.array(solution["x"]).ravel()


# The levels of a program in sparse matrices, by the QP solvers of CasADi.


class SparseLevels:
    """A `LevelModel`; its QPs are built once, here. Raises `InvalidInput` for a program without derivative functions."""

    def __init__(self, program: LexicographicProgram, options: SqpOptions) -> None:
        self._program, self.slack = program, options.tolerance
        self._qps = [LevelQp(nlp, i, options) for i, nlp in enumerate(program.nlps)]
        self._p, self._from, self._step = np.zeros(program.n_p), np.zeros(program.n_x), np.zeros(program.n_x)
        self._bounds = row_bounds(program.ranges, -np.inf, np.inf, program.n_x)

    def begin(self, x: np.ndarray, p: np.ndarray, bounds: RowBounds) -> SqpPoint:
        """Begin as `LevelModel.begin`; x (n_x,) [unit of x], p (n_p,) [unit of the parameter]."""
        self._p, self._bounds = p, bounds
        self._from, self._step = x, np.zeros_like(x)
        return self.moved(0.0)

    def step(self, level: int, point: SqpPoint, bounds: RowBounds, damping: float) -> NlpStatus | None:
        """Solve the QP of a level as `LevelModel.step`; damping [1/unit of x^2]."""
        self._from = point.x
        self._step, failure = self._qps[level].step(point.x, self._p, bounds, damping)
        return failure

    def moved(self, share: float) -> SqpPoint:
        """Return the point after a share of the step, as `LevelModel.moved`."""
        x, first = self._from + share * self._step, self._program.nlps[0]
        rows = tuple(np.array(y).ravel() for y in self._program.values.call([x, self._p]))
        residuals = [self._residual(i, x, y) for i, y in enumerate(rows)]
        g = np.array(first.functions["nlp_g"](x, self._p)).ravel()
        violation = self._bounds.violation(x, g, first.rows)
        merit = LevelMerit(violation=violation if np.isfinite(violation) else np.inf, residuals=np.array(residuals))
        return SqpPoint(x=x, rows=rows, merit=merit)

    def _residual(self, i: int, x: np.ndarray, y: np.ndarray) -> float:
        """Norm of the rows of level i, or that of its cost where the cost is what is kept: there rows may weigh differently."""
        level = self._program.ranges.levels[i]
        if level.relax is None:
            return float(np.linalg.norm(level.distance(y)))
        cost, _ = self._program.nlps[i].functions["nlp_grad_f"](x, self._p)
        return float(np.sqrt(2 * float(cost)))

    def variables(self, point: SqpPoint) -> np.ndarray:
        """Return the variables of a point, as `LevelModel.variables`."""
        return point.x


# Sequential quadratic programming for control in real time: few steps, each of them complete.
#
# Within one step levels take their turns. Each is linearised where those above it left the point, so that a level also mends
# what curvature did to the constraints, and keeps their rows as they truly are there. The first takes its step whole; those
# below are damped and searched along (`proximal.py`, `acceptance.py`), and none of them takes what costs a level above
# more than the tolerance. Where a whole step would, because rows above are curved, a second one from its end brings them back
# [Fletcher1982], and both are taken if they lead further than the share that is allowed. A level whose QP fails, or for
# which no time is left, stays where it is.


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpResult:
    """The best point of all steps: the first that keeps the constraints, or else the one that breaks them least."""

    x: np.ndarray
    """(n,) [unit of x] finite."""
    status: NlpStatus
    """SOLVED where x keeps the constraints to `SqpOptions.accuracy`; no word on optimality."""
    violation: float
    """Largest, of scaled rows."""
    steps: int
    """Made, the one that failed included."""
    solve_time: float
    """[s] by the clock that was given."""
    reached: tuple[float, ...] = ()
    """(n,) norm of the residual of each level after its own turn in the step that led to x; levels below may have raised
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
    def level_model(self, slack: float) -> LevelModel:
        """Slack [unit of the row]: half the width of what frozen rows keep."""


def _model(program: LexicographicProgram | StagedProgram, options: SqpOptions) -> LevelModel:
    if isinstance(program, LexicographicProgram):
        if options.plugin == STAGEWISE:
            raise InvalidInput("the program has no stages; transcribe it stage by stage, or give another plugin")
        return SparseLevels(program, options)
    return program.level_model(options.tolerance)


@checked
class RealTimeSqp:
    """Steps of one program: its QPs are built once, here.

    Raises `InvalidInput` for a program without derivative functions, and for one that has no stages where the options ask for
    them. The Hessian must not be indefinite: Gauss-Newton.
    """

    def __init__(self, program: LexicographicProgram | StagedProgram, options: SqpOptions | None = None) -> None:
        self.program, self.options = program, options or SqpOptions()
        self._model = _model(program, self.options)
        self._turns = LexicographicSqp(self._model, self.options, len(program.ranges.levels))

    @checked_on_failure
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
        """Make one step from x (n,) [unit of x], and more while the constraints are broken and `time_limit` [s] allows
        another.

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
