"""What moves a robot: its thrusters or a wrench on the vehicle, and its joints."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.ocp.problem import Actuation
from uvms_ocp.ocp.terms import finite_or

_UNLIMITED_EFFORT = 10.0  # [N m] unit of torque where the robot has no limit
_RANK = 1e-9  # of a singular value of the thruster matrix
_VEHICLE_FORCE = 100.0  # [N, N m] unit of the wrench on a vehicle without thrusters


class Actuators:
    """Matrix, units and limits of what moves the robot."""

    def __init__(self, robot: Robot, actuation: Actuation) -> None:
        thrusters = bool(robot.n_vehicle) and actuation is Actuation.THRUSTERS
        n = robot.n_vehicle
        self.matrix = thruster_matrix(robot)[:n] if thrusters else np.eye(n)
        limits = thrust_limits(robot) if thrusters else (np.full(n, -np.inf), np.full(n, np.inf))
        largest = np.maximum(np.abs(limits[0]), np.abs(limits[1]))
        self.thrust_unit = finite_or(largest, _VEHICLE_FORCE)
        self.thrust_lower, self.thrust_upper = (limit / self.thrust_unit for limit in limits)
        self.torque_unit = finite_or(robot.limits.effort, _UNLIMITED_EFFORT)
        self.torque_limit = robot.limits.effort / self.torque_unit
        reach = np.abs(self.matrix) @ self.thrust_unit / 4
        self.force_unit = np.concatenate([np.maximum(reach, 1e-3 * reach.max(initial=1.0)), self.torque_unit])

    @cached_property
    def spread(self) -> np.ndarray:
        """(n_thrust, n_vehicle) least thrust in shares [-] for a wrench [N, N m]."""
        return np.asarray(np.linalg.pinv(self.matrix * self.thrust_unit, rcond=_RANK))

    @cached_property
    def null(self) -> np.ndarray:
        """(n_thrust, n) [-] thrust in shares that cancels out."""
        return self._complement((self.matrix * self.thrust_unit).T)

    @cached_property
    def beyond(self) -> np.ndarray:
        """(n_vehicle, n) [-] directions of a wrench that no thrust makes, in shares of its units."""
        return self._complement(self.matrix / self.force_unit[: len(self.matrix), None])

    @staticmethod
    def _complement(matrix: np.ndarray) -> np.ndarray:
        """Orthonormal directions (n, ...) [-] that are orthogonal to all columns of a matrix (n, m)."""
        U, sizes, _ = np.linalg.svd(matrix, full_matrices=True)
        return np.asarray(U[:, int(np.sum(sizes > _RANK * sizes.max(initial=0.0))) :])
