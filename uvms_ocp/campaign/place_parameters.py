"""Parameters of campaigns that move things: the start of the robot, the true height of the floor,
the true places of obstacles.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.campaign.current_parameters import with_environment
from uvms_ocp.campaign.distributions import Parameter
from uvms_ocp.planning.planned_axes import joint_axis
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import (
    FlatSeafloor,
    HeightField,
)

AXES = tuple(enumerate("xyz"))
_ANGLES = tuple(enumerate(("roll", "pitch", "yaw")))


def place_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield the parameters that are added to the start, the height of the floor and the positions of
    obstacles. Controller and mission are not told of those of floor and obstacles.
    """
    robot = scenario.robot
    if robot.n_vehicle:
        for axis, name in AXES:
            meaning = f"added to {name} of the vehicle at the start, in W"
            yield Parameter(f"start.{name}", "m", meaning, partial(_with_moved_start, axis))
        for axis, name in _ANGLES:
            axis_name = "xyz"[axis]
            meaning = f"turn of the vehicle at the start about its {axis_name}"
            yield Parameter(f"start.{name}", "rad", meaning, partial(_with_turned_start, axis))
    for joint in robot.joints:
        if joint.n_v == 1:
            name = f"start.{joint_axis(robot, joint.name)}"
            unit = "m" if joint.slides else "rad"
            yield Parameter(
                name,
                unit,
                "added to this joint at the start",
                partial(_with_moved_joint, joint.idx_v),
            )
    if isinstance(scenario.environment.seafloor, FlatSeafloor | HeightField):
        yield Parameter("floor.z", "m", "added to the height of the floor", _with_floor)
    for obstacle in scenario.environment.obstacles:
        for axis, name in AXES:
            meaning = f"added to {name} of this obstacle, whose true place nobody knows"
            yield Parameter(
                f"obstacles.{obstacle.name}.{name}",
                "m",
                meaning,
                partial(_with_obstacle, obstacle.name, axis),
            )


def _with_moved_start(axis: int, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with the start moved by a value [m] along an axis of W."""
    start = np.array(scenario.start)
    start[axis] += value
    return replace(scenario, start=start)


def _with_turned_start(axis: int, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with the vehicle turned at the start by a value [rad] about its axis."""
    start = np.array(scenario.start)
    turn = pin.Quaternion(pin.exp3(value * np.eye(3)[axis]))
    x, y, z, w = start[3:7]
    attitude = pin.Quaternion(w, x, y, z) * turn
    start[3:7] = attitude.normalized().coeffs()
    return replace(scenario, start=start)


def _with_moved_joint(index: int, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with a joint moved at the start by a value [rad or m]; index: of the joint's
    rate among the velocities.
    """
    model = scenario.robot.model
    displacement = value * np.eye(model.nv)[index]
    return replace(scenario, start=pin.integrate(model, scenario.start, displacement))


def _with_floor(scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with the floor higher by a value [m]."""
    floor: Any = scenario.environment.seafloor
    return with_environment(scenario, seafloor=replace(floor, z=floor.z + value))


def _with_obstacle(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with an obstacle moved by a value [m] along an axis of W."""
    shift = pin.SE3(np.eye(3), value * np.eye(3)[axis])
    obstacles = []
    for obstacle in scenario.environment.obstacles:
        if obstacle.name == name:
            obstacles.append(replace(obstacle, X_WO=shift * obstacle.X_WO))
        else:
            obstacles.append(obstacle)
    return with_environment(scenario, obstacles=tuple(obstacles))
