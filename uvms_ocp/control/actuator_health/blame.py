"""Which thruster the residual wrench of the last seconds blames: how much of its changes the thrust asked of it explains.

Thruster i that gives ``(1 - theta) T_i + c`` in place of T_i leaves ``b_i (c - theta T_i)`` in the residual: along one known
direction, as its command goes, and at the same time. Water, loads and the floor push along others, and what is asked
follows them late, so that little of what they do is explained by any thruster, and about as much by several. The ratio of
what is left is that of likelihoods of an additive fault of unknown size ([Willsky1976]).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning

_TINY = 1e-12
_sum, _largest = partial(np.add.reduce, axis=0), np.maximum.reduce  # the methods take twice the time
_PLAUSIBLE = (0.25, 3.5)  # theta; a thruster that sticks far from what is asked looks like more than 2 at first
_LATE = (0, 1, 2)  # looks by which what is measured of the motion may lag what is asked
_EARLY = (2, 4)  # looks by which what is asked lags what pushes, where it only answers it


@dataclass(frozen=True, kw_only=True, slots=True)
class Blame:
    """The likeliest culprit."""

    thruster: int
    """[-] counted from 0; -1 where none explains enough."""
    explained: float
    """[-] share of the changes."""
    lead: float
    """[-] what the next best leaves unexplained, over what this one does."""


NOBODY = Blame(thruster=-1, explained=0.0, lead=1.0)


class BlameWindow:
    """What was seen lately. Holds it: one per run."""

    def __init__(self, matrix: np.ndarray, scale: np.ndarray, tuning: ActuatorHealthTuning, *, period: float) -> None:
        """matrix (6, n) [N/N, N m/N] of the thrusters; scale (6,) [N, N m]: what counts as one on each axis; period [s] of
        the looks."""
        n = matrix.shape[1]
        self._directions, self._scale, self._tuning = matrix / scale[:, None], scale, tuning
        self._square = np.sum(self._directions**2, axis=0)
        self._length = max(round(tuning.window / period), 4)
        self._size = 2 * self._length + max(_LATE) + max(_EARLY)
        self._seen, self._asked = np.zeros((2 * self._size, 6)), np.zeros((2 * self._size, n))
        self._time, self._count = np.zeros(2 * self._size), 0

    def clear(self) -> None:
        """Forget everything."""
        self._count = 0

    def look(self, residual: np.ndarray, asked: np.ndarray, t: float) -> None:
        """Take in the residual (6,) [N, N m] and the thrust asked (n,) [N], as it should be in it, at time t [s]."""
        first = self._count % self._size
        for k in (first, first + self._size):  # twice: any stretch is in one piece
            self._seen[k], self._asked[k], self._time[k] = residual / self._scale, asked, t
        self._count += 1

    def blame(self) -> Blame:
        """Of the last `window` seconds, or of half of it at the beginning."""
        now = max(_EARLY)
        n = min(self._length, self._count - max(_LATE) - now)
        if n < self._length // 2:
            return NOBODY
        seen = self._last(self._seen, n, now)
        seen = seen - _sum(seen) / n
        total = float(np.vdot(seen, seen))
        if total < n * self._tuning.least_change**2:
            return NOBODY
        along = seen @ self._directions
        causes = [self._explained(along, now + late) for late in _LATE]
        blame = _leader(total, max(causes, key=_largest))
        if blame.explained < self._tuning.explained or blame.lead < self._tuning.lead:
            return NOBODY
        answers = [self._explained(along, now - early)[blame.thruster] for early in _EARLY]
        precedes = total - max(answers) >= self._tuning.precedes * (1.0 - blame.explained) * total
        return blame if precedes else NOBODY

    def history(self, thruster: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All that is kept, (m,): times [s], thrust asked [N], thrust [N] along the thruster that the residual comes to."""
        m, b = min(self._count, self._size), self._directions[:, thruster]
        along = self._last(self._seen, m) @ b / max(float(self._square[thruster]), _TINY)
        return self._last(self._time, m), self._last(self._asked, m)[:, thruster], along

    def _last(self, array: np.ndarray, n: int, before: int = 0) -> np.ndarray:
        end = (self._count - 1) % self._size + self._size + 1 - before
        return array[end - n : end]

    def _explained(self, along: np.ndarray, before: int) -> np.ndarray:
        """Of the sum of squares, by each thruster (n,), by what it was asked so many looks before now."""
        asked = self._last(self._asked, len(along), before)
        asked = asked - _sum(asked) / len(along)
        size = np.maximum(self._square * np.einsum("ti,ti->i", asked, asked), _TINY)
        theta = -np.einsum("ti,ti->i", asked, along) / size
        return np.where((theta > _PLAUSIBLE[0]) & (theta < _PLAUSIBLE[1]), theta**2 * size, 0.0)


def _leader(total: float, explained: np.ndarray) -> Blame:
    best = int(explained.argmax())
    left = max(total - float(explained[best]), _TINY * total)
    others = explained.copy()
    others[best] = 0.0
    lead = (total - float(_largest(others))) / left
    return Blame(thruster=best, explained=1.0 - left / total, lead=lead)
