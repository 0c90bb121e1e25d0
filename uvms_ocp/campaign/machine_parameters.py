"""Parameters of what moves in the water: drag, added mass, mass, payload, thrusters. The controller
knows the nominal ones. The estimator knows the delays of sensors alone, as somebody who fits the
sensors measures them; unmodelled delays have names of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import pinocchio as pin

from uvms_ocp.campaign.distributions import Parameter
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import static_balance
from uvms_ocp.robot.coefficients import coefficients_of, links_in_water
from uvms_ocp.robot.description import LinkDescription, Thruster, TrimBody, checked_copy
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.scenario import Scenario


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
        mass, volume = (
            partial(_carrying, carrier, payload, quantity) for quantity in ("mass", "volume")
        )
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
    """Return the robot with these coefficients of its links scaled; a shape becomes the
    coefficients that its rule gives.
    """
    if not factor >= 0.0:
        raise InvalidInput(f"{parameter} = {factor:g}; give a factor of 0 or more")
    untrimmed = checked_copy(robot.description, trim=())
    scaled = []
    for link in links_in_water(untrimmed):
        coefficients = {name: factor * getattr(link, name) for name in names}
        scaled.append(replace(link, **coefficients))
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


def _carrying(carrier: str, payload: str, quantity: str, robot: Robot, value: float) -> Robot:
    if not value >= 0.0:
        raise InvalidInput(f"{payload}.{quantity} = {value:g}; give 0 or more")
    body = {"mass": 0.0, "volume": 0.0} | {quantity: value}
    return static_balance.with_trim(
        robot,
        [TrimBody(name=f"{payload} {quantity}", link=carrier, position=(0.0, 0.0, 0.0), **body)],
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
