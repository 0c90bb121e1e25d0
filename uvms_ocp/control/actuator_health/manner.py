"""In which manner a thruster fails, and since when: every onset of late, against a share and against no answer at all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_AFTER = 6  # looks that an onset must be back at least
_TINY = 1e-12
_REVERSED = 0.5  # share, the other way, from which a thruster counts as reversed; one that sticks may look like less
_STUCK = 0.1  # of what a dead thruster would leave unexplained


@dataclass(frozen=True, kw_only=True, slots=True)
class Manner:
    """The likeliest, of one thruster."""

    share: float
    """[-] that it gives of what it is asked, from now on; 0 where it does not follow."""
    constant: float
    """[N] that it gives instead, where it does not follow."""
    sigma: float
    """[N] of the constant."""
    onset: float
    """[s]"""


def manner_of(t: np.ndarray, asked: np.ndarray, along: np.ndarray, bandwidth: float, follows: float) -> Manner:
    """From times t (m,) [s], thrust asked (m,) [N] as filtered with bandwidth [rad/s], and the residual along it (m,) [N].

    follows [-]: least share of a thruster that follows its command.
    """
    shares, stops, deaths = [], [], []
    for k in range(max(len(t) - _AFTER, 1)):
        faded = np.where(np.arange(len(t)) >= k, np.exp(-bandwidth * np.maximum(t - t[k], 0.0)), 1.0)
        lost = np.where(faded < 1.0, asked - asked[k] * faded, 0.0)
        shares.append((*_line(-lost, along), float(t[k])))
        stops.append((*_line(1.0 - faded, along + lost), float(t[k])))
        deaths.append(float(np.var(along + lost)) * len(t))
    loss, _, left_of_share, onset = min(shares, key=lambda fit: fit[2])
    constant, sigma, left_of_stop, stopped = min(stops, key=lambda fit: fit[2])
    if left_of_stop <= left_of_share or 1.0 - follows < loss < 1.0 + _REVERSED:
        stuck = left_of_stop < _STUCK * min(deaths)
        return Manner(share=0.0, constant=constant if stuck else 0.0, sigma=sigma, onset=stopped)
    return Manner(share=1.0 - loss, constant=0.0, sigma=math.inf, onset=onset)


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Slope of y over x, its standard deviation, and the sum of squares that is left."""
    x, y = x - x.mean(), y - y.mean()
    size = max(float(x @ x), _TINY)
    slope = float(x @ y) / size
    left = float(np.sum((y - slope * x) ** 2))
    return slope, math.sqrt(left / max(len(x) - 2, 1) / size), left
