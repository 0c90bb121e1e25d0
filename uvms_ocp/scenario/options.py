"""Options that all scenarios take, and what their missions are built from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields, replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control import LoadLearning, VelocityGains
from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.mission import Abort, Below, Condition, Mission, Phase, Transition
from uvms_ocp.record.meta_values import ABORT
from uvms_ocp.robot import (
    IDEAL_SENSORS,
    Obstacle,
    Robot,
    SensorSpecs,
    load_robot,
    robot_sensors,
    static_balance,
    thrusters,
)
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import Current, Environment, FlatSeafloor, Seafloor, StillWater, UniformCurrent
from uvms_ocp.sim.faults import Fault, parse_faults
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.tasks import (
    Hierarchy,
    HorizontalAttitude,
    JointLimits,
    MinimumAltitude,
    Task,
    UnderActuation,
)
from uvms_ocp.types import Bound, Count, Finite, Positive

ROBOT = "girona_maris7_full"
_SEABED = -40.0  # [m] z of the floor in W

Markers = Mapping[str, tuple[float, float, float]]
"""Points (3,) [m] in W to draw, by name."""

_OF_SCENARIO = ("robot", "solver", "plant", "seed", "dt", "duration", "record_rate", "faults")
"""Options that a `Scenario` has under the same names."""

CHANGEABLE = (
    "plant",
    "solver",
    "current",
    "seabed",
    "seed",
    "noise",
    "duration",
    "dt",
    "record_rate",
    "faults",
)
"""Names of the options that `apply_options` takes."""

SAFETY: tuple[Task, ...] = (JointLimits(), MinimumAltitude(), HorizontalAttitude())
"""Tasks that keep a robot safe, JL, MAC and HA, which missions begin with."""


@checked_dataclass(eq=False)
class RunOptions:
    """Options of every scenario. `run_options` makes them from keywords, which may give a robot or
    a current by less.
    """

    robot: Robot = field(default_factory=partial(load_robot, ROBOT))
    """Robot. As a keyword also the name of one."""
    seabed: Finite = _SEABED
    """[m] height of the floor in W, of a rough one between its protuberances."""
    current: Current = field(default_factory=StillWater)
    """Current of the water. As a keyword also the velocity (3,) [m/s] in W of a uniform one."""
    solver: HierarchySolver = field(default_factory=LexicographicActiveSet)
    """Solver of the hierarchy."""
    plant: str = "dynamic"
    """Plant: `dynamic`, in water, or `kinematic`, whose velocities follow at once."""
    payload: TrimBody | None = None
    """Body that the dynamic plant carries and the controller does not know."""
    observer: bool = True
    """True to estimate and cancel disturbances in the dynamic layer."""
    learn_load: bool = False
    """True to learn the load of the tool in the dynamic layer, which needs the observer."""
    noise: bool = False
    """True to give sensors the noise, rates and delays of the robot's file."""
    seed: Count = 0
    """Seed of everything random."""
    faults: tuple[Fault, ...] = ()
    """Faults. As a keyword also texts, see `uvms_ocp.sim.parse_fault`."""
    dt: Bound = 1 / 200
    """[s] control period."""
    duration: Bound = 120.0
    """[s] Time at which an incomplete mission is stopped."""
    record_rate: Positive | None = None
    """[Hz] Rate of the rows of the record, as near to it as whole ticks allow; by default every
    tick has one.
    """

    def start(self, X_WB: pin.SE3, joints: ArrayLike | None = None) -> np.ndarray:
        """Return the configuration (n_q,) with the vehicle at X_WB; joints (n_joints,) [rad or m],
        stowed by default.

        Raises `InvalidInput` outside the joint limits, and for a robot without a vehicle.
        """
        if not self.robot.n_vehicle:
            raise InvalidInput(
                f"{self.robot.name}: a fixed base; give a vehicle, or run what `uvms-ocp"
                " new-mission` writes"
            )
        quaternion = pin.Quaternion(X_WB.rotation).coeffs()
        return self.robot.configuration(
            position=X_WB.translation, quaternion=quaternion, joints=joints
        )

    def scenario(
        self,
        *,
        name: str,
        mission: Mission,
        start: np.ndarray,
        markers: Markers,
        seafloor: Seafloor | None = None,
        obstacles: Sequence[Obstacle] = (),
        plant_robot: Robot | None = None,
    ) -> Scenario:
        """Return the scenario of a mission from start (n_q,) [m, rad]; the floor is flat unless
        given.

        plant_robot: what moves, where it is not the robot that the controller knows. Raises
        `InvalidInput` and `NameNotFound` as `Scenario` does.
        """
        gains = VelocityGains()
        if not self.observer:
            gains = VelocityGains(observer_vehicle=0.0)
        flown_robot = plant_robot or self.robot
        floor = seafloor or FlatSeafloor(z=self.seabed)
        if self.payload is not None:
            flown_robot = static_balance.with_trim(flown_robot, [self.payload])
        return Scenario(
            **{option: getattr(self, option) for option in _OF_SCENARIO},
            name=name,
            mission=mission,
            environment=Environment(
                seafloor=floor, current=self.current, obstacles=tuple(obstacles)
            ),
            start=start,
            sensors=_sensors(self.robot, self.noise),
            gains=gains,
            load=LoadLearning() if self.learn_load else None,
            plant_robot=flown_robot,
            markers=markers,
        )


def run_options(
    keywords: Mapping[str, Any], *, robot: Robot | str = ROBOT, seabed: float = _SEABED
) -> RunOptions:
    """Make the options of a scenario from keywords, `None` for the default; robot and seabed [m] are
    the scenario's own.

    Raises `NameNotFound` for an option or a robot that there is not, and `InvalidInput` for a
    current, a fault or a seed that is none.
    """
    option_names = [item.name for item in fields(RunOptions)]
    for name in keywords:
        require_known("option of all scenarios", name, option_names)
    options = with_defaults(keywords, robot=robot, seabed=seabed)
    if isinstance(options["robot"], str):
        options["robot"] = load_robot(options["robot"])
    options["current"] = current_from(options.get("current"))
    faults = options.get("faults", ())
    if isinstance(faults, str | Fault):
        faults = (faults,)
    options["faults"] = parse_faults(faults)
    return RunOptions(**options)


def with_defaults(options: Mapping[str, Any], **defaults: Any) -> dict[str, Any]:
    """Return options with a scenario's own defaults in the place of those that are not given, or
    `None`.
    """
    given = {name: value for name, value in options.items() if value is not None}
    return {**defaults, **given}


def current_from(current: Current | Sequence[float] | None) -> Current:
    """Return a current as it is, a uniform one for a velocity (3,) [m/s] in W, still water for
    `None`.
    """
    if current is None:
        return StillWater()
    if isinstance(current, Sequence | np.ndarray):
        return UniformCurrent(current)
    return current


def apply_options(scenario: Scenario, options: Mapping[str, Any]) -> Scenario:
    """Return the scenario with the options given, some of `CHANGEABLE`, in the words of
    `run_options`.

    Raises `InvalidInput` and `NameNotFound` as `run_options` and `Scenario` do.
    """
    requested = run_options(options, robot=scenario.robot)
    changes: dict[str, Any] = {}
    for name in ("plant", "solver", "seed", "duration", "dt", "record_rate", "faults"):
        if name in options:
            changes[name] = getattr(requested, name)
    surroundings: dict[str, Any] = {}
    if "current" in options:
        surroundings["current"] = requested.current
    if "seabed" in options:
        surroundings["seafloor"] = FlatSeafloor(z=requested.seabed)
    if "noise" in options:
        changes["sensors"] = _sensors(scenario.robot, requested.noise)
    environment = replace(scenario.environment, **surroundings)
    return replace(scenario, environment=environment, **changes)


def _sensors(robot: Robot, noise: bool) -> SensorSpecs:
    if noise:
        return robot_sensors(robot.description)
    return IDEAL_SENSORS


def mission_of(
    robot: Robot,
    tasks: Sequence[Task],
    phases: Sequence[Phase],
    *,
    order: Sequence[str] | None = None,
    overrides: Mapping[str, Mapping[str, Any]] | None = None,
    abort: Abort | None = None,
) -> Mission:
    """Compose a mission of tasks and phases, with a task on top that is always on for axes that no
    thruster drives.

    order: task names, highest priority first, instead of the order of the classes. overrides:
    fields of tasks by name. Raises `NameNotFound` for an unknown task or field, and `InvalidInput`
    for an order that does not name every task.
    """
    all_tasks = list(tasks)
    first_names: list[str] = []
    # No axes of a robot without thrusters: its vehicle moves on the kinematic plant alone, on all.
    axes = thrusters.undriven_axes(robot)
    if axes:
        under_actuation = UnderActuation(axes=axes)
        all_tasks.insert(0, under_actuation)
        first_names.append(under_actuation.name)
    if overrides:
        all_tasks = override(all_tasks, overrides)
    full_order = None if order is None else (*first_names, *order)
    hierarchy = Hierarchy(all_tasks, full_order)
    mission = Mission(hierarchy=hierarchy, phases=tuple(phases), abort=abort)
    return with_activations(mission, activate(*first_names))


def with_activations(mission: Mission, activations: Mapping[str, float]) -> Mission:
    """Return the mission with these activations in every phase that does not set them itself, that
    of its abort too.
    """
    phases = []
    for phase in mission.all_phases:
        phases.append(replace(phase, activations={**activations, **phase.activations}))
    abort = mission.abort
    if abort is not None:
        abort = replace(abort, phase=phases.pop())
    return replace(mission, phases=tuple(phases), abort=abort)


def abort_phase(*names: str, arrived: float = 0.3, hold: float = 2.0) -> Abort:
    """Return a climb to a safe altitude, where it is held: the vehicle by PC, the arm towards the
    posture of MP, if it is named.

    names: of the tasks that are on beside PC, such as those that keep the robot safe. arrived [m]
    and hold [s]: how near to that altitude, and for how long.
    """
    altitude_condition = Below(quantity="PC.position_error", limit=arrived)
    return Abort(
        phase=phase_of("climb", "abort", ("PC", *names), ABORT, altitude_condition, hold=hold)
    )


def activate(*names: str) -> dict[str, float]:
    """Return the activations of a phase with these tasks fully on."""
    return dict.fromkeys(names, 1.0)


def phase_of(
    name: str,
    title: str,
    on: Sequence[str],
    to: str,
    *when: Condition,
    hold: float = 0.0,
    **goals: Any,
) -> Phase:
    """Return a phase with these tasks fully on and one way on: to a phase once conditions have held
    for `hold` [s].

    goals: by task, in place of their own.
    """
    exits = (Transition(to=to, when=when, hold=hold),)
    return Phase(name=name, title=title, activations=activate(*on), transitions=exits, goals=goals)


def approach_phase() -> Phase:
    """Return phase A, in which the small vehicle comes near its way point, before its tool acts in
    phase B.
    """
    position_condition = Below(quantity="PC.position_error", limit=0.2)
    orientation_condition = Below(quantity="PC.orientation_error", limit=0.2)
    return phase_of(
        "A",
        "approach",
        ("JL", "MAC", "HA", "PC", "MP"),
        "B",
        position_condition,
        orientation_condition,
    )


def override(tasks: list[Task], overrides: Mapping[str, Mapping[str, Any]]) -> list[Task]:
    """Return the tasks with fields replaced; raises `NameNotFound` for an unknown task or field."""
    by_name = {task.name: task for task in tasks}
    for name, changes in overrides.items():
        require_known("task", name, by_name)
        allowed = [field.name for field in fields(by_name[name])]
        for field_name in changes:
            require_known(f"field of task {name}", field_name, allowed)
        by_name[name] = replace(by_name[name], **changes)
    return list(by_name.values())
