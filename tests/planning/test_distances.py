"""Laws of planned coordinates and of distances along them."""

from __future__ import annotations

import numpy as np
import pytest
from curves.capsules import capsule_robot
from curves.closed_forms import ClosedFormDistances
from planned_scenes import PIPE, SPHERE, differences, random_x

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.planned_axes import Coordinates, coordinates
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.robot.robot import Robot


def test_coordinates_and_configurations_are_inverse(planned: Coordinates) -> None:
    x = random_x(planned, 20)
    again = np.array([planned.x(q) for q in planned.configurations(x)])
    np.testing.assert_allclose(again, x, atol=1e-12)


def test_axes_that_are_not_planned_keep_their_reference(robot: Robot) -> None:
    q = robot.configuration(position=[1.0, 2.0, 3.0], rpy=[0.0, 0.1, 0.2])
    arm = coordinates(robot, reference=q, axes=robot.joint_names)
    np.testing.assert_allclose(arm.configurations(arm.x(q)[None])[0], q, atol=1e-12)
    assert arm.names == robot.joint_names
    with pytest.raises(NameNotFound, match="joint1"):
        coordinates(robot, axes=["joint01"])


def test_columns_are_looked_for_once(planned: Coordinates) -> None:
    assert planned.columns is planned.columns
    assert planned.fold is planned.fold


def test_gradients_of_coal_distances_match_differences(scene: CollisionScene) -> None:
    distances = CoalDistances(scene)
    x = random_x(scene.coordinates, 10)
    near = distances.near(x, np.full(scene.n_pairs, 0.3))
    assert near.sample.size > 50
    for sample in range(10):
        slopes = differences(lambda z: distances.distances(z[None])[0], x[sample], 1e-4)
        mine = near.sample == sample
        found = near.gradient[mine]
        np.testing.assert_allclose(found, slopes.T[near.pair[mine]], atol=2e-4)


def test_remembered_bounds_do_not_change_what_is_near(scene: CollisionScene) -> None:
    warm = CoalDistances(scene)
    x = random_x(scene.coordinates, 30)
    thresholds = np.full(scene.n_pairs, 0.1)
    for size in (0.0, 0.01, 0.1, 0.01):
        x = x + size
        again = warm.near(x, thresholds)
        fresh = CoalDistances(scene).near(x, thresholds)
        np.testing.assert_array_equal(again.pair, fresh.pair)
        np.testing.assert_array_equal(again.sample, fresh.sample)
        np.testing.assert_allclose(again.gradient, fresh.gradient, atol=1e-4)


def test_no_distance_changes_faster_than_its_reach(scene: CollisionScene) -> None:
    near = CoalDistances(scene).near(
        random_x(scene.coordinates, 50, 0.5), np.full(scene.n_pairs, 10.0)
    )
    assert (np.abs(near.gradient) <= scene.reach[near.pair] + 1e-9).all()


def test_closed_forms_equal_coal(capsule_scene: CollisionScene) -> None:
    x = random_x(capsule_scene.coordinates, 100)
    thresholds = np.full(capsule_scene.n_pairs, 0.2)
    closed = ClosedFormDistances(capsule_scene)
    exact = CoalDistances(capsule_scene)
    np.testing.assert_allclose(closed.distances(x), exact.distances(x), atol=1e-9)
    a = closed.near(x, thresholds)
    b = exact.near(x, thresholds)
    np.testing.assert_array_equal(a.pair, b.pair)
    np.testing.assert_allclose(a.gradient, b.gradient, atol=1e-9)
    np.testing.assert_allclose(a.centre, b.centre, atol=1e-12)


def test_a_robot_covered_by_capsules_is_nowhere_smaller(robot: Robot, planned: Coordinates) -> None:
    x = random_x(planned, 50)
    exact = collision_scene(planned, [SPHERE, PIPE], self_collision=False)
    covered = collision_scene(
        coordinates(capsule_robot(robot)), [SPHERE, PIPE], self_collision=False
    )
    assert (
        CoalDistances(covered).distances(x).min(axis=1)
        <= CoalDistances(exact).distances(x).min(axis=1) + 1e-6
    ).all()


def test_shapes_without_closed_form_are_refused(scene: CollisionScene) -> None:
    with pytest.raises(InvalidInput, match="Box has no closed form"):
        ClosedFormDistances(scene)
