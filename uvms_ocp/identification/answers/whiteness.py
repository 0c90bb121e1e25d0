"""Whether what a search has left is white noise: then the model has nothing more to say, and samples count one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.answers.certainty import bartlett
from uvms_ocp.identification.answers.predictions import Predicted
from uvms_ocp.identification.methods.output_error import Noise
from uvms_ocp.identification.parameters.vehicle_quantities import AXES

CHANNELS = (*AXES, "vertical x", "vertical y", "vertical z")
"""Of the three sensors, three of each."""
LEVEL = 0.05
"""[-] of white residuals that the test takes for coloured."""
LEAST_TOLD = 1e-6
"""[-] chance that is not told more exactly."""
_LAGS = 20


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Whiteness:
    """Of one channel."""

    channel: str
    size: float
    """[-] root mean square of the residuals, by the noise that was expected."""
    together: float
    """[-] samples that miss alike, by Bartlett's formula."""
    p: float
    """[-] of white noise to look like this or worse, by Ljung and Box's test."""
    correlation: np.ndarray
    """(k + 1,) [-] autocorrelation from lag 0 on, in samples."""
    interval: float
    """[s] between samples, in the median."""
    bound: float
    """[-] in which 95 % of the correlations of white noise lie."""

    @property
    def white(self) -> bool:
        """Whether nothing speaks against it."""
        return self.p >= LEVEL


def whiteness(left: Predicted, noise: Noise) -> tuple[Whiteness, ...]:
    """Of every channel that has residuals: `CHANNELS`."""
    return tuple(_channels(left, noise))


def _channels(left: Predicted, noise: Noise) -> Iterator[Whiteness]:
    for k, sigma in enumerate((noise.velocity, noise.rate, noise.vertical)):
        for name, residual in zip(CHANNELS[3 * k :], ((left.rows[k] - left.seen[k]) / sigma).T, strict=False):
            if np.ptp(residual) > 0.0:
                yield _whiteness(name, residual, float(np.median(np.diff(left.t[k]))))


def _whiteness(name: str, residual: np.ndarray, interval: float) -> Whiteness:
    centred = residual - residual.mean()
    p, rho = ljung_box(residual)
    return Whiteness(
        channel=name,
        size=float(np.sqrt((residual**2).mean())),
        together=bartlett(centred),
        p=p,
        correlation=rho,
        interval=interval,
        bound=1.96 / float(np.sqrt(len(residual))),
    )


def ljung_box(residual: np.ndarray, lags: int = _LAGS) -> tuple[float, np.ndarray]:
    """p [-] that white noise is as correlated as a residual (m,) [any], and its autocorrelation (k + 1,) [-].

    lags: [-] that are looked at, a fifth of the samples at most. What a model has been fitted to has a little less freedom than
    the test believes.
    """
    from scipy.special import gammaincc  # a tenth of a second

    n = len(residual)
    k, centred = max(1, min(lags, n // 5)), residual - residual.mean()

    found = np.correlate(centred, centred, "full")[n - 1 : n + k]
    rho = found / max(float(found[0]), 1e-300)
    statistic = n * (n + 2) * float((rho[1:] ** 2 / (n - np.arange(1, k + 1))).sum())
    return float(gammaincc(k / 2, statistic / 2)), rho
