"""Closed meshes are solids: their distances are those of the shape that they bound, wherever it is."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.shapes.closed_mesh import closed_solid
from uvms_ocp.robot.shapes.obstacles import mesh_shape
from uvms_ocp.robot.shapes.shape_pairs import self_pairs
from uvms_ocp.robot.shapes.signed_distance import Body, PairContact, signed_contact

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
FACES = np.array(
    [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
        (1, 5, 7),
        (1, 7, 3),
    ]
)
SOLIDS = {
    "sphere": lambda: coal.Sphere(0.13),
    "capsule": lambda: coal.Capsule(0.08, 0.2),
    "cylinder": lambda: coal.Cylinder(0.1, 0.3),
    "cone": lambda: coal.Cone(0.1, 0.3),
    "box": lambda: coal.Box(0.2, 0.3, 0.16),
    "ellipsoid": lambda: coal.Ellipsoid(0.1, 0.2, 0.15),
    "mesh": lambda: box_mesh(np.array([0.1, 0.15, 0.08])),
}


def box_mesh(half: np.ndarray) -> coal.BVHModelOBBRSS:
    return mesh_shape(CORNERS * half, FACES)


def contact(
    first: coal.CollisionGeometry, second: coal.CollisionGeometry, X: pin.SE3
) -> PairContact:
    """Of the first at the origin and the second at X."""
    result = coal.DistanceResult()
    places = [coal.Transform3s(), coal.Transform3s(X.rotation, X.translation)]
    coal.distance(first, places[0], second, places[1], coal.DistanceRequest(), result)
    return signed_contact((Body(first), Body(second)), (pin.SE3.Identity(), X), result)


def by_box(half: np.ndarray, second: coal.CollisionGeometry, X: pin.SE3) -> float:
    """Distance from a box by its six planes: exact where the other shape is inside or crosses one of
    them.
    """
    body = Body(second)
    directions = np.vstack([np.eye(3), -np.eye(3)])
    return max(
        float(n @ X.act(body.lowest(X.rotation.T @ n))) - float(np.abs(n) @ half)
        for n in directions
    )


@pytest.mark.parametrize("kind", SOLIDS)
def test_what_is_inside_a_closed_mesh_is_as_deep_as_in_the_box(kind: str) -> None:
    rng = np.random.default_rng(5)
    half = np.array([1.0, 0.8, 1.3])
    mesh = box_mesh(half)
    for _ in range(20):
        place = pin.SE3(
            pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3)), rng.uniform(-0.6, 0.6, 3) * half
        )
        shape = SOLIDS[kind]()
        mesh_contact = contact(mesh, shape, place)
        nearest_face = by_box(half, shape, place)
        # The way out through the nearest place is a way out, and seldom longer than the least.
        assert mesh_contact.distance <= nearest_face + 1e-6
        assert mesh_contact.distance == pytest.approx(nearest_face, abs=0.25)
        moved = pin.SE3(
            place.rotation, place.translation - (mesh_contact.distance - 1e-4) * mesh_contact.normal
        )
        assert contact(mesh, shape, moved).distance == pytest.approx(1e-4, abs=1e-5)
        other_way = contact(shape, mesh, place.inverse())
        assert other_way.distance == pytest.approx(mesh_contact.distance, abs=1e-6)


@pytest.mark.parametrize("kind", SOLIDS)
def test_crossing_and_apart_are_those_of_the_box(kind: str) -> None:
    half = np.array([1.0, 0.8, 1.3])
    mesh = box_mesh(half)
    box = coal.Box(*(2 * half))
    for x in (0.9, 0.96, 1.04, 1.3, 2.0):
        place = pin.SE3(np.eye(3), np.array([x, 0.1, -0.2]))
        shape = SOLIDS[kind]()
        second_shape = coal.Box(0.2, 0.3, 0.16) if kind == "mesh" else shape
        result = coal.DistanceResult()
        places = [coal.Transform3s(), coal.Transform3s(place.rotation, place.translation)]
        coal.distance(box, places[0], second_shape, places[1], coal.DistanceRequest(), result)
        assert contact(mesh, shape, place).distance == pytest.approx(result.min_distance, abs=1e-5)


def test_meshes_contain_one_another_whichever_comes_first() -> None:
    small = box_mesh(np.full(3, 0.1))
    large = box_mesh(np.ones(3))
    place = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
    assert contact(large, small, place).distance == pytest.approx(-0.8)
    assert contact(small, large, place.inverse()).distance == pytest.approx(-0.8)


def test_an_open_patch_is_no_solid_and_a_turned_box_is_one() -> None:
    half = np.ones(3)
    assert closed_solid(CORNERS, FACES) is not None
    assert closed_solid(CORNERS, FACES[:, ::-1]) is not None  # inside out
    assert closed_solid(CORNERS, FACES[:-1]) is None
    separate = CORNERS[FACES].reshape(-1, 3)  # as STL files have it
    assert closed_solid(separate, np.arange(len(separate)).reshape(-1, 3)) is not None
    patch = mesh_shape(CORNERS * half, FACES[:2])
    below = contact(patch, coal.Sphere(0.1), pin.SE3(np.eye(3), np.array([-2.0, 0.0, 0.0])))
    assert below.distance == pytest.approx(0.9)


def test_the_normal_of_two_meshes_is_the_slope_of_their_distance() -> None:
    rng = np.random.default_rng(8)
    first_mesh = box_mesh(np.array([0.3, 0.2, 0.4]))
    second_mesh = box_mesh(np.array([0.1, 0.3, 0.2]))
    for _ in range(10):
        direction = rng.normal(size=3)
        place = pin.SE3(
            pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3)),
            1.2 * direction / np.linalg.norm(direction),
        )
        mesh_contact = contact(first_mesh, second_mesh, place)
        assert np.linalg.norm(mesh_contact.normal) == pytest.approx(1.0)
        for axis in np.eye(3):
            moved = [
                contact(
                    first_mesh, second_mesh, pin.SE3(place.rotation, place.translation + h * axis)
                ).distance
                for h in (1e-5, -1e-5)
            ]
            slope = (moved[0] - moved[1]) / 2e-5
            assert slope == pytest.approx(mesh_contact.normal @ axis, abs=1e-3)


@pytest.mark.sampled
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("kind", ["sphere", "capsule", "cone", "box"])
def test_depth_in_a_closed_mesh_changes_as_its_points_and_normal_say(kind: str, order: int) -> None:
    """A normal across an edge of each turns with both, which is not told."""
    rng = np.random.default_rng(3)
    mesh = box_mesh(np.array([0.2, 0.15, 0.1]))
    shape = {"sphere": coal.Sphere(0.15), "capsule": coal.Capsule(0.1, 0.4)}.get(kind)
    if shape is None:
        shape = coal.Cone(0.2, 0.4) if kind == "cone" else coal.Box(0.4, 0.3, 0.2)

    def measured(place: pin.SE3) -> PairContact:
        if order == 1:
            return contact(mesh, shape, place)
        return contact(shape, mesh, place)

    n_overlaps = 0
    n_compared = 0
    h = 1e-4
    for _ in range(300):
        direction = rng.normal(size=3)
        position = rng.uniform(0.02, 0.35) * direction / np.linalg.norm(direction)
        place = pin.SE3(pin.exp3(rng.normal(size=3)), position)
        overlap = measured(place)
        if overlap.distance > -h or not _is_across_face(overlap, place, order, kind):
            continue
        n_overlaps += 1
        if n_overlaps > 12:
            break
        assert_opposite(overlap)
        for axis in np.eye(6):
            moved = [measured(pin.exp6(step * axis) * place).distance for step in (h, -h)]
            twist = axis[:3] + np.cross(axis[3:], overlap.second)  # at the point, of the second
            slope = (moved[0] - moved[1]) / (2 * h)
            is_kink = abs(sum(moved) - 2 * overlap.distance) > 1e-2 * h
            if not is_kink:
                n_compared += 1
                assert slope == pytest.approx(overlap.normal @ twist, abs=2e-2)
    assert n_overlaps > 12
    assert n_compared > 0.8 * 6 * 12


def _is_across_face(overlap: PairContact, place: pin.SE3, order: int, kind: str) -> bool:
    """Check whether the normal is that of a face of the mesh, or of the box beside it."""
    first_normal = overlap.normal
    second_normal = place.rotation.T @ overlap.normal
    normals = [first_normal, second_normal]
    if kind != "box":
        normals = [first_normal if order == 1 else second_normal]
    return any(np.abs(normal).max() > 1.0 - 1e-6 for normal in normals)


def assert_opposite(overlap: PairContact) -> None:
    way = overlap.second - overlap.first
    np.testing.assert_allclose(way, overlap.distance * overlap.normal, atol=1e-5)


@pytest.mark.parametrize(("radius", "are_apart"), [(0.1, False), (0.01, True)])
def test_a_link_that_is_stowed_inside_a_closed_mesh_is_no_pair_of_it(
    radius: float, are_apart: bool, tmp_path: Path
) -> None:
    """The hull is as large as the radius tells: around the last link, or far from it."""
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    faces = "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES)
    (tmp_path / "hull.obj").write_text(corners + faces, encoding="utf-8")
    scale = 10.0 * radius
    inertial = (
        "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/>"
        "</inertial>"
    )
    hull = f"<geometry><mesh filename='hull.obj' scale='{scale} {scale} {scale}'/></geometry>"
    ball = "<collision><geometry><sphere radius='0.05'/></geometry></collision>"
    links = f"<link name='base_link'>{inertial}<collision>{hull}</collision></link>"
    links += f"<link name='a'>{inertial}</link><link name='b'>{inertial}{ball}</link>"
    joints = ""
    for parent, child in (("base_link", "a"), ("a", "b")):
        joints += (
            f"<joint name='to_{child}' type='revolute'><parent link='{parent}'/>"
            f"<child link='{child}'/><origin xyz='0.2 0 0'/><axis xyz='0 0 1'/>"
            "<limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
        )
    (tmp_path / "robot.urdf").write_text(f"<robot name='r'>{links}{joints}</robot>", "utf-8")
    assert bool(self_pairs(load_robot(urdf=tmp_path / "robot.urdf"))) == are_apart
