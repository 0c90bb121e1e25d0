"""Test whether the residuals of a fit are white, and by how much coloured ones inflate variances.

Errors of a model are not white: samples that follow each other miss alike, and count for less than
their number. The information is divided by the number of samples that miss together before standard
errors are taken from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification import parameters
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.predictor import Predicted

CHANNELS = (*parameters.AXES, "vertical x", "vertical y", "vertical z")
"""Channels of velocity, angular velocity and vertical, three of each."""
LEVEL = 0.05
"""Level of the test: share of white residuals that it takes for coloured."""
LEAST_P = 1e-6
"""p-value below which no digits are written."""
_LAGS = 20  # of the autocorrelation that the test looks at
_STILL = 0.1  # [noise] range of residuals below which a channel did not move, as along a held axis


def whiteness(predicted: Predicted, noise: Noise) -> tuple[Whiteness, ...]:
    """Test the whiteness of every channel in `CHANNELS` that has residuals."""
    tests = []
    for channel, residual, t in _residuals(predicted, noise):
        if np.ptp(residual) > 0.0:
            tests.append(_whiteness(channel, residual, t))
    return tuple(tests)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Whiteness:
    """Whiteness test of the residuals of one channel."""

    channel: str
    """Name of the channel, of `CHANNELS`."""
    size: float
    """Root mean square of the residuals, in standard deviations of the noise."""
    inflation: float
    """Number of samples that miss alike, by Bartlett's formula."""
    p: float
    """p-value of the Ljung-Box test."""
    correlation: np.ndarray
    """(k + 1,) autocorrelation from lag 0 on, in samples."""
    interval: float
    """[s] median interval between samples."""
    bound: float
    """Bound within which 95 % of the correlations of white noise lie."""

    @property
    def white(self) -> bool:
        """True if the test does not reject whiteness."""
        return self.p >= LEVEL

    @property
    def unexplained(self) -> bool:
        """True if residuals are coloured and so large that standard errors of the channel alone
        would be twice as large.
        """
        return not self.white and self.size**2 * self.inflation > 4.0


def variance_inflation(predicted: Predicted, noise: Noise) -> float:
    """Estimate the variance inflation: samples of a prediction that miss alike, times their squared
    miss relative to `noise`; at least 1.

    By Bartlett's formula, ``1 + 2 sum rho_k``, up to the first lag at which residuals are no longer
    correlated. The mean over the channels, but no less than of any that the model does not explain:
    what is wrong with it may be wrong for all numbers.
    """
    inflations = []
    for _, residual, _ in _residuals(predicted, noise):
        if np.ptp(residual) > _STILL:
            square = float((residual**2).mean())
            inflations.append(square * bartlett(residual - residual.mean()))
    inflation = max(1.0, float(np.mean(inflations or [1.0])))
    for test in whiteness(predicted, noise):
        if test.unexplained:
            inflation = max(inflation, test.size**2 * test.inflation)
    return inflation


def ljung_box(residual: np.ndarray, lags: int = _LAGS) -> tuple[float, np.ndarray]:
    """Compute the probability that white noise is as correlated as a residual (m,) [any], and its
    autocorrelation (k + 1,).

    lags: that are looked at, a fifth of the samples at most. What a model has been fitted to has a
    little less freedom than the test believes.
    """
    from scipy.special import gammaincc  # a tenth of a second

    n = len(residual)
    k = max(1, min(lags, n // 5))
    rho = autocorrelation(residual - residual.mean())[: k + 1]
    statistic = n * (n + 2) * float((rho[1:] ** 2 / (n - np.arange(1, k + 1))).sum())
    return float(gammaincc(k / 2, statistic / 2)), rho


def bartlett(residual: np.ndarray) -> float:
    """Compute ``1 + 2 sum rho_k`` of a residual (m,) [any] with mean zero, up to the first lag
    without correlation.
    """
    n = len(residual)
    rho = autocorrelation(residual)[1:]
    below = np.flatnonzero(rho < 2.0 / np.sqrt(n))
    return 1.0 + 2.0 * float(rho[: below[0] if len(below) else n].sum())


def autocorrelation(residual: np.ndarray) -> np.ndarray:
    """Compute the autocorrelation (m,) from lag 0 on, of a residual (m,) [any] with mean zero."""
    n = len(residual)
    spectrum = np.fft.rfft(residual, 1 << (2 * n - 1).bit_length())
    covariances = np.fft.irfft((spectrum * spectrum.conj()).real)[:n]
    return np.asarray(covariances / max(float(covariances[0]), 1e-300))


def _whiteness(channel: str, residual: np.ndarray, t: np.ndarray) -> Whiteness:
    """Test the residuals (m,) of one channel, at times t (m,) [s]."""
    p, rho = ljung_box(residual)
    return Whiteness(
        channel=channel,
        size=float(np.sqrt((residual**2).mean())),
        inflation=bartlett(residual - residual.mean()),
        p=p,
        correlation=rho,
        interval=float(np.median(np.diff(t))),
        bound=1.96 / float(np.sqrt(len(residual))),
    )


def _residuals(predicted: Predicted, noise: Noise) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield channels in `CHANNELS`, their residuals (m,), relative to the noise, and times (m,)
    [s].
    """
    for k, sigma in enumerate((noise.velocity, noise.rate, noise.vertical)):
        residuals = (predicted.rows[k] - predicted.measured[k]) / sigma
        names = CHANNELS[3 * k : 3 * k + 3]
        for name, residual in zip(names, residuals.T, strict=True):
            yield name, residual, predicted.t[k]
