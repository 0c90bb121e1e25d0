"""Joints as the filter knows them, one number each, and as q has them, where a turn may take two."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.control.navigation.filter.memory import Channel, Memory
from uvms_ocp.model.robot import Robot


class JointChart:
    """Displacements of the joints from an origin, which follows the estimate where q is no vector space."""

    __slots__ = ("_memory", "_origin", "_plain", "_robot")

    def __init__(self, robot: Robot, memory: Memory) -> None:
        self._robot, self._memory, self._origin = robot, memory, pin.neutral(robot.model)
        self._plain = all(joint.n_q == joint.n_v for joint in robot.joints)

    def values(self, channel: str, reading: Array) -> Array:
        """(n_joints,) of a reading (n_joint_q,) [rad or m] of joint positions, or (n_joints,) [rad/s or m/s] of velocities."""
        if self._plain or channel != "joint_positions":
            return reading
        if not np.isfinite(reading).all():
            return np.full(self._robot.n_joints, np.nan)
        q = self._origin.copy()
        q[self._robot.joint_q] = reading
        return np.asarray(pin.difference(self._robot.model, self._origin, q)[self._robot.joint_v])

    def configuration(self) -> Array:
        """The joint part of q [rad or m]."""
        displaced = self._memory.joint_x[:, 0]
        if self._plain:
            return displaced.copy()
        v = np.zeros(self._robot.n_v)
        v[self._robot.joint_v] = displaced
        self._origin = pin.integrate(self._robot.model, self._origin, v)
        clones = self._memory.joint_owner == Channel.JOINT_POSITIONS
        self._memory.joint_seen[:, clones] -= displaced[:, None]
        self._memory.joint_x[:, 0] = 0.0
        return np.asarray(self._origin[self._robot.joint_q])
