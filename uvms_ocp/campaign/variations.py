"""Parameters that can be varied in a scenario, by name, and the scenario with the values that a run
has drawn.
"""

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
from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.errors import InvalidInput, NameNotFound, require_known
from uvms_ocp.mission.mission import Mission
from uvms_ocp.planning.scene import joint_axis
from uvms_ocp.record.tables import of_joints
from uvms_ocp.robot import assembly
from uvms_ocp.robot.coefficients import coefficients_of, links_in_water
from uvms_ocp.robot.description import LinkDescription, Thruster, TrimBody, checked_copy
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import CHANNELS, UNITS, SensorSpec, SensorSpecs
from uvms_ocp.scenario.scenario import Scenario, maker_of
from uvms_ocp.sim import (
    Current,
    FlatSeafloor,
    GustyCurrent,
    HeightField,
    OnsetCurrent,
    StillWater,
    UniformCurrent,
)
from uvms_ocp.tasks import Hierarchy, JointTracking
from uvms_ocp.types import Count

# Parameters of what moves in the water: drag, added mass, mass, payload, thrusters. The controller
# knows the nominal ones. The estimator knows the delays of sensors alone, as somebody who fits the
# sensors measures them; unmodelled delays have names of their own.


def machine_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters of the robot on the dynamic plant; the kinematic one has none."""
    if scenario.plant == "kinematic":
        return
    robot = scenario.plant_robot or scenario.robot
    yield _of_robot("water.density", "kg/m3", "density of the water", Robot.with_water_density)
    if robot.description.links:
        drag = partial(_scaled, "water.drag", ("linear_drag", "quadratic_drag"))
        yield _of_robot("water.drag", "-", "factor of all drag, linear and quadratic", drag)
        added = partial(_scaled, "water.added_mass", ("added_mass",))
        yield _of_robot("water.added_mass", "-", "factor of the added mass of all links", added)
    yield _of_robot("robot.mass", "-", "factor of the mass and inertia of all links", _heavier)
    for k, carrier in enumerate(robot.tools or ("base_link",), 1):
        payload = f"payload{k}" if k > 1 else "payload"
        mass, volume = (partial(_carrying, carrier, payload, what) for what in ("mass", "volume"))
        yield _of_robot(f"{payload}.mass", "kg", f"of a point mass fixed to {carrier}", mass)
        yield _of_robot(
            f"{payload}.volume",
            "m3",
            f"of water that something without mass displaces at {carrier}",
            volume,
        )
    if robot.description.thrusters:
        lag = partial(
            _driven, lambda thruster, factor: {"time_constant": factor * thruster.time_constant}
        )
        zone = partial(_driven, lambda thruster, value: {"dead_zone": value})
        yield _of_robot(
            "thrusters.limit",
            "-",
            "factor of the thrust limits of all thrusters",
            partial(_driven, _limited),
        )
        yield _of_robot("thrusters.time_constant", "-", "factor of the lag of all thrusters", lag)
        yield _of_robot("thrusters.dead_zone", "N", "command below which no thruster pushes", zone)


def _of_robot(
    name: str, unit: str, meaning: str, change: Callable[[Robot, float], Robot]
) -> Parameter:
    def apply(scenario: Scenario, value: float) -> Scenario:
        return replace(scenario, plant_robot=change(scenario.plant_robot or scenario.robot, value))

    return Parameter(name, unit, meaning, apply)


def _scaled(parameter: str, names: tuple[str, ...], robot: Robot, factor: float) -> Robot:
    """The robot with these coefficients of its links scaled; a shape becomes the coefficients that
    its rule gives.
    """
    if not factor >= 0.0:
        raise InvalidInput(f"{parameter} = {factor:g}; give a factor of 0 or more")
    bare = checked_copy(robot.description, trim=())
    scaled = [
        replace(link, **{name: factor * getattr(link, name) for name in names})
        for link in links_in_water(bare)
    ]
    links = {link.frame: LinkDescription(coefficients=coefficients_of(link)) for link in scaled}
    description = checked_copy(robot.description, links=links)
    return replace(robot, description=description, hydrodynamics=links_in_water(description))


def _heavier(robot: Robot, factor: float) -> Robot:
    if not factor > 0.0:
        raise InvalidInput(f"robot.mass = {factor:g}; give a factor > 0")
    model = robot.model.copy()
    for k in range(1, model.njoints):
        inertia = model.inertias[k]
        model.inertias[k] = pin.Inertia(
            factor * inertia.mass, inertia.lever, factor * inertia.inertia
        )
    return replace(robot, model=model)


def _carrying(carrier: str, payload: str, what: str, robot: Robot, value: float) -> Robot:
    if not value >= 0.0:
        raise InvalidInput(f"{payload}.{what} = {value:g}; give 0 or more")
    body = {"mass": 0.0, "volume": 0.0} | {what: value}
    return assembly.with_trim(
        robot, [TrimBody(name=f"{payload} {what}", link=carrier, position=(0.0, 0.0, 0.0), **body)]
    )


def _limited(thruster: Thruster, factor: float) -> dict[str, object]:
    curve = tuple((signal, factor * thrust) for signal, thrust in thruster.curve)
    return {
        "minimum": factor * thruster.minimum,
        "maximum": factor * thruster.maximum,
        "curve": curve,
    }


def _driven(
    change: Callable[[Thruster, float], dict[str, object]], robot: Robot, value: float
) -> Robot:
    thrusters = tuple(
        dict(thruster) | change(thruster, value) for thruster in robot.description.thrusters
    )
    return replace(robot, description=checked_copy(robot.description, thrusters=thrusters))


# Parameters of the sensors, as they truly are: the estimator goes on with what the robot's file
# says of them.
#
# It is given delays, as somebody who fits the sensors measures them; those that it is not given are
# `unmodelled_delay`.

_FIELDS = {
    "sigma": ("standard deviation of the noise", ""),
    "bias": ("constant error of all components", ""),
    "unmodelled_delay": ("added to its delay, unknown to the controller", "s"),
    "dropout": ("probability that a reading is lost", "-"),
    "rate": ("readings per second", "Hz"),
}


def sensor_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters of all sensors together, and of each that the robot has."""
    channels = [channel for channel in CHANNELS if getattr(scenario.specs, channel) is not None]
    noise = partial(_each, lambda spec, factor: {"sigma": factor * spec.sigma})
    later = partial(_each, lambda spec, value: {"delay": spec.delay + value})
    yield Parameter("sensors.noise", "-", "factor of the noise of all channels", noise)
    if isinstance(scenario.sensors, SensorSpecs):  # estimator and controller are given the delays
        text = "added to the delay of all channels, as their file would say it"
        yield Parameter("sensors.delay", "s", text, _delayed)
        text = "time from taking a reading to delivering it, as its file would say it"
        for channel in channels:
            yield Parameter(f"sensors.{channel}.delay", "s", text, partial(_with_delay, channel))
    yield Parameter(
        "sensors.unmodelled_delay",
        "s",
        "added to the delay of all channels, unknown to the controller",
        later,
    )
    slides = [joint.slides for joint in scenario.robot.joints]
    for channel in channels:
        for name, (meaning, unit) in _FIELDS.items():
            apply = partial(_with_field, channel, name)
            yield Parameter(
                f"sensors.{channel}.{name}",
                unit or of_joints(UNITS[channel], slides),
                meaning,
                apply,
            )


def _delayed(scenario: Scenario, value: float) -> Scenario:
    for channel in CHANNELS:
        spec: SensorSpec | None = getattr(scenario.specs, channel)
        if spec is not None:
            scenario = _with_delay(channel, scenario, spec.delay + value)
    return scenario


def _with_delay(channel: str, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with another nominal delay; the unmodelled part of the delay stays."""
    specs = scenario.specs
    true = _true(scenario)
    known = getattr(specs, channel)
    spec = getattr(true, channel)
    specified = replace(specs, **{channel: replace(known, delay=value)})
    real = replace(true, **{channel: replace(spec, delay=value + spec.delay - known.delay)})
    return replace(scenario, sensors=specified, real_sensors=scenario.real_sensors and real)


def _each(
    change: Callable[[SensorSpec, float], dict[str, float]], scenario: Scenario, value: float
) -> Scenario:
    specs = _true(scenario)
    found = {name: getattr(specs, name) for name in CHANNELS}
    changed = {
        name: replace(spec, **change(spec, value))
        for name, spec in found.items()
        if spec is not None
    }
    return replace(scenario, real_sensors=replace(specs, **changed))


def _with_field(channel: str, name: str, scenario: Scenario, value: float) -> Scenario:
    specs = _true(scenario)
    spec: SensorSpec = getattr(specs, channel)
    if name == "unmodelled_delay":
        name = "delay"
        value = spec.delay + value
    return replace(
        scenario, real_sensors=replace(specs, **{channel: replace(spec, **{name: value})})
    )


def _true(scenario: Scenario) -> SensorSpecs:
    return scenario.real_sensors or scenario.specs


# Parameters of the current: uniform parts, heading and gusts.

_UNIFORM = (StillWater, UniformCurrent, OnsetCurrent)


def flow_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters of a uniform current, with gusts or without; of other currents gusts
    alone.
    """
    if scenario.plant == "kinematic":
        return
    if isinstance(_base(scenario), _UNIFORM):
        for axis, name in enumerate("xyz"):
            meaning = f"added to the velocity of the water along {name} of W"
            yield Parameter(f"current.{name}", "m/s", meaning, partial(_added, axis))
        yield Parameter(
            "current.speed", "m/s", "horizontal speed of the water", partial(_with_flow, "speed")
        )
        meaning = "heading of the horizontal flow, from x of W towards y"
        yield Parameter("current.heading", "rad", meaning, partial(_with_flow, "heading"))
    yield Parameter(
        "current.gusts", "m/s", "standard deviation of gusts along each axis of W", _with_gusts
    )


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
    if isinstance(base, UniformCurrent | OnsetCurrent):
        return base.value
    return np.zeros(3)


def _base(scenario: Scenario) -> Current:
    """The current without its gusts."""
    current = scenario.environment.current
    if isinstance(current, GustyCurrent):
        return current.base
    return current


def _flowing(scenario: Scenario, velocity: np.ndarray) -> Scenario:
    base = _base(scenario)
    current = scenario.environment.current
    if isinstance(base, OnsetCurrent):
        base = OnsetCurrent(velocity, start=base.start, rise=base.rise)
    else:
        base = UniformCurrent(velocity)
    return _in(
        scenario, current=replace(current, base=base) if isinstance(current, GustyCurrent) else base
    )


def _in(scenario: Scenario, **changes: Any) -> Scenario:
    return replace(scenario, environment=replace(scenario.environment, **changes))


# Parameters of places: where the robot starts, how high the floor truly is, where obstacles truly
# are.

_AXES = tuple(enumerate("xyz"))
_TURNS = tuple(enumerate(("roll", "pitch", "yaw")))


def place_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Offsets from what the scenario says; controller and mission know nothing of those of floor
    and obstacles.
    """
    robot = scenario.robot
    for axis, name in _AXES if robot.n_vehicle else ():
        yield Parameter(
            f"start.{name}",
            "m",
            f"added to {name} of the vehicle at the start, in W",
            partial(_moved, axis),
        )
    for axis, name in _TURNS if robot.n_vehicle else ():
        meaning = f"turn of the vehicle at the start about its {'xyz'[axis]}"
        yield Parameter(f"start.{name}", "rad", meaning, partial(_turned, axis))
    for joint in robot.joints:
        if joint.n_v == 1:
            name = f"start.{joint_axis(robot, joint.name)}"
            unit = "m" if joint.slides else "rad"
            yield Parameter(
                name, unit, "added to this joint at the start", partial(_bent, joint.idx_v)
            )
    if isinstance(scenario.environment.seafloor, FlatSeafloor | HeightField):
        yield Parameter("floor.z", "m", "added to the height of the floor", _with_floor)
    for obstacle in scenario.environment.obstacles:
        for axis, name in _AXES:
            meaning = f"added to {name} of this obstacle, whose true place nobody knows"
            yield Parameter(
                f"obstacles.{obstacle.name}.{name}",
                "m",
                meaning,
                partial(_with_obstacle, obstacle.name, axis),
            )


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
    return replace(
        scenario, start=pin.integrate(model, scenario.start, value * np.eye(model.nv)[index])
    )


def _with_floor(scenario: Scenario, value: float) -> Scenario:
    floor = scenario.environment.seafloor
    return _in(scenario, seafloor=replace(floor, z=floor.z + value))  # type: ignore[type-var, attr-defined]


def _with_obstacle(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    shift = pin.SE3(np.eye(3), value * np.eye(3)[axis])
    moved = [
        replace(o, X_WO=shift * o.X_WO) if o.name == name else o
        for o in scenario.environment.obstacles
    ]
    return _in(scenario, obstacles=tuple(moved))


# Parameters of the mission: goals that do not move, numbers of tasks, gains of the velocity loop.


def objective_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters that the controller knows: goals and tasks."""
    for task in scenario.mission.hierarchy.tasks:
        goal = getattr(task, "goal", None)
        own = f"goals.{task.name}"
        # The posture of an arm of three joints is no point in W.
        is_point = (
            isinstance(goal, np.ndarray)
            and goal.shape == (3,)
            and not isinstance(task, JointTracking)
        )
        for axis, name in _AXES if isinstance(goal, pin.SE3) or is_point else ():
            meaning = f"added to {name} of the goal of {task.name}, in W"
            yield Parameter(f"{own}.{name}", "m", meaning, partial(_with_goal, task.name, axis))
        if isinstance(goal, pin.SE3):
            meaning = f"turn of the goal of {task.name} about z of W"
            yield Parameter(f"{own}.yaw", "rad", meaning, partial(_with_goal, task.name, 3))
        for name in real_numbers(task):
            apply = partial(_with_number, task.name, name)
            yield Parameter(
                f"tasks.{task.name}.{name}",
                "as there",
                f"{name} of {task.name}, as its class has it",
                apply,
            )
    for name in [item.name for item in fields(VelocityGains)] if scenario.takes_forces else []:
        yield Parameter(
            f"gains.{name}", "as there", f"{name} of VelocityGains", partial(_with, "gains", name)
        )


def _with_goal(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    """Shift the goal of the task itself and of the phases that give it a goal of their own."""
    mission = _changed(
        scenario.mission, name, lambda task: task.with_goal(_shifted(task.goal, axis, value))
    )
    phases = list(mission.phases)
    for k, phase in enumerate(phases):
        if name in phase.goals:
            phases[k] = replace(
                phase, goals={**phase.goals, name: _shifted(phase.goals[name], axis, value)}
            )
    return replace(scenario, mission=replace(mission, phases=tuple(phases)))


def _shifted(goal: Any, axis: int, value: float) -> Any:
    if not isinstance(goal, pin.SE3):
        if callable(goal):
            return goal
        return goal + value * np.eye(3)[axis]
    if axis < len(_AXES):
        return pin.SE3(goal.rotation, goal.translation + value * np.eye(3)[axis])
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, value) @ goal.rotation, goal.translation)


def _with_number(name: str, field: str, scenario: Scenario, value: float) -> Scenario:
    return replace(
        scenario,
        mission=_changed(scenario.mission, name, lambda task: replace(task, **{field: value})),
    )


def _changed(mission: Mission, name: str, change: Any) -> Mission:
    """The mission with another task in the place of that name; the order stays."""
    tasks = [change(task) if task.name == name else task for task in mission.hierarchy.tasks]
    return replace(
        mission, hierarchy=Hierarchy(tasks, tuple(task.name for task in mission.hierarchy.tasks))
    )


# Parameters of parts that are not the toolkit's: the numbers of the dataclass that makes one.


def own_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Such as ``parts.plant.rate``, of every own part that is made by a dataclass with real
    numbers.
    """
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

_FAMILIES = (
    *(flow_parameters, machine_parameters, sensor_parameters),
    *(place_parameters, objective_parameters, own_parameters),
)


@checked
def available_parameters(scenario: Scenario) -> dict[str, Parameter]:
    """Return every parameter that can be varied: water, machine, sensors, start, floor, obstacles,
    goals, own parts.

    What concerns the robot and its sensors is the truth that the plant has: the controller goes on
    with its model. It knows the delays of its sensors, but not parameters that end in
    ``unmodelled_delay``.
    """
    return {
        parameter.name: parameter
        for parameter in chain.from_iterable(family(scenario) for family in _FAMILIES)
    }


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
        if self.apply is None:
            own = ""
        else:
            own = f" by {getattr(self.apply, '__qualname__', 'a function')}"
        return f"{self.name}: {self.distribution!r}{own}"


@checked
def require_available(variations: Sequence[Variation], scenario: Scenario) -> None:
    """Raise `NameNotFound` for a parameter that the scenario does not have, `InvalidInput` for one
    that is varied twice.
    """
    known = available_parameters(scenario)
    names = [variation.name for variation in variations]
    for variation in variations:
        if names.count(variation.name) > 1:
            raise InvalidInput(
                f"{variation.name} is varied twice; give each parameter one distribution"
            )
        if variation.apply is None and variation.name not in known:
            raise NameNotFound(
                "parameter", variation.name, known, "`uvms-ocp campaign MISSION --parameters`"
            )


@checked
def vary(
    scenario: Scenario,
    values: Mapping[str, float],
    *,
    variations: Sequence[Variation] = (),
    seed: Count | None = None,
) -> Scenario:
    """Return the scenario with these values [unit of each] by name of a parameter: tasks, goals and
    gains need no code.

    seed: of everything else that is random; left out: the scenario's. variations: parameters of
    one's own, which come last; others in the order of `available_parameters`. Raises `NameNotFound`
    for a parameter that the scenario does not have, and what a value that is impossible raises.
    """
    known = available_parameters(scenario)
    own = {v.name: v.apply for v in variations if v.apply is not None}
    for name in [name for name in values if name not in own]:
        require_known("parameter in values", name, known)
    if seed is None:
        changed = scenario
    else:
        changed = seeded(scenario, seed)
    asked = {
        name: parameter.apply
        for name, parameter in known.items()
        if name in values and name not in own
    }
    for name, apply in (asked | own).items():
        changed = apply(changed, values[name])
    return changed


def seeded(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with this seed of sensors and gusts."""
    water = scenario.environment.current
    environment = scenario.environment
    if isinstance(water, GustyCurrent):
        environment = replace(environment, current=replace(water, seed=seed))
    return replace(scenario, seed=seed, environment=environment)


def quantiles(variations: Sequence[Variation], u: Sequence[float]) -> dict[str, float]:
    """Values by name of the numbers u (n_variations,) from 0 to 1."""
    return {
        v.name: float(v.distribution.quantile(float(share)))
        for v, share in zip(variations, u, strict=True)
    }
