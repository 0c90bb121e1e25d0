"""Scenario: robot, mission, environment, solver and parts composed, checked and simulated into a
`Record`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass, finite_array
from uvms_ocp.control import LoadLearning, VelocityGains
from uvms_ocp.control.velocity.guide import Guide
from uvms_ocp.control.velocity.kinematic import HierarchySolver, KinematicController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.interrupts import Interrupted, on_interrupt, raised_outside_casadi
from uvms_ocp.mission import Mission
from uvms_ocp.record.display import FieldTable
from uvms_ocp.record.record import Record
from uvms_ocp.robot import IDEAL_SENSORS, Robot, SensorSpecs
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.scenario.part_factories import (
    ControllerFactory,
    EstimatorFactory,
    MissionController,
    maker_of,
    our_controller,
    our_estimator,
    own_names,
)
from uvms_ocp.scenario.preflight.checks import check_mission
from uvms_ocp.scenario.preflight.findings import PreflightReport
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.scenario.scenario_run import RunParts, ScenarioRun, run_bar
from uvms_ocp.scenario.stepped_run import SteppedRun
from uvms_ocp.sim import (
    DynamicPlant,
    Environment,
    Fault,
    KinematicPlant,
    Plant,
    SensorSuite,
    injected_faults,
    parse_fault,
    watched_plant,
    watched_sensors,
)
from uvms_ocp.sim.loop import (
    Progress,
    Sensors,
    TickObserver,
)
from uvms_ocp.sim.machine_faults import require_possible
from uvms_ocp.sim.own_parts import (
    part_name,
    require_plant,
    require_simulated,
    specs_of,
    takes_forces,
)
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.types import DAY, Count, Positive


@checked_dataclass(eq=False, repr=False)
class Scenario(FieldTable):
    """Everything that one simulation needs.

    Raises `InvalidInput` for a start outside the joint limits or below the seafloor, for a bad
    period, duration, seed or solver, for what makes no part, or for a fault that robot or plant
    cannot have, `NameNotFound` for an unknown plant and `FrameNotFound` for an unknown altimeter
    frame. Goals are judged by `check`.
    """

    name: str
    """Name of the scenario, which records and reports have."""
    robot: Robot
    """Robot as the controller knows it; the plant's, too, unless there is a `plant_robot`."""
    mission: Mission
    """Tasks in strict order, and the phases in which they count."""
    environment: Environment
    """Water, seafloor and obstacles."""
    start: np.ndarray
    """(n_q,) [m, rad] configuration at t = 0, at rest."""
    solver: HierarchySolver = field(default_factory=LexicographicActiveSet)
    """Solver of the hierarchy of tasks at every tick."""
    plant: str | Callable[..., Any] = "dynamic"
    """``dynamic``, ``kinematic``, or what makes a plant of a user's own, a
    `uvms_ocp.sim.PlantMaker`.
    """
    sensors: SensorSpecs | Callable[..., Any] = IDEAL_SENSORS
    """Specifications of the toolkit's sensors, or a `uvms_ocp.sim.SensorsMaker` for others."""
    real_sensors: SensorSpecs | None = None
    """True specifications, where they differ from those that the estimator has."""
    estimator: Callable[..., Any] = our_estimator
    """Maker of an estimator for a run, a `uvms_ocp.sim.EstimatorMaker`; by default the toolkit's
    filter.

    ``scenario.estimator()`` calls it, with a monitor around what it makes that keeps from it what
    cannot be true.
    """
    controller: Callable[..., Any] = our_controller
    """Maker of a controller for a run: takes the scenario, returns a callable ``(StateEstimate, t)
    -> Command``.

    ``scenario.controller()`` calls it. By default it makes the hierarchy's, with thrust and torque
    unless the plant is kinematic; any other is watched by the mission, see `SupervisedController`.
    """
    gains: VelocityGains = field(default_factory=VelocityGains)
    """Gains of the dynamic layer, lowered where sensors are late; the kinematic plant has none."""
    load: LoadLearning | None = None
    """Learning of what the tool carries, by the dynamic layer; `None` for none."""
    plant_robot: Robot | None = None
    """Robot that moves in the water, where it differs from the controller's."""
    seed: Count = 0
    """Seed of the sensor noise."""
    altimeter_frame: str | None = None
    """Frame of the altimeter; by default the one that the robot's file names, if any."""
    dt: float = 1 / 200
    """[s] control period."""
    duration: float = 120.0
    """[s] Time at which an incomplete mission is stopped."""
    record_rate: Positive | None = None
    """[Hz] of the rows of the record, at least 0.1, as near to it as whole ticks allow; by default
    every tick has one. See `uvms_ocp.record.row_rates`.
    """
    markers: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Points (3,) [m] in W to draw, by name."""
    faults: str | tuple[Fault | Callable[..., Any] | str, ...] = ()
    """Faults, unknown to controller and pre-flight, or texts as the shell takes them, see
    `uvms_ocp.sim.parse_fault`; also a user's own, each a `uvms_ocp.sim.FaultMaker`.
    """

    def __post_init__(self) -> None:
        require_plant(self.plant)
        specs_of(self.sensors)
        self._require_times()
        self._require_solver()
        self._require_start()
        controller = maker_of("controller", self.controller)
        object.__setattr__(self, "controller", ControllerFactory(maker=controller, scenario=self))
        estimator = maker_of("estimator", self.estimator)
        object.__setattr__(self, "estimator", EstimatorFactory(maker=estimator, scenario=self))
        self._parse_faults()
        self._require_possible_faults()

    def _require_times(self) -> None:
        for name, value in (("dt", self.dt), ("duration", self.duration)):
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} = {value} s; give a finite time > 0")
        if self.duration < self.dt:
            raise InvalidInput(
                f"duration = {self.duration} s; give at least one control period of {self.dt:g} s"
            )
        if self.duration > DAY:
            raise InvalidInput(f"duration = {self.duration:g} s; give at most {DAY:g} s, a day")
        if self.record_rate is not None and not 0.1 <= self.record_rate < np.inf:
            raise InvalidInput(f"record_rate = {self.record_rate:g} Hz; give 0.1 or more")

    def _require_solver(self) -> None:
        if isinstance(self.solver, type):
            name = self.solver.__name__
            raise InvalidInput(f"solver = the class {name}; give a value, {name}()")
        if not hasattr(self.solver, "bind"):
            raise InvalidInput(
                f"solver = {self.solver!r}; give a value such as LexicographicActiveSet()"
            )

    def _require_start(self) -> None:
        if not self.robot.n_v:
            raise InvalidInput(
                f"robot {self.robot.name!r} has a fixed base and no joints: nothing of it moves;"
                " load it with base='free_flyer', or give it joints"
            )
        self.robot.check_configuration(self.start)
        if self.altimeter_frame is not None:
            self.robot.frame_id(self.altimeter_frame)
        if self.robot.n_vehicle:
            x, y, z = self.start[:3].tolist()
            floor_z = self.environment.seafloor.height(x, y)
            if z <= floor_z:
                raise InvalidInput(
                    f"start position of the vehicle z = {z:g} m is below the seafloor"
                    f" z = {floor_z:g} m; raise it"
                )

    def _parse_faults(self) -> None:
        """Replace texts, as the shell takes them, by the faults that they describe."""
        texts_or_faults = (self.faults,) if isinstance(self.faults, str) else self.faults
        parsed_faults = []
        for fault in texts_or_faults:
            parsed_faults.append(parse_fault(fault) if isinstance(fault, str) else fault)
        faults = tuple(parsed_faults)
        object.__setattr__(self, "faults", faults)
        for fault in faults:
            injected_faults.require_fault(fault)

    def _require_possible_faults(self) -> None:
        """Raise `InvalidInput` for a fault that this robot, plant or sensors cannot have."""
        faults = self.toolkit_faults
        if not faults:
            return
        plant_robot = self.plant_robot or self.robot
        require_possible(faults, plant_robot, kinematic=self.plant == "kinematic")
        require_simulated(faults, self.plant, self.sensors)
        self._sensor_suite()

    @property
    def toolkit_faults(self) -> tuple[Fault, ...]:
        """Faults of the toolkit, which plant and sensors simulate themselves."""
        return tuple(fault for fault in self.faults if isinstance(fault, Fault))

    @property
    def takes_forces(self) -> bool:
        """True where the plant takes thrust and torque, and not velocities alone."""
        return takes_forces(self.plant)

    @property
    def specs(self) -> SensorSpecs:
        """Specifications of the sensors that estimator, monitor and pre-flight expect."""
        return specs_of(self.sensors)

    @property
    def own_parts(self) -> dict[str, str]:
        """Names of the parts that are a user's own, by kind: plant, sensors, estimator,
        controller.
        """
        parts = {
            "plant": self.plant,
            "sensors": self.sensors,
            "estimator": self.estimator,
            "controller": self.controller,
        }
        return own_names(parts, (our_estimator, our_controller))

    def kinematic_controller(self, guide: Guide | None = None) -> KinematicController:
        """Make the velocity layer of a controller for one run.

        guide: stands in for the hierarchy while it lasts.
        """
        return KinematicController(
            robot=self.robot, mission=self.mission, solver=self.solver, dt=self.dt, guide=guide
        )

    def guided(self, guide: Guide) -> MissionController:
        """Make the toolkit's controller for one run, with a guide that stands in for the hierarchy
        while it lasts.
        """
        return our_controller(self, guide)

    def check(self) -> PreflightReport:
        """Check, before it begins, whether this mission can be completed, and what has to change if
        not.
        """
        with raised_outside_casadi():
            return check_mission(self.setup())

    def setup(self) -> Setup:
        """Return the inputs of the pre-flight checks."""
        return Setup(
            robot=self.robot,
            mission=self.mission,
            environment=self.environment,
            start=np.array(self.start),
            altimeter_frame=self.altimeter_frame or self.robot.description.altimeter,
            with_forces=self.takes_forces,
            dt=self.dt,
            duration=self.duration,
            sensors=self.specs,
            own_parts=self.own_parts,
            gains=self.gains,
            load_bandwidth=None if self.load is None else self.gains.observer_vehicle,
        )

    def run(
        self,
        progress: Progress | None = None,
        controller: MissionController | None = None,
        observer: TickObserver | None = None,
        folder: Path | str | None = None,
    ) -> Record:
        """Simulate until the mission is complete or `duration` is over.

        progress: called at every tick, in place of a bar where somebody looks
        (`uvms_ocp.progress`). controller: by default a fresh one. observer: called at every tick,
        see `uvms_ocp.viz.scene.live.live`. folder: a new one, to which rows go every two seconds in
        place of memory, and whose series are mapped by the record; whatever ends the program,
        `Record.load` opens it. Ctrl-C, or the stop of a notebook's cell, raises `Interrupted`,
        whose ``result`` is the record so far.

        Raises `OutputError` where the folder cannot be written, and `InvalidInput` for more ticks
        than fit into memory.
        """
        parts = self._parts(controller)
        controller = parts.controller
        presses: list[object] = []
        with (
            on_interrupt(presses.append),
            run_bar(self, shown=progress is None, kinematic=controller.kinematic) as show_time,
        ):
            run = ScenarioRun(self, parts)
            record = run.record(show_time, progress, observer, folder, presses)
        if presses:
            raise Interrupted(f"stopped by hand at t = {record['t'][-1]:g} s", record)
        return record

    def simulation(self) -> SteppedRun:
        """Begin a run that is stepped by hand, from t = 0: `run` ends with the same record."""
        return SteppedRun(self, self._parts(None))

    def _parts(self, controller: MissionController | None) -> RunParts:
        """Make the parts of one run, around a controller where there is one already."""
        with raised_outside_casadi():
            controller = controller or self.controller()
            estimator = self.estimator()
            plant, sensors = injected_faults.inject_faults(self, self._plant(), self._sensors())
        return RunParts(plant=plant, sensors=sensors, estimator=estimator, controller=controller)

    def _plant(self) -> Plant:
        if not isinstance(self.plant, str):
            return watched_plant.WatchedPlant(self.plant(self), self.robot, part_name(self.plant))
        if self.plant == "kinematic":
            return KinematicPlant(self.robot, self.start, self.toolkit_faults)
        plant_robot = self.plant_robot or self.robot
        dynamics = cached_dynamics(plant_robot)
        faults = self.toolkit_faults
        return DynamicPlant(
            plant_robot, self.start, dynamics=dynamics, environment=self.environment, faults=faults
        )

    def _sensors(self) -> Sensors:
        if isinstance(self.sensors, SensorSpecs):
            return self._sensor_suite().read
        return watched_sensors.WatchedSensors(
            self.sensors(self), self.robot, self.specs, part_name(self.sensors)
        )

    def _sensor_suite(self) -> SensorSuite:
        floor = self.environment.seafloor
        specs = self.real_sensors or self.specs
        return SensorSuite(
            self.robot, floor, specs, self.seed, self.altimeter_frame, self.toolkit_faults
        )


@checked
def pose_at(position: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Return the pose of a position (3,) [m] and rpy (3,) [rad], R = Rz Ry Rx. Raises
    `InvalidInput` for anything else.
    """
    p = finite_array("position", position, (3,))
    angles = finite_array("rpy", rpy, (3,))
    return pin.SE3(pin.rpy.rpyToMatrix(angles), p)
