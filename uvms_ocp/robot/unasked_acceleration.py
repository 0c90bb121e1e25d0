"""Acceleration of a vehicle that nobody asked for: by weight and buoyancy, and by a faulty thruster."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import lifts
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.types import read_only


@lru_cache(maxsize=8)
def unasked_acceleration(robot: Robot) -> np.ndarray:
    """Return the largest acceleration (6,) [m/s2, rad/s2] of each axis of a vehicle, from rest in
    its usual configuration.

    Weight and buoyancy may act in any attitude, and the thruster that moves the axis most gives all
    it can.
    """
    q = np.array(robot.configuration())
    M_inverse = np.linalg.inv(cached_dynamics(robot).mass_matrix(q)[:6, :6])
    arms, lift = lifts(robot, q)
    force = abs(float(lift.sum()))
    moment = float(np.linalg.norm(arms.T @ lift))
    by_weight = force * np.linalg.norm(M_inverse[:, :3], axis=1)
    by_weight += moment * np.linalg.norm(M_inverse[:, 3:], axis=1)
    if not robot.description.thrusters:
        return read_only(by_weight)
    lower, upper = thrust_limits(robot)
    largest_thrust = np.maximum(np.abs(lower), np.abs(upper))
    by_thrusters = np.abs(M_inverse @ (thruster_matrix(robot) * largest_thrust))
    return read_only(by_weight + by_thrusters.max(axis=1))
