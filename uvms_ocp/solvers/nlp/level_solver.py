"""Solve one level of a lexicographic program, an NLP, by IPOPT from cold or warm starts; report
progress and stop on request.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.solvers.nlp.options import IPOPT, NlpOptions, solver_options
from uvms_ocp.solvers.nlp.program import (
    LevelNlp,
    LexicographicProgram,
    NlpStatus,
    RowBounds,
    status_of,
)
from uvms_ocp.solvers.nlp.solve_monitor import BestIterate, IterationReport, SolveMonitor

# Error, in multiples of the tolerance, up to which a level counts as solved to reduced accuracy.
_REDUCED_ACCURACY = 1e3
# Slack of equations, where there are more of them than variables, as a share of the violation that
# usable points may have.
_SLACK_SHARE = 0.1
# Gradients larger than this scale errors down: their last digits are rounding.
_STEEP_GRADIENT = 100.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NlpPoint:
    """Start or end point of an NLP. Without multipliers a start is cold."""

    x: np.ndarray
    """(n_x,) [unit of x] variables."""
    x_multipliers: np.ndarray | None = None
    """(n_x,) [1/unit of x] multipliers of the bounds of x."""
    row_multipliers: np.ndarray | None = None
    """(n_rows,) [1/unit of the row] multipliers in the numbering of the program."""

    @property
    def warm(self) -> bool:
        return self.row_multipliers is not None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NlpOutcome:
    """End point, status and cost of one call of a `LevelSolver`."""

    point: NlpPoint
    """End point, always finite."""
    status: NlpStatus
    """Status that the NLP solver reports."""
    iterations: int
    """Iterations of the NLP solver."""
    violation: float
    """Largest violation of a scaled row."""
    usable: bool = False
    """True if the violation is within `NlpOptions.feasibility`."""
    cost: float = np.inf
    """Cost of the level at the point."""


class Deadline:
    """A time after which no further iteration begins; shared by all NLPs of a solve."""

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self._end = np.inf

    def set(self, seconds: float) -> None:
        """Set the deadline to `seconds` [s] from now."""
        self._end = self._clock() + seconds

    @property
    def over(self) -> bool:
        return self._clock() > self._end


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NlpLinearization:
    """Values and slopes of one NLP at a point."""

    cost: float
    gradient: np.ndarray
    """(n_x,) [1/unit of x] gradient of the cost."""
    rows: np.ndarray
    """(m,) [unit of the row] rows."""
    jacobian: ca.DM
    """(m, n_x) [unit of the row / unit of x] slopes of the rows."""


class OptimalityConditions:
    """First-order optimality conditions of one NLP, computed apart from IPOPT, which scales its own
    by the gradient at the start, and also ends where its steps become too small.
    """

    def __init__(self, nlp: LevelNlp) -> None:
        self._rows = nlp.rows
        functions = nlp.functions
        if "nlp_grad_f" in functions and "nlp_jac_g" in functions:
            self._gradient = functions["nlp_grad_f"]
            self._jacobian = functions["nlp_jac_g"]
            return
        x, p, f, g = (nlp.nlp[name] for name in ("x", "p", "f", "g"))
        self._gradient = ca.Function("gradient", [x, p], [f, ca.gradient(f, x)])
        self._jacobian = ca.Function("jacobian", [x, p], [g, ca.jacobian(g, x)])

    def linearized(self, x: np.ndarray, p: np.ndarray) -> NlpLinearization:
        """Linearize at x (n_x,) [unit of x]; the cost and rows that IPOPT returns are not those of
        its x where it stops early.
        """
        cost, gradient = self._gradient(x, p)
        rows, jacobian = self._jacobian(x, p)
        return NlpLinearization(
            cost=float(cost),
            gradient=np.array(gradient).ravel(),
            rows=np.array(rows).ravel(),
            jacobian=jacobian,
        )

    def error(self, point: NlpPoint, linear: NlpLinearization, bounds: RowBounds) -> float:
        """Return the largest entry [1/unit of x] of the gradient of the Lagrangian, or product of a
        multiplier with the distance from its bound, scaled down where the cost is steeper than
        `_STEEP_GRADIENT`; linear: the NLP at the point.
        """
        assert point.x_multipliers is not None
        assert point.row_multipliers is not None
        y = point.row_multipliers[self._rows]
        rows_gradient = np.array(linear.jacobian.T @ y).ravel()
        slope = linear.gradient + rows_gradient + point.x_multipliers
        lower = bounds.lower[self._rows]
        upper = bounds.upper[self._rows]
        complementarity = max(
            _complementarity(y, linear.rows, lower, upper),
            _complementarity(point.x_multipliers, point.x, bounds.x_lower, bounds.x_upper),
        )
        scale = max(1.0, float(np.abs(linear.gradient).max(initial=0.0)) / _STEEP_GRADIENT)
        return max(float(np.abs(slope).max(initial=0.0)), complementarity) / scale


def _complementarity(
    y: np.ndarray, value: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> float:
    """Return the largest product of a multiplier that is not 0 and the distance from its bound."""
    gap = np.abs(np.where(y > 0.0, upper, lower) - value)
    active = np.flatnonzero(y)
    return float(np.abs(y[active] * gap[active]).max(initial=0.0))


class LevelSolver:
    """Solver of the NLP of one level."""

    def __init__(
        self,
        program: LexicographicProgram,
        index: int,
        options: NlpOptions,
        deadline: Deadline,
        watch: SolveMonitor,
    ) -> None:
        self._watch = watch
        name = program.ranges.levels[index].name
        self._options = options
        self._deadline = deadline
        self._n_rows = program.ranges.n_rows
        self._nlp: LevelNlp = program.nlps[index]
        self._stop = _Stop(self._nlp, name, deadline, watch)
        self._conditions = OptimalityConditions(self._nlp)
        self._cold, self._warm = (
            self._solver(f"level_{index}", warm=warm) for warm in (False, True)
        )

    def fits(self, point: NlpPoint) -> bool:
        """Check for a start with as many variables and rows as this program has."""
        if point.row_multipliers is None:
            n_rows = self._n_rows
        else:
            n_rows = len(point.row_multipliers)
        return len(point.x) == self._nlp.nlp["x"].numel() and n_rows == self._n_rows

    def __call__(self, start: NlpPoint, p: np.ndarray, bounds: RowBounds) -> NlpOutcome:
        """Solve from `start`, warm if it has multipliers, with parameters p (n_p,) [unit of the
        parameter].
        """
        if self._deadline.over:
            return NlpOutcome(
                point=start, status=NlpStatus.TIME_LIMIT, iterations=0, violation=np.inf
            )
        if not self._has_more_equations_than_variables(bounds):
            return self._solved(start, p, bounds, bounds)
        evaluated = self._evaluated(start, p, bounds)
        if evaluated.usable and evaluated.status.optimal:
            return evaluated
        slack = _SLACK_SHARE * self._options.feasibility
        return self._solved(start, p, bounds, bounds.widened(slack))

    def _has_more_equations_than_variables(self, bounds: RowBounds) -> bool:
        """Check for an NLP that IPOPT refuses: some of its equations repeat or contradict others."""
        rows = self._nlp.rows
        n_equations = np.count_nonzero(bounds.lower[rows] == bounds.upper[rows])
        return bool(n_equations > self._nlp.nlp["x"].numel())

    def _evaluated(self, start: NlpPoint, p: np.ndarray, bounds: RowBounds) -> NlpOutcome:
        """Judge the start itself as a solution; where it keeps all rows, with multipliers of the
        equations by least squares.
        """
        rows = self._nlp.rows
        linear = self._conditions.linearized(start.x, p)
        violation = bounds.violation(start.x, linear.rows, rows)
        usable = violation <= self._options.feasibility
        multipliers = np.zeros(self._n_rows)
        equations = np.flatnonzero(bounds.lower[rows] == bounds.upper[rows])
        slopes = linear.jacobian.full()[equations]
        if usable and np.isfinite(linear.gradient).all() and np.isfinite(slopes).all():
            multipliers[rows[equations]] = np.linalg.lstsq(slopes.T, -linear.gradient)[0]
        point = NlpPoint(
            x=start.x, x_multipliers=np.zeros(len(start.x)), row_multipliers=multipliers
        )
        return NlpOutcome(
            point=point,
            usable=usable,
            status=self._judged(NlpStatus.SOLVED, point, linear, bounds),
            iterations=0,
            violation=violation,
            cost=linear.cost,
        )

    def _solved(
        self, start: NlpPoint, p: np.ndarray, bounds: RowBounds, ipopt_bounds: RowBounds
    ) -> NlpOutcome:
        """Solve within `ipopt_bounds`, and measure the violation of the result by `bounds`."""
        rows = self._nlp.rows
        solver = self._warm if start.warm else self._cold
        best = self._stop.best = BestIterate(bounds, rows, self._options.feasibility)
        arguments: dict[str, Any] = {
            "x0": start.x,
            "p": p,
            "lbx": bounds.x_lower,
            "ubx": bounds.x_upper,
        }
        arguments |= {"lbg": ipopt_bounds.lower[rows], "ubg": ipopt_bounds.upper[rows]}
        if start.row_multipliers is not None:
            arguments |= {"lam_x0": start.x_multipliers, "lam_g0": start.row_multipliers[rows]}
        called = solver.call(arguments)
        if self._watch.should_stop and best.x is not None:
            return self._interrupted(best)
        solution = {name: np.array(value).ravel() for name, value in called.items()}
        stats = solver.stats()
        iterations = int(stats.get("iter_count", 0))
        linear = self._conditions.linearized(solution["x"], p)
        if not (np.isfinite(solution["x"]).all() and np.isfinite(linear.rows).all()):
            return NlpOutcome(
                point=start, status=NlpStatus.NOT_A_NUMBER, iterations=iterations, violation=np.inf
            )
        multipliers = np.zeros(self._n_rows)
        multipliers[rows] = np.nan_to_num(solution["lam_g"])
        violation = bounds.violation(solution["x"], linear.rows, rows)
        point = NlpPoint(
            x=solution["x"],
            x_multipliers=np.nan_to_num(solution["lam_x"]),
            row_multipliers=multipliers,
        )
        return NlpOutcome(
            point=point,
            usable=violation <= self._options.feasibility,
            status=self._judged(status_of(stats), point, linear, ipopt_bounds),
            iterations=iterations,
            violation=violation,
            cost=linear.cost,
        )

    def _judged(
        self, reported: NlpStatus, point: NlpPoint, linear: NlpLinearization, bounds: RowBounds
    ) -> NlpStatus:
        """Check a status of an optimum by the optimality conditions at the point."""
        if not reported.optimal:
            return reported
        error = self._conditions.error(point, linear, bounds)
        if reported is NlpStatus.SOLVED and error <= self._options.convergence:
            return reported
        reduced = error <= _REDUCED_ACCURACY * self._options.convergence
        if reduced:
            return NlpStatus.INEXACT
        return NlpStatus.STALLED

    def _interrupted(self, best: BestIterate) -> NlpOutcome:
        """Return the best iterate, without multipliers: those of the solver belong to its last
        iterate.
        """
        assert best.x is not None
        return NlpOutcome(
            point=NlpPoint(x=best.x),
            status=NlpStatus.INTERRUPTED,
            iterations=best.iterations,
            violation=best.violation,
            usable=best.violation <= self._options.feasibility,
            cost=best.cost,
        )

    def _solver(self, name: str, *, warm: bool) -> ca.Function:
        options: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            "cache": dict(self._nlp.functions),
        }
        options |= dict.fromkeys(("calc_lam_p", "calc_lam_x", "calc_f", "calc_g"), False)
        options |= {
            IPOPT: solver_options(self._options, warm=warm),
            "iteration_callback": self._stop,
        }
        return ca.nlpsol(name, IPOPT, dict(self._nlp.nlp), options)


class _Stop(ca.Callback):  # type: ignore[misc]  # CasADi has no types
    """Callback of IPOPT after each iteration; returns 1, which stops it, once the deadline is over or
    the monitor asks to stop.
    """

    def __init__(self, nlp: LevelNlp, name: str, deadline: Deadline, watch: SolveMonitor) -> None:
        ca.Callback.__init__(self)
        self._name = name
        self._deadline = deadline
        self._watch = watch
        self.best: BestIterate | None = None
        """Best iterate of the present call."""
        n, m, n_p = (nlp.nlp[key].numel() for key in ("x", "g", "p"))
        self._sizes: Mapping[str, int] = {
            "x": n,
            "f": 1,
            "g": m,
            "lam_x": n,
            "lam_g": m,
            "lam_p": n_p,
        }
        self.construct("stop", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)])

    def eval(self, arguments: list[ca.DM]) -> list[float]:
        if self.best is not None:
            x = arguments[0].full().ravel()
            f = float(arguments[1])
            g = arguments[2].full().ravel()
            violation = self.best.update(x, f, g)
            residual = math.sqrt(max(2 * f, 0.0))
            iteration = self.best.iterations - 1
            self._watch.report(
                IterationReport(
                    level=self._name, iteration=iteration, residual=residual, violation=violation
                )
            )
        return [float(self._deadline.over or self._watch.should_stop)]
