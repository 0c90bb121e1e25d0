"""From a generalized force to what is asked of thrusters and joint motors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.force.allocation import Allocation, AllocationResult, allocation_of
from uvms_ocp.control.force.degraded import DegradedAllocation
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thrust_limits


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
        self._whole = allocation_of(robot)
        self._allocation: Allocation | DegradedAllocation = self._whole
        self._lag = ThrusterLag(robot, lead, dt)
        self._torque = np.zeros(robot.n_joints)
        self._effect: Effect | None = None

    @property
    def asked(self) -> np.ndarray:
        """(n_thrusters,) [N] now, of thrusters that all follow their commands."""
        return self._lag.thrust

    @property
    def force(self) -> np.ndarray:
        """Generalized force (n_v,) [N, N m] now: thrusters as they follow their commands, motors as last asked."""
        thrust = self._lag.thrust if self._effect is None else self._effect.given(self._lag.thrust)
        wrench = self._whole.matrix @ thrust
        return np.concatenate([wrench[: self._robot.n_vehicle], self._torque])

    def realize(self, tau: np.ndarray) -> Realized:
        """What the limits leave of tau (n_v,) [N, N m]."""
        n, limit = self._robot.n_vehicle, self._robot.limits.effort
        wrench = np.zeros(6)
        wrench[:n] = tau[self._robot.vehicle_v]
        torque = np.clip(tau[self._robot.joint_v], -limit, limit)
        result = self._allocation.allocate(wrench)
        return Realized(allocation=result, torque=torque, force=np.concatenate([result.reached[:n], torque]))

    def drive(self, realized: Realized, *, hurry: bool = True) -> np.ndarray:
        """Command (n_thrusters,) [N] of the thrusters for a tick; hurry: through their lag, ahead of it."""
        self._torque, wanted = realized.torque, realized.allocation.thrust
        return self._lag.drive(wanted if self._effect is None else self._effect.asked(wanted), hurry=hurry)

    def adapt(self, effect: Effect) -> None:
        """From now on: what thrusters make of their commands."""
        self._effect, self._allocation = effect, DegradedAllocation(self._whole, effect)


class ThrusterLag:
    """Model of first-order thrusters, and the thrust command that makes them `lead` times faster."""

    def __init__(self, robot: Robot, lead: float, dt: float) -> None:
        """lead [-] and dt [s] as `Actuators` takes them."""
        time_constants = np.array([thruster.time_constant for thruster in robot.description.thrusters])
        self._decay = np.exp(-dt / np.maximum(time_constants, 1e-9))
        self._lower, self._upper = thrust_limits(robot)
        # Faster than the control period would ring.
        self._lead = np.clip(lead, 1.0, np.maximum(time_constants / (2 * dt), 1.0))
        self.thrust = np.zeros(len(time_constants))
        """(n_thrusters,) [N] modelled, now."""

    def drive(self, wanted: np.ndarray, *, hurry: bool) -> np.ndarray:
        """Command (n_thrusters,) [N] for the wanted (n_thrusters,) [N]; advances the model by one tick."""
        lead = self._lead if hurry else 1.0
        command = np.clip(self.thrust + lead * (wanted - self.thrust), self._lower, self._upper)
        self.thrust = command + (self.thrust - command) * self._decay
        return command
