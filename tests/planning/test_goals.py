"""Laws of goals: what they mean for a path in planned axes and for tasks is the same place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from tiny_robots import TINY, robot_of

from uvms_ocp.errors import FrameNotFound, InvalidInput, NameNotFound
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.planned_axes import coordinates
from uvms_ocp.planning.request import PostureGoal, ToolGoal
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.scenario.preflight.arm_reach import ArmReach


@pytest.fixture(scope="module")
def start(robot: Robot) -> np.ndarray:
    return robot.configuration(position=(0.5, 0.0, -1.0), rpy=(0.0, 0.0, 0.3))


@pytest.fixture(scope="module")
def empty(robot: Robot, start: np.ndarray) -> CollisionScene:
    return collision_scene(coordinates(robot, reference=start), [])


@pytest.mark.parametrize(
    "goal",
    [
        PostureGoal(position=(1.0, 2.0, -3.0)),
        PostureGoal(rpy=(0.1, -0.2, 1.0)),
        PostureGoal(
            position=(1.0, 2.0, -3.0), rpy=(0.1, -0.2, 1.0), joints={"joint1": 0.4, "joint3": 0.1}
        ),
    ],
)
def test_a_posture_is_the_same_in_axes_and_in_tasks(
    robot: Robot, start: np.ndarray, empty: CollisionScene, goal: PostureGoal
) -> None:
    x = goal.as_coordinates(CoalDistances(empty), seed=0)
    q = empty.coordinates.configurations(x[None])[0]
    vehicle, *joints = goal.as_tasks(robot, start)
    X_WB = Kinematics(robot, q).pose("base_link")
    np.testing.assert_allclose(vehicle.goal.homogeneous, X_WB.homogeneous, atol=1e-12)
    assert [task.joints for task in joints] == ([tuple(goal.joints)] if goal.joints else [])
    for name, value in zip(robot.joint_names, q[7:], strict=True):
        assert value == pytest.approx(
            goal.joints.get(name, start[7 + robot.joint_names.index(name)])
        )


@pytest.mark.parametrize("rpy", [None, (np.pi, 0.0, 0.3)])
def test_a_tool_goal_is_the_same_in_axes_and_in_tasks(
    robot: Robot, start: np.ndarray, empty: CollisionScene, rpy: tuple[float, float, float] | None
) -> None:
    goal = ToolGoal(position=(2.0, 1.0, -1.5), rpy=rpy)
    x = goal.as_coordinates(CoalDistances(empty), seed=0)
    assert x is not None
    X_WT = Kinematics(robot, empty.coordinates.configurations(x[None])[0]).pose("tool")
    (task,) = goal.as_tasks(robot, start)
    np.testing.assert_allclose(X_WT.translation, task.goal.translation, atol=1e-5)
    if rpy is not None:
        np.testing.assert_allclose(pin.log3(X_WT.rotation.T @ task.goal.rotation), 0.0, atol=1e-5)


def test_goals_that_the_robot_does_not_have_are_refused(
    robot: Robot, start: np.ndarray, empty: CollisionScene
) -> None:
    distances = CoalDistances(empty)
    elsewhere = PostureGoal(joints={"joint9": 0.1})
    with pytest.raises(NameNotFound, match="joint9"):
        elsewhere.as_coordinates(distances, seed=0)
    with pytest.raises(NameNotFound, match="joint9"):
        elsewhere.as_tasks(robot, start)
    unknown = ToolGoal(position=(0.0, 0.0, 0.0), frame="tol")
    with pytest.raises(FrameNotFound, match="tol"):
        unknown.as_coordinates(distances, seed=0)
    with pytest.raises(FrameNotFound, match="tol"):
        unknown.as_tasks(robot, start)


def test_a_goal_on_an_axis_that_is_not_planned_is_refused_by_name(
    robot: Robot, start: np.ndarray
) -> None:
    arm = collision_scene(coordinates(robot, reference=start, axes=robot.joint_names), [])
    with pytest.raises(
        InvalidInput, match=r"the goal moves yaw from 0\.3 to 1, but the planned axes are joint1, "
    ):
        PostureGoal(rpy=(0.0, 0.0, 1.0)).as_coordinates(CoalDistances(arm), seed=0)
    stays = PostureGoal(rpy=(0.0, 0.0, 0.3), joints={"joint1": 0.2}).as_coordinates(
        CoalDistances(arm), seed=0
    )
    np.testing.assert_allclose(stays, [0.2, *start[8:]], atol=1e-12)


def test_shapes_that_touch_are_told_with_their_place(empty: CollisionScene) -> None:
    apart = np.full(empty.n_pairs, 0.1)
    empty.check_no_overlap(apart, "the start")
    apart[1] = -0.02
    with pytest.raises(
        InvalidInput, match=f"the start is in collision: {empty.pairs[1].name} overlap by 0.02 m"
    ):
        empty.check_no_overlap(apart, "the start")


@pytest.mark.parametrize(
    ("here", "there"), [(170, -170), (-175, 175), (200, 200), (10, 30), (10, 550), (-100, 100)]
)
def test_an_attitude_is_reached_the_short_way_round(
    robot: Robot, here: float, there: float
) -> None:
    start = robot.configuration(rpy=(0.0, 0.0, np.radians(here)))
    scene = collision_scene(coordinates(robot, reference=start, axes=("x", "y", "z", "yaw")), [])
    way = np.radians(there - here)
    short = np.arctan2(np.sin(way), np.cos(way))
    for rpy in (
        (0.0, 0.0, np.radians(there)),
        (2 * np.pi, 0.0, np.radians(there)),
        (np.pi, np.pi, np.radians(there - 180)),
    ):
        x = PostureGoal(rpy=rpy).as_coordinates(CoalDistances(scene), seed=0)
        assert x[3] - scene.coordinates.x(start)[3] == pytest.approx(short, abs=1e-9)
    tool = Kinematics(robot, robot.configuration(rpy=(0.0, 0.0, np.radians(there)))).pose("tool")
    rpy = tuple(pin.rpy.matrixToRpy(tool.rotation).tolist())
    x = ToolGoal(position=tuple(tool.translation.tolist()), rpy=rpy).as_coordinates(
        CoalDistances(scene), seed=0
    )
    assert x is not None
    assert abs(x[3] - scene.coordinates.x(start)[3]) <= np.pi + 1e-9


@pytest.mark.parametrize("joint", ["elbow", "x", "yaw"])
@pytest.mark.parametrize(
    "goal", [PostureGoal(position=(1.0, 2.0, -3.0)), PostureGoal(rpy=(0.0, 0.0, 1.0))]
)
def test_a_goal_of_the_vehicle_of_a_fixed_base_is_refused(
    tmp_path: Path, goal: PostureGoal, joint: str
) -> None:
    """It was "unknown axis 'x'", or moved a joint that is called as an axis of a vehicle."""
    TINY["fixed base, no thrusters"].write(tmp_path)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(urdf.read_text().replace("turn0", joint))
    arm = load_robot(urdf=urdf, hydrodynamics=tmp_path / "hydrodynamics.yaml")
    distances = CoalDistances(collision_scene(coordinates(arm), []))
    refusal = f"robot 'tiny' has a fixed base; give joints only: {joint}"
    with pytest.raises(InvalidInput, match=refusal):
        goal.as_coordinates(distances, seed=0)
    with pytest.raises(InvalidInput, match=refusal):
        goal.as_tasks(arm, arm.configuration())


def test_axes_of_the_vehicle_of_a_fixed_base_are_refused() -> None:
    arm = robot_of(TINY["fixed base, no thrusters"])
    with pytest.raises(InvalidInput, match=r"'tiny' has a fixed base, .* 'z'; give .*: turn0"):
        coordinates(arm, axes=("turn0", "z"))


@pytest.mark.parametrize("with_attitude", [False, True])
def test_an_arm_of_one_joint_reaches_with_its_tool(with_attitude: bool) -> None:
    """Its Jacobian was one of no columns: a raw error of NumPy."""
    arm = robot_of(TINY["fixed base, no thrusters"])
    q = arm.configuration(joints={arm.joint_names[0]: 0.4})
    tool = Kinematics(arm, q).pose("tool")
    rpy = None
    if with_attitude:
        rpy = tuple(pin.rpy.matrixToRpy(tool.rotation).tolist())
    distances = CoalDistances(collision_scene(coordinates(arm), []))
    goal = ToolGoal(position=tuple(tool.translation.tolist()), rpy=rpy)
    x = goal.as_coordinates(distances, seed=0)
    np.testing.assert_allclose(x, [0.4], atol=1e-5)


def test_distances_of_an_arm_of_one_joint_change_as_their_gradients_say() -> None:
    pad = """<link name="pad"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
      <joint name="pad_mount" type="fixed"><parent link="arm0"/><child link="pad"/>
        <origin xyz="0.3 0 0"/></joint>"""
    arm = robot_of(replace(TINY["fixed base, no thrusters"], more=pad))
    ball = obstacle("ball", coal.Sphere(0.1), [0.6, 0.0, 0.3])
    distances = CoalDistances(collision_scene(coordinates(arm), [ball]))
    x = np.array([[0.2]])
    near = distances.near(x, np.full(len(distances.scene.pairs), 10.0))
    assert np.abs(near.gradient).max() > 0.1
    h = 1e-6
    slopes = (distances.distances(x + h) - distances.distances(x - h))[0] / (2 * h)
    np.testing.assert_allclose(near.gradient[:, 0], slopes[near.pair], atol=1e-5)


def test_inverse_kinematics_of_an_arm_of_one_joint() -> None:
    arm = robot_of(TINY["fixed base, no thrusters"])
    goal = Kinematics(arm, arm.configuration(joints={arm.joint_names[0]: 0.4})).pose("tool")
    assert ArmReach(arm, "tool").solve(pin.SE3.Identity(), goal).reached
