"""Computed-torque control: the forces of a planned motion, corrected by feedback of positions and
velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control.force.allocation import AllocationResult, allocation_of
from uvms_ocp.control.force.thruster_lag import thruster_lag
from uvms_ocp.robot import Command, Robot, State, signals
from uvms_ocp.robot.dynamics import Dynamics
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.types import Lead, Magnitude

# From a generalized force to what is asked of thrusters and joint motors.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RealizedForce:
    """Limits of thrusters and motors on a generalized force."""

    allocation: AllocationResult
    """Limits of the thrusters, once they have come up to speed."""
    torque: np.ndarray
    """(n_joints,) [N m or N], inside the limits."""
    force: np.ndarray
    """(n_v,) [N, N m] that both give."""


class Actuators:
    """Thrusters and joint motors of a robot. Holds their modelled state: build one per run."""

    def __init__(self, robot: Robot, *, lead: float, dt: float) -> None:
        """lead: thrusters are driven this many times faster than their lag. dt [s]: control
        period.
        """
        self._robot = robot
        self._allocation = allocation_of(robot)
        self._lag = thruster_lag(robot, lead=lead, dt=dt)
        self._thrust = np.zeros(len(self._lag.lower))
        self._torque = np.zeros(robot.n_joints)

    @property
    def force(self) -> np.ndarray:
        """Generalized force (n_v,) [N, N m] now: thrusters as they follow their commands, motors as
        last asked.
        """
        wrench = self._allocation.matrix @ self._thrust
        return np.concatenate([wrench[: self._robot.n_vehicle], self._torque])

    def realize(self, tau: np.ndarray) -> RealizedForce:
        """Limit tau (n_v,) [N, N m]."""
        n = self._robot.n_vehicle
        limit = self._robot.limits.effort
        wrench = np.zeros(6)
        wrench[:n] = tau[self._robot.vehicle_v]
        torque = np.clip(tau[self._robot.joint_v], -limit, limit)
        result = self._allocation.allocate(wrench)
        return RealizedForce(
            allocation=result, torque=torque, force=np.concatenate([result.reached[:n], torque])
        )

    def drive(self, realized: RealizedForce) -> np.ndarray:
        """Command (n_thrusters,) [N] of the thrusters for a tick, through their lag, ahead of
        it.
        """
        command = self._lag.command(self._thrust, realized.allocation.thrust, True)
        self._thrust = self._lag.after(self._thrust, command)
        self._torque = realized.torque
        return np.asarray(command)


@checked_dataclass()
class TrackingGains:
    """Gains of the closed loop's position and velocity errors. Raises `InvalidInput` for a gain
    below 0 or a lead below 1.
    """

    vehicle_stiffness: Magnitude = 1.0
    """[1/s^2]"""
    vehicle_damping: Magnitude = 2.0
    """[1/s]"""
    joints_stiffness: Magnitude = 36.0
    """[1/s^2]"""
    joints_damping: Magnitude = 12.0
    """[1/s]"""
    lead: Lead = 4.0
    """Thrusters are driven this many times faster than their lag."""


OPEN_LOOP = TrackingGains(
    vehicle_stiffness=0, vehicle_damping=0, joints_stiffness=0, joints_damping=0
)
"""No feedback."""


class ComputedTorque:
    """The law of one robot. Holds the modelled state of its actuators: build one per run."""

    def __init__(
        self,
        robot: Robot,
        dynamics: Dynamics,
        *,
        dt: float,
        gains: TrackingGains | None,
        water: Water,
    ) -> None:
        """Dt [s]: control period. water: as far as the controller knows it."""
        chosen = gains or TrackingGains()
        self._robot = robot
        self._dynamics = dynamics
        self._water = water
        self._open = chosen == OPEN_LOOP
        n, m = robot.n_vehicle, robot.n_joints
        self._K_p = np.repeat([chosen.vehicle_stiffness, chosen.joints_stiffness], [n, m])
        self._K_d = np.repeat([chosen.vehicle_damping, chosen.joints_damping], [n, m])
        self._actuators = Actuators(robot, lead=chosen.lead, dt=dt)

    @property
    def force(self) -> np.ndarray:
        """Generalized force (n_v,) [N, N m] now, as `Actuators.force`."""
        return self._actuators.force

    def command(
        self,
        state: State,
        *,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        disturbance: np.ndarray | float = 0.0,
    ) -> Command:
        """Command for a measured state and the planned q (n_q,) [m, rad], v (n_v,) [m/s, rad/s] and
        a (n_v,) [m/s2, rad/s2].

        disturbance (n_v,) [N, N m]: force to work against.
        """
        if self._open:
            at = signals.unchecked_state(q=q, v=v)
        else:
            at = state
        wanted = a + self._K_p * pin.difference(self._robot.model, at.q, q) + self._K_d * (v - at.v)
        tau = self._dynamics.inverse_dynamics(at.q, at.v, wanted, self._water) - disturbance
        realized = self._actuators.realize(tau)
        return signals.unchecked_command(
            v=v, thrust=self._actuators.drive(realized), torque=realized.torque
        )
