"""How sure the unknowns are, and which combinations of them the recordings leave open.

Errors of a model are not white: samples that follow each other miss alike, and count for less than their number. The
information is divided by the number of samples that miss together before standard errors are taken from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.answers.predictions import Predicted
from uvms_ocp.identification.methods.output_error import Estimate, Noise
from uvms_ocp.identification.models.stage import Vehicle

DETERMINED = 0.3
"""[-] largest standard error of a coordinate, relative for what is positive, with which it counts as determined."""
NARROWED = 0.7
"""[-] of the deviation that priors leave, below which recordings say more than these."""
_NOTHING = 1e-12  # of information: all that is known where there is none
_TOLD = 0.3  # of the largest entry of a combination


@dataclass(frozen=True, kw_only=True, slots=True)
class Certainty:
    """Of one unknown."""

    name: str
    value: float
    """[as `Unknowns.start`]"""
    sigma: float
    """[as `Unknowns.start`] standard error."""
    determined: bool
    """By the recordings, not by the prior."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Open:
    """A combination of unknowns that the recordings do not determine."""

    sigma: float
    """[as `Unknowns.start`] standard error along it, priors left out."""
    shares: tuple[tuple[str, float], ...]
    """Unknowns and what they change by along it [-], the largest first."""


def certainties(vehicle: Vehicle, estimate: Estimate, together: float = 1.0) -> tuple[Certainty, ...]:
    """Of every shared unknown. together: [-] samples that miss alike, as `correlated` finds."""
    sigma = np.sqrt(np.diag(covariance(vehicle, estimate, together)))
    learnt = (sigma < DETERMINED) & (sigma < NARROWED * vehicle.shared.sigma)
    rows = zip(vehicle.shared.names, estimate.shared, sigma, learnt, strict=True)
    return tuple(Certainty(name=n, value=float(v), sigma=float(s), determined=bool(d)) for n, v, s, d in rows)


def covariance(vehicle: Vehicle, estimate: Estimate, together: float = 1.0) -> np.ndarray:
    """(n, n) [unknowns^2] of the shared unknowns, by recordings and priors; together: [-] as in `certainties`."""
    prior = np.diag(1.0 / vehicle.shared.sigma**2 + _NOTHING)
    return np.asarray(np.linalg.inv(_data(vehicle, estimate, together) + prior))


def prior_covariance(vehicle: Vehicle) -> np.ndarray:
    """(n, n) [unknowns^2] of what is believed without recordings."""
    return np.diag(1.0 / (1.0 / vehicle.shared.sigma**2 + _NOTHING))


def left_open(vehicle: Vehicle, estimate: Estimate, together: float = 1.0) -> tuple[Open, ...]:
    """Combinations of which less is known than `DETERMINED`, the worst first; together: [-] as in `certainties`."""
    values, axes = np.linalg.eigh(_data(vehicle, estimate, together))
    found = []
    for value, axis in zip(values, axes.T, strict=True):
        sigma = 1.0 / np.sqrt(max(float(value), _NOTHING))
        if sigma > DETERMINED:
            order = np.argsort(-np.abs(axis))
            told = [i for i in order if abs(axis[i]) > _TOLD * abs(axis[order[0]])]
            found.append(Open(sigma=sigma, shares=tuple((vehicle.shared.names[i], float(axis[i])) for i in told)))
    return tuple(found)


def _data(vehicle: Vehicle, estimate: Estimate, together: float) -> np.ndarray:
    """Information of the recordings alone."""
    return np.asarray(estimate.information - np.diag(1.0 / vehicle.shared.sigma**2)) / together


def correlated(predicted: Predicted, noise: Noise) -> float:
    """[-] How many samples of a prediction miss alike, times how far they miss beyond `noise`, squared; at least 1.

    By Bartlett's formula, ``1 + 2 sum rho_k``, up to the first lag at which residuals are no longer correlated.
    """
    found = []
    for rows, seen, sigma in zip(
        predicted.rows, predicted.seen, (noise.velocity, noise.rate, noise.vertical), strict=True
    ):
        for residual in ((rows - seen) / sigma).T:
            found.append(float((residual**2).mean()) * bartlett(residual - residual.mean()))
    return max(1.0, float(np.mean(found)))


def bartlett(residual: np.ndarray) -> float:
    """[-] ``1 + 2 sum rho_k`` of a residual (m,) [any] with mean zero, up to the first lag without correlation."""
    n = len(residual)
    rho = np.correlate(residual, residual, "full")[n:] / max(float(residual @ residual), 1e-300)
    below = np.flatnonzero(rho < 2.0 / np.sqrt(n))
    return 1.0 + 2.0 * float(rho[: below[0] if len(below) else n].sum())
