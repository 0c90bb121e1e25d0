"""In which manner a thruster fails, and since when: every onset of late, against a share and
against no answer at all.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector

_AFTER = 6  # looks that an onset must be back at least
_TINY_SCATTER = 1e-12
# share, the other way, from which a thruster counts as reversed; one that sticks may look like less
_REVERSED = 0.5
_NOTHING = 0.3  # share below which a thruster is dead, not weak
_STUCK = 0.1  # of what a dead thruster would leave unexplained


class LineFit(Layout):
    """Fitted to y over x."""

    x: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [any]"""
    y: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N]"""
    slope: float
    """[N/any]"""
    left: float
    """[N^2] sum of squares that is left."""
    best_slope: float
    """[N/any] of all that were tried, the one that leaves least."""
    best_sigma: float
    """[N/any] standard deviation of that."""
    least: float
    """[N^2] that it leaves."""
    onset: float
    """[s] for which it was tried."""


class FaultFit(Layout):
    """The likeliest, of one thruster."""

    count: int
    """Looks at it."""
    time: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [s]"""
    asked: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] thrust, as filtered."""
    along: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] thrust along the thruster that the residual comes to."""
    bandwidth: float
    """[rad/s] of the filter."""
    faded: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) what the filter still has of the time before an onset."""
    lost: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] of what was asked since."""
    shares: LineFit
    stops: LineFit
    dead: float
    """[N^2] that is left where it gives nothing, at least."""
    # found
    share: float
    """Share of its command that it gives; 0 where it does not follow."""
    constant: float
    """[N] that it gives instead, where it does not follow."""
    sigma: float
    """[N] of the constant."""
    onset: float
    """[s]"""


def classify_fault(m: FaultFit) -> None:
    """Fit share and constant to commands and residuals."""
    m.shares.least = math.inf
    m.stops.least = math.inf
    m.dead = math.inf
    for k in range(max(m.count - _AFTER, 1)):
        _try_onset(m, k)
    loss = m.shares.best_slope
    follows = m.stops.least > m.shares.least and not 1.0 - _NOTHING < loss < 1.0 + _REVERSED
    stuck = m.stops.least < _STUCK * m.dead
    m.share = 1.0 - loss if follows else 0.0
    if stuck and not follows:
        m.constant = m.stops.best_slope
    else:
        m.constant = 0.0
    m.sigma = math.inf if follows else m.stops.best_sigma
    m.onset = m.shares.onset if follows else m.stops.onset


def _try_onset(m: FaultFit, k: int) -> None:
    """Explain the looks by a fault that began at look k, and keep it where it explains them best."""
    for j in range(m.count):
        if j >= k:
            m.faded[j] = math.exp(-m.bandwidth * max(m.time[j] - m.time[k], 0.0))
        else:
            m.faded[j] = 1.0
        m.lost[j] = m.asked[j] - m.asked[k] * m.faded[j] if m.faded[j] < 1.0 else 0.0
        m.shares.x[j] = -m.lost[j]
        m.shares.y[j] = m.along[j]
        m.stops.x[j] = 1.0 - m.faded[j]
        m.stops.y[j] = m.along[j] + m.lost[j]
    m.dead = min(m.dead, _scatter(m.stops.y, m.count))
    _try_line(m.shares, m.count, m.time[k])
    _try_line(m.stops, m.count, m.time[k])


def _scatter(y: Vector, n: int) -> float:
    """Sum of squares of what is not the mean."""
    mean = 0.0
    total = 0.0
    for j in range(n):
        mean += y[j] / n
    for j in range(n):
        total += (y[j] - mean) * (y[j] - mean)
    return total


def _try_line(f: LineFit, n: int, onset: float) -> None:
    mean_x = 0.0
    mean_y = 0.0
    size = 0.0
    along = 0.0
    for j in range(n):
        mean_x += f.x[j] / n
        mean_y += f.y[j] / n
    for j in range(n):
        size += (f.x[j] - mean_x) * (f.x[j] - mean_x)
        along += (f.x[j] - mean_x) * (f.y[j] - mean_y)
    size = max(size, _TINY_SCATTER)
    f.slope = along / size
    f.left = 0.0
    for j in range(n):
        rest = f.y[j] - mean_y - f.slope * (f.x[j] - mean_x)
        f.left += rest * rest
    if f.left < f.least:
        f.least = f.left
        f.best_slope = f.slope
        f.best_sigma = math.sqrt(f.left / max(n - 2, 1) / size)
        f.onset = onset
