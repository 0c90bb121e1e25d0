"""Composition root: robot + mission + environment + solver, run into a `Record`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.arguments import DAY, Count, checked
from uvms_ocp.control.force.dynamic import DynamicController, VelocityGains
from uvms_ocp.control.navigation.estimator import Estimator
from uvms_ocp.control.navigation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.control.navigation.health.monitor import HealthMonitor
from uvms_ocp.control.navigation.pass_through import PassThrough
from uvms_ocp.control.velocity.kinematic import HierarchySolver, KinematicController
from uvms_ocp.control.velocity.tick.guide import Guide
from uvms_ocp.control.watched import WatchedController
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.meta_values import FaultMeta
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, SensorSpecs
from uvms_ocp.model.state import Command, Measurement, State
from uvms_ocp.preflight.checks import check_mission
from uvms_ocp.preflight.findings import PreflightReport
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.record import Record, Recorder
from uvms_ocp.report.meta import Ending, run_meta
from uvms_ocp.run_meta import RunMeta
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults.fault import Fault
from uvms_ocp.sim.faults.plant_faults import require_possible
from uvms_ocp.sim.loop import Progress, StateEstimator, require_few_ticks, simulate
from uvms_ocp.sim.plant import KinematicPlant, Plant
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet

PLANTS = ("dynamic", "kinematic")


class MissionController(Protocol):
    """What controls a run."""

    @property
    def kinematic(self) -> KinematicController:
        """The layer that knows the mission, its events and its quantities."""

    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""


def our_controller(scenario: Scenario, guide: Guide | None = None) -> KinematicController | DynamicController:
    """The hierarchy's, fresh."""
    kinematic = scenario.kinematic_controller(guide)
    if scenario.plant == "kinematic":
        return kinematic
    model = robot_dynamics(scenario.robot)
    return DynamicController(robot=scenario.robot, dynamics=model, kinematic=kinematic, gains=scenario.gains)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ControllerOf:
    """What makes the controllers of one scenario."""

    maker: Callable[[Scenario], Any]
    """Of any scenario's."""
    scenario: Scenario = field(repr=False)

    def __call__(self) -> MissionController:
        """A fresh one. Raises `InvalidInput` where the maker makes no callable."""
        made = self.maker(self.scenario)
        if self.maker is our_controller:
            return made
        if not callable(made):
            raise InvalidInput(f"controller made {type(made).__name__}; make a callable (Measurement, t) -> Command")
        n = None if self.scenario.plant == "kinematic" else len(self.scenario.robot.description.thrusters)
        return WatchedController(controller=made, kinematic=self.scenario.kinematic_controller(), n_thrusters=n)


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scenario:
    """Everything that one simulation needs.

    Raises `InvalidInput` for a start outside the joint limits or below the seafloor, for a bad period, duration, seed or
    solver, or for a fault that robot or plant cannot have, `NameNotFound` for an unknown plant and `FrameNotFound` for an
    unknown altimeter frame. Goals are judged by `check`.
    """

    name: str
    robot: Robot
    mission: Mission
    environment: Environment
    start: np.ndarray
    """(n_q,) [m, rad] configuration at t = 0, at rest."""
    solver: HierarchySolver = field(default_factory=LexicographicActiveSet)
    plant: str = "dynamic"
    sensors: SensorSpecs = IDEAL_SENSORS
    real_sensors: SensorSpecs | None = None
    """What the sensors are truly like, where that differs from what the estimator knows."""
    controller: Callable[..., Any] = our_controller
    """What makes a controller for a run: takes the scenario, returns a callable ``(Measurement, t) -> Command``.

    ``scenario.controller()`` calls it. By default it makes the hierarchy's, with thrust and torque unless the plant is kinematic;
    any other is watched by the mission, see `WatchedController`.
    """
    gains: VelocityGains = field(default_factory=VelocityGains)
    """Of the dynamic layer; the kinematic plant has none."""
    plant_robot: Robot | None = None
    """What moves in the water, where it differs from what the controller knows."""
    seed: Count = 0
    """Of the sensor noise."""
    altimeter_frame: str | None = None
    """By default the one that the robot's file names, if any."""
    dt: float = 1 / 200
    """[s] control period."""
    duration: float = 120.0
    """[s] at which an incomplete mission is stopped."""
    markers: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Points (3,) [m] in W to draw, by name."""
    faults: tuple[Fault, ...] = ()
    """What goes wrong, unknown to controller and pre-flight."""

    def __post_init__(self) -> None:
        if self.plant not in PLANTS:
            raise NameNotFound("plant", self.plant, PLANTS)
        for name, value in (("dt", self.dt), ("duration", self.duration)):
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} = {value} s; give a finite time > 0")
        if self.duration < self.dt:
            raise InvalidInput(f"duration = {self.duration} s; give at least one control period of {self.dt:g} s")
        if self.duration > DAY:
            raise InvalidInput(f"duration = {self.duration:g} s; give at most {DAY:g} s, a day")
        require_few_ticks(self.duration, self.dt)
        if isinstance(self.solver, type):
            raise InvalidInput(f"solver = the class {self.solver.__name__}; give a value, {self.solver.__name__}()")
        if not hasattr(self.solver, "bind"):
            raise InvalidInput(f"solver = {self.solver!r}; give a value such as LexicographicActiveSet()")
        self.robot.check_configuration(self.start)
        if self.altimeter_frame is not None:
            self.robot.frame_id(self.altimeter_frame)
        if self.robot.n_vehicle:
            self._require_above_floor()
        object.__setattr__(self, "controller", ControllerOf(maker=_maker_of(self.controller), scenario=self))
        if self.faults:
            require_possible(self.faults, self.plant_robot or self.robot, kinematic=self.plant == "kinematic")
            self._sensor_suite()

    def kinematic_controller(self, guide: Guide | None = None) -> KinematicController:
        """Its layer of velocities alone, fresh; guide: what stands in for the hierarchy while it lasts."""
        return KinematicController(robot=self.robot, mission=self.mission, solver=self.solver, dt=self.dt, guide=guide)

    def guided(self, guide: Guide) -> MissionController:
        """The hierarchy's controller, fresh, with a guide that stands in for the hierarchy while it lasts."""
        return our_controller(self, guide)

    def estimator(self) -> GuardedEstimator:
        """A fresh estimator, ``(Readings, t, Command | None) -> Measurement``; a monitor keeps from it what cannot be true."""
        monitor = HealthMonitor(self.robot, self.sensors, altimeter_frame=self.altimeter_frame)
        return GuardedEstimator(self._unguarded(), self.robot, self.sensors, monitor)

    def check(self) -> PreflightReport:
        """Pre-flight: whether this mission can be completed, and what has to change if not."""
        return check_mission(self.setup())

    def setup(self) -> Setup:
        """What pre-flight looks at."""
        return Setup(
            robot=self.robot,
            mission=self.mission,
            environment=self.environment,
            start=np.array(self.start),
            altimeter_frame=self.altimeter_frame or self.robot.description.altimeter,
            with_forces=self.plant == "dynamic",
            dt=self.dt,
            duration=self.duration,
            sensors=self.sensors,
        )

    def run(self, progress: Progress | None = None, controller: MissionController | None = None) -> Record:
        """Simulate until the mission is complete or `duration` is over.

        controller: a fresh one, as `controller` makes them, for who wants to look into it meanwhile.
        """
        controller = controller or self.controller()
        kinematic, plant, estimator = controller.kinematic, self._plant(), self.estimator()
        begin = perf_counter()
        recorder = simulate(
            plant=plant,
            sensors=self._sensor_suite().read,
            estimator=estimator,
            controller=controller,
            dt=self.dt,
            duration=self.duration,
            progress=progress,
        )
        wall = perf_counter() - begin
        truth = kinematic.evaluate(self._true_measurement(plant.state), recorder.last("t"))
        at_events = self._truth_at_events(kinematic, recorder)
        spread = recorder.last("q_spread") if "q_spread" in recorder else None
        ending = Ending(q=recorder.last("q"), quantities=truth, at_events=at_events, wall_s=wall, spread=spread)
        return recorder.freeze(self._meta(kinematic, estimator.monitor, ending))

    def _truth_at_events(self, kinematic: KinematicController, recorder: Recorder) -> tuple[dict[str, float], ...]:
        """All quantities at the true state when each phase ended, of the goals that it had."""
        truths = []
        for event, state in zip(kinematic.events, kinematic.left, strict=True):
            row = round(event.t / self.dt)
            then = State(q=recorder.at("q", row), v=recorder.at("v", row))
            truths.append(kinematic.evaluate(self._true_measurement(then), event.t, state))
        return tuple(truths)

    def _meta(self, controller: KinematicController, monitor: HealthMonitor, ending: Ending) -> RunMeta:
        return run_meta(
            name=self.name,
            setup=self.setup(),
            plant=self.plant,
            solver=type(self.solver).__name__,
            seed=self.seed,
            markers=self.markers,
            faults=tuple(map(_told, self.faults)),
            controller=controller,
            monitor=monitor,
            ending=ending,
        )

    def _plant(self) -> Plant:
        if self.plant == "kinematic":
            return KinematicPlant(self.robot, self.start, self.faults)
        real = self.plant_robot or self.robot
        dynamics = robot_dynamics(real)
        options: dict[str, Any] = {"dynamics": dynamics, "environment": self.environment, "faults": self.faults}
        return DynamicPlant(real, self.start, **options, shared=real is not self.robot)

    def _sensor_suite(self) -> SensorSuite:
        floor = self.environment.seafloor
        specs = self.real_sensors or self.sensors
        return SensorSuite(self.robot, floor, specs, self.seed, self.altimeter_frame, self.faults)

    def _unguarded(self) -> StateEstimator:
        if self.sensors == IDEAL_SENSORS:
            return PassThrough(self.robot, self.sensors)
        return Estimator(self.robot, self.sensors, altimeter_frame=self.altimeter_frame)

    def _true_measurement(self, state: State) -> Measurement:
        floor, frame = self.environment.seafloor, self.altimeter_frame
        readings = SensorSuite(self.robot, floor, IDEAL_SENSORS, altimeter_frame=frame).read(state, 0.0)
        return PassThrough(self.robot, IDEAL_SENSORS)(readings, 0.0)

    def _require_above_floor(self) -> None:
        x, y, z = self.start[:3].tolist()
        floor = self.environment.seafloor.height(x, y)
        if z <= floor:
            text = f"start position of the vehicle z = {z:g} m is below the seafloor z = {floor:g} m; raise it"
            raise InvalidInput(text)


def _maker_of(given: Callable[..., Any]) -> Callable[..., Any]:
    """What was given, also to the scenario that a changed one is made of."""
    if isinstance(given, ControllerOf):
        return given.maker
    if not callable(given):
        raise InvalidInput(f"controller = {given!r}; give a callable that takes the scenario and makes a controller")
    return given


def _told(fault: Fault) -> FaultMeta:
    end = fault.end if np.isfinite(fault.end) else None
    return FaultMeta(text=str(fault), target=fault.target, kind=fault.kind, t=fault.onset, end=end)


@checked
def pose_at(position: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Pose from a position (3,) [m] and rpy (3,) [rad], R = Rz Ry Rx. Raises `InvalidInput` for anything else."""
    p, angles = _three("position", position), _three("rpy", rpy)
    return pin.SE3(pin.rpy.rpyToMatrix(angles), p)


def _three(what: str, values: ArrayLike) -> np.ndarray:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InvalidInput(f"{what} = {values!r}; give three numbers") from None
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InvalidInput(f"{what} = {array.tolist()}; give three finite numbers")
    return array
