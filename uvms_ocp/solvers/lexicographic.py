"""Lexicographic nonlinear optimisation: level by level, what a level has reached is kept by all levels below.

The scalar constraint "cost no worse than before" has a zero gradient at a least-squares optimum, so that no constraint
qualification holds there. The rows of a solved level are frozen instead, within a tolerance: this keeps its cost, and
the next NLP stays regular. Where rows freeze more than they need to (other rows with the same cost) the result is still
one that no level above is asked to pay for.

Anticipation: the lowest level is tried first, with every level above required to be met in full. No level can do better
than a cost of zero, so if that NLP is feasible its solution is the answer, for the price of one solve. Otherwise the
levels are solved in order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.solvers.nlp_program import LevelRows, LexicographicProgram
from uvms_ocp.solvers.nlp_status import NlpStatus, status_of

PLUGINS = ("ipopt", "fatrop")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NlpOptions:
    """How the NLPs are solved. plugin: ``ipopt`` or ``fatrop``. Options of the plugin itself go to `plugin_options`."""

    plugin: str = "ipopt"
    tolerance: float = 1e-6
    """By which the rows of a solved level may move. With 0, and always with fatrop, rows of equalities are frozen as
    equality constraints: not for levels whose rows contradict each other, where no constraint qualification holds."""
    convergence: float = 1e-8
    max_iterations: int = 150
    time_limit: float = 20.0
    """[s] for every NLP, and between levels for all together; fatrop knows the latter only."""
    anticipate: bool = True
    barrier: float = 1e-2
    """Barrier parameter at a cold start."""
    plugin_options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def feasibility(self) -> float:
        """Largest violation of scaled rows with which a point counts as usable."""
        return max(1e-5, self.convergence)

    @property
    def freezing(self) -> float:
        """`tolerance`, 0 where rows are frozen as equalities."""
        return 0.0 if self.plugin == "fatrop" else self.tolerance

    def __post_init__(self) -> None:
        if self.plugin not in PLUGINS:
            raise NameNotFound("NLP solver", self.plugin, PLUGINS)
        for name in ("convergence", "max_iterations", "time_limit", "barrier"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} = {value}; give a finite value > 0")
        if not (np.isfinite(self.tolerance) and self.tolerance >= 0):
            raise InvalidInput(f"tolerance = {self.tolerance}; give a finite value >= 0")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NlpPoint:
    """Where an NLP starts or ended. Without multipliers a start is cold."""

    x: np.ndarray
    x_multipliers: np.ndarray | None = None
    row_multipliers: np.ndarray | None = None  # (n_rows,), in the numbering of the program

    @property
    def warm(self) -> bool:
        return self.row_multipliers is not None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LexicographicResult:
    """Solution of a lexicographic program."""

    x: np.ndarray
    """(n,) always finite; the start where nothing better was found."""
    status: NlpStatus
    """Of the worst level."""
    level_status: tuple[NlpStatus, ...]
    values: tuple[np.ndarray, ...]
    """Rows y of every level at x."""
    residuals: tuple[np.ndarray, ...]
    """Signed distance of the rows to their range."""
    iterations: tuple[int, ...]
    """Per level; with anticipation all of them belong to the last."""
    anticipated: bool
    """True if all levels above the last are met in full."""
    violation: float
    """Largest violation of constraints, bounds and frozen rows at x."""
    points: tuple[NlpPoint, ...]
    """Where each level ended; a warm start for the next solve."""
    solve_time: float
    """[s]"""

    @property
    def level_residuals(self) -> np.ndarray:
        """(levels,) Euclidean norm of each level's residual."""
        return np.array([np.linalg.norm(residual) for residual in self.residuals])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Outcome:
    point: NlpPoint
    status: NlpStatus
    iterations: int
    violation: float
    usable: bool = False
    cost: float = np.inf


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Bounds:
    """Of the variables and of all rows of the program; rows of levels that are not frozen yet are infinite."""

    x_lower: np.ndarray
    x_upper: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def with_rows(self, rows: slice, bounds: tuple[np.ndarray, np.ndarray]) -> _Bounds:
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[rows], upper[rows] = bounds
        return _Bounds(x_lower=self.x_lower, x_upper=self.x_upper, lower=lower, upper=upper)


class LexicographicNlp:
    """Solves one program again and again: every NLP is built once, here."""

    def __init__(self, program: LexicographicProgram, options: NlpOptions | None = None) -> None:
        self.program = program
        self.options = options or NlpOptions()
        self._cold = [self._solver(i, warm=False) for i in range(len(program.nlps))]
        self._warm = [self._solver(i, warm=True) for i in range(len(program.nlps))]

    def solve(
        self,
        start: np.ndarray | LexicographicResult,
        *,
        p: np.ndarray | None = None,
        x_lower: np.ndarray | float = -np.inf,
        x_upper: np.ndarray | float = np.inf,
    ) -> LexicographicResult:
        """Solve from a guess (n,), cold, or from an earlier result, warm in primal and dual variables.

        Raises `InvalidInput` for a start or parameters that are not finite.
        """
        begin = perf_counter()
        points = self._starts(start)
        parameters = np.zeros(0) if p is None else np.asarray(p, dtype=float)
        if not np.isfinite(parameters).all():
            raise InvalidInput("parameters have NaN or infinite entries; give finite numbers")
        bounds = self._bounds(x_lower, x_upper, len(points[0].x))
        run = _Run(self, points, parameters, bounds, begin)
        return run.anticipated(start) or run.in_order()

    def _starts(self, start: np.ndarray | LexicographicResult) -> tuple[NlpPoint, ...]:
        if isinstance(start, LexicographicResult):
            return start.points
        x = np.asarray(start, dtype=float)
        if not np.isfinite(x).all():
            raise InvalidInput("the guess has NaN or infinite entries; give finite numbers")
        return tuple(NlpPoint(x=x) for _ in self.program.levels)

    def _bounds(self, x_lower: np.ndarray | float, x_upper: np.ndarray | float, n: int) -> _Bounds:
        lower, upper = np.full(self.program.n_rows, -np.inf), np.full(self.program.n_rows, np.inf)
        m = len(self.program.lower)
        lower[:m], upper[:m] = self.program.lower, self.program.upper
        return _Bounds(
            x_lower=np.broadcast_to(np.asarray(x_lower, dtype=float), (n,)),
            x_upper=np.broadcast_to(np.asarray(x_upper, dtype=float), (n,)),
            lower=lower,
            upper=upper,
        )

    def call(self, index: int, start: NlpPoint, p: np.ndarray, bounds: _Bounds) -> _Outcome:
        """Solve the NLP of one level."""
        rows = self.program.nlps[index].rows
        solver = (self._warm if start.warm else self._cold)[index]
        arguments: dict[str, Any] = {"x0": start.x, "p": p, "lbx": bounds.x_lower, "ubx": bounds.x_upper}
        arguments |= {"lbg": bounds.lower[rows], "ubg": bounds.upper[rows]}
        if start.row_multipliers is not None:
            arguments |= {"lam_x0": start.x_multipliers, "lam_g0": start.row_multipliers[rows]}
        solution = {name: np.array(value).ravel() for name, value in solver.call(arguments).items()}
        stats = solver.stats()
        if not all(np.isfinite(solution[name]).all() for name in ("x", "g")):
            return _Outcome(point=start, status=NlpStatus.NOT_A_NUMBER, iterations=_iterations(stats), violation=np.inf)
        multipliers = np.zeros(self.program.n_rows)
        multipliers[rows] = np.nan_to_num(solution["lam_g"])
        point = NlpPoint(x=solution["x"], x_multipliers=np.nan_to_num(solution["lam_x"]), row_multipliers=multipliers)
        violation = max(
            _violation(solution["g"], bounds.lower[rows], bounds.upper[rows]),
            _violation(point.x, bounds.x_lower, bounds.x_upper),
        )
        return _Outcome(
            point=point,
            usable=violation <= self.options.feasibility,
            status=status_of(stats),
            iterations=_iterations(stats),
            violation=violation,
            cost=float(solution["f"][0]),
        )

    def rows_at(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Rows y of every level at x."""
        return tuple(np.array(y).ravel() for y in self.program.values.call([x, p]))

    def _solver(self, index: int, *, warm: bool) -> ca.Function:
        level = self.program.nlps[index]
        options: dict[str, Any] = {"print_time": False, "error_on_fail": False, "cache": dict(level.functions)}
        options |= dict.fromkeys(("calc_lam_p", "calc_lam_x", "calc_f", "calc_g"), False)
        if self.options.plugin == "ipopt":
            options["ipopt"] = self._ipopt(warm=warm)
        else:
            equal = self._equalities()[level.rows].tolist()
            options |= {"structure_detection": "auto", "equality": equal, "fatrop": self._fatrop(warm=warm)}
        return ca.nlpsol(f"level_{index}", self.options.plugin, dict(level.nlp), options)

    def _equalities(self) -> np.ndarray:
        """(n_rows,) True for constraints that are equalities, and for rows that are frozen as such."""
        equal = np.zeros(self.program.n_rows, dtype=bool)
        equal[: len(self.program.lower)] = self.program.lower == self.program.upper
        for level in self.program.levels:
            if level.relax is None and self.options.freezing == 0:
                equal[level.frozen] = level.lower == level.upper
        return equal

    def _ipopt(self, *, warm: bool) -> dict[str, Any]:
        chosen: dict[str, Any] = {
            "print_level": 0,
            "sb": "yes",
            "tol": self.options.convergence,
            "max_iter": self.options.max_iterations,
            "max_wall_time": self.options.time_limit,
            "mu_init": self.options.barrier,
            "bound_relax_factor": min(1e-8, 0.1 * (self.options.tolerance or 1e-7)),
        }
        return chosen | (_IPOPT_WARM if warm else {}) | dict(self.options.plugin_options)

    def _fatrop(self, *, warm: bool) -> dict[str, Any]:
        chosen: dict[str, Any] = {
            "print_level": 0,
            "tol": self.options.convergence,
            "max_iter": self.options.max_iterations,
            "mu_init": self.options.barrier,
        }
        return chosen | (_FATROP_WARM if warm else {}) | dict(self.options.plugin_options)


_IPOPT_WARM = {
    "warm_start_init_point": "yes",
    "mu_init": 1e-6,
    "warm_start_bound_push": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
    "warm_start_slack_bound_push": 1e-9,
    "warm_start_bound_frac": 1e-9,
    "warm_start_slack_bound_frac": 1e-9,
}
_FATROP_WARM = {"mu_init": 1e-6}


class _Run:
    """One solve of all levels."""

    def __init__(
        self, nlp: LexicographicNlp, points: tuple[NlpPoint, ...], p: np.ndarray, bounds: _Bounds, begin: float
    ) -> None:
        self._nlp, self._points, self._p, self._bounds, self._begin = nlp, points, p, bounds, begin
        self._levels = nlp.program.levels
        self._tolerance = nlp.options.freezing
        self._spent = 0  # iterations of an anticipation that failed

    def anticipated(self, start: np.ndarray | LexicographicResult) -> LexicographicResult | None:
        """The solution in which every level above the last is met in full, if there is one."""
        failed_before = isinstance(start, LexicographicResult) and not start.anticipated
        above = self._levels[:-1]
        unmeetable = any(level.relax is not None for level in above)
        if not self._nlp.options.anticipate or not above or unmeetable or failed_before:
            return None
        bounds = self._bounds
        for level in above:
            bounds = bounds.with_rows(level.frozen, level.ideal_bounds())
        outcome = self._nlp.call(len(above), self._points[-1], self._p, bounds)
        if not (outcome.status.optimal and outcome.usable):
            self._spent = outcome.iterations
            return None
        zeros = (0,) * len(above)
        statuses = (NlpStatus.SOLVED,) * len(above)
        points = (outcome.point,) * len(self._levels)
        return self._result(outcome, (*statuses, outcome.status), (*zeros, outcome.iterations), points, True)

    def in_order(self) -> LexicographicResult:
        """Level by level. A level that fails leaves those below it out."""
        bounds, best = self._bounds, None
        statuses, iterations, points = [], [], list(self._points)
        for index, level in enumerate(self._levels):
            outcome = self._nlp.call(index, self._start(index, best), self._p, bounds)
            statuses.append(self._status(outcome))
            iterations.append(outcome.iterations)
            if outcome.usable or best is None:
                best, points[index] = outcome, outcome.point
            if not outcome.usable or self._late():
                break
            if index + 1 < len(self._levels):
                y = self._nlp.rows_at(best.point.x, self._p)[index]
                bounds = bounds.with_rows(level.frozen, level.frozen_bounds(y, best.cost, self._tolerance))
        left = len(self._levels) - len(statuses)
        statuses += [NlpStatus.TIME_LIMIT if self._late() else NlpStatus.SKIPPED] * left
        iterations += [0] * left
        iterations[0] += self._spent
        return self._result(best or self._nothing(), tuple(statuses), tuple(iterations), tuple(points), False)

    def _start(self, index: int, best: _Outcome | None) -> NlpPoint:
        """A warm start of this level if there is one; otherwise where the level above ended, cold."""
        if best is None or self._points[index].warm:
            return self._points[index]
        return NlpPoint(x=best.point.x)

    def _status(self, outcome: _Outcome) -> NlpStatus:
        if outcome.status.optimal and not outcome.usable:
            return NlpStatus.INFEASIBLE
        return outcome.status

    def _late(self) -> bool:
        return perf_counter() - self._begin > self._nlp.options.time_limit

    def _nothing(self) -> _Outcome:
        return _Outcome(point=self._points[0], status=NlpStatus.SKIPPED, iterations=0, violation=np.inf)

    def _result(
        self,
        best: _Outcome,
        statuses: tuple[NlpStatus, ...],
        iterations: tuple[int, ...],
        points: tuple[NlpPoint, ...],
        anticipated: bool,
    ) -> LexicographicResult:
        values = self._nlp.rows_at(best.point.x, self._p)
        pairs: zip[tuple[LevelRows, np.ndarray]] = zip(self._levels, values, strict=True)
        return LexicographicResult(
            x=best.point.x,
            status=max(statuses, key=_severity),
            level_status=statuses,
            values=values,
            residuals=tuple(level.distance(y) for level, y in pairs),
            iterations=iterations,
            anticipated=anticipated,
            violation=best.violation,
            points=points,
            solve_time=perf_counter() - self._begin,
        )


_ORDER = tuple(NlpStatus)


def _severity(status: NlpStatus) -> int:
    """SKIPPED is only ever the consequence of another status."""
    return 1 if status is NlpStatus.SKIPPED else _ORDER.index(status)


def _iterations(stats: Mapping[str, Any]) -> int:
    return int(stats.get("iter_count", 0))


def _violation(value: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    return float(np.maximum(np.maximum(lower - value, value - upper), 0.0).max(initial=0.0))
