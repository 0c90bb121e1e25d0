"""The attitude that the measured motion of the arm should lead to: balanced at every moment, or
simulated.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from pool.recordings import SAMPLE_TIME, Recording
from pool.vehicle import PoolVehicle

Predictor: TypeAlias = Callable[[PoolVehicle, Recording, np.ndarray], np.ndarray]
"""Function that predicts roll and pitch (n, 2) [rad] at the times of the joints, for a shift (3,) [m] of the centre of
buoyancy.
"""


def static_balance(vehicle: PoolVehicle, recording: Recording, shift: np.ndarray) -> np.ndarray:
    """Roll and pitch (n, 2) [rad] at which weight and buoyancy balance, for a shift (3,) [m] of the
    centre of buoyancy.
    """
    return roll_pitch(righting(vehicle, recording, shift))


def righting(vehicle: PoolVehicle, recording: Recording, shift: np.ndarray) -> np.ndarray:
    """First moment (n, 3) [N m] in B of buoyancy less weight, for a shift (3,) [m]; at rest it is
    up.
    """
    moment: np.ndarray = np.asarray(
        vehicle.righting.map(len(recording.joint_t))(recording.joint_q.T, shift)
    ).T
    return moment


def replay(vehicle: PoolVehicle, recording: Recording, shift: np.ndarray) -> np.ndarray:
    """Simulated roll and pitch (n, 2) [rad], from rest in the static balance, for a shift (3,)
    [m].
    """
    joints = np.hstack([recording.joint_q, recording.joint_v, recording.joint_a])
    n_steps = (len(joints) - 1) // 2  # a step spans two samples, the middle one serves Runge-Kutta
    windows = np.hstack([joints[2 * k : 2 * k + 3].T for k in range(n_steps)])
    start = np.concatenate(
        [quaternion_of(static_balance(vehicle, recording, shift)[0]), np.zeros(6)]
    )
    path = vehicle.step.mapaccum(n_steps)(start, windows, shift, 2 * SAMPLE_TIME)
    quaternions = np.vstack([start[:4], np.asarray(path).T[:, :4]])
    attitude = roll_pitch(_up(quaternions))
    return at_times(recording.joint_t, recording.joint_t[: 2 * n_steps + 1 : 2], attitude)


def roll_pitch(up: np.ndarray) -> np.ndarray:
    """Roll and pitch (n, 2) [rad] of a vehicle that sees the vertical along up (n, 3), of any
    length.
    """
    x, y, z = up.T
    return np.column_stack([np.arctan2(y, z), -np.arctan2(x, np.hypot(y, z))])


def _up(quaternions: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternions.T
    return np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def quaternion_of(attitude: np.ndarray) -> np.ndarray:
    """Quaternion xyzw (4,) of roll and pitch (2,) [rad]."""
    sr, sp = np.sin(attitude / 2)
    cr, cp = np.cos(attitude / 2)
    return np.array([sr * cp, cr * sp, -sr * sp, cr * cp])


def at_times(t: np.ndarray, undelayed_t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (m, k) that are known at times (m,) [s], at the times t (n,) [s]."""
    return np.column_stack([np.interp(t, undelayed_t, column) for column in values.T])
