"""How far predicted roll and pitch are from what a sensor showed, and how far two sensors are from
each other.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from recording.report import Row

from pool.learnt import STEP, Learner
from pool.replay import at_times, roll_pitch
from pool.scores import without_offset
from uvms_ocp.identification.fit import Predicted
from uvms_ocp.identification.rollout import PreparedRecording
from uvms_ocp.robot.spatial import exp3

ANGLES = ("roll", "pitch")


def angles(predicted: Predicted) -> tuple[np.ndarray, np.ndarray]:
    """Predicted and seen roll and pitch (m, 2) [deg], each less its mean in the beginning."""
    t = predicted.t[2]
    found, seen = (
        without_offset(t, roll_pitch(part[2])) for part in (predicted.rows, predicted.measured)
    )
    return found, seen


def errors(predicted: Predicted) -> np.ndarray:
    """RMSE (2,) [deg]."""
    found, seen = angles(predicted)
    return _size(found - seen)


def still(predicted: Predicted) -> np.ndarray:
    """RMSE (2,) [deg] of a vehicle that stays as it was."""
    return _size(angles(predicted)[1])


def about_mean(predicted: Predicted) -> np.ndarray:
    """RMSE (2,) [deg] of a vehicle that stays at the mean of what was seen, which nobody knew."""
    return np.asarray(angles(predicted)[1].std(axis=0))


def _size(difference: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(difference**2, axis=0)))


def row(name: str, sensor: str, kind: str, rmse: np.ndarray) -> Row:
    """Of one prediction."""
    return {"recording": name, "sensor": sensor, "prediction": kind} | {
        f"{angle} RMSE [deg]": float(value) for angle, value in zip(ANGLES, rmse, strict=True)
    }


def turned_back(
    learner: Learner, prepared: PreparedRecording, shared: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) [s], and roll and pitch (m, 2) [rad] of B, by a sensor that sits as unknowns
    shared (n,) have it.
    """
    (whole,) = prepared.stretches(STEP)
    turn = np.asarray(
        ca.DM(exp3(learner.vehicle.shared.values(ca.SX(ca.DM(shared)))["attitude_turn"]))
    )
    return whole.t[2], roll_pitch(whole.measured[2] @ turn.T)


def apart(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """RMS (2,) [deg] between two sensors, each less its mean in the beginning, at the times of the
    first.
    """
    inside = (one[0] >= other[0][0]) & (one[0] <= other[0][-1])
    t = one[0][inside]
    return _size(without_offset(t, one[1][inside]) - without_offset(t, at_times(t, *other)))
