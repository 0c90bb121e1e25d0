"""Parameters of what moves in the water: drag, added mass, mass, payload, thrusters. The controller knows the nominal ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.campaign.variations.parameter import Parameter
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.assembly.trim import with_trim
from uvms_ocp.model.files.description import LinkCoefficients, LinkDescription, Pose, Thruster, TrimBody, checked_copy
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.water.coefficients import links_in_water
from uvms_ocp.model.water.hydrodynamics import LinkHydrodynamics
from uvms_ocp.scenario import Scenario

_HAND = "tool"


def machine_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Of the robot on the dynamic plant; the kinematic one has none of them."""
    if scenario.plant == "kinematic":
        return
    robot = scenario.plant_robot or scenario.robot
    yield _of_robot("water.density", "kg/m3", "density of the water", Robot.with_water_density)
    if robot.description.links:
        yield _of_robot("water.drag", "-", "factor of all drag, linear and quadratic", _dragged)
        yield _of_robot("water.added_mass", "-", "factor of the added mass of all links", _with_added_mass)
    yield _of_robot("robot.mass", "-", "factor of the mass and inertia of all links", _heavier)
    carrier = _HAND if robot.has_frame(_HAND) else robot.frame_names[-1]
    yield _of_robot("payload.mass", "kg", f"of a point mass fixed to {carrier}", partial(_carrying, carrier, "mass"))
    meaning = f"of water that something without mass displaces at {carrier}"
    yield _of_robot("payload.volume", "m3", meaning, partial(_carrying, carrier, "volume"))
    if robot.description.thrusters:
        yield _of_robot("thrusters.limit", "-", "factor of the thrust limits of all thrusters", _with_limits)
        yield _of_robot("thrusters.time_constant", "-", "factor of the lag of all thrusters", _with_lag)
        yield _of_robot("thrusters.dead_zone", "N", "command below which no thruster pushes", _with_dead_zone)


def _of_robot(name: str, unit: str, meaning: str, change: Callable[[Robot, float], Robot]) -> Parameter:
    def apply(scenario: Scenario, value: float) -> Scenario:
        return replace(scenario, plant_robot=change(scenario.plant_robot or scenario.robot, value))

    return Parameter(name=name, unit=unit, meaning=meaning, apply=apply)


def _dragged(robot: Robot, factor: float) -> Robot:
    if not factor >= 0.0:
        raise InvalidInput(f"water.drag = {factor:g}; give a factor of 0 or more")
    return _wet(
        robot, lambda link: {"linear_drag": factor * link.linear_drag, "quadratic": factor * link.quadratic_drag}
    )


def _with_added_mass(robot: Robot, factor: float) -> Robot:
    if not factor >= 0.0:
        raise InvalidInput(f"water.added_mass = {factor:g}; give a factor of 0 or more")
    return _wet(robot, lambda link: {"added_mass": factor * link.added_mass})


def _wet(robot: Robot, change: Callable[[LinkHydrodynamics], dict[str, np.ndarray]]) -> Robot:
    """The robot with other coefficients of its links; a shape becomes the coefficients that its rule gives."""
    bare = checked_copy(robot.description, trim=())
    links = {link.frame: _described(link, change(link)) for link in links_in_water(bare)}
    description = checked_copy(robot.description, links=links)
    return replace(robot, description=description, hydrodynamics=links_in_water(description))


def _described(link: LinkHydrodynamics, changes: dict[str, np.ndarray]) -> LinkDescription:
    terms = {"added_mass": link.added_mass, "linear_drag": link.linear_drag, "quadratic": link.quadratic_drag} | changes
    position, rpy = link.X_FL.translation, pin.rpy.matrixToRpy(link.X_FL.rotation)
    coefficients = LinkCoefficients(
        pose=Pose(position=tuple(position.tolist()), rpy=tuple(rpy.tolist())),
        added_mass=_rows(terms["added_mass"]),
        linear_drag=_rows(terms["linear_drag"]),
        quadratic_drag=tuple(np.diag(terms["quadratic"]).tolist()),
        volume=link.volume,
        centre_of_buoyancy=tuple(link.centre_of_buoyancy.tolist()) if link.volume else None,
    )
    return LinkDescription(coefficients=coefficients)


def _rows(matrix: np.ndarray) -> Any:
    return tuple(map(tuple, matrix.tolist()))


def _heavier(robot: Robot, factor: float) -> Robot:
    if not factor > 0.0:
        raise InvalidInput(f"robot.mass = {factor:g}; give a factor > 0")
    model = robot.model.copy()
    for k in range(1, model.njoints):
        inertia = model.inertias[k]
        model.inertias[k] = pin.Inertia(factor * inertia.mass, inertia.lever, factor * inertia.inertia)
    return replace(robot, model=model)


def _carrying(carrier: str, what: str, robot: Robot, value: float) -> Robot:
    if not value >= 0.0:
        raise InvalidInput(f"payload.{what} = {value:g}; give 0 or more")
    body = {"mass": 0.0, "volume": 0.0} | {what: value}
    return with_trim(robot, [TrimBody(name=f"payload {what}", link=carrier, position=(0.0, 0.0, 0.0), **body)])


def _with_limits(robot: Robot, factor: float) -> Robot:
    def change(thruster: Thruster) -> dict[str, object]:
        curve = tuple((signal, factor * thrust) for signal, thrust in thruster.curve)
        return {"minimum": factor * thruster.minimum, "maximum": factor * thruster.maximum, "curve": curve}

    return _driven(robot, change)


def _with_lag(robot: Robot, factor: float) -> Robot:
    return _driven(robot, lambda thruster: {"time_constant": factor * thruster.time_constant})


def _with_dead_zone(robot: Robot, value: float) -> Robot:
    return _driven(robot, lambda thruster: {"dead_zone": value})


def _driven(robot: Robot, change: Callable[[Thruster], dict[str, object]]) -> Robot:
    thrusters = tuple(dict(thruster) | change(thruster) for thruster in robot.description.thrusters)
    return replace(robot, description=checked_copy(robot.description, thrusters=thrusters))
