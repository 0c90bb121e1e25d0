"""Lexicographic least squares by active sets, short and slow: the oracle of the solver in C, and in
its place without a compiler.

A hierarchy of equalities is solved level by level in the null space of the levels above; rows that
the step towards that optimum meets become active, and the one whose multiplier has the wrong sign
at the first level that has any is dropped. Where the result of a run from a warm start is not
certified, the next starts cold; then every level is solved on its own with those above held,
ordinarily and with more care; then fewer levels. Where nothing is certified the velocity counts that
is best at the highest level where velocities differ.

`[rate]` is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from uvms_ocp.codegen.elementwise import interval_distance
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.solvers.hierarchy.certificate import (
    NO_NEGLIGIBLE_ROWS,
    NormalRows,
    normal_certificate,
    normal_rows,
)
from uvms_ocp.solvers.hierarchy.iteration_budget import iteration_budget
from uvms_ocp.solvers.hierarchy.level import is_valid, residual, row_slices, widen_bounds
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.types import Array, Indices, Mask


class RowState(IntEnum):
    """State of one row: free, held at a bound, or an equality, which is always held."""

    LOWER = -1
    FREE = 0
    UPPER = 1
    EQUAL = 2


LOWER, FREE, UPPER, EQUAL = (int(state) for state in RowState)


class PivotRules(NamedTuple):
    """Pivot rules: rows too dependent to be pivots, and multipliers that are rounding."""

    rank_tolerance: float
    """`tolerances.RANK_TOLERANCE`."""
    rank_noise: float
    """`tolerances.RANK_NOISE`."""
    multiplier: float
    """`tolerances.MULTIPLIER`."""


ORDINARY = PivotRules(tolerances.RANK_TOLERANCE, tolerances.RANK_NOISE, tolerances.MULTIPLIER)
CAREFUL = PivotRules(
    tolerances.CAREFUL_RANK, tolerances.CAREFUL_NOISE, tolerances.CAREFUL_MULTIPLIER
)


class _Block(NamedTuple):
    """Active rows of one level, pivots first, in the coordinates of the factorisation."""

    rows: Indices
    """(m,) numbers of the rows, the first `rank` of them pivots."""
    T: Array
    """(m, n) rows in those coordinates."""
    column: int
    """Number of coordinates that belong to the levels above."""
    rank: int
    """Number of coordinates that this level determines."""


class _Rule(IntEnum):
    """Choice of the row to drop: the worst, the first (which ends most cycles), or the first and
    never again (which ends all).
    """

    GREEDY = 0
    BLAND = 1
    TABU = 2


class _ActiveSet:
    """One run of the method: M rows in normal units, n velocities."""

    def __init__(self, rows: NormalRows, active_set: Array, rules: PivotRules) -> None:
        self.A = rows.J
        self.lower = rows.lower
        self.upper = rows.upper
        self.rules = rules
        self.levels = list(row_slices(rows.sizes))
        self.norm = np.sqrt((rows.J * rows.J).sum(axis=1))
        bounds = np.abs([rows.lower, rows.upper])
        largest_bound = np.where(bounds < tolerances.ENDLESS, bounds, 0.0).max(axis=0)
        self.tolerance = tolerances.FEASIBLE * (self.norm + largest_bound)
        """(M,) by how much a row may be violated."""
        self.state = np.sign(active_set)
        """(M,) `RowState` of each row."""
        lacks_upper = (self.state > 0) & (rows.upper == np.inf)
        lacks_lower = (self.state < 0) & (rows.lower == -np.inf)
        self.state[lacks_upper | lacks_lower] = FREE
        # A flag of equality must never be inherited: the row may have become an inequality.
        self.state[rows.lower >= rows.upper] = EQUAL
        self.tabu = np.zeros(len(rows.J), dtype=bool)
        """(M,) rows that must not be dropped any more."""
        self.v = np.zeros(rows.J.shape[1])
        """(n,) velocity that the run has reached."""
        self.target = np.zeros(rows.J.shape[1])
        """(n,) optimum of the active rows."""
        self.slack = np.zeros(len(rows.J))
        """(M,) by how much active rows miss their bound at the target."""
        self.blocks = list[_Block]()
        """Active rows level by level."""

    def solve(self, max_iterations: int) -> tuple[Array, int]:
        """Return the optimum (n,) and the number of iterations, `max_iterations` at most."""
        self._solve_equalities()
        self.v = self.target
        dropped = -1
        stalled = 0
        rule = _Rule.GREEDY
        above, below = self._violated(self.v)
        self.state[above] = UPPER
        self.state[below] = LOWER
        pending = bool((above | below).any())
        budget = iteration_budget(len(self.A))
        limit = min(budget.most_iterations, max_iterations)
        for iteration in range(1, limit + 1):
            if pending:
                self._solve_equalities()
                moved, blocked = self._step()
                stalled += not moved
                if moved and rule is not _Rule.TABU:
                    stalled = 0
                    rule = _Rule.GREEDY
                    self.tabu[:] = False
                elif not moved and blocked == dropped >= 0:
                    # A row that blocks at once where it was dropped was dropped for rounding: it
                    # stays.
                    self.tabu[blocked] = True
                dropped = -1
                if blocked >= 0:
                    continue
            dropped = self._wrong_row(rule)
            if dropped < 0:
                return self.v, iteration
            self.state[dropped] = FREE
            pending = True
            stalled = stalled + 1
            if stalled > budget.tabu_stalls or iteration > budget.tabu_iterations:
                rule = _Rule.TABU
                self.tabu[dropped] = True
            elif stalled > budget.bland_stalls:
                rule = _Rule.BLAND
        return self.v, limit

    def _violated(self, v: Array) -> tuple[Mask, Mask]:
        """Find the free rows (M,) above their upper bound at v, and those below their lower one."""
        y = self.A @ v
        free = self.state == FREE
        return free & (y > self.upper + self.tolerance), free & (y < self.lower - self.tolerance)

    def _solve_equalities(self) -> None:
        """Find the least-norm least squares of the active rows, level by level in the null space of
        the levels above.
        """
        from scipy.linalg import qr

        n = self.A.shape[1]
        Q = np.eye(n)
        y = np.zeros(n)
        column = 0
        smallest = 1.0
        self.slack = np.zeros(len(self.A))
        self.blocks = list[_Block]()
        for level in self.levels:
            is_active = (self.state[level] != FREE) & (self.norm[level] > 0.0)
            rows = level.start + np.flatnonzero(is_active)
            rank = 0
            if rows.size and column < n:
                scaled_rows = self.A[rows] @ Q[:, column:] / self.norm[rows, None]
                turn, R, order = qr(scaled_rows.T, pivoting=True)
                for part in np.abs(np.diag(R)):
                    if part <= max(self.rules.rank_tolerance, self.rules.rank_noise / smallest):
                        break
                    smallest = float(min(smallest, part))
                    rank = rank + 1
                rows = rows[order]
                Q[:, column:] = Q[:, column:] @ turn
            T = self.A[rows] @ Q
            end = column + rank
            T[:rank, end:] = 0.0
            bound = np.where(self.state[rows] == LOWER, self.lower[rows], self.upper[rows])
            missed = bound - T[:, :column] @ y[:column]
            if rank:
                orthogonal, R = np.linalg.qr(T[:, column:end])
                y[column:end] = np.linalg.solve(R, orthogonal.T @ missed)
            if rank < len(rows):
                self.slack[rows] = T[:, column:end] @ y[column:end] - missed
            self.blocks.append(_Block(rows, T, column, rank))
            column = end
        self.target = Q @ y

    def _step(self) -> tuple[bool, int]:
        """Go to `target` until a free row blocks, which becomes active; return whether v moved, and
        that row or -1.
        """
        above, below = self._violated(self.target)
        blocking = np.flatnonzero(above | below)
        before = self.v
        row = -1
        if blocking.size == 0:
            self.v = self.target
        else:
            y = (self.A @ self.v)[blocking]
            end = (self.A @ self.target)[blocking]
            limit = np.where(above, self.upper, self.lower)[blocking]
            outside = np.where(above[blocking], y >= limit, y <= limit)
            length = np.where(outside, 0.0, (limit - y) / np.where(outside, 1.0, end - y))
            row = int(blocking[np.argmin(length)])
            self.v = self.v + min(1.0, max(0.0, float(length.min()))) * (self.target - self.v)
            self.state[row] = UPPER if above[row] else LOWER
        smallest_move = tolerances.MOVED * max(1.0, np.abs(self.v).max())
        moved = bool(np.abs(self.v - before).max() > smallest_move)
        return moved, row

    def _wrong_row(self, rule: _Rule) -> int:
        """Return the row to drop by its multiplier at the first level where the sign of one is
        wrong; -1 where all signs hold.
        """
        decided = np.zeros(len(self.A), dtype=bool)
        for k, level in enumerate(self.blocks):
            slack = self.slack[level.rows]
            multiplier = np.zeros(len(self.A))
            # A slack that an exact solution could not tell from zero decides nothing for the levels
            # below.
            relative_noise = tolerances.SIGNIFICANT / tolerances.FEASIBLE
            significant = np.abs(slack) > relative_noise * self.tolerance[level.rows]
            if not significant.any():
                continue
            multiplier[level.rows[significant]] = slack[significant]
            g = slack @ level.T[:, : level.column]
            for rows, T, column, rank in reversed(self.blocks[:k]):
                if rank:
                    R = T[:rank, column : column + rank]
                    level_multiplier = np.linalg.solve(R.T, -g[column:])
                    multiplier[rows[:rank]] = level_multiplier
                    g = g[:column] + level_multiplier @ T[:rank, :column]
            is_decided = (self.state == EQUAL) | decided
            value = np.where(is_decided, 0.0, multiplier * self.state * self.norm)
            size = float(np.abs(slack) @ self.norm[level.rows])
            threshold = max(self.rules.multiplier * size, tolerances.WRONG)
            decided |= value > threshold
            wrong = (value < -threshold) & ~self.tabu
            if not wrong.any():
                continue
            if rule is _Rule.GREEDY:
                return int(np.argmin(np.where(wrong, value, 0.0)))
            return int(np.argmax(wrong))
        return -1


def lexicographic_least_squares(
    rows: NormalRows, active_set: Array, rules: PivotRules, max_iterations: int
) -> tuple[Array, Array, int]:
    """Run the method once; return w (n,) in normal units, active set (M,) and number of iterations,
    `max_iterations` at most. The result is not certified.

    active_set (M,): `RowState` of each row to start with.
    """
    run = _ActiveSet(rows, active_set, rules)
    w, iterations = run.solve(max_iterations)
    return w, run.state, iterations


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
    """Solve levels: J (M, n) [rate/velocity], lower and upper (M,) [rate], gate and active_set
    (M,).

    sizes: rows of each level.
    """
    if not is_valid(J, lower, upper, gate):
        v = np.zeros(J.shape[1])
        nothing = np.zeros(len(lower))
        return SolvedRows(
            v=v,
            active_set=nothing,
            status=Status.INVALID_INPUT,
            residual=nothing.copy(),
            iterations=0,
        )
    rows = normal_rows(J, *widen_bounds(J, lower, upper, gate), sizes)
    # No run can mend entries that were lost to rounding: they are judged once, below.
    attempts = _Attempts(replace(rows, lost=NO_NEGLIGIBLE_ROWS))
    status = attempts.solve(active_set)
    v = attempts.w * rows.velocity
    if not _is_finite(v):
        v = np.zeros_like(v)
        status = Status.INEXACT
    if rows.lost.are_missed(v, rows.velocity):
        status = Status.INEXACT
    return SolvedRows(
        v=v,
        active_set=attempts.active_set,
        status=status,
        residual=residual(J, v, lower, upper, gate),
        iterations=iteration_budget(len(J)).most_of_all - attempts.left,
    )


class _Attempts:
    """All runs of one call, and the best result so far: w (n,) in normal units, and its active set
    (M,).
    """

    def __init__(self, rows: NormalRows) -> None:
        self.rows = rows
        self.left = iteration_budget(len(rows.J)).most_of_all
        self.w = np.zeros(rows.J.shape[1])
        self.active_set = np.zeros(len(rows.J))
        self._levels = [
            level_rows
            for level_rows in row_slices(rows.sizes)
            if level_rows.stop > level_rows.start
        ]
        self._missed: Array | None = None
        self._near = tolerances.TOUCHING * (1.0 + np.abs(rows.J).sum(axis=1))

    def solve(self, active_set: Array) -> Status:
        """Try warm, cold and level-by-level runs in turn until a result is certified."""
        if self._is_proven(*self._run(self.rows, active_set)):
            return Status.SOLVED
        if active_set.any() and self._is_proven(*self._run(self.rows)):
            return Status.COLD_STARTED
        certified = self._by_levels(ORDINARY) or self._by_levels(CAREFUL) or self._by_fewer_levels()
        if certified:
            return Status.CASCADED
        return Status.INEXACT

    def _run(
        self, rows: NormalRows, active_set: Array | None = None, rules: PivotRules = ORDINARY
    ) -> tuple[Array, Array]:
        if active_set is None:
            start = np.zeros(len(rows.J))
        else:
            start = active_set
        w, reached, iterations = lexicographic_least_squares(rows, start, rules, self.left)
        self.left -= iterations
        return w, reached

    def _by_levels(self, rules: PivotRules) -> bool:
        """Solve each level with those above held, then run all levels from the rows that this
        touches.
        """
        w = np.zeros(self.rows.J.shape[1])
        for level_rows in self._levels:
            if self.left <= 0:
                break
            # Rows above may miss their bounds as much as at w, and those below are free.
            y = self.rows.J @ w
            free = self._without(level_rows.stop)
            above = np.arange(len(self.rows.J)) < level_rows.start
            lower = np.where(above, np.minimum(y, self.rows.lower), free.lower)
            upper = np.where(above, np.maximum(y, self.rows.upper), free.upper)
            candidate, _ = self._run(replace(free, lower=lower, upper=upper), rules=rules)
            y = self.rows.J @ candidate
            is_kept = (y >= lower - self._near) & (y <= upper + self._near)
            if _is_finite(candidate) and is_kept[above].all():
                w = candidate
        y = self.rows.J @ w
        touched = np.zeros(len(y))
        touched[y <= self.rows.lower + self._near] = -1.0
        touched[y >= self.rows.upper - self._near] = 1.0
        return self._is_proven(w, touched) or self._is_proven(*self._run(self.rows, touched, rules))

    def _by_fewer_levels(self) -> bool:
        """Solve as many of the first levels as can be solved: the lowest are given up first."""
        for given_up in reversed(self._levels[1:]):
            if self.left <= 0:
                break
            fewer = self._without(given_up.start)
            w, active_set = self._run(fewer)
            if np.isfinite(w).all() and normal_certificate(fewer, w) <= tolerances.CERTIFIED:
                return self._is_proven(w, active_set)
        return False

    def _without(self, end: int) -> NormalRows:
        """Return the rows with infinite bounds from row `end` on."""
        is_before = np.arange(len(self.rows.J)) < end
        lower = np.where(is_before, self.rows.lower, -np.inf)
        upper = np.where(is_before, self.rows.upper, np.inf)
        return replace(self.rows, lower=lower, upper=upper)

    def _is_proven(self, w: Array, active_set: Array) -> bool:
        """Check whether a result is certified; else keep it if it is the best so far: at the first
        level that differs by more than rounding.
        """
        if not _is_finite(w):
            return False
        slack = interval_distance(self.rows.J @ w, self.rows.lower, self.rows.upper)
        missed = np.array([np.linalg.norm(slack[level_rows]) for level_rows in self._levels])
        best = self._missed
        proven = normal_certificate(self.rows, w) <= tolerances.CERTIFIED
        if proven or best is None or _is_better(missed, best):
            self.w = w
            self.active_set = active_set
            self._missed = missed
        return proven


def _is_better(missed: Array, best: Array) -> bool:
    """Check whether the norms of residuals (levels,) are less than the best at the first level
    where they differ by more than rounding.
    """
    differing = np.flatnonzero(np.abs(missed - best) > tolerances.TIED * (1.0 + best))
    if differing.size == 0:
        return False
    first = differing[0]
    return bool(missed[first] < best[first])


def _is_finite(w: Array) -> bool:
    return bool((np.abs(w) < tolerances.ENDLESS).all())
