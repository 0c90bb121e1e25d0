"""Scenario: robot, mission, environment, solver and parts composed, checked and simulated into a
`Record`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass, finite_array
from uvms_ocp.control import DynamicController, LoadLearning, VelocityGains, external
from uvms_ocp.control.velocity.guide import Guide
from uvms_ocp.control.velocity.kinematic import HierarchySolver, KinematicController
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.health.channel_state import sizes_of
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.interrupts import Interrupted, on_interrupt, raised_outside_casadi
from uvms_ocp.mission import Mission, MissionState
from uvms_ocp.progress import progress_bar
from uvms_ocp.record.display import FieldTable
from uvms_ocp.record.record import Record, Recorder
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.robot import IDEAL_SENSORS, Command, Robot, SensorSpecs, State, StateEstimate
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.scenario.preflight.checks import check_mission
from uvms_ocp.scenario.preflight.setup import PreflightReport, Setup
from uvms_ocp.scenario.run_metadata import RunOutcome, computed_or, energy_used, run_meta
from uvms_ocp.sim import (
    DynamicPlant,
    Environment,
    Fault,
    KinematicPlant,
    Plant,
    SensorSuite,
    injected_faults,
    parse_fault,
    watched_estimator,
    watched_plant,
    watched_sensors,
)
from uvms_ocp.sim.loop import (
    Progress,
    Sensors,
    StateEstimator,
    TickObserver,
    has_diverged,
    simulate,
)
from uvms_ocp.sim.machine_faults import require_possible
from uvms_ocp.sim.own_parts import (
    part_name,
    plant_name,
    require_plant,
    require_simulated,
    specs_of,
    takes_forces,
)
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.types import DAY, Count, Positive

# What makes the parts of one scenario's runs: `scenario.controller()`, `scenario.estimator()`.

_OURS = (KinematicController, DynamicController)
_SILENT = 2.0  # [s] that a run may take without a bar
# ticks between two looks at the mission; letters, whatever a phase is called
_BAR_EVERY = 40
_BAR_TEXT = 60


class MissionController(Protocol):
    """Controller of a run."""

    @property
    def kinematic(self) -> KinematicController:
        """The layer that knows the mission, its events and its quantities."""

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """The command for the tick at time t [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PartFactory:
    """Maker of a part of the runs of one scenario."""

    maker: Callable[..., Any]
    """Constructor for any scenario."""
    scenario: Any = field(repr=False)


class ControllerFactory(PartFactory):
    """Maker of the controllers of one scenario."""

    __slots__ = ()

    def __call__(self) -> MissionController:
        """A fresh one. Raises `InvalidInput` where the maker makes no callable."""
        controller = self.maker(self.scenario)
        scenario = self.scenario
        if type(controller) in _OURS:
            return controller
        if not callable(controller):
            raise InvalidInput(
                f"controller made {type(controller).__name__}; make a callable (StateEstimate, t)"
                " -> Command"
            )
        if scenario.takes_forces:
            n = len(scenario.robot.description.thrusters)
        else:
            n = None
        kinematic = scenario.kinematic_controller()
        return external.SupervisedController(
            controller=controller, kinematic=kinematic, n_thrusters=n, name=part_name(self.maker)
        )


class EstimatorFactory(PartFactory):
    """Maker of the estimators of one scenario."""

    __slots__ = ()

    def __call__(self) -> GuardedEstimator:
        """Make a fresh one, ``(Readings, t, Command | None) -> StateEstimate``; a monitor keeps
        from it what cannot be true.

        Raises `InvalidInput` where the maker makes no callable.
        """
        estimator = self.maker(self.scenario)
        scenario = self.scenario
        robot = scenario.robot
        specs = scenario.specs
        if not callable(estimator):
            allowed = "make a callable (Readings, t, command) -> StateEstimate"
            raise InvalidInput(f"estimator made {type(estimator).__name__}; {allowed}")
        monitor = HealthMonitor(robot, specs, altimeter_frame=scenario.altimeter_frame)
        return GuardedEstimator(
            watched_estimator.watched_estimator(estimator, robot, part_name(self.maker)),
            robot,
            specs,
            monitor,
        )


def maker_of(part: str, argument: Any) -> Callable[..., Any]:
    """Return the maker of a part: the argument itself, or the maker in a `PartFactory`. Raises
    `InvalidInput` where it cannot be called.
    """
    if isinstance(argument, PartFactory):
        return argument.maker
    if not callable(argument):
        raise InvalidInput(
            f"{part} = {argument!r}; give a callable that takes the scenario and makes one"
        )
    return argument


def own_names(parts: Mapping[str, Any], ours: tuple[Callable[..., Any], ...]) -> dict[str, str]:
    """Names of those parts of a scenario that are not the toolkit's, which are values or made by
    `ours`.
    """
    makers = {
        kind: maker_of(kind, part)
        for kind, part in parts.items()
        if not isinstance(part, str | SensorSpecs)
    }
    return {kind: part_name(maker) for kind, maker in makers.items() if maker not in ours}


# Composition root: robot + mission + environment + solver, run into a `Record`.


def our_controller(
    scenario: Scenario, guide: Guide | None = None
) -> KinematicController | DynamicController:
    """The hierarchy's, fresh."""
    kinematic = scenario.kinematic_controller(guide)
    if not scenario.takes_forces:
        return kinematic
    options: dict[str, Any] = {
        "gains": scenario.gains,
        "sensors": scenario.specs,
        "load": scenario.load,
    }
    return DynamicController(
        robot=scenario.robot,
        dynamics=cached_dynamics(scenario.robot),
        kinematic=kinematic,
        **options,
    )


def our_estimator(scenario: Scenario) -> StateEstimator:
    """The filter, fresh; ideal sensors are taken for the truth."""
    if scenario.specs == IDEAL_SENSORS:
        return PassThrough(scenario.robot, scenario.specs)
    return Estimator(scenario.robot, scenario.specs, altimeter_frame=scenario.altimeter_frame)


@checked_dataclass(eq=False, repr=False)
class Scenario(FieldTable):
    """Everything that one simulation needs.

    Raises `InvalidInput` for a start outside the joint limits or below the seafloor, for a bad
    period, duration, seed or solver, for what makes no part, or for a fault that robot or plant
    cannot have, `NameNotFound` for an unknown plant and `FrameNotFound` for an unknown altimeter
    frame. Goals are judged by `check`.
    """

    name: str
    robot: Robot
    mission: Mission
    environment: Environment
    start: np.ndarray
    """(n_q,) [m, rad] configuration at t = 0, at rest."""
    solver: HierarchySolver = field(default_factory=LexicographicActiveSet)
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
    """How the dynamic layer learns what the tool carries; by default it does not."""
    plant_robot: Robot | None = None
    """Robot that moves in the water, where it differs from the controller's."""
    seed: Count = 0
    """Seed of the sensor noise."""
    altimeter_frame: str | None = None
    """Name of the tool frame; by default the one that the robot's file names, if any."""
    dt: float = 1 / 200
    """[s] control period."""
    duration: float = 120.0
    """[s] at which an incomplete mission is stopped."""
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
        if isinstance(self.solver, type):
            raise InvalidInput(
                f"solver = the class {self.solver.__name__}; give a value, {self.solver.__name__}()"
            )
        if not hasattr(self.solver, "bind"):
            raise InvalidInput(
                f"solver = {self.solver!r}; give a value such as LexicographicActiveSet()"
            )
        self._require_start()
        for name, kind in (("controller", ControllerFactory), ("estimator", EstimatorFactory)):
            object.__setattr__(
                self, name, kind(maker=maker_of(name, getattr(self, name)), scenario=self)
            )
        faults = (self.faults,) if isinstance(self.faults, str) else self.faults
        faults = tuple(parse_fault(fault) if isinstance(fault, str) else fault for fault in faults)
        object.__setattr__(self, "faults", faults)
        for fault in faults:
            injected_faults.require_fault(fault)
        toolkit_faults = self.toolkit_faults
        if toolkit_faults:
            require_possible(
                toolkit_faults, self.plant_robot or self.robot, kinematic=self.plant == "kinematic"
            )
            require_simulated(toolkit_faults, self.plant, self.sensors)
            self._sensor_suite()

    def _require_start(self) -> None:
        if not self.robot.n_v:
            text = f"robot {self.robot.name!r} has a fixed base and no joints: nothing of it moves"
            raise InvalidInput(f"{text}; load it with base='free_flyer', or give it joints")
        self.robot.check_configuration(self.start)
        if self.altimeter_frame is not None:
            self.robot.frame_id(self.altimeter_frame)
        if self.robot.n_vehicle:
            x, y, z = self.start[:3].tolist()
            if z <= (floor := self.environment.seafloor.height(x, y)):
                place = f"start position of the vehicle z = {z:g} m"
                raise InvalidInput(f"{place} is below the seafloor z = {floor:g} m; raise it")

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
        """Names of the parts that are not the toolkit's, by what they are."""
        parts = {
            part: getattr(self, part) for part in ("plant", "sensors", "estimator", "controller")
        }
        return own_names(parts, (our_estimator, our_controller))

    def kinematic_controller(self, guide: Guide | None = None) -> KinematicController:
        """Its layer of velocities alone, fresh; guide: what stands in for the hierarchy while it
        lasts.
        """
        return KinematicController(
            robot=self.robot, mission=self.mission, solver=self.solver, dt=self.dt, guide=guide
        )

    def guided(self, guide: Guide) -> MissionController:
        """The hierarchy's controller, fresh, with a guide that stands in for the hierarchy while it
        lasts.
        """
        return our_controller(self, guide)

    def check(self) -> PreflightReport:
        """Pre-flight: whether this mission can be completed, and what has to change if not."""
        with raised_outside_casadi():
            return check_mission(self.setup())

    def setup(self) -> Setup:
        """Inputs of the pre-flight checks."""
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

        progress: told of every tick, in place of a bar where somebody looks (`uvms_ocp.progress`).
        controller: by default a fresh one. observer: called at every tick, see
        `uvms_ocp.viz.scene.live.live`. folder: a new one, to which rows go every two seconds in
        place of memory, and whose series are mapped by the record; whatever ends the program,
        `Record.load` opens it. Ctrl-C, or the stop of a notebook's cell, raises `Interrupted`,
        whose `result` is the record so far.

        Raises `OutputError` where the folder cannot be written, and `InvalidInput` for more ticks
        than fit into memory.
        """
        with raised_outside_casadi():
            controller = controller or self.controller()
            estimator = self.estimator()
            plant, sensors = injected_faults.inject_faults(self, self._plant(), self._sensors())
        parts: dict[str, Any] = {
            "plant": plant,
            "sensors": sensors,
            "estimator": estimator,
            "controller": controller,
        }
        presses: list[object] = []
        with (
            on_interrupt(presses.append),
            self._bar(progress is None, controller.kinematic) as show,
        ):
            record = self._recorded(
                parts, {"progress": progress, "observer": observer}, show, presses, folder
            )
        if presses:
            raise Interrupted(f"stopped by hand at t = {record['t'][-1]:g} s", record)
        return record

    @contextmanager
    def _bar(
        self, shown: bool, kinematic: KinematicController
    ) -> Iterator[Callable[[float], None]]:
        """Inside what is yielded is to get times [s] of ticks, for a bar where somebody looks."""
        with progress_bar(
            shown=shown, total=self.duration, delay=_SILENT, bar_format="{elapsed} |{bar}| {desc}"
        ) as bar:

            def show(t: float) -> None:
                if not bar.disable and round(t / self.dt) % _BAR_EVERY == 0:
                    phase = self.mission.all_phases[kinematic.state.phase]
                    text = plain_line(
                        f"{phase.name} {phase.title}: {kinematic.pending()}", _BAR_TEXT
                    )
                    bar.set_description_str(text.ljust(_BAR_TEXT), refresh=False)
                    bar.update(t - bar.n)

            yield show

    def _recorded(
        self,
        parts: Mapping[str, Any],
        callbacks: Mapping[str, Any],
        show: Callable[[float], None],
        presses: Sequence[object],
        folder: Path | str | None,
    ) -> Record:
        """Simulate with these parts, and sum up. callbacks: functions that are told of every tick,
        by the name of the argument. presses: one entry for each Ctrl-C.
        """
        begin = perf_counter()
        plant = parts["plant"]
        controller = parts["controller"]
        estimator = parts["estimator"]
        kinematic = controller.kinematic
        counts = list[int]()
        own_parts = self.own_parts
        names = {
            "plant": plant_name(self.plant),
            "solver": type(self.solver).__name__,
            "sensors": own_parts.get("sensors", SensorSuite.__name__),
            "estimator": own_parts.get("estimator", type(estimator.estimator).__name__),
            "controller": getattr(controller, "name", type(controller).__name__),
        }
        run_fields: dict[str, Any] = {
            "name": self.name,
            "setup": self.setup(),
            "parts": names,
            "faults": tuple(map(injected_faults.fault_meta, self.faults)),
            "controller": kinematic,
        }
        if self.record_rate is None:
            ticks_per_row = 1
        else:
            ticks_per_row = max(1, round(1.0 / (self.record_rate * self.dt)))
        run_fields |= {
            "seed": self.seed,
            "markers": self.markers,
            "monitor": estimator.monitor,
            "dt": ticks_per_row * self.dt,
        }
        # true ones at events
        meta = partial(run_meta, **run_fields)
        states = list[State]()

        def news() -> RunMeta | None:
            """Metadata so far, after an event or an alarm."""
            previous_counts = counts.copy()
            counts[:] = map(
                len, (kinematic.events, estimator.monitor.alarms, kinematic.watchdog.alarms)
            )
            ending = RunOutcome(
                q=plant.state.q,
                t=self.duration,
                quantities={},
                wall_s=perf_counter() - begin,
                stopped="cut off",
            )
            if counts == previous_counts or has_diverged(plant.state):
                return None
            return meta(ending=ending)

        def watch(t: float, state: State) -> None:
            if len(kinematic.events) > len(states):
                states.append(state)
            show(t)

        capacity = min(512, max(1, round(2.0 / self.dt)))
        if folder is None:
            place = None
        else:
            place = Path(folder)
        if place or ticks_per_row > 1:
            recorder = Recorder(capacity, place, news, ticks_per_row)
        else:
            recorder = None
        shapes = (
            {} if isinstance(estimator.estimator, PassThrough) else sizes_of(self.robot)
        )  # which repeats its readings
        reading_sizes = {
            name: math.prod(shapes[name]) for name in estimator.monitor.channels if name in shapes
        }
        try:
            recorder = simulate(
                **parts,
                **callbacks,
                watch=watch,
                dt=self.dt,
                duration=self.duration,
                kept_readings=reading_sizes,
                recorder=recorder,
            )
        except Interrupted as stop:
            recorder = stop.result
        wall = perf_counter() - begin

        flown = recorder.series()

        def quantities(true_state: State, t: float, state: MissionState) -> dict[str, float]:
            errors: dict[str, float] = computed_or(
                {},
                "true errors",
                lambda: kinematic.evaluate(self._true_measurement(true_state), t, state),
            )
            return errors | {
                name: value
                for name, value in energy_used(flown, state, t).items()
                if name in errors
            }

        diverged = has_diverged(plant.state)
        if diverged:
            last_state = State(q=recorder.last("q"), v=recorder.last("v"))
        else:
            last_state = plant.state
        truth = quantities(last_state, recorder.last("t"), kinematic.state)
        phase_ends = zip(
            states, kinematic.events, kinematic.left, strict=False
        )  # with the goals that the phase had when it ended
        ends = [quantities(state, event.t, goals) for state, event, goals in phase_ends]
        stopped: Literal["", "stopped", "diverged"] = ""
        if diverged:
            stopped = "diverged"
        elif presses:
            stopped = "stopped"
        ending = RunOutcome(
            q=recorder.last("q"),
            t=recorder.last("t"),
            quantities=truth,
            at_events=tuple(ends),
            wall_s=wall,
            std=recorder.last("q_std") if "q_std" in recorder else None,
            stopped=stopped,
        )
        return recorder.freeze(meta(ending=ending))

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

    def _true_measurement(self, state: State) -> StateEstimate:
        suite = SensorSuite(
            self.robot,
            self.environment.seafloor,
            IDEAL_SENSORS,
            altimeter_frame=self.altimeter_frame,
        )
        return PassThrough(self.robot, IDEAL_SENSORS)(suite.read(state, 0.0), 0.0)


@checked
def pose_at(position: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Pose from a position (3,) [m] and rpy (3,) [rad], R = Rz Ry Rx. Raises `InvalidInput` for
    anything else.
    """
    p = finite_array("position", position, (3,))
    angles = finite_array("rpy", rpy, (3,))
    return pin.SE3(pin.rpy.rpyToMatrix(angles), p)
