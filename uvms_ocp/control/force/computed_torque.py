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
from uvms_ocp.robot.thrusters import thruster_matrix
from uvms_ocp.types import Lead, Magnitude

_RANK = 1e-9
"""of a singular value of the thruster matrix, as a share of the largest."""

_VEHICLE_BRAKING = 0.2
_JOINTS_BRAKING = 0.06
"""[s] over which what is left to the limit of a rate may be used up: thrusters come up to speed
within the first, and a joint's motor follows at once.
"""
_BRAKING_TICKS = 3.0
"""periods of control that it takes at least."""
_ASKED_RATE = 0.98
"""share of the limit that is asked for: forces are held over a tick, in which rates go on."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RealizedForce:
    """Limits of thrusters and motors on a generalized force."""

    allocation: AllocationResult
    """Limits of the thrusters, once they have come up to speed."""
    torque: np.ndarray
    """(n_joints,) [N m or N], inside the limits."""
    force: np.ndarray
    """(n_v,) [N, N m] generalized force of thrusters and motors together."""


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
        approach = self._lag.lead * (1.0 - self._lag.decay)
        if len(approach):
            self.lag = dt * float(np.mean(1.0 / approach - 0.5))
        else:
            self.lag = 0.0
        """[s] by which thrust comes later than it is asked for, driven ahead of its own lag."""

    @property
    def force(self) -> np.ndarray:
        """Generalized force (n_v,) [N, N m] now: thrusters as they follow their commands, motors as
        last asked.
        """
        return np.concatenate([self.vehicle_force, self._torque])

    @property
    def vehicle_force(self) -> np.ndarray:
        """Force (n_vehicle,) [N, N m] of the thrusters now, as they follow their commands."""
        wrench: np.ndarray = self._allocation.matrix @ self._thrust
        return wrench[: self._robot.n_vehicle]

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

    def turn(self, torque: np.ndarray) -> np.ndarray:
        """Ask the motors for a torque (n_joints,) [N m or N]; return it inside their limits."""
        limit = self._robot.limits.effort
        self._torque = np.clip(torque, -limit, limit)
        return self._torque


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


def feedback_gains(robot: Robot, gains: TrackingGains) -> tuple[np.ndarray, np.ndarray]:
    """Return the stiffness (n_v,) [1/s^2] and damping (n_v,) [1/s] of every axis."""
    n = [robot.n_vehicle, robot.n_joints]
    return (
        np.repeat([gains.vehicle_stiffness, gains.joints_stiffness], n),
        np.repeat([gains.vehicle_damping, gains.joints_damping], n),
    )


OPEN_LOOP = TrackingGains(
    vehicle_stiffness=0, vehicle_damping=0, joints_stiffness=0, joints_damping=0
)
"""No feedback."""


# Axes that no thruster pushes.


def undriven_axes(robot: Robot) -> np.ndarray:
    """Return orthonormal directions (n_v, k) of generalized force that neither thrusters nor motors
    give, such as a moment about the pitch axis.
    """
    n = robot.n_vehicle
    if not n:
        return np.zeros((robot.n_v, 0))
    U, sizes, _ = np.linalg.svd(thruster_matrix(robot)[:n], full_matrices=True)
    rank = int(np.sum(sizes > _RANK * sizes.max(initial=0.0)))
    return np.vstack([U[:, rank:], np.zeros((robot.n_joints, n - rank))])


def attained_acceleration(
    undriven: np.ndarray, M: np.ndarray, bias: np.ndarray, desired: np.ndarray
) -> np.ndarray:
    """Return the acceleration (n_v,) [m/s2, rad/s2] that is as `desired` but along the undriven
    axes (n_v, k), which move as the bias force (n_v,) [N, N m] and the others make them.

    M (n_v, n_v) [kg, kg m, kg m2]. Forces for `desired` itself would make driven axes miss what the
    undriven ones were to do for them.
    """
    missing = undriven.T @ (M @ desired + bias)
    along = np.linalg.solve(undriven.T @ M @ undriven, missing)
    return desired - undriven @ along


class RateLimiter:
    """Keeps rates within their limits: ``-(v_max + v) / T <= a <= (v_max - v) / T``, a barrier that
    brings a rate that is beyond its limit back within T, too.
    """

    def __init__(self, robot: Robot, limit: np.ndarray, dt: float) -> None:
        """limit (n_v,) [m/s, rad/s]: infinite where there is none. dt [s]: control period."""
        n, m = robot.n_vehicle, robot.n_joints
        self._limit = _ASKED_RATE * limit
        braking = np.repeat([_VEHICLE_BRAKING, _JOINTS_BRAKING], [n, m])
        self._time = np.maximum(braking, _BRAKING_TICKS * dt)

    def velocity(self, v: np.ndarray) -> np.ndarray:
        """Return the reference velocity (n_v,) [m/s, rad/s] within the limits."""
        return np.clip(v, -self._limit, self._limit)

    def acceleration(self, a: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the acceleration a (n_v,) [m/s2, rad/s2] that the measured velocity v (n_v,)
        [m/s, rad/s] leaves room for.
        """
        return np.clip(a, (-self._limit - v) / self._time, (self._limit - v) / self._time)


def held_inertia(M: np.ndarray, slope: np.ndarray, dt: float) -> np.ndarray:
    """Compute the inertia (n_v, n_v) [kg, kg m, kg m2] for the mean acceleration over a tick of dt
    [s] in which a force is held and drag grows: ``M x / (1 - exp(-x))`` of ``x = dt M^-1 slope``,
    to third order in x, so that it is right to 15 % until x = 5.

    M (n_v, n_v) [kg, kg m, kg m2]; slope (n_v, n_v) [N/(m/s), N m/(rad/s)] of drag.
    """
    grown = dt * slope
    return M + grown / 2 + grown @ np.linalg.solve(M, grown) / 12


class ComputedTorque:
    """Computed-torque control of one robot. Holds the modelled state of its actuators: build one
    per run.

    With feedback thrusters are asked for the force of the state in which it will act, which is
    later than now by their lag. The motors of the joints are asked for what their accelerations take
    while the vehicle accelerates as its thrusters do push it: an arm would else be thrown by what
    the vehicle lacks.
    """

    def __init__(
        self,
        robot: Robot,
        dynamics: Dynamics,
        *,
        dt: float,
        gains: TrackingGains | None,
        water: Water,
        rate_limit: np.ndarray | None = None,
    ) -> None:
        """dt [s]: control period. water: as far as the controller knows it. rate_limit (n_v,)
        [m/s, rad/s]: that no rate is to pass, by default none.
        """
        gains = gains or TrackingGains()
        self._robot = robot
        self._dynamics = dynamics
        self._dt = dt
        self._water = water
        self._open = gains == OPEN_LOOP
        self._K_p, self._K_d = feedback_gains(robot, gains)
        self._actuators = Actuators(robot, lead=gains.lead, dt=dt)
        self._undriven = undriven_axes(robot)
        if rate_limit is None:
            rate_limit = np.full(robot.n_v, np.inf)
        self._rates = RateLimiter(robot, rate_limit, dt)

    @property
    def force(self) -> np.ndarray:
        """Generalized force (n_v,) [N, N m] now: thrusters as they follow their commands, motors as
        last asked.
        """
        return self._actuators.force

    def correction(self, error: np.ndarray, rate_error: np.ndarray) -> np.ndarray:
        """Return the acceleration (n_v,) [m/s2, rad/s2] by which the law answers an error of the
        configuration (n_v,) [m, rad] and of the velocity (n_v,) [m/s, rad/s].
        """
        return self._K_p * error + self._K_d * rate_error

    def command(
        self,
        state: State,
        *,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        disturbance: np.ndarray | float = 0.0,
    ) -> Command:
        """Return the command for a measured state and the planned q (n_q,) [m, rad], v (n_v,) [m/s, rad/s] and
        a (n_v,) [m/s2, rad/s2].

        disturbance (n_v,) [N, N m]: force to work against.
        """
        if self._open:
            return self._open_command(q, v, a, disturbance)
        model = self._robot.model
        reference = self._rates.velocity(v)
        M = self._dynamics.mass_matrix(state.q)
        bias = self._dynamics.bias_force(state.q, state.v, self._water) - disturbance

        # The vehicle is driven as its thrust will act once the lag has passed.
        lag = self._actuators.lag
        moving = np.linalg.solve(M, self._actuators.force - bias)
        v_then = state.v + lag * moving
        q_then = pin.integrate(model, state.q, lag * state.v + lag * lag / 2 * moving)
        reference_then = self._rates.velocity(v + lag * a)
        planned_then = pin.integrate(model, q, lag * v + lag * lag / 2 * a)
        error_then = pin.difference(model, q_then, planned_then)
        bias_then = self._dynamics.bias_force(q_then, v_then, self._water) - disturbance
        unlimited_then = a + self.correction(error_then, reference_then - v_then)
        desired_then = self._rates.acceleration(unlimited_then, v_then)
        attained = attained_acceleration(self._undriven, M, bias_then, desired_then)
        realized = self._actuators.realize(M @ attained + bias_then)
        before = self._actuators.vehicle_force
        thrust = self._actuators.drive(realized)

        # The joints are driven as the vehicle is pushed in this tick.
        pushed = (before + self._actuators.vehicle_force) / 2
        error = pin.difference(model, state.q, q)
        unlimited = a + self.correction(error, reference - state.v)
        desired = self._rates.acceleration(unlimited, state.v)
        slope = self._dynamics.drag_slope(state.q, state.v, self._water)
        inertia = held_inertia(M, slope, self._dt)
        torque = self._actuators.turn(self._joint_torque(inertia, bias, desired, pushed))
        return signals.unchecked_command(v=reference, thrust=thrust, torque=torque)

    def _open_command(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, disturbance: np.ndarray | float
    ) -> Command:
        """Return the command of the planned motion, whatever the state is."""
        tau = self._dynamics.inverse_dynamics(q, v, a, self._water) - disturbance
        realized = self._actuators.realize(tau)
        thrust = self._actuators.drive(realized)
        return signals.unchecked_command(v=v, thrust=thrust, torque=realized.torque)

    def _joint_torque(
        self, M: np.ndarray, bias: np.ndarray, desired: np.ndarray, pushed: np.ndarray
    ) -> np.ndarray:
        """Compute the torque (n_joints,) [N m or N] for the desired accelerations of the joints, of (n_v,)
        [m/s2, rad/s2], while the thrusters push the vehicle with pushed (n_vehicle,) [N, N m].

        M (n_v, n_v) [kg, kg m, kg m2]: with the drag that grows over a tick in which the torque is
        held, many times the inertia of a light link; bias (n_v,) [N, N m].
        """
        vehicle = self._robot.vehicle_v
        joints = self._robot.joint_v
        coupled = M[vehicle, joints] @ desired[joints]
        moved = np.linalg.solve(M[vehicle, vehicle], pushed - bias[vehicle] - coupled)
        return M[joints, vehicle] @ moved + M[joints, joints] @ desired[joints] + bias[joints]
