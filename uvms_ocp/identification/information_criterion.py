"""Scalar criterion of the Fisher information of an experiment, with its slope.

The information is that of sensors which see every step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification import estimates
from uvms_ocp.identification.trajectory_simulator import ExperimentTrajectory

_NEXT_TO_NOTHING = 1e-6  # [1 / unknowns^2] information on an unknown without a prior
_SHARPNESS = 20.0
"""Power of standard errors whose mean counts: with 0 all count alike, with much the worst alone."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InformationCriterion:
    """Scalar criterion of the Fisher information of an experiment."""

    slopes: np.ndarray
    """(m, n_p) [units of numbers, per unknown] slopes of the numbers that matter."""
    prior_information: np.ndarray
    """(n_p, n_p) [1 / unknowns^2] information of priors, and of recordings that there are."""
    noise: estimates.Noise
    """Standard deviations of the sensors."""
    rate: float
    """[Hz] rate of the sensors."""

    def weights(self, h: float) -> np.ndarray:
        """Compute weights (9,) [1 / unit^2] of the outputs, in steps of h [s]."""
        sigma = np.repeat([self.noise.velocity, self.noise.rate, self.noise.vertical], 3)
        return self.rate * h / sigma**2

    def information(self, trajectory: ExperimentTrajectory, h: float) -> np.ndarray:
        """Compute the information (n_p, n_p) [1 / unknowns^2] of a trajectory alone, in steps h
        [s].
        """
        weighted = trajectory.J * np.sqrt(self.weights(h))[:, None]
        J = weighted.reshape(-1, trajectory.J.shape[-1])
        return np.asarray(J.T @ J)

    def figure(
        self, trajectory: ExperimentTrajectory, h: float, targets: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Compute the figure of merit of a trajectory in steps h [s], and its slope with J (n + 1, 9,
        n_p).

        It is the smooth maximum of the logarithms of the numbers' standard errors over targets (m,)
        [units of numbers].
        """
        covariances = self.slopes @ self.covariance(self.information(trajectory, h))
        variances = np.maximum(np.einsum("ij,ij->i", covariances, self.slopes), 1e-300)
        value, share = _softly_largest(np.log(variances) / 2 - np.log(targets))
        by_information = -np.einsum(
            "ij,ik,i->jk", covariances, covariances, 0.5 * share / variances
        )
        return value, 2.0 * self.weights(h)[:, None] * (trajectory.J @ by_information)

    def deviations(self, information: np.ndarray) -> np.ndarray:
        """Compute standard errors (m,) [units of numbers] after recordings of some information
        (n_p, n_p) [1 / unknowns^2].
        """
        covariance = self.covariance(information)
        variances = np.einsum("ij,jk,ik->i", self.slopes, covariance, self.slopes)
        return np.asarray(np.sqrt(variances))

    def covariance(self, information: np.ndarray) -> np.ndarray:
        """Compute the covariance (n_p, n_p) [unknowns^2] after recordings of some information (n_p,
        n_p) [1 / unknowns^2].
        """
        floor = _NEXT_TO_NOTHING * np.eye(len(self.prior_information))
        total = information + self.prior_information + floor
        # Unknowns differ by powers of ten in what is known of them.
        scale = 1.0 / np.sqrt(np.diag(total))
        return np.asarray(scale[:, None] * np.linalg.inv(total * np.outer(scale, scale)) * scale)


def _softly_largest(values: np.ndarray) -> tuple[float, np.ndarray]:
    """Compute a smooth maximum of values (m,), between their mean and the largest, with its slope
    (m,).
    """
    largest = float(values.max())
    exponentials = np.exp(_SHARPNESS * (values - largest))
    smooth_maximum = largest + float(np.log(exponentials.mean())) / _SHARPNESS
    return smooth_maximum, exponentials / exponentials.sum()
