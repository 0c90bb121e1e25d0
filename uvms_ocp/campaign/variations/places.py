"""Parameters of places: where the robot starts, how high the floor truly is, where obstacles truly are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from uvms_ocp.campaign.variations.parameter import Parameter
from uvms_ocp.scenario import Scenario
from uvms_ocp.sim.height_field import HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor

_AXES = tuple(enumerate("xyz"))
_TURNS = tuple(enumerate(("roll", "pitch", "yaw")))


def place_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Offsets from what the scenario says; controller and mission know nothing of those of floor and obstacles."""
    robot = scenario.robot
    if robot.n_vehicle:
        for axis, name in _AXES:
            meaning = f"added to {name} of the vehicle at the start, in W"
            yield Parameter(name=f"start.{name}", unit="m", meaning=meaning, apply=partial(_moved, axis))
        for axis, name in _TURNS:
            meaning = f"turn of the vehicle at the start about its {'xyz'[axis]}"
            yield Parameter(name=f"start.{name}", unit="rad", meaning=meaning, apply=partial(_turned, axis))
    for index, name in enumerate(robot.joint_names):
        meaning = "added to this joint at the start"
        yield Parameter(name=f"start.{name}", unit="rad or m", meaning=meaning, apply=partial(_bent, index))
    if isinstance(scenario.environment.seafloor, FlatSeafloor | HeightField):
        yield Parameter(name="floor.z", unit="m", meaning="added to the height of the floor", apply=_with_floor)
    for obstacle in scenario.environment.obstacles:
        for axis, name in _AXES:
            meaning = f"added to {name} of this obstacle, whose true place nobody knows"
            apply = partial(_with_obstacle, obstacle.name, axis)
            yield Parameter(name=f"obstacles.{obstacle.name}.{name}", unit="m", meaning=meaning, apply=apply)


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
    start = np.array(scenario.start)
    start[scenario.robot.joint_q.start + index] += value
    return replace(scenario, start=start)


def _with_floor(scenario: Scenario, value: float) -> Scenario:
    floor = scenario.environment.seafloor
    raised = replace(floor, z=floor.z + value)  # type: ignore[type-var, attr-defined]
    return replace(scenario, environment=replace(scenario.environment, seafloor=raised))


def _with_obstacle(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    shift = pin.SE3(np.eye(3), value * np.eye(3)[axis])
    moved = tuple(
        replace(obstacle, X_WO=shift * obstacle.X_WO) if obstacle.name == name else obstacle
        for obstacle in scenario.environment.obstacles
    )
    return replace(scenario, environment=replace(scenario.environment, obstacles=moved))
