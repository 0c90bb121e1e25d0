"""Water that is proposed does not depend on how a shape lies in its link, nor on how a body is cut
into links.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.proposal import propose

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
    displaced = 1025.0 * np.prod(SIZE)
    np.testing.assert_allclose(np.diag(hull.added_mass)[:3], displaced, rtol=1e-3)
    R = pin.rpy.rpyToMatrix(np.array(rpy))
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
