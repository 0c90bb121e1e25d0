"""From a generalized force to what is asked of thrusters and joint motors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.control.force.allocation import AllocationResult, allocation_of
from uvms_ocp.control.force.thruster_lag import thruster_lag
from uvms_ocp.model.robot import Robot


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Realized:
    """What thrusters and motors can do of a generalized force."""

    allocation: AllocationResult
    """Of the thrusters, once they have come up to speed."""
    torque: np.ndarray
    """(n_joints,) [N m or N], inside the limits."""
    force: np.ndarray
    """(n_v,) [N, N m] that both give."""


class Actuators:
    """Thrusters and joint motors of a robot. Holds their modelled state: build one per run."""

    def __init__(self, robot: Robot, *, lead: float, dt: float) -> None:
        """lead [-]: thrusters are driven this many times faster than their lag. dt [s]: control period."""
        self._robot = robot
        self._allocation = allocation_of(robot)
        self._lag = thruster_lag(robot, lead=lead, dt=dt)
        self._thrust = np.zeros(len(self._lag.lower))
        self._torque = np.zeros(robot.n_joints)

    @property
    def force(self) -> np.ndarray:
        """Generalized force (n_v,) [N, N m] now: thrusters as they follow their commands, motors as last asked."""
        wrench = self._allocation.matrix @ self._thrust
        return np.concatenate([wrench[: self._robot.n_vehicle], self._torque])

    def realize(self, tau: np.ndarray) -> Realized:
        """What the limits leave of tau (n_v,) [N, N m]."""
        n, limit = self._robot.n_vehicle, self._robot.limits.effort
        wrench = np.zeros(6)
        wrench[:n] = tau[self._robot.vehicle_v]
        torque = np.clip(tau[self._robot.joint_v], -limit, limit)
        result = self._allocation.allocate(wrench)
        return Realized(allocation=result, torque=torque, force=np.concatenate([result.reached[:n], torque]))

    def drive(self, realized: Realized) -> np.ndarray:
        """Command (n_thrusters,) [N] of the thrusters for a tick, through their lag, ahead of it."""
        command = self._lag.command(self._thrust, realized.allocation.thrust, True)
        self._thrust, self._torque = self._lag.after(self._thrust, command), realized.torque
        return np.asarray(command)
