"""Classify the fault of a thruster, and date it: fit a share of the command and a constant thrust
for every onset of late, and keep the likeliest.
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
    """Least-squares lines, y over x, one for every onset that is tried, and the best of them."""

    x: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [unit of x] abscissae of the samples."""
    y: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] ordinates of the samples."""
    slope: float
    """[N/unit of x] slope of the line tried last."""
    left: float
    """[N^2] sum of squares that the line tried last leaves."""
    best_slope: float
    """[N/unit of x] slope of the best line."""
    best_sigma: float
    """[N/unit of x] standard deviation of the slope of the best line."""
    least: float
    """[N^2] sum of squares that the best line leaves."""
    onset: float
    """[s] onset of the best line."""


class FaultFit(Layout):
    """Fit of the likeliest fault of one thruster to its commands and the residual wrench."""

    count: int
    """Number of samples in the window."""
    time: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [s] times of the samples."""
    asked: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] commanded thrust, filtered as the residual is."""
    along: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] residual wrench, projected on the direction of the thruster."""
    bandwidth: float
    """[rad/s] of the filter."""
    faded: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) share that the filter still has of the time before an onset."""
    lost: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] commanded thrust since the onset, as filtered."""
    shares: LineFit
    stops: LineFit
    dead: float
    """[N^2] sum of squares that is left of the best onset where the thruster gives nothing since.
    """
    # found
    share: float
    """Share of its command that it gives; 0 where it does not follow."""
    constant: float
    """[N] that it gives instead, where it does not follow."""
    sigma: float
    """[N] standard deviation of the constant."""
    onset: float
    """[s] onset of the fault."""


def classify_fault(fit: FaultFit) -> None:
    """Fit share and constant to commands and residuals."""
    fit.shares.least = math.inf
    fit.stops.least = math.inf
    fit.dead = math.inf
    for k in range(max(fit.count - _AFTER, 1)):
        _try_onset(fit, k)
    _try_before(fit)
    loss = fit.shares.best_slope
    follows = fit.stops.least > fit.shares.least and not 1.0 - _NOTHING < loss < 1.0 + _REVERSED
    stuck = fit.stops.least < _STUCK * fit.dead
    fit.share = 1.0 - loss if follows else 0.0
    if stuck and not follows:
        fit.constant = fit.stops.best_slope
    else:
        fit.constant = 0.0
    fit.sigma = math.inf if follows else fit.stops.best_sigma
    fit.onset = fit.shares.onset if follows else fit.stops.onset


def _try_onset(fit: FaultFit, k: int) -> None:
    """Explain the looks by a fault that began at look k, and keep it where it explains them best."""
    for j in range(fit.count):
        if j >= k:
            fit.faded[j] = math.exp(-fit.bandwidth * max(fit.time[j] - fit.time[k], 0.0))
        else:
            fit.faded[j] = 1.0
        fit.lost[j] = fit.asked[j] - fit.asked[k] * fit.faded[j] if fit.faded[j] < 1.0 else 0.0
        fit.shares.x[j] = -fit.lost[j]
        fit.shares.y[j] = fit.along[j]
        fit.stops.x[j] = 1.0 - fit.faded[j]
        fit.stops.y[j] = fit.along[j] + fit.lost[j]
    fit.dead = min(fit.dead, _scatter(fit.stops.y, fit.count))
    _try_line(fit.shares, fit.count, fit.time[k])
    _try_line(fit.stops, fit.count, fit.time[k])


def _try_before(fit: FaultFit) -> None:
    """Explain the looks by a fault that began before the first of them: one that shows late.

    Where it then sticks cannot be told from what else pushes all the time; taken for one that began
    in the window, a dead thruster would stick at what it was asked at the first look.
    """
    for j in range(fit.count):
        fit.shares.x[j] = -fit.asked[j]
        fit.shares.y[j] = fit.along[j]
        fit.stops.y[j] = fit.along[j] + fit.asked[j]
    fit.dead = min(fit.dead, _scatter(fit.stops.y, fit.count))
    _try_line(fit.shares, fit.count, fit.time[0])


def _scatter(y: Vector, n: int) -> float:
    """Compute the sum of squares of y (n,) [N] about its mean."""
    mean = 0.0
    total = 0.0
    for j in range(n):
        mean += y[j] / n
    for j in range(n):
        total += (y[j] - mean) * (y[j] - mean)
    return total


def _try_line(fit: LineFit, n: int, onset: float) -> None:
    mean_x = 0.0
    mean_y = 0.0
    size = 0.0
    along = 0.0
    for j in range(n):
        mean_x += fit.x[j] / n
        mean_y += fit.y[j] / n
    for j in range(n):
        size += (fit.x[j] - mean_x) * (fit.x[j] - mean_x)
        along += (fit.x[j] - mean_x) * (fit.y[j] - mean_y)
    size = max(size, _TINY_SCATTER)
    fit.slope = along / size
    fit.left = 0.0
    for j in range(n):
        rest = fit.y[j] - mean_y - fit.slope * (fit.x[j] - mean_x)
        fit.left += rest * rest
    if fit.left < fit.least:
        fit.least = fit.left
        fit.best_slope = fit.slope
        fit.best_sigma = math.sqrt(fit.left / max(n - 2, 1) / size)
        fit.onset = onset
