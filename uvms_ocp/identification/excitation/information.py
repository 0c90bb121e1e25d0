"""What a course tells of the numbers that matter, as one figure with its slope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.excitation.course import Course
from uvms_ocp.identification.methods.output_error import Noise

_NOTHING = 1e-6  # of information: what is known of an unknown without a prior
_SHARP = (
    20.0  # [-] power of standard errors whose mean counts: 0 would make all count alike, more and more the worst alone
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Aim:
    """What is to be learnt."""

    slopes: np.ndarray
    """(m, n_p) [units of numbers, per unknown] of the numbers that matter."""
    known: np.ndarray
    """(n_p, n_p) [1 / unknowns^2] of priors, and of recordings that there are."""
    noise: Noise
    rate: float
    """[Hz] of the sensors."""

    def weights(self, h: float) -> np.ndarray:
        """(9,) [1 / unit^2] of what is seen, in steps of h [s]."""
        sigma = np.repeat([self.noise.velocity, self.noise.rate, self.noise.vertical], 3)
        return self.rate * h / sigma**2

    def information(self, one: Course, h: float) -> np.ndarray:
        """(n_p, n_p) [1 / unknowns^2] of a course alone, in steps h [s]."""
        J = (one.J * np.sqrt(self.weights(h))[:, None]).reshape(-1, one.J.shape[-1])
        return np.asarray(J.T @ J)

    def figure(self, one: Course, h: float, wanted: np.ndarray) -> tuple[float, np.ndarray]:
        """[-] Logarithm of the numbers' standard errors over those wanted (m,) [units of numbers], those farthest off first.

        With its slope with J (n + 1, 9, n_p); steps h [s].
        """
        C = self.covariance(self.information(one, h))
        with_numbers = self.slopes @ C
        squares = np.maximum(np.einsum("ij,ij->i", with_numbers, self.slopes), 1e-300)
        value, share = _softly_largest(np.log(squares) / 2 - np.log(wanted))
        with_information = -np.einsum("ij,ik,i->jk", with_numbers, with_numbers, 0.5 * share / squares)
        return value, 2.0 * self.weights(h)[:, None] * (one.J @ with_information)

    def deviations(self, information: np.ndarray) -> np.ndarray:
        """(m,) [units of numbers] standard errors after recordings of some information (n_p, n_p) [1 / unknowns^2]."""
        C = self.covariance(information)
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", self.slopes, C, self.slopes)))

    def covariance(self, information: np.ndarray) -> np.ndarray:
        """(n_p, n_p) [unknowns^2] after recordings of some information (n_p, n_p) [1 / unknowns^2]."""
        whole = information + self.known + _NOTHING * np.eye(len(self.known))
        # Unknowns differ by powers of ten in what is known of them.
        scale = 1.0 / np.sqrt(np.diag(whole))
        return np.asarray(scale[:, None] * np.linalg.inv(whole * np.outer(scale, scale)) * scale)


def _softly_largest(values: np.ndarray) -> tuple[float, np.ndarray]:
    """Of values (m,) [-], between their mean and the largest, with its slope (m,) [-]."""
    most = float(values.max())
    grown = np.exp(_SHARP * (values - most))
    return most + float(np.log(grown.mean())) / _SHARP, grown / grown.sum()
