"""Dynamic control layer: forces and torques that make the robot follow reference velocities ([Gao2022] figure 4)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import changed, checked, late
from uvms_ocp.control.actuator_health.monitor import ActuatorMonitor, Look
from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning
from uvms_ocp.control.force.actuators import Actuators, Realized
from uvms_ocp.control.force.allocation import allocation_of
from uvms_ocp.control.force.observer import DisturbanceObserver
from uvms_ocp.control.velocity.distress import Strain
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.control.velocity.tick_state import TickState
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.dynamics import Dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, Measurement

SEARCH = ActuatorHealthTuning()
"""For faulty thrusters and joints, by default."""
_EASE = 1.0  # [s] in which the bandwidth of the velocity loop changes
_ENCODER_SILENCE = 0.05  # [s] after which joints are no longer fed back; a joint falls faster than a vehicle drifts
_FULL = 0.95  # share of its bandwidth that the observer needs for its findings to be judged
_ENCODERS = ("joint_positions", "joint_velocities")


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class VelocityGains:
    """Gains of the velocity loop, in units of the closed loop: the model takes care of mass and water.

    Raises `InvalidInput` for a gain below 0 or a lead below 1.
    """

    vehicle: float = 3.0
    """[1/s] proportional."""
    joints: float = 12.0
    """[1/s]"""
    vehicle_reset: float = 1.0
    """[1/s] inverse integral time: how fast the integral takes over."""
    joints_reset: float = 3.0
    """[1/s]"""
    observer_vehicle: float = 3.0
    """[rad/s] bandwidth of the disturbance observer; 0 turns it off."""
    observer_joints: float = 4.0
    """[rad/s]"""
    lead: float = 4.0
    """[-] thrusters are driven this many times faster than their lag."""

    def __post_init__(self) -> None:
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name, value in values.items():
            if not (np.isfinite(value) and value >= 0):
                raise InvalidInput(f"gain {name} = {value}; give a finite value >= 0")
        if self.lead < 1:
            raise InvalidInput(f"gain lead = {self.lead}; give a factor >= 1")


@checked
class DynamicController:
    """Tracks the velocities of a kinematic layer: a callable ``(Measurement, t) -> Command`` with thrust and torque.

    ``tau = M (a_ref + K_p (e + i)) + D i + h(q, v_ref) - d`` with ``i = reset * int e``: model-based feed-forward, PI
    on the velocity error with anti-windup, and the disturbance d of an observer. Thrusters are inverted through their lag.
    D in the integral part: without it, axes with much drag are left with a slow tail. Drag in h is that of the
    reference: fed back from the measured velocity it destabilises the loop wherever the model has too much of it.
    """

    def __init__(
        self,
        *,
        robot: Robot,
        dynamics: Dynamics,
        kinematic: KinematicController,
        gains: VelocityGains | None = None,
        health: ActuatorHealthTuning | None = SEARCH,
    ) -> None:
        """health: thresholds of the search for faulty thrusters and joints; `None` turns it off.

        Raises `InvalidInput` for a vehicle without thrusters.
        """
        if robot.n_vehicle and not robot.description.thrusters:
            raise InvalidInput(
                f"robot {robot.name!r} has no thrusters; give some in its YAML, or use the kinematic plant"
            )
        self.kinematic = kinematic
        self._robot, self._dynamics, self._dt = robot, dynamics, kinematic.dt
        self._gains = gains or VelocityGains()
        self._lift = float(_strength(robot)[2])
        self._actuators = Actuators(robot, lead=self._gains.lead, dt=self._dt)
        self._observer = observer_of(robot, dynamics, self._gains, self._dt)
        self.monitor = self._monitor(health)
        """Of thrusters and joints; `None` where it is off, and without the observer, whose findings it reads."""
        self._handicap, self._jammed = "", tuple[int, ...]()
        self._K_p = _per_axis(robot, self._gains.vehicle, self._gains.joints)
        self._reset = _per_axis(robot, self._gains.vehicle_reset, self._gains.joints_reset)
        self._share = np.ones(robot.n_v)
        self._integral = np.zeros(robot.n_v)
        self._reference = np.zeros(robot.n_v)

    @late
    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""
        tick = self.kinematic.observe(measurement, t)
        sound, command = tick.measurement, self.kinematic.command(tick)
        if command.stop:
            self._integral[self._robot.vehicle_v] = 0.0
        trusted = self._trusted(command, sound)
        self._soften(tick.restriction.feedback)
        disturbance = self._disturbance(sound, command)
        if self.monitor is not None:
            self._watch(self.monitor, command, tick, trusted)
        error = np.where(trusted, command.v - sound.v, 0.0)
        tau = self._force(sound.q, command.v, error) - disturbance
        tau += self._dynamics.damping_matrix(sound.q, command.v) @ (self._share * self._reset * self._integral)
        self._reference = command.v
        if command.stop:
            tau[self._robot.vehicle_v] = 0.0
        realized = self._actuators.realize(tau)
        self._integrate(error, tau, realized.force)
        self.kinematic.feel(self._met(sound.q, disturbance, realized))
        telemetry = {
            **command.telemetry,
            "disturbance": disturbance.copy(),
            "wrench": tau[: self._robot.n_vehicle],
            "unreachable": realized.allocation.unreachable,
            "saturated": realized.allocation.saturated,
            **({} if self.monitor is None else self.monitor.telemetry()),
        }
        thrust = self._actuators.drive(realized, hurry=not command.stop)
        return changed(command, thrust=thrust, torque=realized.torque, brakes=not trusted[-1], telemetry=telemetry)

    def _force(self, q: np.ndarray, v: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Generalized force (n_v,) [N, N m] of the reference v (n_v,), whose last change counts, corrected by PI."""
        a = (v - self._reference) / self._dt + self._share * self._K_p * (
            error + self._share * self._reset * self._integral
        )
        return self._dynamics.inverse_dynamics(q, v, a)

    def _met(self, q: np.ndarray, disturbance: np.ndarray, realized: Realized) -> Strain:
        """What the mission may be given up for."""
        if not self._robot.n_vehicle:
            return Strain()
        up, monitor = pin.Quaternion(q[3:7]).matrix()[2], self.monitor
        strain = Strain(short=realized.allocation.saturated, push=float(up @ disturbance[:3]) / self._lift)
        if monitor is None or not self._handicap:
            return strain
        over = not monitor.can_go_on
        fault = f"{self._handicap}: {monitor.authority}" if over else ""
        return replace(strain, fault=fault, handicap=self._handicap, jammed=self._jammed)

    def _trusted(self, command: Command, measurement: Measurement) -> np.ndarray:
        """Which axes (n_v,) are fed back. On the others feed-forward goes on alone: feedback from a frozen velocity
        would accelerate the robot without end."""
        joints = not command.brakes and measurement.joint_age <= _ENCODER_SILENCE
        return np.repeat([not command.hold, joints], [self._robot.n_vehicle, self._robot.n_joints])

    def _soften(self, feedback: float) -> None:
        """Bring the bandwidth of the vehicle's loops nearer to the share `feedback` [-] of their own."""
        vehicle = self._robot.vehicle_v
        self._share[vehicle] += min(1.0, self._dt / _EASE) * (feedback - self._share[vehicle])

    def _disturbance(self, measurement: Measurement, command: Command) -> np.ndarray:
        if self._observer is None:
            return np.zeros(self._robot.n_v)
        if command.hold:
            self._observer.pause(forget=command.stop)
            return self._observer.estimate
        return self._observer.update(measurement.q, measurement.v, self._actuators.force, self._share)

    def _watch(self, monitor: ActuatorMonitor, command: Command, tick: TickState, trusted: np.ndarray) -> None:
        """Look for faults of thrusters and joints, and do without what is faulty from now on."""
        if self._observer is None or not trusted.all() or self._share[0] < _FULL:
            monitor.pause()
        elif monitor.due(self._actuators.asked, self._reference):
            doubted = tick.restriction.doubted
            look = Look(
                q=tick.measurement.q,
                residual=self._observer.prompt,
                disturbance=self._observer.estimate,
                joints_known=doubted.isdisjoint(_ENCODERS),
            )
            if monitor.look(look, tick.t):
                self._adapt(monitor, self._observer)

    def _adapt(self, monitor: ActuatorMonitor, observer: DisturbanceObserver) -> None:
        """To new verdicts."""
        before = self._actuators.force
        self._actuators.adapt(monitor.effect)
        # What a thruster failed to give has been taken for water so far.
        observer.estimate += before - self._actuators.force
        self._jammed = tuple((self._robot.n_vehicle + np.flatnonzero(monitor.joints.jammed)).tolist())
        for axis in self._jammed:
            observer.estimate[axis] = self._integral[axis] = 0.0
        self._handicap = monitor.faulty

    def _monitor(self, tuning: ActuatorHealthTuning | None) -> ActuatorMonitor | None:
        if tuning is None or self._observer is None or not self._robot.n_vehicle:
            return None
        return ActuatorMonitor(
            self._robot,
            self._dynamics,
            bandwidth=self._gains.observer_vehicle,
            dt=self._dt,
            alarms=self.kinematic.watchdog.alarms,
            tuning=tuning,
        )

    def _integrate(self, error: np.ndarray, wanted: np.ndarray, reached: np.ndarray) -> None:
        """Conditional integration: an axis whose force falls short does not wind up further in that direction."""
        short = wanted - reached
        winding = (np.abs(short) > 1e-6 * (1 + np.abs(wanted))) & (short * error > 0)
        self._integral += np.where(winding, 0.0, error * self._dt)


def _per_axis(robot: Robot, vehicle: float, joints: float) -> np.ndarray:
    return np.concatenate([np.full(robot.n_vehicle, vehicle), np.full(robot.n_joints, joints)])


def _strength(robot: Robot) -> np.ndarray:
    """Wrench (6,) [N, N m] that the thrusters can give at most, axis by axis; nothing without thrusters."""
    return np.asarray(np.abs(allocation_of(robot).matrix) @ np.array([t.maximum for t in robot.description.thrusters]))


def observer_of(robot: Robot, dynamics: Dynamics, gains: VelocityGains, dt: float) -> DisturbanceObserver | None:
    """The observer that `gains` ask for, at control period dt [s]; None where its bandwidth is 0."""
    if not gains.observer_vehicle:
        return None
    wrench = _strength(robot)
    return DisturbanceObserver(
        dynamics,
        bandwidth=_per_axis(robot, gains.observer_vehicle, gains.observer_joints or gains.observer_vehicle),
        limit=np.concatenate([wrench[: robot.n_vehicle], robot.limits.effort]),
        dt=dt,
    )
