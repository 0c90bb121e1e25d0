"""Lexicographic least squares by active sets in NumPy, for machines without a C compiler; keep in step with the C files.

equalities.c: least squares of the active rows; active_set.c: which rows are active; fallbacks.c: what is tried one after the
other until a velocity is certified.

`[rate]` is the unit of a row, `[velocity]` that of an entry of v.

The core from a warm start, then cold; level by level, ordinarily and with more care; with fewer levels. Where nothing is
certified the best velocity counts, by the levels in their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from uvms_ocp.codegen.elementwise import interval_distance
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.solvers.hierarchy.certificate import NO_NEGLIGIBLE_ROWS, NormalRows, normal_certificate, normal_rows
from uvms_ocp.solvers.hierarchy.level import is_valid, residual, row_slices, widen_bounds
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tolerances import IterationBudget, iteration_budget
from uvms_ocp.types import Array

# What the numbers mean that the solver in C and Python exchange.

STATUSES = tuple(Status)
"""Statuses by their codes."""


class RowState(IntEnum):
    """State of one row: free, held at a bound, or an equality, which is always held."""

    LOWER = -1
    FREE = 0
    UPPER = 1
    EQUAL = 2


# As plain integers, which NumPy compares four times as fast.
LOWER, FREE, UPPER, EQUAL = (int(state) for state in RowState)


# The algorithm of equalities.c in NumPy: least squares of the active rows, level by level; keep both in step.
#
# `[rate]` is the unit of a row, `[velocity]` that of an entry of v.


@dataclass(frozen=True, slots=True)
class PivotRules:
    """Pivot rules: rows too dependent to be pivots, and multipliers that are rounding."""

    rank_tolerance: float
    """`tolerances.RANK_TOLERANCE`."""
    rank_noise: float
    """`tolerances.RANK_NOISE`."""
    multiplier: float
    """`tolerances.MULTIPLIER`."""


ORDINARY = PivotRules(tolerances.RANK_TOLERANCE, tolerances.RANK_NOISE, tolerances.MULTIPLIER)
CAREFUL = PivotRules(tolerances.CAREFUL_RANK, tolerances.CAREFUL_NOISE, tolerances.CAREFUL_MULTIPLIER)


@dataclass(slots=True, eq=False)
class ActiveSetWorkspace:
    """Workspace of a run: M rows, n velocities."""

    A: Array
    """(M, n) [rate/velocity] rows."""
    lower: Array
    """(M,) [rate]"""
    upper: Array
    """(M,) [rate]"""
    norm: Array
    """(M,) [rate/velocity] of the rows."""
    tolerance: Array
    """(M,) [rate] by how much a row may be violated."""
    levels: list[slice]
    """Rows of each level."""
    state: Array
    """(M,) `RowState` of each row."""
    v: Array
    """(n,) [velocity] where the run is."""
    tabu: Array
    """(M,) True for rows that must not be dropped any more."""
    manner: PivotRules
    """Pivot rules of the run."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelFactor:
    """Active rows of one level, pivots first, in the coordinates of the factorisation."""

    rows: Array
    """(m,) their numbers."""
    T: Array
    """(m, n) [rate/velocity]"""
    column: int
    """First coordinate that the levels above left free."""
    rank: int
    """Number of pivots."""
    smallest: float
    """Least independent part of any pivot so far, relative to its row."""


@dataclass(frozen=True, slots=True, eq=False)
class EqualitySolution:
    """The hierarchy of the active rows, solved."""

    blocks: list[LevelFactor]
    """One per level."""
    target: Array
    """(n,) [velocity] of least norm among the optima."""
    slack: Array
    """(M,) [rate] by how much active rows miss their bound there."""


def start_workspace(
    J: Array, lower: Array, upper: Array, state: Array, sizes: Sequence[int], manner: PivotRules = ORDINARY
) -> ActiveSetWorkspace:
    """A run that starts with the rows of ``state`` (M,) active, as far as their bounds are finite.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate]; sizes: rows of each level.
    """
    norm = np.sqrt((J * J).sum(axis=1))
    size = np.fmax(_size(lower), _size(upper))
    given = np.sign(state)
    given[((given > 0) & (upper == np.inf)) | ((given < 0) & (lower == -np.inf))] = FREE
    # A flag of equality must never be inherited: the row may have become an inequality.
    given[lower >= upper] = EQUAL
    return ActiveSetWorkspace(
        A=J,
        lower=lower,
        upper=upper,
        norm=norm,
        tolerance=tolerances.FEASIBLE * (norm + size),
        levels=list(row_slices(sizes)),
        state=given,
        v=np.zeros(J.shape[1]),
        tabu=np.zeros(len(J), dtype=bool),
        manner=manner,
    )


def _size(bound: Array) -> Array:
    return np.where(np.abs(bound) < tolerances.ENDLESS, np.abs(bound), 0.0)


def bounds_of(work: ActiveSetWorkspace, rows: Array) -> Array:
    """(k,) [rate] the bound at which each of the active rows (k,) is held."""
    return np.asarray(np.where(work.state[rows] == LOWER, work.lower[rows], work.upper[rows]))


def solve_equalities(work: ActiveSetWorkspace) -> EqualitySolution:
    """Least squares of the active rows, level by level."""
    n = work.A.shape[1]
    Q, y, slack, blocks, column = np.eye(n), np.zeros(n), np.zeros(len(work.A)), [], 0
    smallest = 1.0
    late: list[Array] = []
    for level in work.levels:
        rows = level.start + np.flatnonzero((work.state[level] != FREE) & (work.norm[level] > 0.0))
        if rows.size == 0:
            blocks.append(LevelFactor(rows, np.zeros((0, n)), column, 0, smallest))
        elif column == n:
            late.append(rows)
            blocks.append(LevelFactor(rows, work.A[rows], column, 0, smallest))
        else:
            block = _reduced(work, rows, Q, column, smallest)
            _solve_level(work, block, y, slack)
            blocks.append(block)
            column, smallest = column + block.rank, block.smallest
    target = Q @ y
    for rows in late:
        slack[rows] = work.A[rows] @ target - bounds_of(work, rows)
    # Rows to which nothing is left lend only the sum of their gradients, in the same coordinates.
    blocks = [replace(b, T=b.T @ Q) if b.column == n else b for b in blocks]
    return EqualitySolution(blocks, target, slack)


def _reduced(work: ActiveSetWorkspace, rows: Array, Q: Array, column: int, smallest: float) -> LevelFactor:
    """Pivoted Householder reduction in the space that the levels above left free; turns Q[:, column:]."""
    T, order, n = work.A[rows] @ Q, rows.copy(), Q.shape[1]
    norm, rank = work.norm[rows], 0
    while rank < len(T) and column + rank < n:
        c = column + rank
        part = (T[rank:, c:] ** 2).sum(axis=1) / norm[rank:] ** 2
        best = int(np.argmax(part))
        if part[best] <= max(work.manner.rank_tolerance, work.manner.rank_noise / smallest) ** 2:
            break
        smallest = min(smallest, float(np.sqrt(part[best])))
        best += rank
        if best != rank:
            swap, back = [rank, best], [best, rank]
            T[swap], order[swap], norm[swap] = T[back], order[back], norm[back]
        _reflect(T, Q, rank, c)
        rank += 1
    return LevelFactor(order, T, column, rank, smallest)


def _reflect(T: Array, Q: Array, row: int, c: int) -> None:
    u = T[row, c:].copy()
    size = float(np.sqrt(u @ u))
    alpha = -size if u[0] > 0 else size
    u[0] -= alpha
    scaled = u * (2.0 / (u @ u))
    T[row, c:] = 0.0
    T[row, c] = alpha
    T[row + 1 :, c:] -= np.outer(T[row + 1 :, c:] @ u, scaled)
    Q[:, c:] -= np.outer(Q[:, c:] @ u, scaled)


def _solve_level(work: ActiveSetWorkspace, block: LevelFactor, y: Array, slack: Array) -> None:
    c0, c1 = block.column, block.column + block.rank
    target = bounds_of(work, block.rows) - block.T[:, :c0] @ y[:c0]
    B = block.T[:, c0:c1]
    if block.rank == len(B):
        y[c0:c1] = np.linalg.solve(B, target)
        return
    if block.rank > 0:
        orthogonal, R = np.linalg.qr(B)
        y[c0:c1] = np.linalg.solve(R, orthogonal.T @ target)
    slack[block.rows] = B @ y[c0:c1] - target


# The algorithm of active_set.c in NumPy, for machines without a C compiler; keep both in step.
#
# `[rate]` is the unit of a row, `[velocity]` that of an entry of v.


class _Rule(IntEnum):
    GREEDY = 0
    BLAND = 1
    TABU = 2


def lexicographic_least_squares(
    J: Array, lower: Array, upper: Array, state: Array, sizes: Sequence[int], manner: PivotRules, left: int
) -> tuple[Array, Array, int]:
    """V (n,) [velocity], active set (M,) and number of iterations, ``left`` at most; see active_set.c for the algorithm.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate], all in normal units (`scaling`); state (M,): `RowState` of
    each row to start with. A run does not judge its own result.
    """
    work = start_workspace(J, lower, upper, state, sizes, manner)
    equalities = solve_equalities(work)
    work.v = equalities.target
    pending, stalled, rule = _activate_violated(work), 0, _Rule.GREEDY
    dropped = -1
    given = iteration_budget(len(J))
    most = min(given.most_iterations, left)
    for iteration in range(1, most + 1):
        if pending:
            equalities = solve_equalities(work)
            moved, blocked = _step(work, equalities.target)
            stalled += not moved
            if moved and rule is not _Rule.TABU:
                stalled, rule = 0, _Rule.GREEDY
                work.tabu[:] = False
            elif not moved and blocked == dropped >= 0:
                # A row that blocks at once where it was dropped was dropped for rounding: it stays.
                work.tabu[blocked] = True
            dropped = -1
            if blocked >= 0:
                continue
        dropped = _drop_row(work, equalities, rule)
        if dropped < 0:
            return work.v, work.state, iteration
        stalled += 1
        rule = _rule(stalled, iteration, given, rule)
        if rule is _Rule.TABU:
            work.tabu[dropped] = True
        pending = True
    return work.v, work.state, most


def _rule(stalled: int, iteration: int, given: IterationBudget, rule: _Rule) -> _Rule:
    if stalled > given.tabu_stalls or iteration > given.tabu_iterations:
        return _Rule.TABU
    return _Rule.BLAND if stalled > given.bland_stalls else rule


def _activate_violated(work: ActiveSetWorkspace) -> bool:
    y, free = work.A @ work.v, work.state == FREE
    above = free & (y > work.upper + work.tolerance)
    below = free & (y < work.lower - work.tolerance)
    work.state[above], work.state[below] = UPPER, LOWER
    return bool(above.any() or below.any())


def _step(work: ActiveSetWorkspace, target: Array) -> tuple[bool, int]:
    """Goes to ``target`` until a free row blocks, which becomes active; whether v moved, and that row or -1."""
    end, free = work.A @ target, work.state == FREE
    above = free & (end > work.upper + work.tolerance)
    below = free & (end < work.lower - work.tolerance)
    blocking = np.flatnonzero(above | below)
    if blocking.size == 0:
        before, work.v = work.v, target
        return _has_moved(before, target), -1
    y, end = work.A[blocking] @ work.v, end[blocking]
    limit = np.where(above[blocking], work.upper[blocking], work.lower[blocking])
    outside = np.where(above[blocking], y >= limit, y <= limit)
    length = np.where(outside, 0.0, (limit - y) / np.where(outside, 1.0, end - y))
    first = int(np.argmin(length))
    row, t = blocking[first], min(1.0, max(0.0, float(length[first])))
    before, work.v = work.v, work.v + t * (target - work.v)
    work.state[row] = UPPER if above[row] else LOWER
    return _has_moved(before, work.v), int(row)


def _has_moved(before: Array, after: Array) -> bool:
    return bool(np.abs(after - before).max() > tolerances.MOVED * max(1.0, np.abs(after).max()))


def _drop_row(work: ActiveSetWorkspace, equalities: EqualitySolution, rule: _Rule) -> int:
    decided = np.zeros(len(work.A), dtype=bool)
    for level in range(len(work.levels)):
        row = _wrong_row(work, equalities, level, rule, decided)
        if row >= 0:
            work.state[row] = FREE
            return row
    return -1


def _wrong_row(work: ActiveSetWorkspace, equalities: EqualitySolution, level: int, rule: _Rule, decided: Array) -> int:
    """The worst row by its multiplier at this level, -1 where all signs hold."""
    own = equalities.blocks[level]
    slack = equalities.slack[own.rows]
    scale = float(np.abs(slack) @ work.norm[own.rows])
    # A slack that an exact solution could not tell from zero decides nothing for the levels below.
    significant = np.abs(slack) > tolerances.SIGNIFICANT / tolerances.FEASIBLE * work.tolerance[own.rows]
    if not significant.any():
        return -1
    rows, multipliers, g = [own.rows[significant]], [slack[significant]], slack @ own.T[:, : own.column]
    for block in reversed(equalities.blocks[:level]):
        if block.rank == 0:
            continue
        c0, c1 = block.column, block.column + block.rank
        pivots = block.T[: block.rank]
        multiplier = np.linalg.solve(pivots[:, c0:c1].T, -g[c0:c1])
        g = g[:c0] + multiplier @ pivots[:, :c0]
        rows.append(block.rows[: block.rank])
        multipliers.append(multiplier)
    tolerance = max(work.manner.multiplier * scale, tolerances.WRONG)
    return _worst(work, np.concatenate(rows), np.concatenate(multipliers), tolerance, rule, decided)


def _worst(
    work: ActiveSetWorkspace, rows: Array, multipliers: Array, tolerance: float, rule: _Rule, decided: Array
) -> int:
    value = multipliers * work.state[rows] * work.norm[rows]
    value = np.where((work.state[rows] != EQUAL) & ~decided[rows], value, 0.0)
    decided[rows[value > tolerance]] = True
    wrong = (value < -tolerance) & ~work.tabu[rows]
    if not wrong.any():
        return -1
    if rule is _Rule.GREEDY:
        return int(rows[np.argmin(np.where(wrong, value, 0.0))])
    return int(rows[wrong].min())


# What is tried one after the other until a velocity is certified; the algorithm of fallbacks.c in NumPy, keep both in step.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SolvedRows:
    """Result of `solve_levels`."""

    v: Array
    """(n,) [velocity] finite, 0 where the rows are invalid."""
    active_set: Array
    """(M,) for the next call."""
    status: Status
    """Reliability of v."""
    residual: Array
    """(M,) [rate] signed distance of J v to [lower, upper], 0 where the gate is 0."""
    iterations: int
    """Iterations of all runs, `IterationBudget.most_of_all` at most."""


@np.errstate(over="ignore", invalid="ignore")  # what overflows ends without a certificate
def solve_levels(
    J: Array, lower: Array, upper: Array, gate: Array, active_set: Array, sizes: Sequence[int]
) -> SolvedRows:
    """Solve levels as `solve_levels` of fallbacks.c: J (M, n) [rate/velocity], lower and upper (M,) [rate], gate and
    active_set (M,).

    sizes: rows of each level.
    """
    if not is_valid(J, lower, upper, gate):
        v, nothing = np.zeros(J.shape[1]), np.zeros(len(lower))
        return SolvedRows(v=v, active_set=nothing, status=Status.INVALID_INPUT, residual=nothing.copy(), iterations=0)
    rows = normal_rows(J, *widen_bounds(J, lower, upper, gate), sizes)
    # No run gets hold of what is lost.
    chain = _Chain(replace(rows, lost=NO_NEGLIGIBLE_ROWS))
    status, v = chain.solve(active_set), chain.best.w * rows.velocity
    if not (np.abs(v) < tolerances.ENDLESS).all():
        v, status = np.zeros_like(v), Status.INEXACT
    return SolvedRows(
        v=v,
        active_set=chain.best.active_set,
        status=Status.INEXACT if rows.lost.are_missed(v, rows.velocity) else status,
        residual=residual(J, v, lower, upper, gate),
        iterations=iteration_budget(len(J)).most_of_all - chain.left,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Result of one run."""

    w: Array
    """(n,) in normal units."""
    active_set: Array
    """(M,) """


class _Chain:
    """All runs of one call."""

    def __init__(self, rows: NormalRows) -> None:
        self.rows = rows
        self.left = iteration_budget(len(rows.J)).most_of_all
        self.best = _Run(np.zeros(rows.J.shape[1]), np.zeros(len(rows.J)))
        self._levels = [own for own in row_slices(rows.sizes) if own.stop > own.start]
        self._missed: Array | None = None
        self._near = tolerances.TOUCHING * (1.0 + np.abs(rows.J).sum(axis=1))

    def solve(self, active_set: Array) -> Status:
        """Try the fallbacks in order; return the status of `best`."""
        cold = np.zeros(len(self.rows.J))
        if self._is_proven(self._run(self.rows, active_set)):
            return Status.SOLVED
        if active_set.any() and self._is_proven(self._run(self.rows, cold)):
            return Status.COLD_STARTED
        found = self._by_levels(ORDINARY) or self._by_levels(CAREFUL) or self._by_fewer_levels()
        return Status.CASCADED if found else Status.INEXACT

    def _by_levels(self, manner: PivotRules) -> bool:
        """Every level on its own, with those above held, then a run that starts where they end."""
        w = np.zeros(self.rows.J.shape[1])
        for own in self._levels:
            if self.left <= 0:
                break
            held = self._held(w, own)
            found = self._run(held, np.zeros(len(held.J)), manner).w
            w = found if self._is_held(held, found, own.start) else w
        y, near = (self.rows.J @ w, self._near)
        touched = np.where(y >= self.rows.upper - near, 1.0, np.where(y <= self.rows.lower + near, -1.0, 0.0))
        return self._is_proven(_Run(w, touched)) or self._is_proven(self._run(self.rows, touched, manner))

    def _by_fewer_levels(self) -> bool:
        """Solve as many of the first levels as can be solved: the lowest are given up first."""
        for given_up in reversed(self._levels[1:]):
            if self.left <= 0:
                break
            fewer = self._without(given_up.start)
            run = self._run(fewer, np.zeros(len(fewer.J)))
            if np.isfinite(run.w).all() and normal_certificate(fewer, run.w) <= tolerances.CERTIFIED:
                return self._is_proven(run)
        return False

    def _run(self, rows: NormalRows, active_set: Array, manner: PivotRules = ORDINARY) -> _Run:
        w, reached, iterations = lexicographic_least_squares(
            rows.J, rows.lower, rows.upper, active_set, rows.sizes, manner, self.left
        )
        self.left -= iterations
        return _Run(w, reached)

    def _is_proven(self, run: _Run) -> bool:
        """Check whether a run is certified; else keep it if it is the best so far."""
        if not _is_finite(run.w):
            return False
        missed = interval_distance(self.rows.J @ run.w, self.rows.lower, self.rows.upper)
        norms = np.array([np.linalg.norm(missed[own]) for own in self._levels])
        proven = normal_certificate(self.rows, run.w) <= tolerances.CERTIFIED
        if proven or self._missed is None or _is_better(norms, self._missed):
            self.best, self._missed = run, norms
        return proven

    def _without(self, end: int) -> NormalRows:
        """The rows before `end`; the others are free."""
        given = np.arange(len(self.rows.J)) < end
        lower, upper = np.where(given, self.rows.lower, -np.inf), np.where(given, self.rows.upper, np.inf)
        return replace(self.rows, lower=lower, upper=upper)

    def _held(self, w: Array, own: slice) -> NormalRows:
        """Return rows by which levels above `own` may miss their bounds as much as at w, and those below are free."""
        rows, y = self._without(own.stop), self.rows.J @ w
        above = np.arange(len(y)) < own.start
        lower = np.where(above, np.minimum(y, self.rows.lower), rows.lower)
        return replace(rows, lower=lower, upper=np.where(above, np.maximum(y, self.rows.upper), rows.upper))

    def _is_held(self, held: NormalRows, w: Array, begin: int) -> bool:
        """Check whether a run has left the levels above where they were held."""
        y, near = held.J[:begin] @ w, self._near[:begin]
        kept = (y >= held.lower[:begin] - near) & (y <= held.upper[:begin] + near)
        return _is_finite(w) and bool(kept.all())


def _is_finite(w: Array) -> bool:
    return bool((np.abs(w) < tolerances.ENDLESS).all())


def _is_better(missed: Array, than: Array) -> bool:
    """Levels whose residuals differ by rounding are equal, and the next one decides."""
    differ = np.flatnonzero(np.abs(missed - than) > tolerances.TIED * (1.0 + than))
    return bool(differ.size) and bool(missed[differ[0]] < than[differ[0]])
