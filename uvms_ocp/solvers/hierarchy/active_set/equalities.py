"""The algorithm of equalities.c in NumPy: least squares of the active rows, level by level; keep both in step.

`[rate]` is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.hierarchy.active_set.codes import EQUAL, FREE, LOWER
from uvms_ocp.solvers.hierarchy.level import row_slices
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES


@dataclass(frozen=True, slots=True)
class Manner:
    """Which rows are too dependent to be pivots, and which multipliers are rounding."""

    rank_tolerance: float
    """[-] `Tolerances.rank_tolerance`."""
    rank_noise: float
    """[-] `Tolerances.rank_noise`."""
    multiplier: float
    """[-] `Tolerances.multiplier`."""


ORDINARY = Manner(TOLERANCES.rank_tolerance, TOLERANCES.rank_noise, TOLERANCES.multiplier)
CAREFUL = Manner(TOLERANCES.careful_rank, TOLERANCES.careful_noise, TOLERANCES.careful_multiplier)


@dataclass(slots=True, eq=False)
class Work:
    """What a run works on: M rows, n velocities."""

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
    """(M,) [-] `RowState` of each row."""
    v: Array
    """(n,) [velocity] where the run is."""
    tabu: Array
    """(M,) [-] True for rows that must not be dropped any more."""
    manner: Manner
    """Of the run."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Active rows of one level, pivots first, in the coordinates of the factorisation."""

    rows: Array
    """(m,) [-] their numbers."""
    T: Array
    """(m, n) [rate/velocity]"""
    column: int
    """First coordinate that the levels above left free."""
    rank: int
    """Number of pivots."""
    smallest: float
    """[-] Least independent part of any pivot so far, relative to its row."""


@dataclass(frozen=True, slots=True, eq=False)
class Equalities:
    """The hierarchy of the active rows, solved."""

    blocks: list[Block]
    """One per level."""
    target: Array
    """(n,) [velocity] of least norm among the optima."""
    slack: Array
    """(M,) [rate] by how much active rows miss their bound there."""


def load(J: Array, lower: Array, upper: Array, state: Array, sizes: Sequence[int], manner: Manner = ORDINARY) -> Work:
    """A run that starts with the rows of ``state`` (M,) [-] active, as far as their bounds are finite.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate]; sizes: rows of each level.
    """
    norm = np.sqrt((J * J).sum(axis=1))
    size = np.fmax(_size(lower), _size(upper))
    given = np.sign(state)
    given[((given > 0) & (upper == np.inf)) | ((given < 0) & (lower == -np.inf))] = FREE
    # A flag of equality must never be inherited: the row may have become an inequality.
    given[lower >= upper] = EQUAL
    return Work(
        A=J,
        lower=lower,
        upper=upper,
        norm=norm,
        tolerance=TOLERANCES.feasible * (norm + size),
        levels=list(row_slices(sizes)),
        state=given,
        v=np.zeros(J.shape[1]),
        tabu=np.zeros(len(J), dtype=bool),
        manner=manner,
    )


def _size(bound: Array) -> Array:
    return np.where(np.abs(bound) < TOLERANCES.endless, np.abs(bound), 0.0)


def bounds_of(work: Work, rows: Array) -> Array:
    """(k,) [rate] the bound at which each of the active rows (k,) [-] is held."""
    return np.asarray(np.where(work.state[rows] == LOWER, work.lower[rows], work.upper[rows]))


def solve_equalities(work: Work) -> Equalities:
    """Least squares of the active rows, level by level."""
    n = work.A.shape[1]
    Q, y, slack, blocks, column = np.eye(n), np.zeros(n), np.zeros(len(work.A)), [], 0
    smallest = 1.0
    late: list[Array] = []
    for level in work.levels:
        rows = level.start + np.flatnonzero((work.state[level] != FREE) & (work.norm[level] > 0.0))
        if rows.size == 0:
            blocks.append(Block(rows, np.zeros((0, n)), column, 0, smallest))
        elif column == n:
            late.append(rows)
            blocks.append(Block(rows, work.A[rows], column, 0, smallest))
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
    return Equalities(blocks, target, slack)


def _reduced(work: Work, rows: Array, Q: Array, column: int, smallest: float) -> Block:
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
    return Block(order, T, column, rank, smallest)


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


def _solve_level(work: Work, block: Block, y: Array, slack: Array) -> None:
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
