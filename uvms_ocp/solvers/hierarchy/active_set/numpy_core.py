"""The algorithm of equalities.c and active_set.c in NumPy, for machines without a C compiler; keep both in step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from uvms_ocp.solvers.hierarchy.level import Array, row_slices

_RANK_TOLERANCE = 1e-8
# Directions carry the rounding error of their own pivot: a small pivot makes dependent rows look independent.
_RANK_NOISE = 1e-14
# Rows smaller than this part of the largest row are what is left of a cancellation: nothing.
_VANISHED = 1e-13
_FEASIBLE = 1e-12
_CONSISTENT = 1e-10
_BALANCED = 5e-8
# Pivots below _CLEAR and dependent rows above _NOTHING leave open what depends on what.
_CLEAR, _NOTHING = 1e-5, 1e-11
# Largest over smallest row; beyond, what is rounding to one row decides about another.
_EVEN = 1e3
# Of a multiplier, relative to _MULTIPLIER.
_DECISIVE = 1e4
_WEAKLY, _FIRMLY = 1, 2
# Far below _FEASIBLE: else a row dropped for the sake of lower levels blocks at once for the sake of this slack.
_SIGNIFICANT = 1e-14
_MOVED = 1e-9
_MULTIPLIER = 1e-10
# Multipliers smaller than this are rounding, however small the slack they balance.
_WRONG = 1e-12
_FREE, _LOWER, _UPPER, _EQUAL = 0, -1, 1, 2


class Outcome(IntEnum):
    """Of one run, as in equalities.c."""

    SOLVED = 0
    STALLED = 1
    LIMIT = 2
    DOUBTFUL = 3
    INVALID = 4


class _Rule(IntEnum):
    GREEDY = 0
    BLAND = 1
    TABU = 2


@dataclass(slots=True, eq=False)
class _Work:
    A: Array
    lower: Array
    upper: Array
    norm: Array
    tolerance: Array
    levels: list[slice]
    state: Array
    v: Array
    tabu: Array
    skipped: bool = False
    unbalanced: float = 0.0
    contradicted: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Active rows of one level, pivots first, in the coordinates of the factorisation."""

    rows: Array
    T: Array
    column: int
    rank: int
    smallest: float
    """Least independent part of any pivot so far, relative to its row."""
    rejected: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Equalities:
    blocks: list[_Block]
    target: Array
    slack: Array
    rejected: float
    """Largest independent part of a row taken for dependent, relative to the row."""


def lexicographic_least_squares(
    J: Array, lower: Array, upper: Array, state: Array, sizes: Sequence[int]
) -> tuple[Array, Array, Outcome, int]:
    """v (n,), active set (M,), outcome and number of iterations; see active_set.c for the algorithm."""
    work = _load(J, lower, upper, state, sizes)
    equalities = _solve_equalities(work)
    work.v = equalities.target
    pending, stalled, rule = _activate_violated(work), 0, _Rule.GREEDY
    dropped = -1
    limit = 20 + 10 * len(J)
    for iteration in range(1, limit + 1):
        if pending:
            equalities = _solve_equalities(work)
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
            outcome = Outcome.SOLVED if _is_consistent(work, equalities) else Outcome.DOUBTFUL
            return work.v, work.state, Outcome.STALLED if work.skipped else outcome, iteration
        stalled += 1
        rule = _rule(stalled, iteration, len(J), rule)
        if rule is _Rule.TABU:
            work.tabu[dropped] = True
        pending = True
    return work.v, work.state, Outcome.LIMIT, limit


def _is_consistent(work: _Work, equalities: _Equalities) -> bool:
    """True if v and the multipliers do what the factorisation promised; false where that cannot be known."""
    rejected, smallest = equalities.rejected, equalities.blocks[-1].smallest
    if _is_uneven(work.norm) or work.contradicted or smallest < _CLEAR or rejected > _NOTHING:
        return False
    if not work.unbalanced <= _BALANCED:
        return False
    rows = np.concatenate([block.rows for block in equalities.blocks])
    error = work.A[rows] @ work.v - _bound(work, rows) - equalities.slack[rows]
    return bool((np.abs(error) <= _CONSISTENT / _FEASIBLE * work.tolerance[rows]).all())


def _is_uneven(norm: Array) -> bool:
    real = norm[norm > 0.0]
    return real.size > 0 and bool(real.max() > _EVEN * real.min())


def _rule(stalled: int, iteration: int, rows: int, rule: _Rule) -> _Rule:
    if stalled > 2 * rows or iteration > 20 + 3 * rows:
        return _Rule.TABU
    return _Rule.BLAND if stalled > rows // 2 + 10 else rule


def _load(J: Array, lower: Array, upper: Array, state: Array, sizes: Sequence[int]) -> _Work:
    norm = np.sqrt((J * J).sum(axis=1))
    size = np.fmax(np.where(np.isinf(lower), 0.0, np.abs(lower)), np.where(np.isinf(upper), 0.0, np.abs(upper)))
    given = np.sign(state)
    given[((given > 0) & (upper == np.inf)) | ((given < 0) & (lower == -np.inf))] = _FREE
    # A flag of equality must never be inherited: the row may have become an inequality.
    given[lower >= upper] = _EQUAL
    return _Work(
        A=J,
        lower=lower,
        upper=upper,
        norm=np.where(norm <= _VANISHED * norm.max(initial=0.0), 0.0, norm),
        tolerance=_FEASIBLE * (norm + size),
        levels=list(row_slices(sizes)),
        state=given,
        v=np.zeros(J.shape[1]),
        tabu=np.zeros(len(J), dtype=bool),
    )


def _bound(work: _Work, rows: Array) -> Array:
    return np.where(work.state[rows] == _LOWER, work.lower[rows], work.upper[rows])


def _solve_equalities(work: _Work) -> _Equalities:
    n = work.A.shape[1]
    Q, y, slack, blocks, column = np.eye(n), np.zeros(n), np.zeros(len(work.A)), [], 0
    smallest = 1.0
    late: list[Array] = []
    for level in work.levels:
        rows = level.start + np.flatnonzero((work.state[level] != _FREE) & (work.norm[level] > 0.0))
        if rows.size == 0:
            blocks.append(_Block(rows, np.zeros((0, n)), column, 0, smallest))
        elif column == n:
            late.append(rows)
            blocks.append(_Block(rows, work.A[rows], column, 0, smallest))
        else:
            block = _reduced(work, rows, Q, column, smallest)
            _solve_level(work, block, y, slack)
            blocks.append(block)
            column, smallest = column + block.rank, block.smallest
    target = Q @ y
    for rows in late:
        slack[rows] = work.A[rows] @ target - _bound(work, rows)
    # Rows to which nothing is left lend only the sum of their gradients, in the same coordinates.
    rejected = max(block.rejected for block in blocks)
    blocks = [replace(b, T=b.T @ Q) if b.column == n else b for b in blocks]
    return _Equalities(blocks, target, slack, rejected)


def _reduced(work: _Work, rows: Array, Q: Array, column: int, smallest: float) -> _Block:
    """Pivoted Householder reduction in the space that the levels above left free; turns Q[:, column:]."""
    T, order, n = work.A[rows] @ Q, rows.copy(), Q.shape[1]
    norm, rank, rejected = work.norm[rows], 0, 0.0
    while rank < len(T) and column + rank < n:
        c = column + rank
        part = (T[rank:, c:] ** 2).sum(axis=1) / norm[rank:] ** 2
        best = int(np.argmax(part))
        if part[best] <= max(_RANK_TOLERANCE, _RANK_NOISE / smallest) ** 2:
            rejected = float(np.sqrt(part[best]))
            break
        smallest = min(smallest, float(np.sqrt(part[best])))
        best += rank
        if best != rank:
            swap, back = [rank, best], [best, rank]
            T[swap], order[swap], norm[swap] = T[back], order[back], norm[back]
        _reflect(T, Q, rank, c)
        rank += 1
    return _Block(order, T, column, rank, smallest, rejected)


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


def _solve_level(work: _Work, block: _Block, y: Array, slack: Array) -> None:
    c0, c1 = block.column, block.column + block.rank
    target = _bound(work, block.rows) - block.T[:, :c0] @ y[:c0]
    B = block.T[:, c0:c1]
    if block.rank == len(B):
        y[c0:c1] = np.linalg.solve(B, target)
        return
    if block.rank > 0:
        orthogonal, R = np.linalg.qr(B)
        y[c0:c1] = np.linalg.solve(R, orthogonal.T @ target)
    slack[block.rows] = B @ y[c0:c1] - target


def _activate_violated(work: _Work) -> bool:
    y, free = work.A @ work.v, work.state == _FREE
    above = free & (y > work.upper + work.tolerance)
    below = free & (y < work.lower - work.tolerance)
    work.state[above], work.state[below] = _UPPER, _LOWER
    return bool(above.any() or below.any())


def _step(work: _Work, target: Array) -> tuple[bool, int]:
    """Goes to ``target`` until a free row blocks, which becomes active; whether v moved, and that row or -1."""
    end, free = work.A @ target, work.state == _FREE
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
    work.state[row] = _UPPER if above[row] else _LOWER
    return _has_moved(before, work.v), int(row)


def _has_moved(before: Array, after: Array) -> bool:
    return bool(np.abs(after - before).max() > _MOVED * max(1.0, np.abs(after).max()))


def _drop_row(work: _Work, equalities: _Equalities, rule: _Rule) -> int:
    decided, work.skipped, work.unbalanced = np.zeros(len(work.A), dtype=int), False, 0.0
    work.contradicted = False
    for level in range(len(work.levels)):
        row = _wrong_row(work, equalities, level, rule, decided)
        if row >= 0:
            work.state[row] = _FREE
            return row
    return -1


def _wrong_row(work: _Work, equalities: _Equalities, level: int, rule: _Rule, decided: Array) -> int:
    """The worst row by its multiplier at this level, -1 where all signs hold."""
    own = equalities.blocks[level]
    slack = equalities.slack[own.rows]
    scale = float(np.abs(slack) @ work.norm[own.rows])
    # A slack that an exact solution could not tell from zero decides nothing for the levels below.
    significant = np.abs(slack) > _SIGNIFICANT / _FEASIBLE * work.tolerance[own.rows]
    if not significant.any():
        return -1
    balance = slack @ work.A[own.rows]
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
        balance = balance + multiplier @ work.A[rows[-1]]
    work.unbalanced = max(work.unbalanced, float(np.sqrt(balance @ balance)) / (scale + 1.0))
    return _worst(
        work, np.concatenate(rows), np.concatenate(multipliers), max(_MULTIPLIER * scale, _WRONG), rule, decided
    )


def _worst(work: _Work, rows: Array, multipliers: Array, tolerance: float, rule: _Rule, decided: Array) -> int:
    value = multipliers * work.state[rows] * work.norm[rows]
    work.contradicted |= bool(((decided[rows] == _WEAKLY) & (value < -tolerance)).any())
    value = np.where((work.state[rows] != _EQUAL) & (decided[rows] == 0), value, 0.0)
    decided[rows[value > tolerance]] = _WEAKLY
    decided[rows[value > _DECISIVE * tolerance]] = _FIRMLY
    wrong = value < -tolerance
    work.skipped |= bool((wrong & work.tabu[rows]).any())
    wrong &= ~work.tabu[rows]
    if not wrong.any():
        return -1
    if rule is _Rule.GREEDY:
        return int(rows[np.argmin(np.where(wrong, value, 0.0))])
    return int(rows[wrong].min())
