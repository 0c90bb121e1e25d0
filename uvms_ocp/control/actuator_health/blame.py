"""Which thrusters the residual wrench of the last seconds blames: how much of its changes their asked thrust explains.

Thruster i that gives ``(1 - theta) T_i + c`` in place of T_i leaves ``b_i (c - theta T_i)`` in the residual: along one known
direction, as its command goes, and at the same time. Water, loads and the floor push along others, and what is asked
follows them late, so that little of what they do is explained by any thruster, and about as much by several.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning

_TINY = 1e-12
_PLAUSIBLE = (0.25, 3.5)  # theta; a thruster that sticks far from what is asked looks like more than 2 at first
_LATE = (0, 1, 2)  # looks by which what is measured of the motion may lag what is asked
_EARLY = (2, 4)  # looks by which what is asked lags what pushes, where it only answers it


@dataclass(frozen=True, kw_only=True, slots=True)
class Blame:
    """The likeliest culprits."""

    thrusters: tuple[int, ...]
    """One, or two at once; none where nothing is explained well enough."""
    explained: float
    """[-] share of the changes."""
    lead: float
    """[-] what the next best leave unexplained, over what these do."""


NOBODY = Blame(thrusters=(), explained=0.0, lead=1.0)


class BlameWindow:
    """What was seen lately. Holds it: one per run."""

    def __init__(self, matrix: np.ndarray, scale: np.ndarray, tuning: ActuatorHealthTuning) -> None:
        """matrix (6, n) [N/N, N m/N] of the thrusters; scale (6,) [N, N m]: what counts as one on each axis."""
        n = matrix.shape[1]
        self._directions, self._tuning = matrix / scale[:, None], tuning
        self._alike = self._directions.T @ self._directions
        self._scale, self._pairs = scale, np.array([*itertools.combinations(range(n), 2)]).reshape(-1, 2)
        self._length = max(round(tuning.window / tuning.sample_time), 2)
        self._size = 2 * self._length + max(_LATE) + max(_EARLY)
        self._seen, self._asked = np.zeros((2 * self._size, 6)), np.zeros((2 * self._size, n))
        self._time, self._count = np.zeros(2 * self._size), 0

    def clear(self) -> None:
        """Forget everything."""
        self._count = 0

    def look(self, residual: np.ndarray, asked: np.ndarray, t: float) -> None:
        """Take in the residual (6,) [N, N m] and the thrust (n,) [N] that should be in it, at time t [s]."""
        for k in (
            self._count % self._size,
            self._count % self._size + self._size,
        ):  # twice: any stretch is in one piece
            self._seen[k], self._asked[k], self._time[k] = residual / self._scale, asked, t
        self._count += 1

    def blame(self) -> Blame:
        """Of the last `window` seconds, or of half of it at the beginning."""
        now = max(_EARLY)
        n = min(self._length, self._count - max(_LATE) - now)
        if n < self._length // 2:
            return NOBODY
        seen = self._last(self._seen, n, now)
        seen = seen - seen.mean(axis=0)
        total = float(np.vdot(seen, seen))
        if total < n * self._tuning.least_change**2:
            return NOBODY
        along = seen @ self._directions
        causes = [self._explained(along, self._last(self._asked, n, now + late)) for late in _LATE]
        one, two = max(causes, key=lambda pair: max(pair[0].max(), pair[1].max()))
        blame = self._judged(total, one, two)
        return blame if blame.thrusters and self._precedes(blame, total, along) else NOBODY

    def _precedes(self, blame: Blame, total: float, along: np.ndarray) -> bool:
        """Whether what the culprits were asked explains what was seen better than what they were asked afterwards."""
        n, now = len(along), max(_EARLY)
        answers = [self._explained(along, self._last(self._asked, n, now - early)) for early in _EARLY]
        left = [total * (1.0 - blame.explained)]
        pair = np.flatnonzero((self._pairs == blame.thrusters).all(axis=1)) if len(blame.thrusters) > 1 else None
        for one, two in answers:
            left.append(total - float(one[blame.thrusters[0]] if pair is None else two[pair[0]]))
        return min(left[1:]) >= self._tuning.precedes * left[0]

    def history(self, thruster: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All that is kept, (m,): times [s], thrust asked [N], thrust [N] along the thruster that the residual comes to."""
        m = min(self._count, self._size)
        b = self._directions[:, thruster]
        along = self._last(self._seen, m) @ b / max(float(b @ b), _TINY)
        return self._last(self._time, m), self._last(self._asked, m)[:, thruster], along

    def _last(self, array: np.ndarray, n: int, late: int = 0) -> np.ndarray:
        end = (self._count - 1) % self._size + self._size + 1 - late
        return array[end - n : end]

    def _explained(self, along: np.ndarray, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the sum of squares: by each thruster (n,), by each pair of thrusters."""
        asked = asked - asked.mean(axis=0)
        G, h = self._alike * (asked.T @ asked), -np.einsum("ti,ti->i", asked, along)
        own = np.maximum(np.diag(G), _TINY)
        one = np.where(_plausible(h / own), h * h / own, 0.0)
        i, j = self._pairs.T
        determinant = np.maximum(own[i] * own[j] - G[i, j] ** 2, _TINY * own[i] * own[j] + _TINY)
        theta_i, theta_j = (
            (h[i] * own[j] - h[j] * G[i, j]) / determinant,
            (h[j] * own[i] - h[i] * G[i, j]) / determinant,
        )
        possible = _plausible(theta_i) & _plausible(theta_j) & (determinant > 1e-3 * own[i] * own[j])
        return one, np.where(possible, theta_i * h[i] + theta_j * h[j], 0.0)

    def _judged(self, total: float, one: np.ndarray, two: np.ndarray) -> Blame:
        for explained, sets in ((one, np.arange(len(one))[:, None]), (two, self._pairs)):
            best = int(explained.argmax()) if len(explained) else -1
            if best < 0 or explained[best] < self._tuning.explained * total:
                continue
            left = max(total - float(explained[best]), _TINY * total)
            lead = (total - float(np.delete(explained, best).max(initial=0.0))) / left
            if lead >= self._tuning.lead:
                return Blame(thrusters=tuple(sets[best].tolist()), explained=1.0 - left / total, lead=lead)
        return NOBODY


def _plausible(theta: np.ndarray) -> np.ndarray:
    return (theta > _PLAUSIBLE[0]) & (theta < _PLAUSIBLE[1])
