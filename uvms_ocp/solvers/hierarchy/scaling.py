"""Rows in normal units: every level divided by its largest row, velocities by their size; scaling.c is the twin in C.

All divisors are powers of two, so that nothing is rounded. `[rate]` is the unit of a row, `[velocity]` that of an entry
of v; in normal units both are 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.hierarchy.level import Level, row_slices
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES
from uvms_ocp.solvers.intervals import distance, excess


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Box:
    """Velocities that the rows of the first level with one entry span: the velocity limits, where there are any."""

    lower: Array
    """(n,) [-] in normal units, -inf where no row is bounded on both sides."""
    upper: Array
    """(n,) [-] in normal units."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LostRows:
    """Rows that count as nothing beside the largest, as they were given."""

    J: Array
    """(k, n) [rate/velocity]"""
    lower: Array
    """(k,) [rate]"""
    upper: Array
    """(k,) [rate]"""

    def are_missed(self, v: Array, velocity: float) -> bool:
        """Whether one of them could be noticeably nearer to its bounds than at v (n,) [velocity].

        velocity [velocity]: the size of velocities.
        """
        if not len(self.J):
            return False
        missed = np.abs(distance(self.J @ v, self.lower, self.upper))
        nearer = np.minimum(missed, TOLERANCES.reach * velocity * _norms(self.J))
        return bool((nearer > np.maximum(TOLERANCES.unnoticed, TOLERANCES.certified * missed)).any())


NOTHING_LOST = LostRows(J=np.zeros((0, 0)), lower=np.zeros(0), upper=np.zeros(0))
"""Where all rows count."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NormalRows:
    """``lower <= J w <= upper`` with rows of J, and w, of the order of 1."""

    J: Array
    """(M, n) [-] 0 in rows that count as nothing beside the largest."""
    lower: Array
    """(M,) [-]"""
    upper: Array
    """(M,) [-]"""
    sizes: tuple[int, ...]
    """Rows of each level."""
    box: Box
    """Of the first level."""
    level: Array
    """(levels,) [rate/velocity] by which the rows of each level have been divided."""
    velocity: float
    """[velocity] v = velocity w."""
    unit: float
    """[-] What counts as much of a rate: the largest that any row asks for over the largest row of all levels, at most 1. It
    is less where rows that are small beside others ask for large velocities."""
    lost: LostRows
    """Rows that are 0 in `J` and were not."""

    def levels(self) -> list[Level]:
        """The rows as levels, for a solver."""
        return [Level(jacobian=self.J[r], lower=self.lower[r], upper=self.upper[r]) for r in row_slices(self.sizes)]


@np.errstate(over="ignore", invalid="ignore")  # what overflows is never called exact
def normal_rows(J: Array, lower: Array, upper: Array, sizes: Sequence[int]) -> NormalRows:
    """Of J (M, n) [rate/velocity] and gated bounds lower and upper (M,) [rate]; sizes: rows of each level.

    The size of velocities is the largest that a row asks for, or what the box of the first level allows if that is less.
    """
    norm = _norms(J)
    largest = norm.max(initial=0.0)
    real = norm > TOLERANCES.vanished * largest
    level = np.array([_power(norm[rows][real[rows]].max(initial=0.0)) for rows in row_slices(sizes)])
    divisor, lost = np.repeat(level, sizes), ~real & (norm > 0.0)
    lost_rows = LostRows(J=J[lost], lower=lower[lost], upper=upper[lost])
    asked = _asked(lower, upper, real) / largest if largest > 0.0 else 0.0
    J = np.where(real[:, None], J / divisor[:, None], 0.0)
    lower, upper = lower / divisor, upper / divisor
    first = next((size for size in sizes if size), 0)
    box = _box(J[:first], lower[:first], upper[:first])
    velocity = _velocity(_asked(lower, upper, real), box)
    box = Box(lower=box.lower / velocity, upper=box.upper / velocity)
    return NormalRows(
        J=J,
        lower=lower / velocity,
        upper=upper / velocity,
        sizes=tuple(sizes),
        box=box,
        level=level,
        velocity=velocity,
        unit=min(asked / velocity, 1.0) if asked > 0.0 else 1.0,
        lost=lost_rows,
    )


def _asked(lower: Array, upper: Array, real: Array) -> float:
    """How far 0 is from the bounds of any row that counts."""
    return float(excess(np.zeros(len(lower)), lower, upper)[real].max(initial=0.0))


def _norms(J: Array) -> Array:
    squares = (J * J).sum(axis=1)
    sound = (squares > TOLERANCES.small_square) & (squares < np.inf)
    return np.asarray(np.where(sound, np.sqrt(squares), np.abs(J).max(axis=1, initial=0.0)))


def _power(size: float) -> float:
    """The power of two above a size; 1 for 0."""
    return float(np.ldexp(1.0, min(int(np.frexp(size)[1]), 1023))) if 0.0 < size < np.inf else 1.0


def _velocity(asked: float, box: Box) -> float:
    allowed = float(np.maximum(-box.lower, box.upper).max())
    return _power(min(asked, allowed) if allowed > 0.0 else asked)


def _box(J: Array, lower: Array, upper: Array) -> Box:
    n = J.shape[1]
    low, up = np.full(n, -np.inf), np.full(n, np.inf)
    alone = ((J != 0.0).sum(axis=1) == 1) & (lower > -np.inf) & (upper < np.inf)
    for row in np.flatnonzero(alone):
        c = int(np.flatnonzero(J[row])[0])
        ends = sorted((lower[row] / J[row, c], upper[row] / J[row, c]))
        low[c], up[c] = max(low[c], ends[0]), min(up[c], ends[1])
    return Box(lower=low, upper=up)
