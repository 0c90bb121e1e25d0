"""The last measurements, to ask what was estimated when a late reading was taken."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np


class Estimate(NamedTuple):
    """Where the robot was taken to be at one tick."""

    t: float
    """[s]"""
    q: np.ndarray
    """(n_q,) [m, rad]"""
    v: np.ndarray
    """(n_v,) [m/s, rad/s]"""


class History:
    """Estimates of the last `length` [s]."""

    def __init__(self, length: float) -> None:
        """length [s]: the longest delay of a reading that is asked about."""
        self._length = length
        self._kept: deque[Estimate] = deque()

    def add(self, t: float, q: np.ndarray, v: np.ndarray) -> None:
        """Keep the estimate at time t [s]: q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s]."""
        self._kept.append(Estimate(t, q, v))
        while self._kept[0].t < t - self._length:
            self._kept.popleft()

    def at(self, t: float) -> Estimate | None:
        """The estimate that was made nearest to time t [s]; `None` before the first."""
        if not self._kept:
            return None
        if t >= self._kept[-1].t:
            return self._kept[-1]
        low, high = 0, len(self._kept) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self._kept[middle].t <= t else (low, middle)
        return min(self._kept[low], self._kept[high], key=lambda kept: abs(kept.t - t))
