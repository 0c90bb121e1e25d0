"""Composition root: robot + mission + environment + solver, run into a `Record`."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from time import perf_counter
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.collision.obstacle_file import ObstacleData
from uvms_ocp.control.force.dynamic import DynamicController, VelocityGains
from uvms_ocp.control.navigation.estimator import Estimator, PassThrough
from uvms_ocp.control.velocity.kinematic import HierarchySolver, KinematicController
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.mission.conditions import Below
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, SensorSpecs
from uvms_ocp.model.state import Measurement, State
from uvms_ocp.preflight.checks import check_mission
from uvms_ocp.preflight.findings import PreflightReport
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.record import Record
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.loop import Controller, Plant, Progress, StateEstimator, simulate
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.sim.seafloor import floor_relief
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.tasks.pose import ToolPose, ToolPosition
from uvms_ocp.tasks.reference import evaluate_pose
from uvms_ocp.version import __version__

PLANTS = ("dynamic", "kinematic")
_FLOOR_AROUND = 12.0  # [m] of a floor with protuberances that a record keeps around the mission
_DEPENDENCIES = ("pin", "casadi", "coal", "numpy")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scenario:
    """Everything that one simulation needs.

    Raises `InvalidInput` for a start outside the joint limits or below the seafloor, or a bad period or duration, and
    `NameNotFound` for an unknown plant. Goals are judged by `check`.
    """

    name: str
    robot: Robot
    mission: Mission
    environment: Environment
    start: np.ndarray  # (n_q,) configuration at t = 0, at rest
    solver: HierarchySolver = field(default_factory=LexicographicActiveSet)
    plant: str = "dynamic"
    sensors: SensorSpecs = IDEAL_SENSORS
    gains: VelocityGains = field(default_factory=VelocityGains)  # of the dynamic layer; the kinematic plant has none
    plant_robot: Robot | None = None  # what moves in the water, where it differs from what the controller knows
    seed: int = 0  # of the sensor noise
    altimeter_frame: str | None = None  # by default the one that the robot's file names, if any
    dt: float = 1 / 200  # [s] control period
    duration: float = 120.0  # [s] at which an incomplete mission is stopped
    markers: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)  # points [m] in W to draw

    def __post_init__(self) -> None:
        if self.plant not in PLANTS:
            raise NameNotFound("plant", self.plant, PLANTS)
        for name, value in (("dt", self.dt), ("duration", self.duration)):
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} = {value} s; give a finite time > 0")
        if self.duration < self.dt:
            raise InvalidInput(f"duration = {self.duration} s; give at least one control period of {self.dt:g} s")
        if self.seed < 0:
            raise InvalidInput(f"seed = {self.seed}; give a whole number >= 0")
        if isinstance(self.solver, type):
            raise InvalidInput(f"solver = the class {self.solver.__name__}; give a value, {self.solver.__name__}()")
        if not hasattr(self.solver, "bind"):
            raise InvalidInput(f"solver = {self.solver!r}; give a value such as LexicographicActiveSet()")
        self.robot.check_configuration(self.start)
        if self.altimeter_frame is not None:
            self.robot.frame_id(self.altimeter_frame)
        if self.robot.n_vehicle:
            self._require_above_floor()

    def controller(self) -> KinematicController:
        """A fresh kinematic layer for this mission."""
        return KinematicController(robot=self.robot, mission=self.mission, solver=self.solver, dt=self.dt)

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
        )

    def run(self, progress: Progress | None = None, kinematic: KinematicController | None = None) -> Record:
        """Simulate until the mission is complete or `duration` is over.

        kinematic: a fresh `controller()`, for who wants to look into it meanwhile.
        """
        kinematic = kinematic or self.controller()
        plant, controller = self._plant_and_controller(kinematic)
        begin = perf_counter()
        recorder = simulate(
            plant=plant,
            sensors=self._sensor_suite().read,
            estimator=self._estimator(),
            controller=controller,
            dt=self.dt,
            duration=self.duration,
            progress=progress,
        )
        wall = perf_counter() - begin
        truth = kinematic.evaluate(self._true_measurement(plant.state), recorder.last("t"))
        around = self._surroundings(recorder.last("q"))
        return recorder.freeze(self._meta(kinematic, wall, truth) | around)

    def _plant_and_controller(self, kinematic: KinematicController) -> tuple[Plant, Controller]:
        if self.plant == "kinematic":
            return KinematicPlant(self.robot, self.start), kinematic
        real = self.plant_robot or self.robot
        plant = DynamicPlant(real, self.start, dynamics=robot_dynamics(real), environment=self.environment)
        model = robot_dynamics(self.robot)
        return plant, DynamicController(robot=self.robot, dynamics=model, kinematic=kinematic, gains=self.gains)

    def _sensor_suite(self, specs: SensorSpecs | None = None) -> SensorSuite:
        return SensorSuite(
            self.robot, self.environment.seafloor, specs or self.sensors, self.seed, self.altimeter_frame
        )

    def _estimator(self) -> StateEstimator:
        if self.sensors == IDEAL_SENSORS:
            return PassThrough(self.robot, self.sensors)
        return Estimator(self.robot, self.sensors, altimeter_frame=self.altimeter_frame)

    def _true_measurement(self, state: State) -> Measurement:
        readings = self._sensor_suite(IDEAL_SENSORS).read(state, 0.0)
        return PassThrough(self.robot, IDEAL_SENSORS)(readings, 0.0)

    def _require_above_floor(self) -> None:
        x, y, z = self.start[:3].tolist()
        floor = self.environment.seafloor.height(x, y)
        if z <= floor:
            text = f"start position of the vehicle z = {z:g} m is below the seafloor z = {floor:g} m; raise it"
            raise InvalidInput(text)

    def _surroundings(self, end: np.ndarray) -> dict[str, Any]:
        """Obstacles, and the floor around the way from the start to the configuration `end` (n_q,), to draw."""
        obstacles = [ObstacleData.of(item) for item in self.environment.obstacles]
        ends = (self.start[:2], end[:2]) if self.robot.n_vehicle else np.zeros((1, 2))
        points = np.array([*ends, *(point[:2] for point in self.markers.values())])
        low, high = points.min(axis=0) - _FLOOR_AROUND, points.max(axis=0) + _FLOOR_AROUND
        return {
            "obstacles": [
                item.model_dump(mode="json", exclude_defaults=True) for item in obstacles if item is not None
            ],
            "floor": floor_relief(self.environment.seafloor, low, high),
        }

    def _meta(self, controller: KinematicController, wall: float, truth: dict[str, float]) -> dict[str, Any]:
        tasks = self.mission.hierarchy.tasks
        tools = [task.name for task in tasks if isinstance(task, (ToolPose, ToolPosition))]
        return {
            "scenario": self.name,
            "robot": self.robot.name,
            "floating": bool(self.robot.n_vehicle),
            "plant": self.plant,
            "solver": type(self.solver).__name__,
            "dt": self.dt,
            "wall_s": wall,
            "seed": self.seed,
            "noise": self.sensors != IDEAL_SENSORS,
            "true_quantities": truth,
            "alarms": [{"t": t, "text": text} for t, text in controller.watchdog.alarms],
            "completed": controller.state.completed,
            "pending": "" if controller.state.completed else controller.pending(),
            "events": [
                {"t": e.t, "source": e.source, "target": e.target, "reason": e.reason} for e in controller.events
            ],
            "phases": [
                {
                    "name": phase.name,
                    "title": phase.title,
                    "tasks": [name for name, gate in phase.gates.items() if gate],
                }
                for phase in self.mission.phases
            ],
            "tasks": [{"name": task.name, "label": task.label} for task in tasks],
            "tool_task": tools[0] if tools else None,
            "levels": [
                {"name": name, "rows": size}
                for name, size in zip(controller.problem.names, controller.problem.sizes, strict=True)
            ],
            "quantities": list(controller.problem.quantity_names),
            "statuses": [status.value for status in Status],
            "joints": list(self.robot.joint_names),
            "limits": {
                "position_lower": self.robot.limits.position_lower.tolist(),
                "position_upper": self.robot.limits.position_upper.tolist(),
                "velocity": self.robot.limits.velocity.tolist(),
                "acceleration": self.robot.limits.acceleration.tolist(),
                "effort": self.robot.limits.effort.tolist(),
            },
            "thresholds": [
                {
                    "quantity": condition.quantity,
                    "limit": condition.limit,
                    "sign": "<" if isinstance(condition, Below) else ">",
                    "phase": phase.name,
                }
                for phase in self.mission.phases
                for transition in phase.transitions
                for condition in transition.when
            ],
            "frames": {
                f"goal of {task.name}": pin.SE3ToXYZQUAT(evaluate_pose(task.name, task.goal, 0.0)[0]).tolist()
                for task in tasks
                if isinstance(task, ToolPose)
            },
            "floor_z": self.environment.seafloor.height(float(self.start[0]), float(self.start[1])),
            "markers": {name: [float(x) for x in point] for name, point in self.markers.items()},
            "versions": _versions(),
        }


def _versions() -> dict[str, str]:
    own = {"uvms_ocp": __version__, "python": platform.python_version()}
    return own | {name: version(name) for name in _DEPENDENCIES}


def pose_at(position: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Pose from a position (3,) [m] and roll, pitch, yaw [rad] (R = Rz Ry Rx). Raises `InvalidInput`."""
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
