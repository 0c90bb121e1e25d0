"""Sequential quadratic programming for control in real time: few steps, each of them complete, QPs
by CasADi.

An interior-point solver of NLPs that is stopped early stands somewhere between its start and the
constraints. A QP that is solved to its end obeys the linearised constraints, all of them: from a
start near the solution, such as the last one moved on in time, one step is nearly feasible and
nearly optimal (real-time iteration [Diehl2005]).

Within one step levels take their turns. Each is linearised where those above it left the point, so
that a level also mends what curvature did to the constraints, and keeps their rows as they truly
are there. The first takes its step whole; those below are damped and searched along, and none of
them takes what costs a level above more than the tolerance. Where a whole step would, because rows
above are curved, a second one from its end brings them back [Fletcher1982], and both are taken if
they lead further than the share that is allowed. A level whose QP fails, or for which no time is
left, stays where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Protocol, runtime_checkable

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_constructor, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.nlp import program as nlp
from uvms_ocp.solvers.nlp.lexicographic_nlp import SelfSolving
from uvms_ocp.solvers.nlp.options import SPARSE_PLUGIN, STAGEWISE, SqpOptions
from uvms_ocp.types import Bound

_WEIGHT_RISE = 5.0  # factor on a proximal weight where a step was cut short
_WEIGHT_FALL = 0.5  # factor where the whole step was taken
_LARGEST_WEIGHT = 3e3  # multiple of the smallest weight
_FUNCTIONS = ("nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
_OPTIONS: dict[str, dict[str, object]] = {
    # Starts are near the solution: a small barrier saves two of nine iterations. Frozen rows leave
    # slabs so thin that the QPs of lower levels take up to 30. With its own 1e8 in the place of
    # infinite bounds hpipm ends far from the solution.
    "hpipm": {"inf": 1e6, "hpipm": {"mu0": 1e-2, "iter_max": 60}},
    "proxqp": {"proxqp": {"eps_abs": 1e-7}},
    # With less regularisation factors of long horizons are noise.
    "piqp": {"piqp": {"reg_lower_limit": 1e-7}},
}


SHARES = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16)
"""Tried one after the other."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelMerit:
    """Merit of a point: residuals and violation."""

    violation: float
    """Largest, of scaled rows; infinite where one of them is no number."""
    residuals: np.ndarray
    """(n_levels,) norm of the residual of each level."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Acceptance:
    """Largest violation and residual norms with which the step of a level is accepted."""

    violation: float
    """Most that constraints may be broken."""
    residuals: np.ndarray
    """(n,) largest norms of the levels above, and that of the level itself."""

    def allows(self, candidate: LevelMerit) -> bool:
        """Check a merit against the limits; one that is not a number is never accepted."""
        no_level_worse = candidate.residuals[: len(self.residuals)] <= self.residuals
        return bool(candidate.violation <= self.violation and no_level_worse.all())


def acceptance(
    levels: Sequence[nlp.LevelRows],
    reached: Sequence[float],
    merit: LevelMerit,
    *,
    accuracy: float,
    tolerance: float,
) -> Acceptance:
    """Return the conditions on the step of the level after those that have `reached` their
    residuals, from a point of this `merit`.

    Constraints may be broken by `accuracy`, or as much as they are here; residuals may rise by
    `tolerance`, those of the levels above by no more than that from where their own turn left them,
    however many levels follow. The first level pays whatever a guess lacks that breaks constraints.
    """
    above = [level.kept(norm, tolerance) for level, norm in zip(levels, reached, strict=False)]
    mending = not above and merit.violation > accuracy
    if mending:
        level_limit = np.inf
    else:
        level_limit = merit.residuals[len(reached)] + tolerance
    return Acceptance(
        violation=max(accuracy, merit.violation), residuals=np.array([*above, level_limit])
    )


class ProximalWeights:
    """Proximal weights of the levels of one program; carried from one solve to the next."""

    def __init__(self, n_levels: int, smallest: float) -> None:
        """smallest [1/unit of x^2]: of all levels but the first, which has a weight only after
        steps that were cut.
        """
        self._smallest = smallest
        self._now = np.full(n_levels, smallest)
        self._now[:1] = 0.0

    def __getitem__(self, level: int) -> float:
        """[1/unit of x^2]"""
        return float(self._now[level])

    def adapt(self, level: int, share: float) -> None:
        """Lower the weight of a level whose whole step was taken, raise it where `share` of it is
        less.
        """
        if share < 1.0:
            weight = max(_WEIGHT_RISE * self[level], self._smallest)
        else:
            weight = _WEIGHT_FALL * self[level]
            if weight < self._smallest:
                weight = 0.0 if level == 0 else self._smallest
        self._now[level] = min(weight, _LARGEST_WEIGHT * self._smallest)


class TimeBudget:
    """Time budget that admits another QP, judged by those that were solved."""

    def __init__(self, limit: float, clock: Callable[[], float]) -> None:
        """Limit [s] from now."""
        self._limit = limit
        self._clock = clock
        self._begin = clock()
        self._solved = 0

    def count(self) -> None:
        """Count one more QP that was solved."""
        self._solved += 1

    @property
    def elapsed(self) -> float:
        """[s] so far."""
        return self._clock() - self._begin

    @property
    def over(self) -> bool:
        """Another QP that takes as long as those before would end too late."""
        return self.elapsed * (self._solved + 1) / max(self._solved, 1) > self._limit


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpPoint:
    """Point reached by the levels so far."""

    x: np.ndarray
    """(n,) [unit of x] variables as the model of the levels has them."""
    rows: tuple[np.ndarray, ...]
    """(m,) [unit of the row] values of the rows of every level."""
    merit: LevelMerit
    reached: tuple[float, ...] = ()
    """(n,) norm of the residual of each level that had its turn, at its end."""

    def after_level(self) -> SqpPoint:
        """Return the point with the norm that the next level has reached here."""
        return replace(
            self, reached=(*self.reached, float(self.merit.residuals[len(self.reached)]))
        )


class LevelModel(Protocol):
    """Linear models of the levels of a program, and the solver of their QPs."""

    slack: float
    """Allowed rise of the norm of frozen rows in a QP; 0 where it bears dependent equalities."""

    def begin(self, x: np.ndarray, p: np.ndarray, bounds: nlp.RowBounds) -> SqpPoint:
        """Return the point of variables x (n_x,) [unit of x]; p (n_p,) [unit of the parameter]
        holds from now on.
        """
        ...

    def step(
        self, level: int, point: SqpPoint, bounds: nlp.RowBounds, damping: float
    ) -> nlp.NlpStatus | None:
        """Find the step of a level from a point; return the reason where there is none. damping
        [1/unit of x^2]: weight of the square of the step.
        """
        ...

    def moved(self, share: float) -> SqpPoint:
        """Return the point after a share of the last step."""
        ...

    def variables(self, point: SqpPoint) -> np.ndarray:
        """Return the variables (n_x,) [unit of x] of a point."""
        ...


class LexicographicSqp:
    """Lexicographic SQP on one program; the weights of its levels are carried from step to step."""

    def __init__(self, model: LevelModel, options: SqpOptions, n_levels: int) -> None:
        self._model = model
        self._options = options
        self._weights = ProximalWeights(n_levels, options.proximal)

    def step(
        self,
        guess: SqpPoint,
        levels: tuple[nlp.LevelRows, ...],
        bounds: nlp.RowBounds,
        budget: TimeBudget,
    ) -> tuple[SqpPoint, nlp.NlpStatus | None]:
        """Make one step from a guess; return the point reached, and why there is none."""
        guess = replace(guess, reached=())
        failure = self._model.step(0, guess, bounds, self._options.damping + self._weights[0])
        budget.count()
        if failure is not None:
            return guess, failure
        share, reached = self._first_searched(guess, levels)
        self._weights.adapt(0, share)
        point = reached.after_level()
        for i in range(1, len(levels)):
            if budget.over:
                break
            bounds = bounds.with_rows(*self._frozen(levels[i - 1], point))
            # While it lacks no more than it may lose, a level has no need of a turn.
            if point.merit.residuals[i] > self._options.tolerance:
                point = self._turn(point, levels, bounds)
                budget.count()
            point = point.after_level()
        return point, None

    def _first_searched(
        self, guess: SqpPoint, levels: tuple[nlp.LevelRows, ...]
    ) -> tuple[float, SqpPoint]:
        """Return the largest share of the first level's step that the rule allows, and the point it
        leads to; where there is none, 0 and the point of least violation, because a guess must be
        left.
        """
        rule = self._rule(guess, levels)
        tried = []
        for share in SHARES:
            tried.append(self._model.moved(share))
            if rule.allows(tried[-1].merit):
                return share, tried[-1]
        return 0.0, min(tried, key=lambda point: point.merit.violation)

    def _turn(
        self, point: SqpPoint, levels: tuple[nlp.LevelRows, ...], bounds: nlp.RowBounds
    ) -> SqpPoint:
        """Move the point by the step of the next level."""
        i = len(point.reached)
        failure = self._model.step(i, point, bounds, self._options.damping + self._weights[i])
        if failure is not None:
            share = 0.0
            reached = point
        else:
            share, reached = self._searched(point, levels, bounds)
        self._weights.adapt(i, share)
        return reached

    def _searched(
        self, point: SqpPoint, levels: tuple[nlp.LevelRows, ...], bounds: nlp.RowBounds
    ) -> tuple[float, SqpPoint]:
        """Return the largest share of the step that is accepted, and the point it leads to; where
        that is not all of it, try a second-order correction of the whole step.
        """
        rule = self._rule(point, levels)
        i = len(point.reached)
        tried = [self._model.moved(1.0)]
        while not rule.allows(tried[-1].merit) and len(tried) < len(SHARES):
            tried.append(self._model.moved(SHARES[len(tried)]))
        if rule.allows(tried[-1].merit):
            share = SHARES[len(tried) - 1]
            best = tried[-1]
        else:
            share = 0.0
            best = point
        if share < 1.0:
            mended = self._mended(tried[0], i, bounds)
            if rule.allows(mended.merit) and mended.merit.residuals[i] <= best.merit.residuals[i]:
                share = 1.0
                best = mended
        return share, replace(best, reached=point.reached)

    def _mended(self, full_step: SqpPoint, level: int, bounds: nlp.RowBounds) -> SqpPoint:
        """Apply a second-order correction: one more step, which takes back what curvature did to
        the rows above.
        """
        failure = self._model.step(
            level, full_step, bounds, self._options.damping + self._weights[level]
        )
        if failure is not None:
            return full_step
        return self._model.moved(1.0)

    def _rule(self, point: SqpPoint, levels: tuple[nlp.LevelRows, ...]) -> Acceptance:
        options = self._options
        return acceptance(
            levels,
            point.reached,
            point.merit,
            accuracy=options.accuracy,
            tolerance=options.tolerance,
        )

    def _frozen(
        self, level: nlp.LevelRows, point: SqpPoint
    ) -> tuple[slice, tuple[np.ndarray, np.ndarray]]:
        """Rows that keep the level that had the last turn where that has left it, and their
        bounds.
        """
        i = len(point.reached) - 1
        return level.frozen, level.frozen_bounds(
            point.rows[i], point.reached[i] ** 2 / 2, self._model.slack
        )


class LevelQp:
    """The QP of one level at a point. Raises `InvalidInput` for a level without derivative
    functions.
    """

    def __init__(self, level: nlp.LevelNlp, index: int, options: SqpOptions) -> None:
        missing = [name for name in _FUNCTIONS if name not in level.functions]
        if missing:
            raise InvalidInput(
                f"the program has no derivatives {', '.join(missing)}; transcribe it for IPOPT"
            )
        self._rows = level.rows
        n = level.nlp["x"].numel()
        m = len(level.rows)
        x = ca.MX.sym("x", n)
        p = ca.MX.sym("p", level.nlp["p"].numel())
        damping = ca.MX.sym("damping")
        _, gradient = level.functions["nlp_grad_f"](x, p)
        g, A = level.functions["nlp_jac_g"](x, p)
        H = ca.triu2symm(
            level.functions["nlp_hess_l"](x, p, 1, ca.MX.zeros(m))
        ) + damping * ca.MX.eye(n)
        self._linearize = ca.Function(f"linear_{index}", [x, p, damping], [gradient, H, g, A])
        shape = {"h": H.sparsity(), "a": A.sparsity()}
        plugin = options.plugin or SPARSE_PLUGIN
        self._qp = ca.conic(
            f"qp_{index}", plugin, shape, {"error_on_fail": False, **_OPTIONS[plugin]}
        )

    def step(
        self, x: np.ndarray, p: np.ndarray, bounds: nlp.RowBounds, damping: float
    ) -> tuple[np.ndarray, nlp.NlpStatus | None]:
        """Step (n,) from x (n,) [unit of x], and why there is none.

        p (n_p,) [unit of the parameter]. damping [1/unit of x^2]: weight of the square of the step.
        """
        slope, H, g, A = self._linearize.call([x, p, damping])
        gradient = np.array(slope).ravel()
        rows = np.array(g).ravel()
        if not (np.isfinite(rows).all() and np.isfinite(gradient).all()):
            return np.zeros_like(x), nlp.NlpStatus.NOT_A_NUMBER
        solution = self._qp(
            h=H,
            g=gradient,
            a=A,
            lba=bounds.lower[self._rows] - rows,
            uba=bounds.upper[self._rows] - rows,
            lbx=bounds.x_lower - x,
            ubx=bounds.x_upper - x,
        )
        step = np.array(solution["x"]).ravel()
        if not (self._qp.stats()["success"] and np.isfinite(step).all()):
            return np.zeros_like(x), nlp.NlpStatus.STALLED
        return step, None


class SparseLevels:
    """Linear models of the levels in sparse matrices, solved by a conic plugin of CasADi. Raises
    `InvalidInput` for a program without derivative functions.
    """

    def __init__(self, program: nlp.LexicographicProgram, options: SqpOptions) -> None:
        self._program = program
        self.slack = options.tolerance
        self._qps = [LevelQp(level, i, options) for i, level in enumerate(program.nlps)]
        self._p = np.zeros(program.n_p)
        self._from = np.zeros(program.n_x)
        self._step = np.zeros(program.n_x)
        self._bounds = nlp.row_bounds(program.ranges, -np.inf, np.inf, program.n_x)

    def begin(self, x: np.ndarray, p: np.ndarray, bounds: nlp.RowBounds) -> SqpPoint:
        """Begin as `LevelModel.begin`; x (n_x,) [unit of x], p (n_p,) [unit of the parameter]."""
        self._p = p
        self._bounds = bounds
        self._from = x
        self._step = np.zeros_like(x)
        return self.moved(0.0)

    def step(
        self, level: int, point: SqpPoint, bounds: nlp.RowBounds, damping: float
    ) -> nlp.NlpStatus | None:
        """Solve the QP of a level as `LevelModel.step`; damping [1/unit of x^2]."""
        self._from = point.x
        self._step, failure = self._qps[level].step(point.x, self._p, bounds, damping)
        return failure

    def moved(self, share: float) -> SqpPoint:
        """Return the point after a share of the step, as `LevelModel.moved`."""
        x = self._from + share * self._step
        first = self._program.nlps[0]
        rows = tuple(np.array(y).ravel() for y in self._program.values.call([x, self._p]))
        residuals = [self._residual(i, x, y) for i, y in enumerate(rows)]
        violation = self._bounds.violation(
            x, np.array(first.functions["nlp_g"](x, self._p)).ravel(), first.rows
        )
        merit = LevelMerit(
            violation=violation if np.isfinite(violation) else np.inf, residuals=np.array(residuals)
        )
        return SqpPoint(x=x, rows=rows, merit=merit)

    def _residual(self, i: int, x: np.ndarray, y: np.ndarray) -> float:
        """Return the norm of the rows of level i, or that of its cost where the cost is what is
        kept: there rows may weigh differently.
        """
        level = self._program.ranges.levels[i]
        if level.relax is None:
            return float(np.linalg.norm(level.distance(y)))
        cost, _ = self._program.nlps[i].functions["nlp_grad_f"](x, self._p)
        return float(np.sqrt(2 * float(cost)))

    def variables(self, point: SqpPoint) -> np.ndarray:
        """Return the variables of a point, as `LevelModel.variables`."""
        return point.x


@checked_dataclass(eq=False)
class SqpResult:
    """The best point of all steps: the first that keeps the constraints, or else the one that
    breaks them least.
    """

    x: np.ndarray
    """(n,) [unit of x] finite."""
    status: nlp.NlpStatus
    """SOLVED where x keeps the constraints to `SqpOptions.accuracy`; no word on optimality."""
    violation: float
    """Largest, of scaled rows."""
    steps: int
    """Steps that were made, the one that failed included."""
    solve_time: float
    """[s] Time of the solve, by the clock that was given."""
    reached: tuple[float, ...] = ()
    """(n,) norm of the residual of each level after its own turn in the step that led to x; levels
    below may have raised it by `SqpOptions.tolerance`, and levels that had no turn are missing.
    """


@runtime_checkable
class StagedProgram(SelfSolving, Protocol):
    """A program whose levels are solved stage by stage."""

    def level_model(self, tolerance: float) -> LevelModel:
        """Build the model of the levels; tolerance [unit of the row]: allowed rise of the norm of
        frozen rows.
        """


def _model(program: nlp.LexicographicProgram | StagedProgram, options: SqpOptions) -> LevelModel:
    if isinstance(program, nlp.LexicographicProgram):
        if options.plugin == STAGEWISE:
            raise InvalidInput(
                "the program has no stages; transcribe it stage by stage, or give another plugin"
            )
        return SparseLevels(program, options)
    return program.level_model(options.tolerance)


@checked_constructor
class RealTimeSqp:
    """Steps of one program: its QPs are built once, here.

    Raises `InvalidInput` for a program without derivative functions, and for one that has no stages
    where the options ask for them. The Hessian must not be indefinite: Gauss-Newton.
    """

    def __init__(
        self, program: nlp.LexicographicProgram | StagedProgram, options: SqpOptions | None = None
    ) -> None:
        self.program = program
        self.options = options or SqpOptions()
        self._model = _model(program, self.options)
        self._turns = LexicographicSqp(self._model, self.options, len(program.ranges.levels))

    def solve(
        self,
        x: nlp.Variables,
        *,
        p: nlp.Parameters,
        x_lower: nlp.Variables | float = -np.inf,
        x_upper: nlp.Variables | float = np.inf,
        time_limit: Bound = np.inf,
        clock: Callable[[], float] = perf_counter,
    ) -> SqpResult:
        """Make one step from x (n,) [unit of x], and more while the constraints are broken and
        `time_limit` [s] allows another.

        p (n_p,) [unit of the parameter]; x_lower and x_upper (n,), or one for all variables [unit
        of x].
        """
        budget = TimeBudget(time_limit, clock)
        ranges = self.program.ranges
        bounds = nlp.row_bounds(ranges, x_lower, x_upper, len(x))
        best = None
        violation = np.inf
        reached = tuple[float, ...]()
        status = nlp.NlpStatus.ITERATION_LIMIT
        steps = 0
        point = self._model.begin(x, p, bounds)
        while steps < self.options.max_steps:
            point, failure = self._turns.step(point, ranges.levels, bounds, budget)
            steps += 1
            if failure is not None:
                status = failure
                break
            if point.merit.violation < violation:
                best = point
                violation = point.merit.violation
                reached = point.reached
            if violation <= self.options.accuracy:
                status = nlp.NlpStatus.SOLVED
                break
            if budget.over:
                status = nlp.NlpStatus.TIME_LIMIT
                break
        return SqpResult(
            x=x if best is None else self._model.variables(best),
            status=status,
            violation=violation,
            steps=steps,
            solve_time=budget.elapsed,
            reached=reached,
        )
