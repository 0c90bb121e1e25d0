"""How well two series agree: in time, in size and in their axes."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

EXPLAINED = 0.15
"""[-] of the motion, by which other axes must explain more."""
WAYS = tuple(
    np.diag(signs) @ np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
)
"""(3, 3) each: all ways to swap and turn axes."""
_LATEST = 1.5  # [s] offsets of clocks that are looked for
_SHIFTS = 0.05 * np.arange(-30, 31)  # [s] up to these
_LEAST = 20  # [-] samples
_LATE = 0.175  # [s] offsets that are told
_JUMP = 0.3  # [s] between offsets of the two halves
_AGREES, _BETTER = 0.6, 0.01  # [-] correlation from which on an offset is one, and by which it is better than others
_PARTED = 0.2  # [-] of it, by which two halves must disagree
_SCALE = 1.9  # [-] beyond which a factor is one of units: the least is that of knots
_UNITS = {180.0 / np.pi: "degrees", 1e3: "mm", 1e2: "cm"}
_CLOSE = 1.25  # [-] to the factor of a unit


def explained(seen: np.ndarray, wanted: np.ndarray) -> float:
    """Share [-] of the squares of wanted (m, 3) [any] that seen (m, 3) [any] has."""
    return 1.0 - float(((seen - wanted) ** 2).sum() / (wanted**2).sum())


def named(Q: np.ndarray) -> str:
    """Axes as Q (3, 3) [-] turns them, such as (y, -x, z)."""
    entries = [("-" if row.sum() < 0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in Q]
    return f"({', '.join(entries)})"


def told_factor(wanted: np.ndarray, seen: np.ndarray) -> str:
    """How much larger seen (m, k) [any] is than wanted (m, k) [any], and of which unit that is; empty where it may be equal.

    Whatever part of either is noise, the factor lies between the slopes of their magnitudes upon each other.
    """
    x, y = (np.linalg.norm(values, axis=1) for values in (wanted, seen))
    low, high = _slopes(x - x.mean(), y - y.mean())
    if low < _SCALE and high > 1 / _SCALE:
        return ""
    factor = float(np.sqrt(low * high))
    units = [told for one, unit in _UNITS.items() for told in _of_unit(factor, one, unit)]
    return f"{factor:.2g} times the rate of the {{}}: {(units or ['its units?'])[0]}"


def _slopes(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Of y upon x, and what that of x upon y says of it [-]; anything where they have nothing in common."""
    common = float(x @ y)
    if correlation(x, y) < _AGREES:
        return 0.0, np.inf
    return common / float(x @ x), float(y @ y) / common


def _of_unit(factor: float, one: float, unit: str) -> Iterator[str]:
    if 1 / _CLOSE < factor / one < _CLOSE:
        yield f"in {unit}?"
    if 1 / _CLOSE < factor * one < _CLOSE:
        yield f"is the other in {unit}?"


def told_late(late: float) -> str:
    """An offset late [s] in words; empty where it is none."""
    return (
        f"{abs(late):.2f} s {'late' if late > 0 else 'early'} against the rate of the {{}}" if abs(late) > _LATE else ""
    )


def offset(t: np.ndarray, wanted: np.ndarray, t_seen: np.ndarray, seen: np.ndarray) -> tuple[float, bool]:
    """By how much [s] seen comes after wanted, and whether that is so from beginning to end; 0 where they do not agree.

    Of wanted (m, k) [any] at t (m,) [s] and seen (n, k) [any] at t_seen (n,) [s], from magnitudes, which have no axes.
    """
    size, magnitude = np.linalg.norm(wanted, axis=1), np.linalg.norm(seen, axis=1)
    inside = np.flatnonzero((t > t_seen[0] + _LATEST) & (t < t_seen[-1] - _LATEST))
    if len(inside) < 2 * _LEAST:
        return 0.0, True
    whole, *halves = (
        np.array([correlation(size[part], np.interp(t[part] + shift, t_seen, magnitude)) for shift in _SHIFTS])
        for part in (inside, *np.array_split(inside, 2))
    )
    return float(_SHIFTS[_best(whole)]), not _differ(*halves)


def _best(agreement: np.ndarray) -> int:
    """Where it is largest; of swings that agree again a period later the nearest, and no offset where that does not matter."""
    middle = len(_SHIFTS) // 2
    if agreement.max() < max(_AGREES, agreement[middle] + _BETTER):
        return middle
    peaks = np.flatnonzero((agreement >= np.roll(agreement, 1)) & (agreement >= np.roll(agreement, -1)))
    good = peaks[agreement[peaks] > agreement.max() - _BETTER]
    return int(good[np.argmin(np.abs(_SHIFTS[good]))])


def _differ(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether each agrees at an offset at which the other does not."""
    a, b = _best(one), _best(other)
    parted = min(one[a] - one[b], other[b] - other[a]) > _PARTED
    return bool(parted and abs(_SHIFTS[a] - _SHIFTS[b]) > _JUMP)


def correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Of two series x (m,) [any] and y (m,) [any], from -1 to 1 [-]; 0 where one does not change."""
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y / max(np.linalg.norm(x) * np.linalg.norm(y), 1e-300))
