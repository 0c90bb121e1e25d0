"""Weights that keep the step of a level near the point at which its rows were linearised.

The first level has none: what it wants is worth a full step. Those below move what the levels above leave free, which is
most of the variables and nearly flat for each of them, so that without a weight their steps are as long as the
linear model says and longer than it holds. A weight rises where only a share of the step could be taken, and falls slowly
back while whole steps are taken.
"""

from __future__ import annotations

import numpy as np

_RISE, _FALL = 5.0, 0.5
_MOST = 3e3  # times the least


class ProximalWeights:
    """Of the levels of one program; carried from one solve to the next."""

    def __init__(self, n_levels: int, least: float) -> None:
        """least [1/unit of x^2]: of all levels but the first, whose weight is 0."""
        self._least = np.full(n_levels, least)
        self._least[:1] = 0.0
        self._now = self._least.copy()

    def __getitem__(self, level: int) -> float:
        """[1/unit of x^2]"""
        return float(self._now[level])

    def adapt(self, level: int, share: float) -> None:
        """After `share` [-] of the level's step could be taken."""
        factor = _FALL if share == 1 else _RISE
        least = self._least[level]
        self._now[level] = np.clip(factor * self._now[level], least, _MOST * least)
