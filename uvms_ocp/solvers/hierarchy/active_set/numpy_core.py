"""The algorithm of active_set.c in NumPy, for machines without a C compiler; keep both in step.

`[rate]` is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.hierarchy.active_set.codes import EQUAL, FREE, LOWER, UPPER
from uvms_ocp.solvers.hierarchy.active_set.equalities import Equalities, Manner, Work, load, solve_equalities
from uvms_ocp.solvers.hierarchy.active_set.patience import Patience, patience
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES


class _Rule(IntEnum):
    GREEDY = 0
    BLAND = 1
    TABU = 2


def lexicographic_least_squares(
    J: Array, lower: Array, upper: Array, state: Array, sizes: Sequence[int], manner: Manner, left: int
) -> tuple[Array, Array, int]:
    """v (n,) [velocity], active set (M,) and number of iterations, ``left`` at most; see active_set.c for the algorithm.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate], all in normal units (`scaling`); state (M,) [-]: `RowState` of
    each row to start with. A run does not judge its own result.
    """
    work = load(J, lower, upper, state, sizes, manner)
    equalities = solve_equalities(work)
    work.v = equalities.target
    pending, stalled, rule = _activate_violated(work), 0, _Rule.GREEDY
    dropped = -1
    given = patience(len(J))
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


def _rule(stalled: int, iteration: int, given: Patience, rule: _Rule) -> _Rule:
    if stalled > given.tabu_stalls or iteration > given.tabu_iterations:
        return _Rule.TABU
    return _Rule.BLAND if stalled > given.bland_stalls else rule


def _activate_violated(work: Work) -> bool:
    y, free = work.A @ work.v, work.state == FREE
    above = free & (y > work.upper + work.tolerance)
    below = free & (y < work.lower - work.tolerance)
    work.state[above], work.state[below] = UPPER, LOWER
    return bool(above.any() or below.any())


def _step(work: Work, target: Array) -> tuple[bool, int]:
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
    return bool(np.abs(after - before).max() > TOLERANCES.moved * max(1.0, np.abs(after).max()))


def _drop_row(work: Work, equalities: Equalities, rule: _Rule) -> int:
    decided = np.zeros(len(work.A), dtype=bool)
    for level in range(len(work.levels)):
        row = _wrong_row(work, equalities, level, rule, decided)
        if row >= 0:
            work.state[row] = FREE
            return row
    return -1


def _wrong_row(work: Work, equalities: Equalities, level: int, rule: _Rule, decided: Array) -> int:
    """The worst row by its multiplier at this level, -1 where all signs hold."""
    own = equalities.blocks[level]
    slack = equalities.slack[own.rows]
    scale = float(np.abs(slack) @ work.norm[own.rows])
    # A slack that an exact solution could not tell from zero decides nothing for the levels below.
    significant = np.abs(slack) > TOLERANCES.significant / TOLERANCES.feasible * work.tolerance[own.rows]
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
    tolerance = max(work.manner.multiplier * scale, TOLERANCES.wrong)
    return _worst(work, np.concatenate(rows), np.concatenate(multipliers), tolerance, rule, decided)


def _worst(work: Work, rows: Array, multipliers: Array, tolerance: float, rule: _Rule, decided: Array) -> int:
    value = multipliers * work.state[rows] * work.norm[rows]
    value = np.where((work.state[rows] != EQUAL) & ~decided[rows], value, 0.0)
    decided[rows[value > tolerance]] = True
    wrong = (value < -tolerance) & ~work.tabu[rows]
    if not wrong.any():
        return -1
    if rule is _Rule.GREEDY:
        return int(rows[np.argmin(np.where(wrong, value, 0.0))])
    return int(rows[wrong].min())
