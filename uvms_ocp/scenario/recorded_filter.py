"""Run the filter and the health monitor over the readings of a recording, tick by tick, and compare
innovations with those that the filter expects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from uvms_ocp.estimation import EstimatorTuning, estimator
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.robot import Command, Robot, SensorSpecs, StateEstimate
from uvms_ocp.scenario.recorded_readings import Arrivals, ReceivedReadings


class FilteredTick(NamedTuple):
    """Estimate of one tick, and how the readings that were compared in it agree."""

    estimate: StateEstimate
    innovation: np.ndarray
    """(n_channels,) squared innovation over its covariance and its degrees of freedom, NaN where nothing
    was compared.
    """
    refused: np.ndarray
    """(n_channels,) True where the filter refused what was compared."""


class RecordedFilter:
    """Filter and health monitor over readings in the order in which they arrived."""

    def __init__(
        self,
        robot: Robot,
        specs: SensorSpecs,
        arrivals: Mapping[str, Arrivals],
        tuning: EstimatorTuning | None = None,
    ) -> None:
        """specs: the noise to expect of the channels that arrive. tuning: how the vehicle is expected
        to move.
        """
        self._sensors = specs.present
        self._filter = estimator.Estimator(robot, specs, tuning)
        self._guarded = GuardedEstimator(self._filter, robot, specs)
        self.monitor = self._guarded.monitor
        """The health monitor, with its channels and alarms."""
        self.channels = self.monitor.channels
        """Names of the channels, in the order of the columns of `FilteredTick`."""
        self._received = ReceivedReadings(arrivals, self.channels)
        self._rows = [self.monitor.numbers[name] for name in self.channels]
        self._compared_times = np.full(len(self.channels), -math.inf)  # [s] of the last readings
        self._degrees = np.ones(len(self.channels))

    def advance(self, tick: int, t: float, command: Command | None = None) -> FilteredTick:
        """Estimate at one tick, at t [s], from what has arrived until then; command: of the tick
        before.
        """
        estimate = self._guarded(self._received.until(tick, t), t, command)
        sample_times, squared, self._degrees, accepted = self._filter.outcomes[self._rows].T
        is_new = sample_times > self._compared_times
        self._compared_times = np.where(is_new, sample_times, self._compared_times)
        innovation = np.where(is_new, squared / np.maximum(self._degrees, 1.0), math.nan)
        return FilteredTick(estimate, innovation, is_new & (accepted == 0.0))

    def agreement(
        self, innovations: np.ndarray, refused: np.ndarray
    ) -> tuple[Mapping[str, Any], ...]:
        """Compare what all ticks have given, (n, n_channels) each, with what was expected; return a row
        for each channel, whose columns `estimate_recording` describes.
        """
        rows = []
        for k, name in enumerate(self.channels):
            sigma = self._sensors[name].sigma
            agreement = _agreement(innovations[:, k], refused[:, k], self._degrees[k], sigma)
            rows.append({"channel": name, **self._received.statistics(name), **agreement})
        return tuple(rows)


def _agreement(
    innovations: np.ndarray, refused: np.ndarray, n_degrees: float, sigma: float
) -> dict[str, Any]:
    """Compare the innovations of a channel with those that its specification predicts.

    innovations: (n,) squares over covariance and degrees of freedom, NaN where there is none.
    refused: (n,) True where the filter refused them. sigma: [unit of the channel] expected standard
    deviation.
    """
    compared = innovations[np.isfinite(innovations)]
    ratio = None
    proposed_sigma = None
    if compared.size:
        # The median of chi-squared over its degrees of freedom, by Wilson and Hilferty.
        expected_median = (1.0 - 2.0 / (9.0 * n_degrees)) ** 3
        ratio = math.sqrt(float(np.median(compared)) / expected_median)
        proposed_sigma = sigma * ratio
    return {
        "compared": len(compared),
        "refused": int(refused.sum()),
        "ratio": ratio,
        "sigma": sigma,
        "proposed_sigma": proposed_sigma,
    }
