"""Laws of plan requests and of obstacles as data."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from tiny_robots import TINY, robot_of

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.planning.request import PlanRequest, PostureGoal, ToolGoal, plan_path
from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.report.planned_motion import motion_record, plan_report
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import (
    build_obstacle,
    describe_obstacle,
    mesh_shape,
    obstacle,
    parse_obstacle,
    read_obstacles,
)
from uvms_ocp.viz.plan_figures import figure_clearance

BALL = obstacle("ball", coal.Sphere(0.3), (1.6, 0.3, -0.4))


def test_a_tool_pose_is_reached_in_position_and_orientation(robot: Robot) -> None:
    X_WT = Kinematics(
        robot, robot.configuration(position=(1.5, 1.0, 0.2), rpy=(0.0, 0.0, 0.4))
    ).pose("tool")
    goal = ToolGoal(position=tuple(X_WT.translation), rpy=tuple(pin.rpy.matrixToRpy(X_WT.rotation)))
    result = plan_path(
        PlanRequest(robot=robot, start=robot.configuration(), goal=goal, obstacles=(BALL,))
    )
    report = plan_report(result)
    assert report["collision_free"]
    assert report["tool_error"]["position_m"] < 1e-5
    assert report["tool_error"]["orientation_rad"] < 1e-5


def test_axes_that_are_not_named_in_the_goal_stay(robot: Robot) -> None:
    start = robot.configuration(position=(0.5, 0.0, -1.0), rpy=(0.05, 0.0, 0.3))
    result = plan_path(
        PlanRequest(robot=robot, start=start, goal=PostureGoal(joints={"joint1": 0.4}), axes="all")
    )
    assert result.plan is not None
    q = motion_record(result, result.plan)["q"]
    np.testing.assert_allclose(q[-1, :7], start[:7], atol=1e-9)
    np.testing.assert_allclose(q[-1, 7:], [0.4, *start[8:]], atol=1e-9)


def test_the_clearance_of_each_obstacle_is_recorded(robot: Robot) -> None:
    goal = PostureGoal(position=(0.0, 0.5, 0.0))
    result = plan_path(
        PlanRequest(robot=robot, start=robot.configuration(), goal=goal, obstacles=(BALL,))
    )
    assert result.plan is not None
    record = motion_record(result, result.plan)
    assert record.meta.clearance_groups == ("ball", "its own links")
    assert record["clearance"].min() == pytest.approx(
        plan_report(result)["min_clearance_m"], abs=1e-3
    )


def test_links_keep_a_clearance_of_their_own(robot: Robot) -> None:
    start = robot.configuration()
    goal = PostureGoal(joints={"joint2": 0.3})
    costs = []
    for other in (0.01, None, 0.06, 0.3):
        result = plan_path(
            PlanRequest(robot=robot, start=start, goal=goal, axes="joints", link_clearance=other)
        )
        assert result.plan is not None
        costs.append(result.plan.cost.collision)
    assert costs[0] < costs[1] == costs[2] < costs[3]
    scene = plan_path(
        PlanRequest(robot=robot, start=start, goal=goal, axes="joints", obstacles=(BALL,))
    ).scene
    assert (
        np.flatnonzero(scene.per_pair(0.1, 0.02) == 0.02).tolist()
        == scene.groups()["its own links"]
    )


@pytest.mark.sampled
@pytest.mark.parametrize("other", [None, 0.06, 0.02, 3.0])
def test_each_clearance_that_was_wanted_is_recorded_and_drawn(
    robot: Robot, other: float | None
) -> None:
    goal = PostureGoal(joints={"joint2": 0.3})
    request = PlanRequest(
        robot=robot, start=robot.configuration(), goal=goal, axes="joints", link_clearance=other
    )
    result = plan_path(request)
    assert result.plan is not None
    record = motion_record(result, result.plan)
    assert record.plan_meta.link_clearance_wanted == other
    figure = figure_clearance(record)
    assert figure is not None
    drawn = {
        text.get_text(): text.xy[1]
        for text in figure.axes[0].texts
        if text.get_text().startswith("wanted")
    }
    links = (
        {f"wanted {other:g} m between links": other}
        if other not in (None, request.clearance)
        else {}
    )
    assert drawn == {f"wanted {request.clearance:g} m": request.clearance, **links}
    assert all(value < figure.axes[0].get_ylim()[1] for value in drawn.values())


def test_a_robot_without_shapes_is_planned_for_too(robot: Robot) -> None:
    bare = replace(robot, collision_model=pin.GeometryModel())
    goal = PostureGoal(position=(0.0, 0.5, 0.0))
    result = plan_path(PlanRequest(robot=bare, start=bare.configuration(), goal=goal))
    assert result.plan is not None
    assert motion_record(result, result.plan)["q"][-1, 1] == pytest.approx(0.5)


def test_axes_that_move_without_limits_are_named() -> None:
    robot = robot_of(replace(TINY["no joints"], limited=False))
    request = PlanRequest(
        robot=robot, start=robot.configuration(), goal=PostureGoal(position=(0.0, 0.5, -1.0))
    )
    with pytest.raises(
        InvalidInput, match=r"^y, z: no limit of velocity or acceleration.*; give vehicle_limits"
    ):
        plan_path(request)


def test_unknown_axes_and_obstacles_of_one_name_are_refused(robot: Robot) -> None:
    goal = PostureGoal(joints={"joint1": 0.4})
    with pytest.raises(InvalidInput, match="two obstacles are called 'ball'"):
        plan_path(
            PlanRequest(robot=robot, start=robot.configuration(), goal=goal, obstacles=(BALL, BALL))
        )
    with pytest.raises(NameNotFound, match="Did you mean 'joints'"):
        plan_path(PlanRequest(robot=robot, start=robot.configuration(), goal=goal, axes="joint"))


@pytest.mark.parametrize(
    ("shape", "size", "kind"),
    [
        ("sphere", 1, coal.Sphere),
        ("capsule", 2, coal.Capsule),
        ("cylinder", 2, coal.Cylinder),
        ("box", 3, coal.Box),
    ],
)
def test_words_and_files_build_the_same_obstacle(
    shape: str, size: int, kind: type, tmp_path: Path
) -> None:
    sizes = [0.2, 0.4, 0.6][:size]
    words = parse_obstacle(shape, ",".join(map(str, [1.0, -2.0, 0.5, *sizes])), "a")
    path = tmp_path / "a.yaml"
    path.write_text(
        f"obstacles: [{{name: a, shape: {shape}, size: {sizes}, position: [1.0, -2.0, 0.5]}}]"
    )
    (read,) = read_obstacles(path)
    assert describe_obstacle(read) == describe_obstacle(words)
    assert isinstance(words.shape, kind)
    data = describe_obstacle(words)
    assert data is not None
    assert data.size == tuple(sizes)


ROOF = mesh_shape(
    np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]]), np.array([[0, 1, 2], [0, 2, 3]])
)


@pytest.mark.parametrize(
    "shape",
    [
        coal.Sphere(0.3),
        coal.Capsule(0.2, 0.7),
        coal.Cylinder(0.2, 0.7),
        coal.Cone(0.2, 0.7),
        coal.Box(0.2, 0.4, 0.6),
        coal.Ellipsoid(0.2, 0.4, 0.6),
        ROOF,
    ],
)
def test_data_of_an_obstacle_build_it_again(shape: coal.CollisionGeometry, robot: Robot) -> None:
    """The same distances of the whole robot, after a detour through JSON."""
    turned = pin.rpy.rpyToMatrix(0.3, -0.8, 2.0)
    item = obstacle("thing", shape, (1.5, 1.0, -0.5), turned)
    data = describe_obstacle(item)
    assert data is not None
    built = build_obstacle(
        ObstacleMeta.model_validate_json(data.model_dump_json(exclude_defaults=True))
    )
    q = robot.configuration()
    given, again = (
        CollisionModel(robot, [thing], self_collision=False).values(q) for thing in (item, built)
    )
    np.testing.assert_allclose(again, given, atol=1e-7)


def test_a_shape_without_an_end_has_no_data() -> None:
    assert (
        describe_obstacle(obstacle("wall", coal.Halfspace(np.array([0.0, 0, 1]), 0.0), (0, 0, 0)))
        is None
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "obstacles: [{name: a, shape: prism, size: [1], position: [0, 0, 0]}]",
            "obstacles.0.shape",
        ),
        (
            "obstacles: [{name: a, shape: sphere, size: [.nan], position: [0, 0, 0]}]",
            "obstacles.0.size.0",
        ),
        (
            "obstacles: [{name: a, shape: sphere, size: [1], position: [0, 0]}]",
            "obstacles.0.position",
        ),
        (
            "obstacles: [{name: a, shape: sphere, size: [1], position: [0, 0, 0], colour: red}]",
            "obstacles.0.colour",
        ),
        (
            "obstacles: [{name: a, shape: mesh, position: [0, 0, 0]}]",
            "a mesh, and only a mesh, has triangles",
        ),
        (
            (
                "obstacles: [{name: a, shape: mesh, vertices: [[0, 0, 0]], triangles: [[0, 0, 1]],"
                " position: [0, 0, 0]}]"
            ),
            "indices from 0 below",
        ),
        ("", "holds no obstacles; give a mapping"),
        ("obstacles: [", "cannot be read as YAML"),
    ],
)
def test_broken_files_are_refused_by_entry(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(InvalidInput, match=message) as caught:
        read_obstacles(tmp_path / "a.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_threads_that_plan_side_by_side_leave_linear_algebra_as_it_was(robot: Robot) -> None:
    def threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    request = PlanRequest(
        robot=robot, start=robot.configuration(), goal=PostureGoal(position=(0.0, 0.5, 0.0))
    )
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        with ThreadPoolExecutor(3) as pool:
            assert all(result.collision_free for result in pool.map(plan_path, [request] * 6))
        assert threads() == before
