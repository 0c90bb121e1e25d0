"""How well a predicted attitude agrees with the measured one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pool.recordings import Recording
from pool.replay import Predictor, at_times
from pool.vehicle import PoolVehicle

OFFSET_TIME = 2.0
"""[s] at the beginning whose mean is removed."""
_LARGEST_LAG = 1.5  # [s]


@dataclass(frozen=True, kw_only=True, slots=True)
class Score:
    """Agreement of one angle over one recording."""

    rmse: float
    """[deg]"""
    correlation: float
    """"""
    lag: float
    """[s] of the prediction behind the measurement, where they agree best; nan: at no lag they
    do.
    """
    overshoot: float
    """peak-to-peak of the prediction over that of the measurement, less 1."""


def compared(recording: Recording, predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Predicted and measured roll and pitch (m, 2) [deg] at the times of the motion capture,
    without their offsets.
    """
    at_mocap = at_times(recording.t, recording.joint_t, predicted)
    return without_offset(recording.t, at_mocap), without_offset(recording.t, recording.attitude)


def without_offset(t: np.ndarray, attitude: np.ndarray) -> np.ndarray:
    """Attitude (m, 2) [deg] at t (m,) [s] from one (m, 2) [rad], less its mean in the beginning."""
    first = t <= t[0] + OFFSET_TIME
    return np.degrees(attitude - attitude[first].mean(axis=0))


def scores(recording: Recording, predicted: np.ndarray) -> tuple[Score, Score]:
    """Agreement of roll and of pitch."""
    simulated, measured = compared(recording, predicted)
    roll = _score(recording.t, simulated[:, 0], measured[:, 0])
    pitch = _score(recording.t, simulated[:, 1], measured[:, 1])
    return roll, pitch


def _score(t: np.ndarray, simulated: np.ndarray, measured: np.ndarray) -> Score:
    return Score(
        rmse=float(np.sqrt(np.mean((simulated - measured) ** 2))),
        correlation=float(np.corrcoef(simulated, measured)[0, 1]),
        lag=lag_of(t, simulated, measured),
        overshoot=float(np.ptp(simulated) / np.ptp(measured) - 1.0),
    )


def lag_of(t: np.ndarray, simulated: np.ndarray, measured: np.ndarray) -> float:
    """[s] by which simulated (n,) is behind measured (n,) at t (n,) [s]; nan where no lag agrees
    best.
    """
    lags = np.arange(-_LARGEST_LAG, _LARGEST_LAG + 1e-9, 0.02)
    inside = (t >= t[0] + _LARGEST_LAG) & (t <= t[-1] - _LARGEST_LAG)
    shifted = [np.interp(t[inside] + lag, t, simulated) for lag in lags]
    best = int(np.argmax([np.corrcoef(values, measured[inside])[0, 1] for values in shifted]))
    if best in (0, len(lags) - 1):
        return np.nan
    return float(lags[best])


def fit_shift(
    vehicle: PoolVehicle, recordings: Sequence[Recording], predict: Predictor
) -> np.ndarray:
    """Shift (3,) [m] of the centre of buoyancy that fits roll and pitch of all the recordings
    best.
    """

    def residuals(shift_cm: np.ndarray) -> np.ndarray:
        errors = []
        for recording in recordings:
            errors.append(_errors(recording, predict(vehicle, recording, shift_cm / 100)))
        return np.concatenate(errors)

    fit = least_squares(residuals, np.zeros(3), diff_step=1e-2, bounds=(-4.0, 4.0))
    shift: np.ndarray = fit.x / 100
    return shift


def _errors(recording: Recording, predicted: np.ndarray) -> np.ndarray:
    simulated, measured = compared(recording, predicted)
    return ((simulated - measured) / np.sqrt(len(measured))).ravel()
