"""Laws of plans around obstacles."""

from __future__ import annotations

import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest
from ipopt_descent import Ipopt
from planned_scenes import limits_of

from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.planning.conservative_advancement import check_clearance
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.path_cost import CostWeights
from uvms_ocp.planning.planned_axes import Coordinates, coordinates
from uvms_ocp.planning.request import ToolGoalOptions, tool_goal
from uvms_ocp.planning.rrt_connect import SamplingOptions, edge_reach, sampled_waypoints
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.planning.soft_collision import (
    PlanStatus,
    SoftCollisionOptions,
    plan_soft_collision,
    straight_guess,
)
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.trajectories.segment_times import MotionLimits


@pytest.fixture(scope="module")
def ends(planned: Coordinates) -> np.ndarray:
    """Two poses with a ball in the way of the arm and the hull."""
    start = planned.x(planned.robot.configuration())
    return np.stack([start, start + np.concatenate([[0.0, 1.6, 0.0], np.zeros(10)])])


@pytest.fixture(scope="module")
def blocked(planned: Coordinates) -> CollisionScene:
    return collision_scene(planned, [obstacle("ball", coal.Sphere(0.25), [0.9, 0.8, -0.5])])


def test_a_straight_line_through_an_obstacle_is_bent_around_it(
    robot: Robot, blocked: CollisionScene, ends: np.ndarray
) -> None:
    exact = CoalDistances(blocked)
    limits = limits_of(robot)
    assert not check_clearance(exact, straight_guess(ends, limits)).collision_free
    plan = plan_soft_collision(blocked, ends, limits=limits)
    t = np.linspace(plan.trajectory.start, plan.trajectory.end, 3000)
    assert plan.status is PlanStatus.FREE
    assert exact.distances(plan.trajectory.evaluate(t)).min() > 0.0
    assert limits.ratio(plan.trajectory) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(plan.trajectory.evaluate([t[0], t[-1]]), ends, atol=1e-10)
    np.testing.assert_allclose(plan.trajectory.evaluate([t[0], t[-1]], 1), 0.0, atol=1e-10)
    assert plan.clearance.nearest.pair in {pair.name for pair in blocked.pairs}
    assert plan.status.advice


@pytest.mark.slow
def test_given_times_are_kept_where_the_limits_allow(
    robot: Robot, blocked: CollisionScene, ends: np.ndarray
) -> None:
    slow = plan_soft_collision(blocked, ends, limits=limits_of(robot), times=[2.0, 62.0])
    assert (slow.trajectory.start, slow.trajectory.end) == (2.0, 62.0)
    hurried = plan_soft_collision(blocked, ends, limits=limits_of(robot), times=[0.0, 0.5])
    assert limits_of(robot).ratio(hurried.trajectory) == pytest.approx(1.0, abs=1e-9)


def test_way_points_are_kept_on_request(
    robot: Robot, blocked: CollisionScene, ends: np.ndarray
) -> None:
    over = ends.mean(axis=0)
    over[2] += 1.0
    waypoints = np.stack([ends[0], over, ends[1]])
    options = SoftCollisionOptions(free_waypoints=False)
    plan = plan_soft_collision(blocked, waypoints, limits=limits_of(robot), options=options)
    middle = plan.trajectory.evaluate(plan.trajectory.breaks[plan.trajectory.n_pieces // 2])
    assert plan.collision_free
    np.testing.assert_allclose(middle, over, atol=1e-9)


@pytest.mark.slow
def test_ipopt_finds_the_same_plan(robot: Robot, blocked: CollisionScene, ends: np.ndarray) -> None:
    mine = plan_soft_collision(blocked, ends, limits=limits_of(robot))
    theirs = plan_soft_collision(
        blocked, ends, limits=limits_of(robot), options=SoftCollisionOptions(solver=Ipopt())
    )
    assert theirs.collision_free
    assert theirs.cost.total == pytest.approx(mine.cost.total, rel=0.05)


def test_the_same_seed_gives_the_same_plan(
    robot: Robot, blocked: CollisionScene, ends: np.ndarray
) -> None:
    a, b = (plan_soft_collision(blocked, ends, limits=limits_of(robot)) for _ in range(2))
    np.testing.assert_array_equal(a.trajectory.coefficients, b.trajectory.coefficients)


def test_a_plan_that_collides_says_so(robot: Robot, planned: Coordinates, ends: np.ndarray) -> None:
    wall = collision_scene(
        planned,
        [obstacle("wall", coal.Box(60.0, 0.1, 60.0), [0.0, 0.8, 0.0])],
        self_collision=False,
    )
    options = SoftCollisionOptions(restarts=0, sampling=SamplingOptions(max_samples=3))
    plan = plan_soft_collision(wall, ends, limits=limits_of(robot), options=options)
    assert plan.status is PlanStatus.COLLIDING
    assert not plan.collision_free
    assert plan.clearance.nearest.distance <= 0.0
    assert plan.clearance.nearest.pair.startswith("wall")


def test_an_end_point_in_collision_or_out_of_limits_is_refused(
    robot: Robot, planned: Coordinates, ends: np.ndarray
) -> None:
    on_goal = collision_scene(planned, [obstacle("rock", coal.Sphere(0.2), ends[1, :3])])
    with pytest.raises(
        InvalidInput, match=r"way point 1 \(the goal\) is in collision: rock - base_link"
    ):
        plan_soft_collision(on_goal, ends, limits=limits_of(robot))
    far = ends.copy()
    far[1, 7] = 3.0
    with pytest.raises(InvalidInput, match=r"way point 1 \(the goal\) has joint2 = 3"):
        plan_soft_collision(on_goal, far, limits=limits_of(robot))
    with pytest.raises(InvalidInput, match="one column per axis"):
        plan_soft_collision(on_goal, ends[:, :5], limits=limits_of(robot))
    with pytest.raises(InvalidInput, match="way points 0 and 1 are equal"):
        plan_soft_collision(on_goal, ends[[0, 0]], limits=limits_of(robot))
    with pytest.raises(InvalidInput, match="obstacle: position has NaN"):
        obstacle("x", coal.Sphere(1.0), [0.0, np.nan, 0.0])


def test_the_certificate_finds_a_thin_wall_between_samples(
    planned: Coordinates, ends: np.ndarray
) -> None:
    thin = collision_scene(
        planned,
        [obstacle("sheet", coal.Box(60.0, 1e-4, 60.0), [0.0, 0.8, 0.0])],
        self_collision=False,
    )
    line = straight_guess(ends, MotionLimits(velocity=1.0))
    report = check_clearance(CoalDistances(thin), line, per_piece=1)
    assert not report.collision_free


def test_sampled_legs_are_free_of_collision(blocked: CollisionScene, ends: np.ndarray) -> None:
    exact = CoalDistances(blocked)
    assert edge_reach(exact, ends[0], ends[1], 0.0) < 1.0
    path = sampled_waypoints(exact, ends[0], ends[1])
    assert path is not None
    np.testing.assert_array_equal(path[[0, -1]], ends)
    for a, b in itertools.pairwise(path):
        assert exact.distances(a + np.linspace(0, 1, 200)[:, None] * (b - a)).min() > 0.0


def test_a_tool_goal_puts_the_tool_there_clear_of_collision(
    robot: Robot, blocked: CollisionScene, ends: np.ndarray
) -> None:
    exact = CoalDistances(blocked)
    data = robot.model.createData()
    X_WT = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, 0.3), np.array([1.2, 1.5, -0.8]))
    x = tool_goal(exact, "tool", X_WT, ends[1])
    assert x is not None
    lower, upper = blocked.coordinates.limits()
    assert ((x >= lower) & (x <= upper)).all()
    assert exact.distances(x[None]).min() > 0.0
    pin.framesForwardKinematics(robot.model, data, blocked.coordinates.configurations(x[None])[0])
    np.testing.assert_allclose(
        data.oMf[robot.frame_id("tool")].homogeneous, X_WT.homogeneous, atol=1e-5
    )


def test_a_tool_goal_inside_an_obstacle_is_not_found(
    blocked: CollisionScene, ends: np.ndarray
) -> None:
    inside = pin.SE3(np.eye(3), np.array([0.9, 0.8, -0.5]))
    options = ToolGoalOptions(attempts=3)
    assert tool_goal(CoalDistances(blocked), "tool", inside, ends[1], options) is None
    with pytest.raises(FrameNotFound, match="tol"):
        tool_goal(CoalDistances(blocked), "tol", inside, ends[1])
    with pytest.raises(InvalidInput, match="guess has shape"):
        tool_goal(CoalDistances(blocked), "tool", inside, ends[1, :3])


def test_joint_tracking_follows_a_planned_trajectory(robot: Robot, ends: np.ndarray) -> None:
    curve = straight_guess(ends, limits_of(robot)).axes(range(9, 13))
    task = JointTracking(joints=robot.joint_names[-4:], goal=curve)
    np.testing.assert_allclose(task.reference(1.0), np.concatenate(curve(1.0)))


def test_weights_out_of_range_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"clearance = 0\.0; give a number > 0"):
        CostWeights(clearance=0.0)
    with pytest.raises(InvalidInput, match=r"smoothness = -1\.0; give a number >= 0"):
        CostWeights(smoothness=-1.0)


def test_a_fixed_base_robot_is_planned_for_as_well() -> None:
    planar = coordinates(load_robot("planar5"))
    start = planar.x(planar.robot.configuration())
    ends = np.stack([start, start + np.array([4.0, 0.0, 0.0, 0.0, 0.0])])
    scene = collision_scene(planar, [obstacle("post", coal.Cylinder(0.3, 2.0), [2.0, 0.1, 0.0])])
    assert CoalDistances(scene).distances(ends.mean(axis=0)[None]).min() < 0.0
    plan = plan_soft_collision(scene, ends, limits=limits_of(planar.robot))
    assert plan.collision_free
