"""Where north and the origin lie, and in which turn an angle is written, changes no plan; limits hold wherever one looks."""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin
import pytest

import uvms_ocp as uo
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.request import OcpRequest, solve_ocp
from uvms_ocp.planning.request import Goal, PlanRequest, PostureGoal, ToolGoal, plan_path
from uvms_ocp.report.planned_motion import motion_record
from uvms_ocp.robot.loading import list_robots
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import obstacle

HERE = pin.SE3.Identity()


def world(turn: float, *origin: float) -> pin.SE3:
    """X_NW of a new world N."""
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, turn), np.array(origin))


START, END = uo.pose_at((0.0, 0.0, -5.0), (0.0, 0.0, 0.2)), uo.pose_at((1.2, 0.3, -5.2), (0.0, 0.0, 1.0))
MOVED = {"moved by 1 km": world(0.0, 800.0, -600.0, 0.0), "turned once around": world(2 * np.pi, 0.0, 0.0, 0.0)}
TURNED = {f"turned by {turn:g}": world(turn, -600.0, 800.0, 0.0) for turn in (-1.9, 0.8, 3.0, np.pi, 3.3)}


def start_in(robot: Robot, X_NW: pin.SE3) -> np.ndarray:
    q = robot.configuration().copy()
    q[:7] = pin.SE3ToXYZQUAT(X_NW * START)
    return q


def posture(X_NW: pin.SE3, turns: int = 0) -> PostureGoal:
    pose = X_NW * END
    roll, pitch, yaw = pin.rpy.matrixToRpy(pose.rotation)
    return PostureGoal(position=tuple(pose.translation), rpy=(roll, pitch, yaw + 2 * np.pi * turns))


def tool(X_NW: pin.SE3) -> ToolGoal:
    return ToolGoal(position=tuple(X_NW.act(np.array([1.5, 0.6, -5.2]))))


def seen_from(X_NW: pin.SE3, q: np.ndarray) -> np.ndarray:
    """(n, 9) place and axes of the vehicle in the world as it was, at configurations (n, n_q)."""
    poses = [X_NW.inverse() * pin.XYZQUATToSE3(row[:7]) for row in q]
    return np.array([np.concatenate([X.translation, X.rotation[:, :2].ravel()]) for X in poses])


def curve(robot: Robot, X_NW: pin.SE3, goal: Goal) -> tuple[np.ndarray, np.ndarray]:
    """Poses (n, 9) along the curve, and largest velocities and accelerations (2, n_v) as shares of their limits."""
    ball = obstacle("ball", coal.Sphere(0.1), X_NW.act(np.array([0.7, 0.9, -4.6])))
    result = plan_path(PlanRequest(robot=robot, start=start_in(robot, X_NW), goal=goal, obstacles=(ball,)))
    assert result.plan is not None
    assert result.collision_free
    record = motion_record(result, result.plan)
    rates = record["v"], np.gradient(record["v"], record["t"], axis=0)
    limits = robot.limits.velocity, robot.limits.acceleration
    return seen_from(X_NW, record["q"]), np.array([np.abs(r).max(axis=0) / limit for r, limit in zip(rates, limits, strict=True)])


@pytest.mark.parametrize("goal", [posture, tool])
def test_a_curve_is_the_same_in_any_world(goal: Callable[[pin.SE3], Goal]) -> None:
    """A turn moves it by centimetres: what the optimiser takes for limits is along the axes of the world."""
    robot = uo.load_robot("bluerov2_alpha5")
    usual, _ = curve(robot, HERE, goal(HERE))
    for name, X_NW in (MOVED | TURNED).items():
        found, _ = curve(robot, X_NW, goal(X_NW))
        n, allowed = min(len(found), len(usual)), 1e-3 if name in MOVED else 0.1
        assert max(len(found), len(usual)) <= (1.01 if name in MOVED else 1.1) * n, name
        assert np.abs(found[:n] - usual[:n]).max() < allowed, name


VEHICLES = [name for name in list_robots() if uo.load_robot(name).n_vehicle]


@pytest.mark.parametrize("name", VEHICLES)
def test_a_curve_keeps_the_limits_of_the_vehicle_along_its_own_axes_and_takes_all_they_give(name: str) -> None:
    robot = uo.load_robot(name)
    for turn in (0.0, 0.8, np.pi / 2):
        X_NW = world(turn, 0.0, 0.0, 0.0)
        for goal in (PostureGoal(position=(3.0, 0.0, -5.0)), posture(X_NW)):
            _, shares = curve(robot, X_NW, goal)
            assert shares.max() == pytest.approx(1.0, abs=5e-3)


@pytest.mark.slow
def test_optimal_control_takes_the_short_way_in_any_world() -> None:
    """Also where the quaternion of the start has another sign than that of the curve it begins from."""
    robot = uo.load_robot("bluerov2_alpha5")
    plans = {}
    for name, X_NW in ({"here": HERE} | MOVED | TURNED).items():
        for turns in (0, 1):
            ball = obstacle("ball", coal.Sphere(0.1), X_NW.act(np.array([0.6, -0.6, -5.1])))
            start, goal = start_in(robot, X_NW), posture(X_NW, turns)
            plan = solve_ocp(OcpRequest(robot=robot, start=start, goal=goal, obstacles=(ball,), n_steps=10)).plan
            assert plan.status is OcpStatus.SOLVED
            plans[name, turns] = plan.levels[-1].residual, seen_from(X_NW, plan.trajectory.q)
    cost, usual = plans["here", 0]
    for case, (found, poses) in plans.items():
        assert found == pytest.approx(cost, rel=1e-4), case
        np.testing.assert_allclose(poses, usual, atol=1e-3, err_msg=str(case))
