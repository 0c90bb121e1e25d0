"""Free swings: what a vehicle does where its arm rests, as it was seen and as it was predicted."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from recording.report import Row

from pool.findings import swing_in
from pool.judging import ANGLES, angles
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.resampling import smoothed

_REST = 0.05  # [rad/s] below which the arm rests
_WINDOW = 0.4  # [s] over which the motion of the arm is smoothed
_SHORTEST = 3.0  # [s] of a rest
_SETTLED = 0.3  # [s] after the arm has come to rest, from when on a swing is free
# Standard deviations of an angle
SMALLEST = 0.05  # [deg] in which a swing is looked for
LARGE = 0.2  # [deg] with which a swing is large


def rests(recording: Recording) -> Iterator[tuple[float, float]]:
    """Find from when to when [s] the arm rests."""
    joints = recording.channel("joint_positions")
    t, rates = smoothed(joints.undelayed_t, joints.values, _WINDOW, derivative=1)
    moving = np.abs(rates).max(axis=1) > _REST
    edges = np.concatenate([[0], 1 + np.flatnonzero(np.diff(moving)), [len(t) - 1]])
    for first, last in pairwise(edges):
        if not moving[first] and t[last] - t[first] > _SHORTEST:
            yield float(t[first]) + _SETTLED, float(t[last])


def swings(recording: Recording, predicted: Predicted) -> list[Row]:
    """A row for every swing that was seen, with the predicted one at the same time."""
    rows = []
    for begin, end in rests(recording):
        inside = (predicted.t[2] >= begin) & (predicted.t[2] <= end)
        t = predicted.t[2][inside]
        for k, angle in enumerate(ANGLES):
            predicted_angles, measured_angles = angles(predicted)
            measured = measured_angles[inside, k]
            if measured.size and measured.std() > SMALLEST:
                simulated = predicted_angles[inside, k]
                rows += _row(recording.name, angle, t - t[0], measured, simulated)
    return rows


def _row(
    name: str, angle: str, t: np.ndarray, measured: np.ndarray, simulated: np.ndarray
) -> list[Row]:
    measured_swing = swing_in(t, measured)
    predicted_swing = swing_in(t, simulated)
    if measured_swing is None:
        return []
    row: dict[str, object] = {"recording": name, "angle": angle}
    row |= {"size [deg]": float(measured.std())}
    row |= {"period [s]": measured_swing.period, "damping": measured_swing.damping}
    if predicted_swing is not None:
        row |= {
            "predicted period [s]": predicted_swing.period,
            "predicted damping": predicted_swing.damping,
        }
        row |= {
            "period [%]": 100 * (predicted_swing.period / measured_swing.period - 1),
            "damping [%]": 100 * (predicted_swing.damping / measured_swing.damping - 1),
        }
    return [row]
