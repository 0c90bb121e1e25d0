"""Distances of robots in machine code and by coal: the same, and each where it can."""

from __future__ import annotations

from functools import partial

import coal
import numpy as np
import pinocchio as pin
import pytest
from compiler import needs_compiler

import uvms_ocp as uo
from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes import pair_distances as compiled_pairs
from uvms_ocp.robot.shapes.collision_model import CollisionModel, with_any_distances
from uvms_ocp.robot.shapes.distance_kernels import DistanceMemory, places_function
from uvms_ocp.robot.shapes.obstacles import mesh_shape, obstacle
from uvms_ocp.robot.shapes.pair_distances import CoalPairs
from uvms_ocp.robot.shapes.shape_pairs import self_pairs, shapes_among

ROCKS = (
    obstacle("ball", coal.Sphere(0.4), (1.6, 0.4, -0.3)),
    obstacle("pillar", coal.Capsule(0.2, 2.0), (-1.8, 0.3, 0.4)),
    obstacle("pipe", coal.Cylinder(0.3, 1.0), (0.3, 1.9, 0.0), pin.rpy.rpyToMatrix(0.4, 0.2, 0.0)),
    obstacle(
        "wreck", coal.Box(0.8, 0.5, 0.6), (0.2, -1.9, -0.5), pin.rpy.rpyToMatrix(0.1, 0.5, 0.3)
    ),
)
PYRAMID = mesh_shape(
    np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
)
MESH = obstacle("rubble", PYRAMID, (0.0, 0.0, -2.5))


@pytest.fixture(scope="module", params=["girona_maris7_full", "bluerov2_alpha5", "planar5"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return uo.load_robot(request.param)


def configurations(robot: Robot, n: int = 25) -> list[np.ndarray]:
    rng = np.random.default_rng(9)
    v = rng.uniform(-0.4, 0.4, (n, robot.n_v))
    return [pin.integrate(robot.model, robot.configuration(), row) for row in v]


def oracle(robot: Robot, obstacles: tuple[uo.Obstacle, ...]) -> CoalPairs:
    geometry = shapes_among(robot, obstacles)
    n = robot.collision_model.ngeoms
    pairs = [(o, i) for o in range(n, geometry.ngeoms) for i in range(n)]
    return CoalPairs(robot.model, geometry, pairs + self_pairs(robot))


@needs_compiler
@pytest.mark.parametrize("obstacles", [ROCKS, (*ROCKS, MESH)], ids=["rocks", "with a mesh"])
def test_distances_and_gradients_are_those_of_coal(
    robot: Robot, obstacles: tuple[uo.Obstacle, ...]
) -> None:
    model = CollisionModel(robot, obstacles)
    by_coal = oracle(robot, obstacles)
    alike = 0
    total = 0
    all_pairs = np.arange(model.n_pairs)
    for q in configurations(robot):
        distances = model.distances(q)
        expected = by_coal.values(q, all_pairs)
        apart = np.flatnonzero(expected > 0.0)
        np.testing.assert_allclose(distances.value[apart], expected[apart], rtol=0, atol=1e-6)
        same = (
            np.abs(distances.gradient - by_coal.gradients(q, all_pairs)).max(axis=1)[apart] < 1e-3
        )
        alike = alike + int(same.sum())
        total = total + len(same)
        chosen = all_pairs[::-3]
        np.testing.assert_allclose(
            model.values(q, chosen), distances.value[chosen], rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(
            model.distances(q, chosen).gradient, distances.gradient[chosen], rtol=0, atol=1e-9
        )
    assert alike >= 0.98 * total


def test_shapes_without_a_form_in_c_are_named(robot: Robot) -> None:
    cone = obstacle("cone", coal.Cone(0.2, 0.5), (3.0, 0.0, 0.0))
    model = CollisionModel(robot, [*ROCKS, MESH, cone])
    assert model.without_c_form == ("rubble", "cone")
    assert model.by_coal
    memory = structure_of(
        DistanceMemory,
        with_any_distances(dimensions_of(robot), [CollisionModel(robot, ROCKS)], robot),
        places=places_function(robot.model),
    )()
    with pytest.raises(
        InvalidInput, match="shapes rubble, cone have no form in C; give spheres, capsules"
    ):
        model.write(memory)
    clear = CollisionModel(robot, ROCKS)
    assert clear.without_c_form == ()
    clear.write(memory)


@needs_compiler
def test_without_a_compiler_coal_measures_the_same(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = CollisionModel(robot, ROCKS)
    monkeypatch.setattr(compiled_pairs, "make_memory", partial(make_memory, compiled=False))
    model = CollisionModel(robot, ROCKS)
    assert model.by_coal
    assert model.without_c_form == ()
    for q in configurations(robot, 5):
        expected = compiled.values(q)
        apart = expected > 0.0
        np.testing.assert_allclose(model.values(q)[apart], expected[apart], rtol=0, atol=1e-6)


@needs_compiler  # coal starts from what it found last
def test_what_was_asked_before_does_not_matter(robot: Robot) -> None:
    model = CollisionModel(robot, ROCKS)
    places = configurations(robot, 6)
    first = [model.distances(q) for q in places]
    again = [model.distances(q) for q in reversed(places)][::-1]
    for forwards, backwards in zip(first, again, strict=True):
        np.testing.assert_array_equal(forwards.value, backwards.value)
        np.testing.assert_array_equal(forwards.gradient, backwards.gradient)
