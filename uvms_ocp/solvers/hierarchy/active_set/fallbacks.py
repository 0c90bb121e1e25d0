"""A bound active-set solver with its chain of fallbacks: warm, cold, cascade polished, fewer levels; best of all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments import trusted
from uvms_ocp.arrays import Array
from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.solvers.hierarchy.active_set.codes import Outcome
from uvms_ocp.solvers.hierarchy.active_set.numpy_core import lexicographic_least_squares
from uvms_ocp.solvers.hierarchy.cascade.solver import LexicographicQp
from uvms_ocp.solvers.hierarchy.certificate import normal_certificate
from uvms_ocp.solvers.hierarchy.gated_rows import gated, is_valid, residual
from uvms_ocp.solvers.hierarchy.level import row_slices
from uvms_ocp.solvers.hierarchy.scaling import NOTHING_LOST, NormalRows, normal_rows
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tick import TickResult
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES
from uvms_ocp.solvers.intervals import distance

_result = trusted(TickResult)

_STATUS = {
    (Outcome.SOLVED, 0): Status.SOLVED,
    (Outcome.SOLVED, 1): Status.COLD_STARTED,
    (Outcome.INCOMPLETE, 0): Status.INEXACT,
    (Outcome.INCOMPLETE, 1): Status.INEXACT,
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ActiveSetFunctions:
    """What a tick evaluates."""

    tick: ca.Function | None
    """(inputs, active set) -> v, active set, report, residual, *extras; None without C."""
    core: ca.Function | None
    """(J, lower, upper, gate, active set) -> v, active set, report, residual; None without C."""
    levels: ca.Function
    """inputs -> J, lower, upper, rate, activation, gate, *extras; dense"""
    sizes: tuple[int, ...]
    """Rows of each level."""
    cascade: bool
    """`LexicographicActiveSet.cascade`."""
    time_limit: float
    """[s] `LexicographicActiveSet.time_limit`."""


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    w: Array
    """(n,) [-] in normal units."""
    active_set: Array
    """(M,) [-] where the run has ended."""
    certificate: float
    """[-] `normal_certificate` of w."""
    status: Status
    """If the run is exact."""


class ActiveSetTick:
    """Warm-started from the active set of the tick before."""

    __slots__ = ("_active_set", "_core", "_functions", "_levels", "_tick")

    def __init__(self, functions: ActiveSetFunctions) -> None:
        self._functions = functions
        self._tick = None if functions.tick is None else BufferedFunction(functions.tick)
        self._core = None if functions.core is None else BufferedFunction(functions.core)
        self._levels = BufferedFunction(functions.levels)
        self._active_set = np.zeros(sum(functions.sizes))

    def reset(self) -> None:
        """Forget the active set: the next tick starts cold."""
        self._active_set[:] = 0.0

    def adopt(self, *inputs: Array) -> Callable[[], TickResult]:
        """The call with these arrays, (m,) or (m, n) [any], as they are then, without copies. No other call comes after it."""
        if self._tick is None:
            return partial(self, *inputs)
        self._tick.adopt(*inputs, self._active_set)
        return partial(self._evaluated, self._tick, inputs)

    @property
    def compiled(self) -> bool:
        """True if the whole tick is one Function with the core in C."""
        return self._tick is not None

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        """Raises `InvalidInput` for a wrong number or shape of inputs."""
        start = perf_counter()
        if self._tick is None:
            return self._recovered(inputs, start)
        return self._told(self._tick(*inputs, self._active_set), inputs, start)

    def _evaluated(self, tick: BufferedFunction, inputs: Sequence[ArrayLike]) -> TickResult:
        """Of inputs that are adopted."""
        start = perf_counter()
        tick.evaluate()
        return self._told([result.copy() for result in tick.results], inputs, start)

    def _told(self, results: Sequence[Array], inputs: Sequence[ArrayLike], start: float) -> TickResult:
        v, active_set, report, missed, *extras = results
        outcome, _, cold = report.tolist()
        status = _STATUS.get((outcome, cold))
        if status is None:
            return self._recovered(inputs, start)
        self._active_set[:] = active_set
        return _result(v=v, status=status, residual=missed, extras=tuple(extras), solve_time=perf_counter() - start)

    @np.errstate(over="ignore", invalid="ignore")  # what overflows ends without a certificate
    def _recovered(self, inputs: Sequence[ArrayLike], start: float) -> TickResult:
        """The chain in Python, whose first link is the whole tick where there is no compiler."""
        J, lower, upper, _, _, gate, *extras = self._levels(*inputs)
        J = J.reshape(-1, self._functions.levels.size2_out(0))
        v, status, missed = np.zeros(J.shape[1]), Status.INVALID_INPUT, np.zeros(len(lower))
        if is_valid(J, lower, upper, gate):
            rows = normal_rows(J, *gated(J, lower, upper, gate), self._functions.sizes)
            # No run gets hold of what is lost.
            run = self._chain(replace(rows, lost=NOTHING_LOST), start + self._functions.time_limit)
            self._active_set[:] = run.active_set
            status, v = run.status, run.w * rows.velocity
            if rows.lost.are_missed(v, rows.velocity):
                status = Status.INEXACT
            if not (np.abs(v) < TOLERANCES.endless).all():
                v, status = np.zeros_like(v), Status.INEXACT
            missed = residual(J, v, lower, upper, gate)
        return _result(v=v, status=status, residual=missed, extras=tuple(extras), solve_time=perf_counter() - start)

    def _chain(self, rows: NormalRows, deadline: float) -> _Run:
        warm = self._run(rows, self._active_set)
        if warm.certificate <= TOLERANCES.certified:
            return warm
        cold = self._cold(rows)
        if cold.certificate <= TOLERANCES.certified:
            return cold
        runs = [warm, cold]
        for more in (self._cascaded, self._shortened):
            if perf_counter() < deadline:
                runs += more(rows)
        return _best(rows, runs)

    def _cascaded(self, rows: NormalRows) -> list[_Run]:
        """The cascade, and a run that starts where it ended."""
        if not self._functions.cascade:
            return []
        w = LexicographicQp(certified=False).solve(rows.levels()).v
        y, near = rows.J @ w, TOLERANCES.touching * (1.0 + np.abs(rows.J).sum(axis=1))
        active = np.where(y >= rows.upper - near, 1.0, np.where(y <= rows.lower + near, -1.0, 0.0))
        return [self._run(rows, active), _Run(w, active, normal_certificate(rows, w), Status.CASCADED)]

    def _shortened(self, rows: NormalRows) -> list[_Run]:
        """As many of the first levels as can be solved: what is given up is given up from the bottom."""
        fewer = replace(rows, lower=rows.lower.copy(), upper=rows.upper.copy())
        run = _Run(np.zeros(rows.J.shape[1]), np.zeros(len(rows.J)), np.inf, Status.INEXACT)
        for given_up in reversed(list(row_slices(rows.sizes))[1:]):
            fewer.lower[given_up], fewer.upper[given_up] = -np.inf, np.inf
            run = self._cold(fewer)
            if run.certificate <= TOLERANCES.certified:
                break
        return [replace(run, certificate=normal_certificate(rows, run.w))]

    def _cold(self, rows: NormalRows) -> _Run:
        return replace(self._run(rows, np.zeros(len(rows.J))), status=Status.COLD_STARTED)

    def _run(self, rows: NormalRows, active_set: Array) -> _Run:
        if self._core is None:
            w, reached, _, _ = lexicographic_least_squares(rows.J, rows.lower, rows.upper, active_set, rows.sizes)
            cold = False
        else:
            w, reached, report, _ = self._core(rows.J, rows.lower, rows.upper, np.ones(len(rows.J)), active_set)
            cold = bool(report[2])
        if np.isfinite(w).all():
            status = Status.COLD_STARTED if cold else Status.SOLVED
            return _Run(w, reached, normal_certificate(rows, w), status)
        return _Run(np.zeros(len(w)), np.zeros(len(rows.J)), np.inf, Status.INEXACT)


def _best(rows: NormalRows, runs: list[_Run]) -> _Run:
    """The best of all runs; exact only if its certificate says so."""
    run = min(runs, key=lambda run: _Badness(rows, run.w))
    exact = run.certificate <= TOLERANCES.certified
    return replace(run, status=Status.CASCADED if exact else Status.INEXACT)


class _Badness:
    """Lexicographic order of level residuals, equal where they differ by rounding."""

    __slots__ = ("_norms",)

    def __init__(self, rows: NormalRows, w: Array) -> None:
        missed = distance(rows.J @ w, rows.lower, rows.upper)
        self._norms = [float(np.linalg.norm(missed[own])) for own in row_slices(rows.sizes)]

    def __lt__(self, other: _Badness) -> bool:
        for mine, theirs in zip(self._norms, other._norms, strict=True):
            if abs(mine - theirs) > TOLERANCES.tied * (1.0 + theirs):
                return mine < theirs
        return False
