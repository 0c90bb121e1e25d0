"""Compute the uncertainty of the unknowns of a fit: their covariance, and the combinations of them that
recordings leave open.

The information of the recordings is divided by the variance inflation of
`uvms_ocp.identification.whiteness` before standard errors are taken from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification import parameters
from uvms_ocp.identification.estimates import Estimate
from uvms_ocp.identification.model import Vehicle

DETERMINED = 0.3
"""Largest standard error of a coordinate, relative for what is positive, with which it counts as
determined.
"""
NEXT_TO_NOTHING = 1e-12
"""[1 / unknowns^2] information that stands for none, so that no matrix is singular."""
_MAIN_SHARE = 0.3  # of the largest entry of a combination, from which on an entry is named


def covariance(vehicle: Vehicle, estimate: Estimate, inflation: float = 1.0) -> np.ndarray:
    """Compute the covariance (n, n) [unknowns^2] of the shared unknowns, by recordings and priors.

    inflation: number of samples that miss alike, by `variance_inflation`. Priors of delays are as wide
    in seconds as where the search began: next to 0 a coordinate says nothing of the other side.
    """
    shared = vehicle.shared
    is_delay = [name in parameters.DELAYS for name in shared.names]
    widening = np.where(is_delay, np.cosh(estimate.shared) / np.cosh(shared.start), 1.0)
    prior_sigma = shared.sigma * np.maximum(widening, 1.0) ** 2
    prior = np.diag(1.0 / prior_sigma**2 + NEXT_TO_NOTHING)
    information = _data(vehicle, estimate, inflation) + prior
    try:
        noise_covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError:  # unknowns that differ by powers of ten in what is known of them
        scale = 1.0 / np.sqrt(np.diag(information))
        scaled = information * np.outer(scale, scale) + NEXT_TO_NOTHING * np.eye(len(information))
        noise_covariance = np.linalg.inv(scaled) * np.outer(scale, scale)
    return np.asarray(noise_covariance + estimate.assumed)


def standard_errors(vehicle: Vehicle, estimate: Estimate, inflation: float = 1.0) -> np.ndarray:
    """Compute standard errors (n,) [as `Unknowns.start`] of the shared unknowns; inflation:
    number of samples that miss alike, by `variance_inflation`.
    """
    return np.sqrt(np.diag(covariance(vehicle, estimate, inflation)))


@dataclass(frozen=True, kw_only=True, slots=True)
class UnidentifiableDirection:
    """A combination of unknowns that the recordings do not determine."""

    sigma: float
    """[as `Unknowns.start`] standard error along it, priors left out."""
    shares: tuple[tuple[str, float], ...]
    """Names of unknowns and their entries [-] in it, the largest first."""


def unidentifiable_directions(
    vehicle: Vehicle, estimate: Estimate, inflation: float = 1.0
) -> tuple[UnidentifiableDirection, ...]:
    """List combinations of which less is known than `DETERMINED`, the worst first.

    inflation: number of samples that miss alike, by `variance_inflation`.
    """
    values, axes = np.linalg.eigh(_data(vehicle, estimate, inflation))
    directions = []
    for value, axis in zip(values, axes.T, strict=True):
        sigma = 1.0 / np.sqrt(max(float(value), NEXT_TO_NOTHING))
        if sigma > DETERMINED:
            largest = np.abs(axis).max()
            shares = []
            for i in np.argsort(-np.abs(axis)):
                if abs(axis[i]) > _MAIN_SHARE * largest:
                    shares.append((vehicle.shared.names[i], float(axis[i])))
            directions.append(UnidentifiableDirection(sigma=sigma, shares=tuple(shares)))
    return tuple(directions)


def _data(vehicle: Vehicle, estimate: Estimate, inflation: float) -> np.ndarray:
    """Return the information of the recordings alone."""
    return np.asarray(estimate.information - np.diag(1.0 / vehicle.shared.sigma**2)) / inflation
