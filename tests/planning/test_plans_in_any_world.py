"""Where north and the origin lie, and in which turn an angle is written, changes no plan; limits
hold wherever one looks.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

import uvms_ocp as uo
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.request import OcpRequest, solve_ocp
from uvms_ocp.planning.request import Goal, PlanRequest, PostureGoal, ToolGoal, plan_path
from uvms_ocp.report.planned_motion import motion_record, plan_report
from uvms_ocp.robot.loading import list_robots
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.viz.colours import THRESHOLD
from uvms_ocp.viz.plan_figures import figure_vehicle_motion

HERE = pin.SE3.Identity()


def world(turn: float, *origin: float) -> pin.SE3:
    """X_NW of a new world N."""
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, turn), np.array(origin))


START = uo.pose_at((0.0, 0.0, -5.0), (0.0, 0.0, 0.2))
END = uo.pose_at((1.2, 0.3, -5.2), (0.0, 0.0, 1.0))
MOVED = {
    "moved by 1 km": world(0.0, 800.0, -600.0, 0.0),
    "turned once around": world(2 * np.pi, 0.0, 0.0, 0.0),
}
TURNED = {
    f"turned by {turn:g}": world(turn, -600.0, 800.0, 0.0) for turn in (-1.9, 0.8, 3.0, np.pi, 3.3)
}


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
    """Poses (n, 9) along the curve, and largest velocities and accelerations (2, n_v) as shares of
    their limits.
    """
    ball = obstacle("ball", coal.Sphere(0.1), X_NW.act(np.array([0.7, 0.9, -4.6])))
    result = plan_path(
        PlanRequest(robot=robot, start=start_in(robot, X_NW), goal=goal, obstacles=(ball,))
    )
    assert result.plan is not None
    assert result.collision_free
    record = motion_record(result, result.plan)
    rates = record["v"], np.gradient(record["v"], record["t"], axis=0)
    limits = robot.limits.velocity, robot.limits.acceleration
    return seen_from(X_NW, record["q"]), np.array(
        [np.abs(r).max(axis=0) / limit for r, limit in zip(rates, limits, strict=True)]
    )


@pytest.mark.sampled
@pytest.mark.parametrize("goal", [posture, tool])
def test_a_curve_is_the_same_in_any_world(goal: Callable[[pin.SE3], Goal]) -> None:
    robot = uo.load_robot("bluerov2_alpha5")
    usual, _ = curve(robot, HERE, goal(HERE))
    for name, X_NW in (MOVED | TURNED).items():
        found, _ = curve(robot, X_NW, goal(X_NW))
        n = min(len(found), len(usual))
        assert max(len(found), len(usual)) <= 1.01 * n, name
        assert np.abs(found[:n] - usual[:n]).max() < 1e-3, name


@pytest.mark.slow
@pytest.mark.parametrize("bearing", [0.0, np.pi / 4, np.pi / 2, -2.0])
@pytest.mark.parametrize("turn", [0.0, np.pi / 2, 2.5])
def test_a_long_way_takes_the_same_time_whatever_its_bearing_is_called(
    bearing: float, turn: float
) -> None:
    """Of a vehicle that is half as fast abeam as ahead, which turns on the way: one path, at one
    speed.
    """
    robot = uo.load_robot("bluerov2_alpha5")
    end = pin.SE3(
        pin.rpy.rpyToMatrix(0.0, 0.0, turn), 8.0 * np.array([np.cos(bearing), np.sin(bearing), 0.0])
    )
    durations = []
    halfway = []
    for north in (0.0, 0.4, 1.2, np.pi / 2, 2.3, -3.0):
        X_NW = world(north, 0.0, 0.0, 0.0)
        start = robot.configuration(rpy=(0.0, 0.0, north))
        goal = PostureGoal(
            position=tuple((X_NW * end).translation),
            rpy=tuple(pin.rpy.matrixToRpy((X_NW * end).rotation)),
        )
        plan = plan_path(PlanRequest(robot=robot, start=start, goal=goal)).plan
        assert plan is not None
        way = plan.trajectory
        np.testing.assert_allclose(way.evaluate(way.end)[:3], (X_NW * end).translation, atol=1e-9)
        durations.append(way.duration)
        halfway.append(X_NW.actInv(way.evaluate(0.5 * way.end)[:3]))
    np.testing.assert_allclose(durations, durations[0], rtol=1e-3)
    np.testing.assert_allclose(halfway, halfway[:1] * len(halfway), atol=1e-3)


@pytest.mark.slow
def test_what_is_found_at_random_is_the_same_in_any_world() -> None:
    """A posture for a tool that looks back, and a way around a wall: neither is found from the
    first guess.
    """
    robot = uo.load_robot("bluerov2_alpha5")
    durations = []
    ends = []
    for north in (0.0, 0.4, np.pi / 2, -3.0):
        X_NW = world(north, 0.0, 0.0, 0.0)
        pose = X_NW * uo.pose_at((2.0, 0.5, -5.3), (0.4, 0.9, 2.8))
        goal = ToolGoal(
            position=tuple(pose.translation), rpy=tuple(pin.rpy.matrixToRpy(pose.rotation))
        )
        wall = obstacle(
            "wall", coal.Box(0.2, 2.0, 2.0), X_NW.act(np.array([1.2, 0.3, -5.0])), X_NW.rotation
        )
        start = robot.configuration(
            position=tuple(X_NW.act(np.array([0.0, 0.0, -5.0]))), rpy=(0.0, 0.0, north)
        )
        result = plan_path(PlanRequest(robot=robot, start=start, goal=goal, obstacles=(wall,)))
        assert result.plan is not None
        assert result.plan.attempts > 1
        report = plan_report(result)
        assert report["collision_free"]
        assert report["tool_error"]["position_m"] < 1e-5
        durations.append(report["duration_s"])
        ends.append(seen_from(X_NW, motion_record(result, result.plan)["q"][-1:])[0])
    np.testing.assert_allclose(durations, durations[0], rtol=1e-2)
    np.testing.assert_allclose(ends, ends[:1] * len(ends), atol=1e-3)


def test_straight_ahead_needs_no_limit_abeam_wherever_the_vehicle_looks() -> None:
    robot = uo.load_robot("bluerov2_alpha5")
    velocity = robot.limits.velocity.copy()
    acceleration = robot.limits.acceleration.copy()
    velocity[1] = acceleration[1] = np.inf
    keel = replace(
        robot, limits=replace(robot.limits, velocity=velocity, acceleration=acceleration)
    )
    for north in (0.0, 0.4, np.pi / 2, -3.0):
        X_NW = world(north, 0.0, 0.0, -5.0)
        start = keel.configuration(position=tuple(X_NW.translation), rpy=(0.0, 0.0, north))
        ahead, abeam = (
            PostureGoal(position=tuple(X_NW.act(np.array(p))))
            for p in ([3.0, 0.0, 0.0], [3.0, 1.0, 0.0])
        )
        result = plan_path(PlanRequest(robot=keel, start=start, goal=ahead))
        assert plan_report(result)["limit_ratios"]["velocity"]["surge"] == pytest.approx(
            1.0, abs=5e-3
        )
        with pytest.raises(InvalidInput, match=r"^y: no limit of velocity or acceleration"):
            plan_path(PlanRequest(robot=keel, start=start, goal=abeam))


VEHICLES = [name for name in list_robots() if uo.load_robot(name).n_vehicle]


@pytest.mark.slow
@pytest.mark.parametrize("name", VEHICLES)
def test_a_curve_keeps_the_limits_of_the_vehicle_along_its_own_axes_and_takes_all_they_give(
    name: str,
) -> None:
    robot = uo.load_robot(name)
    for turn in (0.0, 0.8, np.pi / 2):
        X_NW = world(turn, 0.0, 0.0, 0.0)
        for goal in (PostureGoal(position=(3.0, 0.0, -5.0)), posture(X_NW)):
            _, shares = curve(robot, X_NW, goal)
            assert shares.max() == pytest.approx(1.0, abs=5e-3)


HEADINGS = [
    (0.0, 0.0),
    (np.pi / 2, np.pi / 2),
    (np.pi / 2, 0.0),
    (0.0, np.pi / 2),
    (0.8, 0.8),
    (0.8, 0.0),
]


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["bluerov2_alpha5", "girona_maris7_full"])
@pytest.mark.parametrize(("first", "last"), HEADINGS)
def test_limits_of_axes_are_recorded_and_drawn_where_they_hold(
    name: str, first: float, last: float
) -> None:
    """No plan that keeps the limits of its vehicle is seen to break one; along the vehicle's own
    axes, each axis has its own.
    """
    robot = uo.load_robot(name)
    start = robot.configuration(rpy=(0.0, 0.0, first))
    goal = PostureGoal(position=(8.0, 1.0, -0.5), rpy=(0.0, 0.0, last))
    result = plan_path(PlanRequest(robot=robot, start=start, goal=goal))
    assert result.plan is not None
    record = motion_record(result, result.plan)
    limits = record.plan_meta.axis_limits
    assert limits.x_acceleration is not None
    for series, largest in (("x_rate", limits.x_rate), ("x_acceleration", limits.x_acceleration)):
        assert (np.abs(record[series]).max(axis=0) <= np.array(largest) * 1.005).all()
    surge, sway, heave, yaw = robot.limits.velocity[[0, 1, 2, 5]]
    along = {(0.0, 0.0): (surge, sway), (np.pi / 2, np.pi / 2): (sway, surge)}.get(
        (first, last), (np.inf, np.inf)
    )
    np.testing.assert_allclose(limits.x_rate, [*along, heave, yaw, *robot.limits.velocity[6:]])
    for row in figure_vehicle_motion(record).axes[1:3]:
        lines = [line for line in row.get_lines() if len(line.get_xdata()) > 2]
        bounds = [
            line
            for line in row.get_lines()
            if len(line.get_xdata()) == 2 and np.ptp(line.get_ydata()) == 0.0
        ]
        for line, bound in itertools.product(lines, bounds):
            if bound.get_color() in (line.get_color(), THRESHOLD):
                assert np.abs(line.get_ydata()).max() <= 1.005 * abs(bound.get_ydata()[0])


@pytest.mark.slow
def test_optimal_control_takes_the_short_way_in_any_world() -> None:
    """Also where the quaternion of the start has another sign than that of the curve it begins
    from.
    """
    robot = uo.load_robot("bluerov2_alpha5")
    plans = {}
    for name, X_NW in ({"here": HERE} | MOVED | TURNED).items():
        for turns in (0, 1):
            ball = obstacle("ball", coal.Sphere(0.1), X_NW.act(np.array([0.6, -0.6, -5.1])))
            start = start_in(robot, X_NW)
            goal = posture(X_NW, turns)
            plan = solve_ocp(
                OcpRequest(robot=robot, start=start, goal=goal, obstacles=(ball,), n_steps=10)
            ).plan
            assert plan.status is OcpStatus.SOLVED
            plans[name, turns] = plan.levels[-1].residual, seen_from(X_NW, plan.trajectory.q)
    cost, usual = plans["here", 0]
    for case, (found, poses) in plans.items():
        assert found == pytest.approx(cost, rel=1e-4), case
        np.testing.assert_allclose(poses, usual, atol=1e-3, err_msg=str(case))
