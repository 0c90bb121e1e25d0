"""Where the origin of the world lies, where north is, and how often somebody has turned changes no
task.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from task_registry import REGISTRY
from task_values import evaluate, random_configuration

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.attitude import Alignment, FieldOfView
from uvms_ocp.tasks.task import Task

WORLDS = {  # X_NW of the new world N
    "turned": pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2.5), np.zeros(3)),
    "turned once around": pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2 * np.pi), np.zeros(3)),
    "moved by 1 km": pin.SE3(np.eye(3), np.array([800.0, -600.0, 0.0])),
    "both": pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, -1.9), np.array([-600.0, 800.0, 0.0])),
}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def moved(task: Task, X_NW: pin.SE3) -> Task:
    """The task with its goal in the new world."""
    goal = getattr(task, "goal", None)
    if isinstance(goal, pin.SE3):
        return task.with_goal(X_NW * goal)
    return (
        task.with_goal(X_NW.act(np.asarray(goal)))
        if isinstance(task, Alignment | FieldOfView)
        else task
    )


@pytest.mark.sampled
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", REGISTRY)
def test_a_task_measures_and_asks_the_same_in_any_world(
    name: str, world: str, robot: Robot
) -> None:
    X_NW = WORLDS[world]
    task = REGISTRY[name].task
    rng = np.random.default_rng(3)
    moved_task = moved(task, X_NW)
    for _ in range(5):
        q = random_configuration(robot, rng)
        q_moved = np.concatenate([pin.SE3ToXYZQUAT(X_NW * pin.XYZQUATToSE3(q[:7])), q[7:]])
        expected = evaluate(robot, task, q)
        rows_there = evaluate(robot, moved_task, q_moved)
        for quantity in expected.keys() - {"jacobian", "rate", "lower", "upper"}:
            np.testing.assert_allclose(
                rows_there[quantity], expected[quantity], rtol=0, atol=1e-9, err_msg=quantity
            )
        for side in (
            "rate",
            "lower",
            "upper",
        ):  # rows may be along axes of the world: what they ask of the robot is the same
            motions = [
                np.linalg.lstsq(values["jacobian"], values[side])[0]
                for values in (expected, rows_there)
            ]
            np.testing.assert_allclose(*reversed(motions), rtol=0, atol=1e-7, err_msg=side)
        gram = [values["jacobian"].T @ values["jacobian"] for values in (expected, rows_there)]
        np.testing.assert_allclose(*reversed(gram), rtol=0, atol=1e-9)
