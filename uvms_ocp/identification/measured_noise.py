"""Measure the noise of the channels of a recording, by the variate differences of their samples.

Differences of a higher order leave less of what moves smoothly, and all of what is white: of white
noise the k-th differences have ``binomial(2 k, k)`` times the variance of a sample. The order that says
least is that with the least motion in it.
"""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.identification.recording import Channel

_ORDERS = range(1, 7)
_MIN_SAMPLES = 50  # new ones, from which on the noise of a channel is measured
_NORMAL = 0.6745  # median size of a normal variable, in standard deviations
_OF_ROTATION = math.sqrt(4.0 / 3.0)
"""Factor from the root of the summed variances of a unit quaternion's four numbers to the standard
deviation of each component of its rotation vector.
"""


def measured_noise(name: str, channel: Channel) -> float | None:
    """Measure the standard deviation [unit of the channel; rad of a rotation vector for an attitude] of
    the noise of each component of a channel; `None` for too few samples.

    Samples that repeat the one before count once. Steps of few digits count as noise of their size.
    """
    values = channel.values[:, _measured_columns(channel)]
    is_new = np.r_[True, (np.diff(values, axis=0) != 0.0).any(axis=1)]
    values = values[is_new]
    if len(values) < _MIN_SAMPLES:
        return None
    deviations = np.array([_deviation(column) for column in values.T])
    if name == "attitude":
        return float(_OF_ROTATION * np.linalg.norm(deviations))
    return float(np.sqrt(np.mean(deviations**2)))


def _measured_columns(channel: Channel) -> np.ndarray:
    """Return the indices of the columns that were measured, and that change."""
    is_measured = np.ptp(channel.values, axis=0) > 0.0
    is_measured[list(channel.constants)] = False
    if not is_measured.any():
        is_measured[:] = True
    return np.flatnonzero(is_measured)


def _deviation(values: np.ndarray) -> float:
    """Measure the standard deviation of the noise of one column (n,) [any]."""
    deviations = []
    differences = values
    for order in _ORDERS:
        differences = np.diff(differences)
        median = float(np.median(np.abs(differences)))
        deviations.append(median / (_NORMAL * math.sqrt(math.comb(2 * order, order))))
    levels = np.abs(np.diff(values))
    smallest_step = float(levels[levels > 0.0].min(initial=np.inf))
    rounding = 0.0
    if np.median(levels) < 2.0 * smallest_step:  # most steps are of the last digit
        rounding = smallest_step / math.sqrt(12.0)
    return max(min(deviations), rounding)
