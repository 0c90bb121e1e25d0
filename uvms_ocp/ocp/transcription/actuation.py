"""What moves a robot: its thrusters or a wrench on the vehicle, and its joints."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from uvms_ocp.ocp.problem import Actuation
from uvms_ocp.ocp.terms import finite_or
from uvms_ocp.robot import Robot
from uvms_ocp.robot.size import size, weight
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix

_RANK = 1e-9  # share of the largest singular value of the thruster matrix below which one is none


class ActuationModel:
    """Matrix, units and limits of what moves the robot; limits are in shares of the units."""

    def __init__(self, robot: Robot, actuation: Actuation) -> None:
        n = robot.n_vehicle
        if n and actuation is Actuation.THRUSTERS:
            self.matrix = thruster_matrix(robot)[:n]
            """(n_vehicle, n_thrust) wrench [N, N m] by thrust [N]."""
            thrust_lower, thrust_upper = thrust_limits(robot)
        else:
            self.matrix = np.eye(n)
            thrust_lower = np.full(n, -np.inf)
            thrust_upper = np.full(n, np.inf)
        largest_thrust = np.maximum(np.abs(thrust_lower), np.abs(thrust_upper))
        # Where there is no limit the robot's weight is the unit, at its size as the lever for moments.
        force = weight(robot.model)
        moment = force * size(robot.model)
        self.thrust_unit = finite_or(largest_thrust, force)
        """(n_thrust,) [N, N m]"""
        self.thrust_lower = thrust_lower / self.thrust_unit
        self.thrust_upper = thrust_upper / self.thrust_unit
        self.torque_unit = finite_or(robot.limits.effort, moment)
        """(n_joints,) [N m]"""
        self.torque_limit = robot.limits.effort / self.torque_unit
        wrench = np.abs(self.matrix) @ self.thrust_unit / 4
        wrench_unit = np.maximum(wrench, 1e-3 * (wrench.max(initial=0.0) or 1.0))
        self.force_unit = np.concatenate([wrench_unit, self.torque_unit])
        """(n_v,) [N, N m] unit of generalised forces."""

    @cached_property
    def spread(self) -> np.ndarray:
        """(n_thrust, n_vehicle) thrust of least squares in shares for a wrench [N, N m]."""
        return np.asarray(np.linalg.pinv(self.matrix * self.thrust_unit, rcond=_RANK))

    @cached_property
    def null(self) -> np.ndarray:
        """(n_thrust, n) thrust in shares that cancels out."""
        return _complement((self.matrix * self.thrust_unit).T)

    @cached_property
    def beyond(self) -> np.ndarray:
        """(n_vehicle, n) directions of a wrench that no thrust makes, in shares of its units."""
        return _complement(self.matrix / self.force_unit[: len(self.matrix), None])


def _complement(matrix: np.ndarray) -> np.ndarray:
    """Return orthonormal directions (n, ...) that are orthogonal to all columns of a matrix
    (n, m).
    """
    U, singular_values, _ = np.linalg.svd(matrix, full_matrices=True)
    smallest = _RANK * singular_values.max(initial=0.0)
    rank = int(np.sum(singular_values > smallest))
    return np.asarray(U[:, rank:])
