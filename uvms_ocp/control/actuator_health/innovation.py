"""Changes of the residual wrench, and how large they may be without a fault.

Water pushes slowly, sensors are noisy, and a wrong model turns part of every change of thrust into residual: the
standard deviation of a change is learned, and grows with what the thrusters change.
"""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.control.actuator_health.thresholds import HealthTuning

TINY = 1e-12
"""Stands in for a size that is 0, to divide by."""
LARGEST_LOSS = 2.6
"""[-] of the thrust that is asked: more than what a reversed thruster takes is no fault of one thruster."""
CONSTANT_GAIN = 6.0
"""[-] that an unknown constant thrust must be worth."""

_OUTLIER, _USUAL = 2.0, 0.73  # variances that one look can teach at most, and what it then teaches on average
_START = 16.0  # floors of variance to begin with, until it is learned


class Innovation:
    """High-pass of the residual wrench. Holds its mean: one per run."""

    def __init__(self, reach: np.ndarray, tuning: HealthTuning) -> None:
        """reach (6,) [N, N m]: what all thrusters together give."""
        self.share = 1.0 - math.exp(-tuning.sample_time / tuning.disturbance_memory)
        """[-] of a change that is forgotten until the next look."""
        self._learn = tuning.sample_time / tuning.noise_memory
        self._error, self._correlation = tuning.model_error, tuning.correlation
        self.floor = (tuning.noise_floor * reach) ** 2 + np.finfo(float).tiny
        """(6,) [N^2, (N m)^2] least variance of a change."""
        self._variance = _START * self.floor
        self._mean = np.zeros(6)
        self._thrust = np.zeros(6)
        self.value = np.zeros(6)
        """(6,) [N, N m] the last change."""
        self.weight = 1.0 / self._variance
        """(6,) [1/N^2, 1/(N m)^2] one over its variance, less for what looks have in common."""

    def restart(self, residual: np.ndarray, wrench: np.ndarray) -> None:
        """Begin anew at a residual (6,) and the wrench (6,) of the thrusters [N, N m]."""
        self._mean, self._thrust = residual.copy(), wrench.copy()

    def look(self, residual: np.ndarray, wrench: np.ndarray) -> None:
        """Take in the residual (6,) and the wrench (6,) that the thrusters should give [N, N m]."""
        change, thrust = residual - self._mean, wrench - self._thrust
        self._mean += self.share * change
        self._thrust += self.share * thrust
        variance = np.maximum(self._variance, self.floor) + (self._error * thrust) ** 2
        self._variance += self._learn * (np.minimum(change**2, _OUTLIER * variance) / _USUAL - self._variance)
        self.value, self.weight = change, 1.0 / (self._correlation * variance)
