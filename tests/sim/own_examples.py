"""A plant, sensors, an estimator and a controller as users write them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from uvms_ocp.control import Estimator, PassThrough
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.signals import (
    IDEAL_SENSORS,
    Command,
    Reading,
    Readings,
    SensorSpecs,
    State,
    StateEstimate,
)
from uvms_ocp.robot.thrusters import thruster_matrix
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import DynamicPlant, KinematicPlant, SensorSuite
from uvms_ocp.tasks import VehiclePose


@dataclass(frozen=True, kw_only=True)
class ExtraDrag:
    """The dynamic plant, slowed down by something that its model does not know; without it, the
    dynamic plant.
    """

    rate: float = 0.0
    """[1/s] of the decay of all velocities."""
    takes_forces: ClassVar[bool] = True
    simulated_faults: ClassVar[tuple[str, ...]] = ("thruster", "current")

    def __call__(self, scenario: Scenario) -> DraggedPlant:
        return DraggedPlant(scenario, self.rate)


class DraggedPlant:
    def __init__(self, scenario: Scenario, rate: float) -> None:
        robot = scenario.plant_robot or scenario.robot
        options: dict[str, Any] = {
            "environment": scenario.environment,
            "faults": scenario.toolkit_faults,
        }
        self.plant = DynamicPlant(robot, scenario.start, dynamics=robot_dynamics(robot), **options)
        self.rate = rate
        self.state = self.plant.state

    def step(self, command: Command, dt: float) -> None:
        self.plant.step(command, dt)
        after = self.plant.state
        self.state = self.plant.state = State(
            q=after.q, v=after.v * np.exp(-self.rate * dt), a=after.a
        )

    def telemetry(self) -> dict[str, Any]:
        return {
            **self.plant.telemetry(),
            "lost_speed": self.rate * float(np.linalg.norm(self.state.v)),
        }


class CopiedKinematics:
    """The kinematic plant, as if it were somebody else's."""

    takes_forces = False

    def __init__(self, scenario: Scenario) -> None:
        self.plant = KinematicPlant(scenario.robot, scenario.start)
        self.state = self.plant.state

    def step(self, command: Command, dt: float) -> None:
        self.plant.step(command, dt)
        self.state = self.plant.state

    def telemetry(self) -> dict[str, Any]:
        return {}


class DoubleIntegrator:
    """Every axis follows its velocity with a lag of its own; the class itself makes the plants."""

    takes_forces = False

    def __init__(self, scenario: Scenario) -> None:
        self.model = scenario.robot.model
        n_v = scenario.robot.n_v
        self.state = State(q=np.array(scenario.start), v=np.zeros(n_v), a=np.zeros(n_v))

    def step(self, command: Command, dt: float) -> None:
        a = 5.0 * (command.v - self.state.v)
        v = self.state.v + a * dt
        self.state = State(q=pin.integrate(self.model, self.state.q, v * dt), v=v, a=a)

    def telemetry(self) -> dict[str, Any]:
        return {"kinetic": 0.5 * self.state.v @ self.state.v}


@dataclass(frozen=True, kw_only=True)
class Bursts:
    """Sensors whose DVL loses sight for seconds at a time; `share` of the time, 0 for the toolkit's
    sensors.
    """

    share: float
    specs: SensorSpecs

    def __call__(self, scenario: Scenario) -> BurstySensors:
        return BurstySensors(self, scenario)


class BurstySensors:
    def __init__(self, settings: Bursts, scenario: Scenario) -> None:
        floor = scenario.environment.seafloor
        specs = scenario.real_sensors or settings.specs
        self.suite = SensorSuite(
            scenario.robot, floor, specs, scenario.seed, scenario.altimeter_frame
        )
        self.share = settings.share
        self.random = np.random.default_rng([scenario.seed, 7])
        self.second = -1
        self.blind = False
        self.last: Reading[np.ndarray] | None = None

    def __call__(self, state: State, t: float) -> Readings:
        readings = self.suite.read(state, t)
        if int(t) != self.second:
            self.second = int(t)
            self.blind = bool(self.random.random() < self.share)
        if not self.blind:
            self.last = readings.linear_velocity
            return readings
        channels = {name: getattr(readings, name) for name in Readings.__dataclass_fields__}
        return Readings(**{**channels, "linear_velocity": self.last})


class ComplementaryFilter:
    """What is quick from gyro and DVL, what lasts from attitude, fixes and depth; joints as
    read.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.robot = scenario.robot
        self.t = 0.0
        self.q = np.array(scenario.start)
        self.v = np.zeros(scenario.robot.n_v)
        self.seen: dict[str, Reading[Any]] = {}

    def __call__(self, readings: Readings, t: float, command: Command | None) -> StateEstimate:
        dt = t - self.t
        self.t = t
        fresh = {name: self._fresh(name, readings) for name in CHANNELS}
        rates = fresh["angular_velocity"]
        if rates is not None:
            self.v[3:6] = rates
        velocity = fresh["linear_velocity"]
        if velocity is not None:
            self.v[:3] = velocity
        self.q = pin.integrate(self.robot.model, self.q, self.v * dt)
        self._correct(fresh, dt)
        echo = readings.altimeter_range
        height = float("nan") if echo is None else echo.value
        return StateEstimate(q=self.q.copy(), v=self.v.copy(), altimeter_range=height)

    def _correct(self, fresh: dict[str, Any], dt: float) -> None:
        q = self.q
        p = fresh["position"]
        if p is not None:
            q[:2] += 0.2 * (p[:2] - q[:2])
        z = fresh["depth"]
        if z is not None:
            q[2] += 0.2 * (z - q[2])
        turn = fresh["attitude"]
        if turn is not None:
            ours = pin.Quaternion(*q[[6, 3, 4, 5]])
            theirs = pin.Quaternion(*turn[[3, 0, 1, 2]])
            q[3:7] = ours.slerp(0.3, theirs).coeffs()
        joints = fresh["joint_positions"]
        if joints is not None:
            missed = joints - q[7:]
            q[7:] = joints
            self.v[6:] += 0.3 * missed / max(dt, 1e-3)

    def _fresh(self, name: str, readings: Readings) -> Any:
        reading = getattr(readings, name)
        if reading is None or reading is self.seen.get(name):
            return None
        self.seen[name] = reading
        return reading.value


class CopiedFilter:
    """The toolkit's filter, as if it were somebody else's."""

    def __init__(self, scenario: Scenario) -> None:
        self.ours: Any = PassThrough(scenario.robot)
        if scenario.specs != IDEAL_SENSORS:
            self.ours = Estimator(scenario.robot, scenario.specs)
            self.outcomes = self.ours.outcomes
            self.inflate_velocity_variance = self.ours.inflate_velocity_variance

    def __call__(self, readings: Readings, t: float, command: Command | None) -> StateEstimate:
        return self.ours(readings, t, command)


@dataclass(frozen=True, kw_only=True)
class Pid:
    """Brings the vehicle to the goal of PC and holds the arm: by forces, without any hierarchy."""

    stiffness: float = 0.4
    """[1/s2]"""
    damping: float = 1.6
    """[1/s]"""
    integral: float = 0.02
    """[1/s3]"""

    def __call__(self, scenario: Scenario) -> PidOfRun:
        return PidOfRun(self, scenario)


class PidOfRun:
    def __init__(self, gains: Pid, scenario: Scenario) -> None:
        self.gains = gains
        self.robot = scenario.robot
        self.dt = scenario.dt
        self.dynamics = robot_dynamics(scenario.robot)
        self.effect = np.linalg.pinv(thruster_matrix(scenario.robot))
        task = next(
            task for task in scenario.mission.hierarchy.tasks if isinstance(task, VehiclePose)
        )
        assert isinstance(task.goal, pin.SE3)
        self.goal = np.array(scenario.start)
        self.goal[:7] = pin.SE3ToXYZQUAT(task.goal)
        self.sum = np.zeros(scenario.robot.n_v)

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        gains = self.gains
        q = estimate.q
        v = estimate.v
        error = pin.difference(self.robot.model, q, self.goal)
        error[:3] *= min(
            1.0, 0.5 / max(1e-9, float(np.linalg.norm(error[:3])))
        )  # far goals are as near as half a metre
        self.sum += error * self.dt
        a = gains.stiffness * error - gains.damping * v + gains.integral * self.sum
        force = self.dynamics.inverse_dynamics(q, np.zeros_like(v), a)
        thrust = self.effect @ force[:6]
        return Command(
            v=np.zeros_like(v),
            thrust=thrust,
            torque=force[self.robot.joint_v],
            telemetry={"pull": error[:3]},
        )


@dataclass(frozen=True, kw_only=True)
class LooseCable:
    """Readings of the DVL are those of the moment when it came loose; thrusters hear half of what
    they are asked.
    """

    onset: float
    end: float = float("inf")
    share: float = 0.5

    def __call__(self, scenario: Scenario) -> LooseCableOfRun:
        return LooseCableOfRun(self.share)


class LooseCableOfRun:
    def __init__(self, share: float) -> None:
        self.share = share
        self.kept: Reading[np.ndarray] | None = None

    def readings(self, readings: Readings, t: float) -> Readings:
        self.kept = self.kept or readings.linear_velocity
        return replace(readings, linear_velocity=self.kept)

    def command(self, command: Command, t: float) -> Command:
        return (
            command
            if command.thrust is None
            else replace(command, thrust=self.share * command.thrust)
        )
