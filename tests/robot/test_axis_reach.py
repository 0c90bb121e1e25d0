"""The reach of an axis bounds the motion of points and distances, for every joint type anywhere in
a tree.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from kinematic_trees import MODELS, built_model, random_configuration

from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.joining import robot_of
from uvms_ocp.robot.kinematics import largest_change, point_reach
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.robot.urdf import UrdfModels

TYPES = ("free_flyer", "planar", "revolute_y", "unbounded_z", "prismatic_x", "prismatic_unaligned")
STEP = 1e-6


def machine(model: pin.Model) -> Robot:
    """On a fixed base, with a ball on every link, off its joint."""
    model = model.copy()
    shapes = pin.GeometryModel()
    rng = np.random.default_rng(1)
    for joint in range(1, model.njoints):
        X = pin.SE3(np.eye(3), rng.uniform(-0.3, 0.3, 3))
        shapes.addGeometryObject(pin.GeometryObject(f"ball{joint}", joint, X, coal.Sphere(0.05)))
    models = UrdfModels(name="tree", model=model, visual=pin.GeometryModel(), collision=shapes)
    return robot_of(models, RobotDescription(base="fixed"), "tree")


def random_tree(seed: int) -> pin.Model:
    """A chain of four joints, or two branches; joints with a position per velocity travel at most
    0.7.
    """
    rng = np.random.default_rng(seed)
    model = built_model(*rng.choice(TYPES, 4), branch_at=3 if seed % 2 else None)
    for joint in model.joints[1:]:
        if joint.nq == joint.nv:
            model.lowerPositionLimit[joint.idx_q] = -0.7
            model.upperPositionLimit[joint.idx_q] = 0.7
    return model


def motions(model: pin.Model, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Configurations and velocities: every axis alone, and all together."""
    rows = [*np.eye(model.nv), *rng.normal(size=(3, model.nv))]
    return [(random_configuration(model), row) for row in rows for _ in range(4)]


@pytest.mark.parametrize("seed", range(24))
def test_no_distance_changes_faster_than_the_reach_allows(seed: int) -> None:
    robot = machine(random_tree(seed))
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    for obstacles, itself in (
        ([obstacle("rock", coal.Sphere(0.3), [0.4, 0.5, -0.2])], False),
        ([], True),
    ):
        pairs = CollisionModel(robot, obstacles, self_collision=itself)
        assert not np.isnan(pairs.reach).any()
        for q, v in motions(robot.model, rng) if pairs.n_pairs else ():
            moved = np.abs(pairs.values(pin.integrate(robot.model, q, STEP * v)) - pairs.values(q))
            apart = pairs.values(q) > 0.01
            assert (
                moved[apart] <= STEP * largest_change(pairs.reach, np.abs(v)) * 1.001 + 1e-8
            ).all(), (q, v)


@pytest.mark.parametrize("seed", range(24))
def test_no_point_moves_faster_than_its_reach_allows(seed: int) -> None:
    check_points(machine(random_tree(seed)), seed)


@pytest.mark.parametrize("name", MODELS)
def test_no_point_of_any_known_tree_moves_faster_than_its_reach_allows(name: str) -> None:
    check_points(machine(MODELS[name]()), seed=0)


def check_points(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = robot.model.createData()
    pin.seed(seed)
    frames = [frame.name for frame in robot.model.frames[1:]][-4:]
    for frame in frames:
        reach = point_reach(robot, frame)
        index = robot.frame_id(frame)
        for q, v in motions(robot.model, rng):
            pin.forwardKinematics(robot.model, data, q, v)
            pin.updateFramePlacements(robot.model, data)
            speed = np.linalg.norm(pin.getFrameVelocity(robot.model, data, index, pin.LOCAL).linear)
            assert speed <= largest_change(reach, np.abs(v)) * (1 + 1e-9) + 1e-12, (frame, q, v)


def test_a_reach_is_finite_where_no_travel_is_unlimited() -> None:
    """Else a bound that is infinite throughout would satisfy every law above."""
    tree = built_model("revolute_x", "planar", "revolute_y", "prismatic_x")
    tree.lowerPositionLimit[-1] = -0.7
    tree.upperPositionLimit[-1] = 0.7
    reach = CollisionModel(machine(tree), [obstacle("rock", coal.Sphere(0.3), [9.0, 0, 0])]).reach
    assert np.isinf(reach[0])  # turns the planar joint, which travels without limit
    assert np.isfinite(reach[1:]).all()
    np.testing.assert_allclose(reach[[1, 2, 5]], 1.0)


def test_what_turns_an_unlimited_slide_is_near_to_everything_unless_it_stands_still() -> None:
    robot = machine(built_model("revolute_x", "prismatic_x"))
    reach = CollisionModel(robot, [obstacle("rock", coal.Sphere(0.3), [9.0, 0, 0])]).reach
    np.testing.assert_allclose(
        largest_change(reach, np.array([[0.1, 0.0], [0.0, 0.1]])), [np.inf, 0.1]
    )
    np.testing.assert_allclose(
        largest_change(np.stack([reach, [0.0, 1.0]]), np.array([[0.1, 0.2]])), [[np.inf, 0.2]]
    )


def test_an_axis_that_carries_both_shapes_of_a_pair_does_not_count_even_if_it_reaches_without_end() -> (
    None
):
    robot = machine(built_model("revolute_x", "prismatic_x", "revolute_y", "revolute_z"))
    itself = CollisionModel(robot)
    assert itself.pair_names == ("ball1 - ball3", "ball1 - ball4", "ball2 - ball4")
    assert itself.reach[0] == 0.0
    assert np.isfinite(itself.reach).all()
