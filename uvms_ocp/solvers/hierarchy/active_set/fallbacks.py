"""What is tried one after the other until a velocity is certified; the algorithm of fallbacks.c in NumPy, keep both in step.

The core from a warm start, then cold; level by level, ordinarily and with more care; with fewer levels. Where nothing is
certified the best velocity counts, by the levels in their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.hierarchy.active_set.equalities import CAREFUL, ORDINARY, Manner
from uvms_ocp.solvers.hierarchy.active_set.numpy_core import lexicographic_least_squares
from uvms_ocp.solvers.hierarchy.active_set.patience import patience
from uvms_ocp.solvers.hierarchy.certificate import normal_certificate
from uvms_ocp.solvers.hierarchy.gated_rows import gated, is_valid, residual
from uvms_ocp.solvers.hierarchy.level import row_slices
from uvms_ocp.solvers.hierarchy.scaling import NOTHING_LOST, NormalRows, normal_rows
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES
from uvms_ocp.solvers.intervals import distance


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SolvedRows:
    """What a call finds."""

    v: Array
    """(n,) [velocity] finite, 0 where the rows are invalid."""
    active_set: Array
    """(M,) [-] for the next call."""
    status: Status
    """How far v can be relied on."""
    residual: Array
    """(M,) [rate] signed distance of J v to [lower, upper], 0 where the gate is 0."""
    iterations: int
    """[-] of all runs, `Patience.most_of_all` at most."""


@np.errstate(over="ignore", invalid="ignore")  # what overflows ends without a certificate
def solve_levels(
    J: Array, lower: Array, upper: Array, gate: Array, active_set: Array, sizes: Sequence[int]
) -> SolvedRows:
    """As `solve_levels` of fallbacks.c, for J (M, n) [rate/velocity], lower and upper (M,) [rate], gate and active_set (M,) [-].

    sizes: rows of each level.
    """
    if not is_valid(J, lower, upper, gate):
        v, nothing = np.zeros(J.shape[1]), np.zeros(len(lower))
        return SolvedRows(v=v, active_set=nothing, status=Status.INVALID_INPUT, residual=nothing.copy(), iterations=0)
    rows = normal_rows(J, *gated(J, lower, upper, gate), sizes)
    # No run gets hold of what is lost.
    chain = _Chain(replace(rows, lost=NOTHING_LOST))
    status, v = chain.solve(active_set), chain.best.w * rows.velocity
    if not (np.abs(v) < TOLERANCES.endless).all():
        v, status = np.zeros_like(v), Status.INEXACT
    return SolvedRows(
        v=v,
        active_set=chain.best.active_set,
        status=Status.INEXACT if rows.lost.are_missed(v, rows.velocity) else status,
        residual=residual(J, v, lower, upper, gate),
        iterations=patience(len(J)).most_of_all - chain.left,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Where a run has ended."""

    w: Array
    """(n,) [-] in normal units."""
    active_set: Array
    """(M,) [-]"""


class _Chain:
    """All runs of one call."""

    def __init__(self, rows: NormalRows) -> None:
        self.rows = rows
        self.left = patience(len(rows.J)).most_of_all
        self.best = _Run(np.zeros(rows.J.shape[1]), np.zeros(len(rows.J)))
        self._levels = [own for own in row_slices(rows.sizes) if own.stop > own.start]
        self._missed: Array | None = None
        self._near = TOLERANCES.touching * (1.0 + np.abs(rows.J).sum(axis=1))

    def solve(self, active_set: Array) -> Status:
        """What `best` is then."""
        cold = np.zeros(len(self.rows.J))
        if self._is_proven(self._run(self.rows, active_set)):
            return Status.SOLVED
        if active_set.any() and self._is_proven(self._run(self.rows, cold)):
            return Status.COLD_STARTED
        found = self._by_levels(ORDINARY) or self._by_levels(CAREFUL) or self._by_fewer_levels()
        return Status.CASCADED if found else Status.INEXACT

    def _by_levels(self, manner: Manner) -> bool:
        """Every level on its own, with those above held, then a run that starts where they end."""
        w = np.zeros(self.rows.J.shape[1])
        for own in self._levels:
            if self.left <= 0:
                break
            held = self._held(w, own)
            found = self._run(held, np.zeros(len(held.J)), manner).w
            w = found if self._is_held(held, found, own.start) else w
        touched = self._touched(w)
        return self._is_proven(_Run(w, touched)) or self._is_proven(self._run(self.rows, touched, manner))

    def _by_fewer_levels(self) -> bool:
        """As many of the first levels as can be solved: what is given up is given up from the bottom."""
        for given_up in reversed(self._levels[1:]):
            if self.left <= 0:
                break
            fewer = self._without(given_up.start)
            run = self._run(fewer, np.zeros(len(fewer.J)))
            if np.isfinite(run.w).all() and normal_certificate(fewer, run.w) <= TOLERANCES.certified:
                return self._is_proven(run)
        return False

    def _run(self, rows: NormalRows, active_set: Array, manner: Manner = ORDINARY) -> _Run:
        w, reached, iterations = lexicographic_least_squares(
            rows.J, rows.lower, rows.upper, active_set, rows.sizes, manner, self.left
        )
        self.left -= iterations
        return _Run(w, reached)

    def _is_proven(self, run: _Run) -> bool:
        """Whether a run is certified; else it is kept if it is the best so far."""
        if not _is_finite(run.w):
            return False
        missed = distance(self.rows.J @ run.w, self.rows.lower, self.rows.upper)
        norms = np.array([np.linalg.norm(missed[own]) for own in self._levels])
        proven = normal_certificate(self.rows, run.w) <= TOLERANCES.certified
        if proven or self._missed is None or _is_better(norms, self._missed):
            self.best, self._missed = run, norms
        return proven

    def _without(self, end: int) -> NormalRows:
        """The rows before `end`; the others are free."""
        given = np.arange(len(self.rows.J)) < end
        lower, upper = np.where(given, self.rows.lower, -np.inf), np.where(given, self.rows.upper, np.inf)
        return replace(self.rows, lower=lower, upper=upper)

    def _held(self, w: Array, own: slice) -> NormalRows:
        """Those above a level may miss their bounds by as much as they do at w, those below are free."""
        rows, y = self._without(own.stop), self.rows.J @ w
        above = np.arange(len(y)) < own.start
        lower = np.where(above, np.minimum(y, self.rows.lower), rows.lower)
        return replace(rows, lower=lower, upper=np.where(above, np.maximum(y, self.rows.upper), rows.upper))

    def _is_held(self, held: NormalRows, w: Array, begin: int) -> bool:
        """Whether a run has left the levels above where they were held."""
        y, near = held.J[:begin] @ w, self._near[:begin]
        kept = (y >= held.lower[:begin] - near) & (y <= held.upper[:begin] + near)
        return _is_finite(w) and bool(kept.all())

    def _touched(self, w: Array) -> Array:
        """(M,) [-] bounds that w touches."""
        y, near = self.rows.J @ w, self._near
        return np.where(y >= self.rows.upper - near, 1.0, np.where(y <= self.rows.lower + near, -1.0, 0.0))


def _is_finite(w: Array) -> bool:
    return bool((np.abs(w) < TOLERANCES.endless).all())


def _is_better(missed: Array, than: Array) -> bool:
    """Levels whose residuals differ by rounding are equal, and the next one decides."""
    differ = np.flatnonzero(np.abs(missed - than) > TOLERANCES.tied * (1.0 + than))
    return bool(differ.size) and bool(missed[differ[0]] < than[differ[0]])
