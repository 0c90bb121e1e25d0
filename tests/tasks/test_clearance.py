"""Clearance of obstacles and of the robot itself: distances, gradients, and what the task asks
for.
"""

from __future__ import annotations

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest
from task_values import evaluate, random_configuration

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.limits import PositionLimit
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import Obstacle, mesh_shape
from uvms_ocp.robot.shapes.shape_pairs import self_pairs
from uvms_ocp.sim.rough_seafloor import HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor, floor_obstacle
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.clearance import Clearance

STEP = 1e-4


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def ball(x: float, y: float, z: float, radius: float = 0.3) -> Obstacle:
    return Obstacle(
        name="ball", shape=coal.Sphere(radius), X_WO=pin.SE3(np.eye(3), np.array([x, y, z]))
    )


def test_gradients_equal_finite_differences(robot: Robot) -> None:
    """Central differences; a shape whose nearest feature changes in between is not differentiable
    there.
    """
    model = CollisionModel(robot, [ball(3.0, 0.0, 0.0)])
    rng = np.random.default_rng(4)
    right = 0
    total = 0
    for _ in range(5):
        q = random_configuration(robot, rng)
        v = rng.normal(size=robot.n_v)
        distances = model.distances(q)
        ahead, behind = (
            model.values(pin.integrate(robot.model, q, sign * STEP * v)) for sign in (1.0, -1.0)
        )
        slope = (ahead - behind) / (2 * STEP)
        apart = distances.value > 1e-3
        right += int((np.abs(distances.gradient @ v - slope)[apart] < 5e-3).sum())
        total += int(apart.sum())
    assert right >= 0.95 * total


def test_links_that_touch_by_design_are_left_out(robot: Robot) -> None:
    values = CollisionModel(robot).values(robot.configuration())
    assert len(self_pairs(robot)) > 10
    assert (values > 0).all()


def test_a_flat_floor_and_its_mesh_are_equally_far(robot: Robot) -> None:
    q = robot.configuration(position=(0.0, 0.0, 0.0), rpy=(0.1, -0.05, 0.7))
    exact = floor_obstacle(FlatSeafloor(z=-2.0), centre=(0.0, 0.0), extent=10.0)
    field = HeightField(
        z=-2.0, centres=np.array([[40.0, 40.0]]), heights=np.ones(1), radii=np.ones(1)
    )
    meshed = floor_obstacle(field, centre=(0.0, 0.0), extent=10.0)
    first, second = (
        CollisionModel(robot, [floor], self_collision=False).values(q) for floor in (exact, meshed)
    )
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_a_mesh_below_a_box_is_touched_at_zero() -> None:
    floor = mesh_shape(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    result = coal.DistanceResult()
    pose = coal.Transform3s(np.eye(3), np.array([0.0, 0.0, 0.25]))
    distance = coal.distance(
        coal.Box(0.5, 0.5, 0.5),
        pose,
        floor,
        coal.Transform3s.Identity(),
        coal.DistanceRequest(),
        result,
    )
    assert distance == pytest.approx(0.0, abs=1e-6)


def test_the_task_forbids_to_come_nearer_than_its_threshold(robot: Robot) -> None:
    model = CollisionModel(robot, [ball(-0.4, 0.0, -0.95)], self_collision=False)
    rows = evaluate(
        robot, Clearance(model=model, threshold=0.1, n_nearest=3), robot.configuration()
    )
    assert rows["clearance"].item() == pytest.approx(0.15, abs=1e-6)
    assert rows["lower"][0] == pytest.approx(-0.5 * 0.05, abs=1e-6)
    assert rows["activation"][0] > 0.8
    np.testing.assert_allclose(rows["jacobian"][0, :3], [0.0, 0.0, 1.0], atol=1e-6)


def test_pairs_that_are_missing_are_far_away(robot: Robot) -> None:
    task = Clearance(
        model=CollisionModel(robot, [ball(3, 0, 0)], self_collision=False, links=["link7_0"])
    )
    assert task.reference(0.0).shape == (task.n_parameters(robot),)
    assert task.reference(0.0)[0] > 100.0


def test_an_unknown_shape_is_named(robot: Robot) -> None:
    with pytest.raises(
        InvalidInput, match=r"\['link9'\] to check for collision; allowed: base_link_0"
    ):
        CollisionModel(robot, links=["link9"])


def test_a_model_without_pairs_is_refused(robot: Robot) -> None:
    with pytest.raises(
        InvalidInput,
        match="CL: a collision model without pairs; give obstacles or self_collision=True",
    ):
        Clearance(model=CollisionModel(robot, self_collision=False))


def test_no_gradient_exceeds_the_reach_of_its_axis(robot: Robot) -> None:
    model = CollisionModel(robot, [ball(1.0, 0.5, 0.0)])
    itself = CollisionModel(robot)
    rng = np.random.default_rng(2)
    assert not itself.reach[:6].any()
    assert (itself.reach[6:] > 0).any()
    for _ in range(20):
        q = random_configuration(robot, rng)
        for pairs in (model, itself):
            assert (np.abs(pairs.distances(q).gradient) <= pairs.reach + 1e-9).all()


def positions(limit: PositionLimit, q: np.ndarray) -> np.ndarray:
    """All of them [m]."""
    is_smooth = isinstance(limit.values, ca.Function)
    return np.array(limit.values(q)).ravel() if is_smooth else limit.values(q, None)


@pytest.mark.parametrize("task", ["CL", "MAC"])
def test_a_position_limit_reads_the_quantity_of_its_task(robot: Robot, task: str) -> None:
    model = CollisionModel(robot, [ball(1.5, 0.0, -0.5)], self_collision=False)
    task_value = {"CL": Clearance(model=model), "MAC": MinimumAltitude()}[task]
    limit = task_value.position_limit(robot)
    assert limit is not None
    rng = np.random.default_rng(4)
    places = [random_configuration(robot, rng) for _ in range(5)]
    heights = [Kinematics(robot, q).pose("altimeter").translation[2] for q in places]
    beams = [Kinematics(robot, q).pose("altimeter").rotation[2, 2] for q in places]
    measured = [
        evaluate(robot, task_value, q, altimeter_range=(h + 9.0) / c)[limit.quantity].item()
        for q, h, c in zip(places, heights, beams, strict=True)
    ]
    values = np.array([positions(limit, q).min() for q in places])
    offset = measured - values
    np.testing.assert_allclose(offset, 9.0 if limit.relative else 0.0, atol=1e-6)
    assert [positions(limit, q).size for q in places] == [limit.n] * 5
    # What the limit says of a small motion is within its reach.
    for q in places:
        v = rng.normal(size=robot.n_v)
        moved = positions(limit, pin.integrate(robot.model, q, 1e-3 * v)) - positions(limit, q)
        assert (np.abs(moved) <= 1e-3 * limit.reach @ np.abs(v) * 1.01 + 1e-9).all()
