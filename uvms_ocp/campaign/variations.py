"""Parameters that can be varied in a scenario, by name, and the scenario with the values that a run has drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, fields, is_dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.campaign.distributions import Parameter, distribution_of, real_numbers
from uvms_ocp.campaign.robot_parameters import machine_parameters, sensor_parameters
from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.errors import InvalidInput, NameNotFound, require_known
from uvms_ocp.mission.mission import Mission
from uvms_ocp.planning.scene import joint_axis
from uvms_ocp.scenario.scenario import Scenario, maker_of
from uvms_ocp.sim import Current, FlatSeafloor, GustyCurrent, HeightField, OnsetCurrent, StillWater, UniformCurrent
from uvms_ocp.tasks import Hierarchy, JointTracking
from uvms_ocp.types import Count

# Parameters of the current: uniform parts, heading and gusts.

_UNIFORM = (StillWater, UniformCurrent, OnsetCurrent)


def flow_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters of a uniform current, with gusts or without; of other currents gusts alone."""
    if scenario.plant == "kinematic":
        return
    if isinstance(_base(scenario), _UNIFORM):
        for axis, name in enumerate("xyz"):
            meaning = f"added to the velocity of the water along {name} of W"
            yield Parameter(f"current.{name}", "m/s", meaning, partial(_added, axis))
        yield Parameter("current.speed", "m/s", "horizontal speed of the water", partial(_with_flow, "speed"))
        meaning = "heading of the horizontal flow, from x of W towards y"
        yield Parameter("current.heading", "rad", meaning, partial(_with_flow, "heading"))
    yield Parameter("current.gusts", "m/s", "standard deviation of gusts along each axis of W", _with_gusts)


def _added(axis: int, scenario: Scenario, value: float) -> Scenario:
    return _flowing(scenario, _velocity(scenario) + value * np.eye(3)[axis])


def _with_flow(name: str, scenario: Scenario, value: float) -> Scenario:
    x, y, z = _velocity(scenario)
    flow = {"speed": math.hypot(x, y), "heading": math.atan2(y, x), name: value}
    way = np.array([math.cos(flow["heading"]), math.sin(flow["heading"]), 0.0])
    return _flowing(scenario, flow["speed"] * way + [0.0, 0.0, z])


def _with_gusts(scenario: Scenario, value: float) -> Scenario:
    current = scenario.environment.current
    if isinstance(current, GustyCurrent):
        return _in(scenario, current=replace(current, sigma=value))
    return _in(scenario, current=GustyCurrent(base=current, sigma=value, seed=scenario.seed))


def _velocity(scenario: Scenario) -> np.ndarray:
    """(3,) [m/s] of the uniform part."""
    base = _base(scenario)
    return base.value if isinstance(base, UniformCurrent | OnsetCurrent) else np.zeros(3)


def _base(scenario: Scenario) -> Current:
    """The current without its gusts."""
    current = scenario.environment.current
    return current.base if isinstance(current, GustyCurrent) else current


def _flowing(scenario: Scenario, velocity: np.ndarray) -> Scenario:
    base, current = _base(scenario), scenario.environment.current
    if isinstance(base, OnsetCurrent):
        base = OnsetCurrent(velocity, start=base.start, rise=base.rise)
    else:
        base = UniformCurrent(velocity)
    return _in(scenario, current=replace(current, base=base) if isinstance(current, GustyCurrent) else base)


def _in(scenario: Scenario, **changes: Any) -> Scenario:
    return replace(scenario, environment=replace(scenario.environment, **changes))


# Parameters of places: where the robot starts, how high the floor truly is, where obstacles truly are.

_AXES = tuple(enumerate("xyz"))
_TURNS = tuple(enumerate(("roll", "pitch", "yaw")))


def place_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Offsets from what the scenario says; controller and mission know nothing of those of floor and obstacles."""
    robot = scenario.robot
    for axis, name in _AXES if robot.n_vehicle else ():
        yield Parameter(f"start.{name}", "m", f"added to {name} of the vehicle at the start, in W", partial(_moved, axis))
    for axis, name in _TURNS if robot.n_vehicle else ():
        meaning = f"turn of the vehicle at the start about its {'xyz'[axis]}"
        yield Parameter(f"start.{name}", "rad", meaning, partial(_turned, axis))
    for joint in robot.joints:
        if joint.n_v == 1:
            name, unit = f"start.{joint_axis(robot, joint.name)}", "m" if joint.slides else "rad"
            yield Parameter(name, unit, "added to this joint at the start", partial(_bent, joint.idx_v))
    if isinstance(scenario.environment.seafloor, FlatSeafloor | HeightField):
        yield Parameter("floor.z", "m", "added to the height of the floor", _with_floor)
    for obstacle in scenario.environment.obstacles:
        for axis, name in _AXES:
            meaning = f"added to {name} of this obstacle, whose true place nobody knows"
            yield Parameter(f"obstacles.{obstacle.name}.{name}", "m", meaning, partial(_with_obstacle, obstacle.name, axis))


def _moved(axis: int, scenario: Scenario, value: float) -> Scenario:
    start = np.array(scenario.start)
    start[axis] += value
    return replace(scenario, start=start)


def _turned(axis: int, scenario: Scenario, value: float) -> Scenario:
    start = np.array(scenario.start)
    turn = pin.Quaternion(pin.exp3(value * np.eye(3)[axis]))
    start[3:7] = (pin.Quaternion(*start[[6, 3, 4, 5]]) * turn).normalized().coeffs()
    return replace(scenario, start=start)


def _bent(index: int, scenario: Scenario, value: float) -> Scenario:
    model = scenario.robot.model
    return replace(scenario, start=pin.integrate(model, scenario.start, value * np.eye(model.nv)[index]))


def _with_floor(scenario: Scenario, value: float) -> Scenario:
    floor = scenario.environment.seafloor
    return _in(scenario, seafloor=replace(floor, z=floor.z + value))  # type: ignore[type-var, attr-defined]


def _with_obstacle(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    shift = pin.SE3(np.eye(3), value * np.eye(3)[axis])
    moved = [replace(o, X_WO=shift * o.X_WO) if o.name == name else o for o in scenario.environment.obstacles]
    return _in(scenario, obstacles=tuple(moved))


# Parameters of the mission: goals that do not move, numbers of tasks, gains of the velocity loop.


def objective_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters that the controller knows: goals and tasks."""
    for task in scenario.mission.hierarchy.tasks:
        goal, own = getattr(task, "goal", None), f"goals.{task.name}"
        # The posture of an arm of three joints is no point in W.
        is_point = isinstance(goal, np.ndarray) and goal.shape == (3,) and not isinstance(task, JointTracking)
        for axis, name in _AXES if isinstance(goal, pin.SE3) or is_point else ():
            meaning = f"added to {name} of the goal of {task.name}, in W"
            yield Parameter(f"{own}.{name}", "m", meaning, partial(_with_goal, task.name, axis))
        if isinstance(goal, pin.SE3):
            meaning = f"turn of the goal of {task.name} about z of W"
            yield Parameter(f"{own}.yaw", "rad", meaning, partial(_with_goal, task.name, 3))
        for name in real_numbers(task):
            apply = partial(_with_number, task.name, name)
            yield Parameter(f"tasks.{task.name}.{name}", "as there", f"{name} of {task.name}, as its class has it", apply)
    for name in [item.name for item in fields(VelocityGains)] if scenario.takes_forces else []:
        yield Parameter(f"gains.{name}", "as there", f"{name} of VelocityGains", partial(_with, "gains", name))


def _with_goal(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    """Shift the goal of the task itself and of the phases that give it a goal of their own."""
    mission = _changed(scenario.mission, name, lambda task: task.with_goal(_shifted(task.goal, axis, value)))
    phases = list(mission.phases)
    for k, phase in enumerate(phases):
        if name in phase.goals:
            phases[k] = replace(phase, goals={**phase.goals, name: _shifted(phase.goals[name], axis, value)})
    return replace(scenario, mission=replace(mission, phases=tuple(phases)))


def _shifted(goal: Any, axis: int, value: float) -> Any:
    if not isinstance(goal, pin.SE3):
        return goal if callable(goal) else goal + value * np.eye(3)[axis]
    if axis < len(_AXES):
        return pin.SE3(goal.rotation, goal.translation + value * np.eye(3)[axis])
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, value) @ goal.rotation, goal.translation)


def _with_number(name: str, field: str, scenario: Scenario, value: float) -> Scenario:
    return replace(scenario, mission=_changed(scenario.mission, name, lambda task: replace(task, **{field: value})))


def _changed(mission: Mission, name: str, change: Any) -> Mission:
    """The mission with another task in the place of that name; the order stays."""
    tasks = [change(task) if task.name == name else task for task in mission.hierarchy.tasks]
    order = tuple(task.name for task in mission.hierarchy.tasks)
    return replace(mission, hierarchy=Hierarchy(tasks, order))


# Parameters of parts that are not the toolkit's: the numbers of the dataclass that makes one.


def own_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Such as ``parts.plant.rate``, of every own part that is made by a dataclass with real numbers."""
    for part, name in scenario.own_parts.items():
        maker: Any = maker_of(part, getattr(scenario, part))
        is_value = is_dataclass(maker) and not isinstance(maker, type)
        for item in real_numbers(maker) if is_value else list[str]():
            meaning = f"{item} of {name}, as its class has it"
            yield Parameter(f"parts.{part}.{item}", "as there", meaning, partial(_with, part, item))


def _with(part: str, name: str, scenario: Scenario, value: float) -> Scenario:
    """The scenario with another number of one of its parts, or of what makes it."""
    own = getattr(scenario, part)
    maker: Any = own if part == "gains" else maker_of(part, own)
    return replace(scenario, **{part: replace(maker, **{name: value})})


# All parameters that a scenario has, by name, in the order in which they are applied.

_FAMILIES = (*(flow_parameters, machine_parameters, sensor_parameters), *(place_parameters, objective_parameters, own_parameters))


@checked
def available_parameters(scenario: Scenario) -> dict[str, Parameter]:
    """Return every parameter that can be varied: water, machine, sensors, start, floor, obstacles, goals, own parts.

    What concerns the robot and its sensors is the truth that the plant has: the controller goes on with its model. Delays
    of sensors it knows, but for `unmodelled_delay`.
    """
    return {parameter.name: parameter for parameter in chain.from_iterable(family(scenario) for family in _FAMILIES)}


# A parameter and its distribution, and a scenario with the values that a run has drawn.


@checked_dataclass(kw_only=False)
class Variation:
    """One uncertain parameter, such as ``Variation("water.drag", LogNormal(1.0, 0.3))``.

    Raises `InvalidInput` for an empty name and for what is no distribution.
    """

    name: str
    """Name of one of `available_parameters`, or any where `apply` is given."""
    distribution: Any
    """Distribution of its values: one of this package, or a frozen one of scipy.stats."""
    apply: Callable[[Scenario, float], Scenario] | None = field(default=None, kw_only=True)
    """For a parameter of your own: the scenario with this value [its unit] of it."""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InvalidInput("a variation without a name; give the one of a parameter")
        object.__setattr__(self, "distribution", distribution_of(self.distribution))

    def __str__(self) -> str:
        own = "" if self.apply is None else f" by {getattr(self.apply, '__qualname__', 'a function')}"
        return f"{self.name}: {self.distribution!r}{own}"


@checked
def require_available(variations: Sequence[Variation], scenario: Scenario) -> None:
    """Raise `NameNotFound` for a parameter that the scenario does not have, `InvalidInput` for one that is varied twice."""
    known, names = available_parameters(scenario), [variation.name for variation in variations]
    for variation in variations:
        if names.count(variation.name) > 1:
            raise InvalidInput(f"{variation.name} is varied twice; give each parameter one distribution")
        if variation.apply is None and variation.name not in known:
            raise NameNotFound("parameter", variation.name, known, "`uvms-ocp campaign MISSION --parameters`")


@checked
def vary(
    scenario: Scenario, values: Mapping[str, float], *, variations: Sequence[Variation] = (), seed: Count | None = None
) -> Scenario:
    """Return the scenario with these values [unit of each] by name of a parameter: code is kept but for numbers that meet others.

    seed: of everything else that is random; left out: the scenario's. variations: parameters of one's own, which come last;
    others in the order of `available_parameters`. Raises `NameNotFound` for a parameter that the scenario does not have, and
    what a value that is impossible raises.
    """
    known, own = available_parameters(scenario), {v.name: v.apply for v in variations if v.apply is not None}
    for name in [name for name in values if name not in own]:
        require_known("parameter in values", name, known)
    changed = scenario if seed is None else seeded(scenario, seed)
    asked = {name: parameter.apply for name, parameter in known.items() if name in values and name not in own}
    for name, apply in (asked | own).items():
        changed = apply(changed, values[name])
    return changed


def seeded(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with this seed of sensors and gusts."""
    water, environment = scenario.environment.current, scenario.environment
    if isinstance(water, GustyCurrent):
        environment = replace(environment, current=replace(water, seed=seed))
    return replace(scenario, seed=seed, environment=environment)


def quantiles(variations: Sequence[Variation], u: Sequence[float]) -> dict[str, float]:
    """Values by name of the numbers u (n_variations,) from 0 to 1."""
    drawn = zip(variations, u, strict=True)
    return {v.name: float(v.distribution.quantile(float(share))) for v, share in drawn}
