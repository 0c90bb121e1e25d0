"""Configurations are elements of a manifold: joints that turn without end are as the bounded ones
at the same angles.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from task_values import evaluate, task_function
from tiny_robots import TINY, Tiny, robot_of, scenario_of

from uvms_ocp.control.velocity.levels import tick_symbols
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.planned_axes import coordinates
from uvms_ocp.planning.request import PostureGoal
from uvms_ocp.planning.scene import collision_scene
from uvms_ocp.record.run_meta import joint_errors, joint_positions
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import up_at_rest
from uvms_ocp.tasks.joints import JointTracking, Manipulability
from uvms_ocp.tasks.task import Task

STEP = 1e-6
_LIMITS = '<limit lower="-3.2" upper="3.2" effort="8" velocity="0.7"/>'


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_of(TINY["endless and not"])


def _quantity(robot: Robot, task: Task, name: str, q: np.ndarray) -> float:
    return float(evaluate(robot, task, q)[name].item())


@pytest.mark.sampled
@pytest.mark.parametrize("angles", [(0.3, -0.4, 2.0), (-3.1, 0.9, 3.1), (1.5, 0.2, -1.6)])
def test_rows_equal_differences_on_the_manifold(robot: Robot, angles: tuple[float, ...]) -> None:
    q = robot.configuration(position=(0.1, 0.2, -3.0), rpy=(0.1, -0.2, 0.4), joints=angles)
    goal = np.array([2.0, 0.1, -2.5])
    posture = JointTracking(joints=robot.joint_names, goal=goal)
    whole = {"MP": posture, "MU": Manipulability()}
    for name, task in whole.items():
        J = np.array(
            task_function(robot, task)(q, np.zeros(robot.n_v), 2.0, task.reference(0.0))[0]
        )
        for i in range(robot.n_v):
            ahead, behind = (
                pin.integrate(robot.model, q, s * np.eye(robot.n_v)[i]) for s in (STEP, -STEP)
            )
            if name == "MP":
                moved = (robot.joint_values(ahead) - robot.joint_values(behind)) / (2 * STEP)
            else:
                mu = [_quantity(robot, task, "manipulability", place) for place in (behind, ahead)]
                moved = np.array([mu[1] - mu[0]]) / (2 * STEP)
            np.testing.assert_allclose(J[:, i], moved, atol=1e-6)


@pytest.mark.parametrize("goal", [0.5, 1.0, 3.0, -3.0])
@pytest.mark.parametrize("start", [0.0, 2.0, -3.0])
def test_a_posture_ends_at_its_goal_by_the_shorter_way(
    robot: Robot, start: float, goal: float
) -> None:
    task = JointTracking(joints=("turn0",), goal=np.array([goal]))
    q = robot.configuration(joints={"turn0": start})
    function = task_function(robot, task, 0.05)
    way = 0.0
    dt = 0.05
    for _ in range(800):
        J, rate = (
            np.array(part)
            for part in function(q, np.zeros(robot.n_v), 2.0, task.reference(0.0))[:2]
        )
        v = (J.T @ rate).ravel()
        q = pin.integrate(robot.model, q, v * dt)
        way = way + dt * v[robot.joints[0].idx_v]
    shorter = (goal - start + np.pi) % (2 * np.pi) - np.pi
    assert way == pytest.approx(shorter, abs=1e-4)
    np.testing.assert_allclose(robot.joint_values(q)[0], goal, atol=1e-4)


def test_over_a_horizon_a_posture_is_as_far_as_in_the_hierarchy(robot: Robot) -> None:
    task = JointTracking(joints=robot.joint_names, goal=np.array([3.0, 0.2, -3.0]))
    symbols = tick_symbols(robot, 0.005)
    parameters = ca.SX.sym("parameters", 6)
    residual = ca.Function(
        "residual", [symbols.q, parameters], [task.residual(symbols, parameters).value]
    )
    q = robot.configuration(joints=(-3.0, 0.0, 3.0))
    np.testing.assert_allclose(
        np.array(residual(q, task.reference(0.0))).ravel(),
        [6.0 - 2 * np.pi, 0.2, 2 * np.pi - 6.0],
        atol=1e-12,
    )


def test_the_attitude_at_rest_does_not_depend_on_how_an_angle_is_written() -> None:
    thrusters = TINY["one wet link"].thrusters[:4]
    heavy = []
    kinds = ("revolute", "continuous")
    for kind in kinds:
        robot = robot_of(
            Tiny(joints=((kind, "0 0 1", _LIMITS),), thrusters=(*thrusters, (0, 0, 0.1, 0, 0, 1)))
        )
        heavy.append(up_at_rest(robot, robot.configuration(joints=[3.0])))
    np.testing.assert_allclose(*heavy, atol=1e-12)
    assert heavy[0][2] < 1.0 - 1e-6


def test_planned_axes_have_one_number_for_each_joint_and_goals_the_shorter_way(
    robot: Robot,
) -> None:
    start = robot.configuration(joints=(3.0, 0.2, -3.0))
    planned = coordinates(robot, reference=start)
    x = planned.x(start)
    assert planned.names[-3:] == robot.joint_names
    np.testing.assert_allclose(x[-3:], [3.0, 0.2, -3.0], atol=1e-12)
    np.testing.assert_allclose(planned.configurations(x[None])[0], start, atol=1e-12)
    distances = CoalDistances(collision_scene(planned, []))
    goal = PostureGoal(joints={"turn0": -3.0, "turn2": 3.0}).as_coordinates(distances, seed=0)
    np.testing.assert_allclose(
        goal[-3:] - x[-3:], [2 * np.pi - 6.0, 0.0, 6.0 - 2 * np.pi], atol=1e-12
    )


@pytest.mark.slow
def test_a_record_tells_one_number_for_each_joint_without_jumps(robot: Robot) -> None:
    record = scenario_of(robot, "kinematic").run()
    turned = np.linspace(0.0, 9.0, 40)
    q = np.array([robot.configuration(joints=(angle, 0.1, -angle)) for angle in turned])
    off = np.array([robot.configuration(joints=(angle + 0.01, 0.1, -angle)) for angle in turned])
    series = {"q": q, "q_estimated": off}
    np.testing.assert_allclose(
        joint_positions(series, record.meta),
        np.column_stack([turned, np.full(40, 0.1), -turned]),
        atol=1e-9,
    )
    np.testing.assert_allclose(
        joint_errors(series, record.meta), np.tile([0.01, 0.0, 0.0], (40, 1)), atol=1e-9
    )
    untold = record.meta.model_copy(update={"endless": ()})
    assert joint_positions(series, untold) is None


def test_a_joint_of_several_degrees_of_freedom_is_refused_by_name(robot: Robot) -> None:
    joint = replace(robot.joints[0], n_v=3, n_q=4)
    with pytest.raises(Exception, match="joint 'turn0' has 3 degrees of freedom"):
        joint.position(robot.configuration())
