"""The wrench that holds the robot still, averaged once it has settled after a fault."""

from __future__ import annotations

import numpy as np


class Balance:
    """Mean over the second half of a wait. Holds what was seen: one per run."""

    def __init__(self, wait: float) -> None:
        """wait [s] from a verdict to a judgement."""
        self._wait, self._began = wait, 0.0
        self._sum, self._count = np.zeros(6), 0
        self.runs = False
        """Whether there is anything to wait for."""

    def begin(self, t: float) -> None:
        """Anew, at time t [s]."""
        self._began, self.runs = t, True
        self._sum, self._count = np.zeros(6), 0

    def clear(self) -> None:
        """What was seen is not to be trusted: wait anew, from the next look on."""
        self._began, self._sum, self._count = np.inf, np.zeros(6), 0

    def take_in(self, wrench: np.ndarray, t: float) -> np.ndarray | None:
        """A wrench (6,) [N, N m] at time t [s]; the mean (6,) where it is time to judge."""
        self._began = min(self._began, t)
        if t - self._began > 0.5 * self._wait:
            self._sum, self._count = self._sum + wrench, self._count + 1
        if t - self._began < self._wait or not self._count:
            return None
        self.runs = False
        return self._sum / self._count
