"""Water that is proposed does not depend on how a shape lies in its link, nor on how a body is cut
into links.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad

from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.loading import list_robots, load_robot, robot_folder
from uvms_ocp.robot.proposal import propose
from uvms_ocp.robot.proposed_hull import (
    ADDED_MASS_INTERVAL,
    DRAG_INTERVAL,
    ellipsoid_added_mass,
    hull_added_mass,
)
from uvms_ocp.robot.robot import Robot

SIZE = np.array([0.6, 0.4, 0.2])
MOMENTS = 48.0 / 12.0 * np.array([0.4**2 + 0.2**2, 0.6**2 + 0.2**2, 0.6**2 + 0.4**2])
TURNS = [(0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 4), (0.5, 0.3, -0.8), (np.pi / 2, 0.5, 0.0)]
FACES = "1 2 4, 1 4 3, 5 7 8, 5 8 6, 1 5 6, 1 6 2, 3 4 8, 3 8 7, 1 3 7, 1 7 5, 2 6 8, 2 8 4"
SHAPES = {
    "box": "<geometry><box size='0.6 0.4 0.2'/></geometry>",
    "mesh": "<geometry><mesh filename='box.obj' scale='0.001 0.001 0.001'/></geometry>",
    "nothing": "",
}


def inertial(mass: float, moments: np.ndarray, rpy: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    xx, yy, zz = moments
    return (
        f"<inertial><origin rpy='{' '.join(map(str, rpy))}'/><mass value='{mass}'/>"
        f"<inertia ixx='{xx}' iyy='{yy}' izz='{zz}' ixy='0' ixz='0' iyz='0'/></inertial>"
    )


def water_of(folder: Path, text: str) -> dict[str, LinkHydrodynamics]:
    corners = "".join(
        f"v {x} {y} {z}\n" for x, y, z in 500.0 * SIZE * np.array([*product((-1, 1), repeat=3)])
    )
    faces = "".join(f"f {face}\n" for face in FACES.split(", "))
    (folder / "box.obj").write_text(corners + faces, encoding="utf-8")
    (folder / "robot.urdf").write_text(f"<robot name='r'>{text}</robot>", encoding="utf-8")
    robot = propose(folder / "robot.urdf", base="free_flyer").robot
    return {water.frame: water for water in robot.hydrodynamics}


def ellipsoid_masses(sides: np.ndarray) -> np.ndarray:
    """Return the added masses (3,) [kg] of an ellipsoid, its integrals by quadrature."""
    a, b, c = squares = (sides / 2.0) ** 2

    def integrand(x: float, axis: int) -> float:
        return float(1.0 / ((squares[axis] + x) * np.sqrt((a + x) * (b + x) * (c + x))))

    alpha = np.sqrt(a * b * c) * np.array([quad(integrand, 0, np.inf, (k,))[0] for k in range(3)])
    return np.asarray(1025.0 * np.pi / 6.0 * np.prod(sides) * alpha / (2.0 - alpha))


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("rpy", TURNS)
def test_a_box_has_its_own_water_however_it_lies_in_its_link(
    kind: str, rpy: tuple[float, float, float], tmp_path: Path
) -> None:
    shape = SHAPES[kind]
    if shape:
        shape = f"<collision><origin rpy='{' '.join(map(str, rpy))}'/>{shape}</collision>"
    link = f"<link name='hull'>{inertial(48.0, MOMENTS, rpy)}{shape}</link>"
    hull = water_of(tmp_path, link)["hull"]
    # Of the ellipsoid in the box, times what edges add to one that is as heavy as the box.
    filled = 48.0 / (1025.0 * np.pi / 6.0 * np.prod(SIZE))
    expected = filled ** (np.log(0.68 * 12.0 / np.pi) / np.log(6.0 / np.pi)) * ellipsoid_masses(
        SIZE
    )
    added = hull.X_FL.rotation @ np.diag(np.diag(hull.added_mass)[:3]) @ hull.X_FL.rotation.T
    R = pin.rpy.rpyToMatrix(np.array(rpy))
    np.testing.assert_allclose(added, R @ np.diag(expected) @ R.T, atol=2e-3 * expected.max())
    areas = 0.3 * 1025.0 * np.prod(SIZE) / SIZE
    drag = R @ np.diag(areas) @ R.T
    box_drag = np.diag(np.diag(hull.quadratic_drag)[:3])
    proposed_drag = hull.X_FL.rotation @ box_drag @ hull.X_FL.rotation.T
    np.testing.assert_allclose(proposed_drag, drag, atol=1e-2 * areas.max())


@pytest.mark.parametrize("rpy", TURNS)
def test_a_slender_link_is_as_thick_however_it_lies(
    rpy: tuple[float, float, float], tmp_path: Path
) -> None:
    shape = (
        f"<collision><origin rpy='{' '.join(map(str, rpy))}'/>"
        "<geometry><cylinder radius='0.03' length='0.4'/></geometry></collision>"
    )
    joint = (
        "<joint name='j' type='revolute'><parent link='hull'/><child link='arm'/><axis xyz='0 1 0'/>"
        "<limit lower='-1' upper='1' effort='9' velocity='1'/></joint>"
    )
    links = f"<link name='hull'>{inertial(48.0, MOMENTS)}</link>"
    links += f"<link name='arm'>{inertial(1.2, np.full(3, 0.01))}{shape}</link>"
    arm = water_of(tmp_path, links + joint)["arm"]
    displaced = 1025.0 * np.pi * 0.03**2 * 0.4
    expected = displaced * np.array([1.0, 1.0, 0.1])
    np.testing.assert_allclose(np.diag(arm.added_mass)[:3], expected, rtol=1e-3)
    axis = pin.rpy.rpyToMatrix(np.array(rpy))[:, 2]
    assert abs(arm.X_FL.rotation[:, 2] @ axis) == pytest.approx(1.0, abs=1e-6)


def test_links_that_are_fixed_together_share_the_water_of_their_joint(tmp_path: Path) -> None:
    moments = np.array([0.02, 0.02, 0.001])
    arm = inertial(1.5, moments)
    joint = (
        "<joint name='j' type='revolute'><parent link='hull'/><child link='arm'/><axis xyz='0 1 0'/>"
        "<limit lower='-1' upper='1' effort='9' velocity='1'/></joint>"
    )
    hull = f"<link name='hull'>{inertial(48.0, MOMENTS)}</link><link name='arm'>{arm}</link>{joint}"
    tip = (
        f"<link name='tip'>{arm}</link><joint name='f' type='fixed'><parent link='arm'/>"
        "<child link='tip'/><origin xyz='0 0 0.4' rpy='0.3 0 0'/></joint>"
    )
    alone = water_of(tmp_path, hull)["arm"]
    together = water_of(tmp_path, hull + tip)
    for name in ("arm", "tip"):
        np.testing.assert_allclose(
            np.diag(together[name].added_mass), np.diag(alone.added_mass), rtol=1e-3
        )


def test_ellipsoids_have_the_added_mass_of_closed_forms() -> None:
    ball = 1000.0 * np.pi / 6.0 * 0.2**3
    np.testing.assert_allclose(
        ellipsoid_added_mass(np.full(3, 0.2), 1000.0), ball * np.array([0.5] * 3 + [0.0] * 3)
    )
    disc = ellipsoid_added_mass(np.array([0.4, 0.4, 1e-5]), 1000.0)
    np.testing.assert_allclose(disc[2], 8.0 / 3.0 * 1000.0 * 0.2**3, rtol=1e-3)
    np.testing.assert_allclose(disc[3:5], 16.0 / 45.0 * 1000.0 * 0.2**5, rtol=1e-3)
    needle = ellipsoid_added_mass(np.array([20.0, 0.02, 0.02]), 1000.0)
    np.testing.assert_allclose(needle[1:3], 1000.0 * np.pi / 6.0 * 20.0 * 0.02**2, rtol=1e-3)


def test_a_solid_cube_has_the_added_mass_of_tables_and_an_open_frame_less() -> None:
    sides = np.full(3, 0.4)
    displaced = 1000.0 * 0.4**3
    solid = hull_added_mass(sides, displaced, 1000.0)
    np.testing.assert_allclose(solid[:3], 0.68 * displaced)
    np.testing.assert_allclose(hull_added_mass(sides, 3.0 * displaced, 1000.0), solid)
    masses = np.linspace(0.02, 1.0, 50) * displaced
    added = [hull_added_mass(sides, mass, 1000.0)[0] for mass in masses]
    assert (np.diff(added) > 0.0).all()
    assert np.abs(np.diff(added)).max() < 0.05 * displaced  # no jump


def vehicle_numbers(robot: Robot, key: str) -> np.ndarray:
    """Return what is stated of the vehicle (6,), at its origin in its axes."""
    total = np.zeros((6, 6))
    for water in robot.hydrodynamics:
        frame = robot.model.frames[robot.frame_id(water.frame)]
        if frame.parentJoint == 1:
            X = (frame.placement * water.X_FL).inverse().action
            total += X.T @ getattr(water, key) @ X
    return np.diag(total)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "interval"), [("added_mass", ADDED_MASS_INTERVAL), ("quadratic_drag", DRAG_INTERVAL)]
)
def test_published_vehicles_lie_within_the_interval_that_is_stated(
    key: str, interval: tuple[float, float]
) -> None:
    ratios = list[float]()
    for name in list_robots():
        published = load_robot(name)
        if not published.n_vehicle:
            continue
        proposed = propose(robot_folder(name) / "robot.urdf", base="free_flyer").robot
        stated = vehicle_numbers(published, key)
        ratio = stated / vehicle_numbers(proposed, key)
        ratios += ratio[stated > 0.0].tolist()
    inside = [interval[0] <= ratio <= interval[1] for ratio in ratios]
    assert len(ratios) > 30
    assert np.mean(inside) >= 0.9, np.round(ratios, 2)
    assert 0.6 < np.median(ratios) < 1.7


def test_buoyancy_and_linear_drag_grow_with_the_hull(tmp_path: Path) -> None:
    arms = []
    drags = []
    for scale in (1.0, 3.0):
        size = scale * SIZE
        moments = MOMENTS * scale**5
        text = f"<geometry><box size='{size[0]} {size[1]} {size[2]}'/></geometry>"
        link = f"<link name='hull'>{inertial(48.0 * scale**3, moments)}<collision>{text}</collision></link>"
        hull = water_of(tmp_path, link)["hull"]
        arms.append(hull.centre_of_buoyancy[2])
        drags.append(np.diag(hull.linear_drag))
    assert arms[1] == pytest.approx(3.0 * arms[0], rel=1e-3)
    np.testing.assert_allclose(drags[1][:3], 9.0 * drags[0][:3], rtol=1e-2)
    assert (drags[0][3:] > 0.0).all()
