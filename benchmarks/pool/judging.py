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
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.robot.spatial import exp3

ANGLES = ("roll", "pitch")


def angles(predicted: Predicted) -> tuple[np.ndarray, np.ndarray]:
    """Predicted and measured roll and pitch (m, 2) [deg], each less its mean in the beginning."""
    t = predicted.t[2]
    simulated = without_offset(t, roll_pitch(predicted.rows[2]))
    measured = without_offset(t, roll_pitch(predicted.measured[2]))
    return simulated, measured


def errors(predicted: Predicted) -> np.ndarray:
    """RMSE (2,) [deg]."""
    simulated, measured = angles(predicted)
    return _size(simulated - measured)


def still(predicted: Predicted) -> np.ndarray:
    """RMSE (2,) [deg] of a vehicle that stays as it was."""
    return _size(angles(predicted)[1])


def about_mean(predicted: Predicted) -> np.ndarray:
    """RMSE (2,) [deg] of a vehicle that stays at the mean of what was seen, which nobody knew."""
    return np.asarray(angles(predicted)[1].std(axis=0))


def _size(difference: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(difference**2, axis=0)))


def row(name: str, sensor: str, kind: str, rmse: np.ndarray) -> Row:
    """Make the row of one prediction."""
    figures: dict[str, object] = {"recording": name, "sensor": sensor, "prediction": kind}
    for angle, value in zip(ANGLES, rmse, strict=True):
        figures[f"{angle} RMSE [deg]"] = float(value)
    return figures


def turned_back(
    learner: Learner, prepared: PreparedRecording, shared: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) [s], and roll and pitch (m, 2) [rad] of B, by a sensor that sits as unknowns
    shared (n,) have it.
    """
    (whole,) = prepared.segments(STEP)
    values = learner.vehicle.shared.values(ca.SX(ca.DM(shared)))
    turn = np.asarray(ca.DM(exp3(values["attitude_turn"])))
    return whole.t[2], roll_pitch(whole.measured[2] @ turn.T)


def apart(
    first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """RMS (2,) [deg] between two sensors, each less its mean in the beginning, at the times of the
    first.
    """
    first_t, first_angles = first
    second_t, second_angles = second
    inside = (first_t >= second_t[0]) & (first_t <= second_t[-1])
    t = first_t[inside]
    second_at_t = at_times(t, second_t, second_angles)
    return _size(without_offset(t, first_angles[inside]) - without_offset(t, second_at_t))
