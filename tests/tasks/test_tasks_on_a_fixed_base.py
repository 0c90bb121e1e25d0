"""Every task on a robot with a fixed base, of one joint or several: it has rows for its joints, or says
in one line what it lacks.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from task_registry import REGISTRY
from tiny_robots import TINY, robot_of

from uvms_ocp.control.velocity.levels import tick_symbols
from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.vehicle_velocity import NullVelocity, UnderActuation

FIXED = ("one joint", "five joints")


def fixed_robot(name: str) -> Robot:
    if name == "one joint":
        return robot_of(TINY["fixed base, no thrusters"])
    return load_robot("planar5")


def task_of(name: str, robot: Robot) -> Task:
    """A task of the registry, on the joints that the robot has."""
    task = REGISTRY[name].task
    if isinstance(task, JointTracking):
        return replace(task, joints=robot.joint_names, goal=np.zeros(robot.n_joints))
    return task


@pytest.mark.parametrize("part", ["rows", "residual"])
@pytest.mark.parametrize("base", FIXED)
@pytest.mark.parametrize("name", REGISTRY)
def test_a_task_moves_the_joints_or_says_what_it_lacks(name: str, base: str, part: str) -> None:
    robot = fixed_robot(base)
    symbols = tick_symbols(robot, 0.01)
    task = task_of(name, robot)
    parameters = ca.SX.sym("parameters", task.n_parameters(robot))
    try:
        made = getattr(task, part)(symbols, parameters)
    except UvmsError as error:
        text = str(error)
        assert "\n" not in text
        assert text.startswith(f"{task.name}: ")
    else:
        assert made.n_rows >= 1
        if part == "rows":
            assert made.jacobian.shape[1] == robot.n_v


@pytest.mark.parametrize("base", FIXED)
@pytest.mark.parametrize(
    "task", [NullVelocity(), NullVelocity(axes=(0,)), UnderActuation(axes=(0,))]
)
def test_the_first_joints_are_no_axes_of_a_vehicle(task: Task, base: str) -> None:
    """The rate of a prismatic joint was held at 0 in place of the surge of a vehicle."""
    robot = fixed_robot(base)
    with pytest.raises(InvalidInput, match=rf"{task.name}: robot '.*' has a fixed base.*; drop"):
        task.rows(tick_symbols(robot, 0.01), ca.SX(0, 1))
