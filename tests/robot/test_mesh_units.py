"""A mesh has the size that its file states, in clearance and picture alike."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.preflight.robot_check import check_robot

SIZE = np.array([0.4, 0.2, 0.1])
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
CORNERS = SIZE / 2 * SIGNS + [0.05, 0.0, 0.02]
FACES = "0 1 3 0 3 2 4 6 7 4 7 5 0 4 5 0 5 1 2 3 7 2 7 6 0 2 6 0 6 4 1 5 7 1 7 3"


def collada(corners: np.ndarray, unit: str, up_axis: str = "Z_UP") -> str:
    numbers = " ".join(map(repr, corners.ravel().tolist()))
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    accessor = f'<accessor source="#a" count="8" stride="3">{params}</accessor>'
    source = (
        f'<source id="p"><float_array id="a" count="24">{numbers}</float_array>'
        f"<technique_common>{accessor}</technique_common></source>"
    )
    mesh = (
        f'<mesh>{source}<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        '<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/>'
        f"<p>{FACES}</p></triangles></mesh>"
    )
    scene = (
        '<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/>'
        "</node></visual_scene></library_visual_scenes>"
        '<scene><instance_visual_scene url="#s"/></scene>'
    )
    return (
        '<?xml version="1.0"?>'
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset>{unit}<up_axis>{up_axis}</up_axis></asset>"
        f'<library_geometries><geometry id="g">{mesh}</geometry></library_geometries>'
        f"{scene}</COLLADA>"
    )


def robot_of_mesh(folder: Path, text: str, scale: str = "1 1 1", moment: float = 0.04) -> Robot:
    (folder / "m.dae").write_text(text, encoding="utf-8")
    geometry = f'<geometry><mesh filename="m.dae" scale="{scale}"/></geometry>'
    inertia = f'ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"'
    (folder / "robot.urdf").write_text(
        '<robot name="r"><link name="base_link"><inertial><mass value="9"/>'
        f"<inertia {inertia}/></inertial><visual>{geometry}</visual>"
        f"<collision>{geometry}</collision></link></robot>",
        encoding="utf-8",
    )
    return load_robot(urdf=folder / "robot.urdf")


def extent(shapes: pin.GeometryModel) -> np.ndarray:
    shape = shapes.geometryObjects[0]
    corners = shape.geometry.vertices() @ shape.placement.rotation.T + shape.placement.translation
    return np.array([corners.min(axis=0), corners.max(axis=0)])


@pytest.mark.parametrize(
    ("metres", "scale"), [(None, 1.0), (1.0, 1.0), (0.01, 1.0), (0.0254, 1.0), (0.001, 2.0)]
)
def test_a_box_is_as_large_in_every_unit(
    metres: float | None, scale: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    unit = "" if metres is None else f'<unit name="u" meter="{metres}"/>'
    text = collada(CORNERS / (metres or 1.0) / scale, unit)
    with caplog.at_level(logging.WARNING):
        robot = robot_of_mesh(tmp_path, text, f"{scale} {scale} {scale}")
    expected = [CORNERS.min(axis=0), CORNERS.max(axis=0)]
    for shapes in (robot.collision_model, robot.visual_model):
        np.testing.assert_allclose(extent(shapes), expected, atol=1e-6)
    is_said = "meshes that state a unit are read in it: 'm.dae'" in caplog.text
    assert is_said == (metres not in (None, 1.0))


def test_axes_are_left_as_they_are_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    robot = robot_of_mesh(tmp_path, collada(CORNERS, "", "Y_UP"))
    np.testing.assert_allclose(
        extent(robot.collision_model), [CORNERS.min(axis=0), CORNERS.max(axis=0)], atol=1e-6
    )
    assert "not turned, as in RViz: 'm.dae' (Y_UP)" in caplog.text


@pytest.mark.parametrize(("factor", "is_doubted"), [(1.0, False), (100.0, True), (0.01, True)])
def test_a_mesh_of_another_size_than_its_inertia_is_doubted(
    factor: float, is_doubted: bool, tmp_path: Path
) -> None:
    robot = robot_of_mesh(tmp_path, collada(factor * CORNERS, ""))
    findings = [finding.text for finding in check_robot(robot).findings]
    assert any("mesh 'm.dae'" in text for text in findings) == is_doubted


@pytest.mark.parametrize(("factor", "is_doubted"), [(1.0, False), (1.0 / 0.3048, True)])
def test_a_hull_in_feet_is_doubted_by_the_water_that_it_holds(
    factor: float, is_doubted: bool, tmp_path: Path
) -> None:
    # 9 kg displace what the box holds; a coarse moment fits 0.92 m, between both.
    robot = robot_of_mesh(tmp_path, collada(factor * CORNERS, ""), moment=0.3)
    findings = [finding.text for finding in check_robot(robot).findings]
    assert any("one in feet holds 35 times as much" in text for text in findings) == is_doubted


@pytest.mark.parametrize("stated", ["Y_UP", "Z_UP"])
@pytest.mark.parametrize("lies_turned", [True, False])
def test_axes_that_fit_the_inertia_when_turned_alone_are_doubted(
    stated: str, lies_turned: bool, tmp_path: Path
) -> None:
    # A body of 1.2 x 0.8 x 0.2 m, flat, by its inertia.
    sides = np.array([1.2, 0.8, 0.2])
    as_saved = sides[[0, 2, 1]] if lies_turned else sides
    corners = CORNERS / np.ptp(CORNERS, axis=0) * as_saved
    (tmp_path / "m.dae").write_text(collada(corners, "", stated), encoding="utf-8")
    xx, yy, zz = 9.0 / 12.0 * (np.sum(sides**2) - sides**2)
    (tmp_path / "robot.urdf").write_text(
        '<robot name="r"><link name="base_link"><inertial><mass value="9"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<visual><geometry><mesh filename="m.dae"/></geometry></visual></link></robot>',
        encoding="utf-8",
    )
    texts = [finding.text for finding in check_robot(load_robot(tmp_path / "robot.urdf")).findings]
    is_doubted = any("fits its body only when turned so" in text for text in texts)
    assert is_doubted == (lies_turned and stated == "Y_UP")


@pytest.mark.parametrize("n_faces", [12, 11])
def test_a_mesh_with_a_hole_is_told(n_faces: int, tmp_path: Path) -> None:
    text = collada(CORNERS, "").replace('count="12"', f'count="{n_faces}"')
    indices = FACES.split()
    text = text.replace(FACES, " ".join(indices[: 3 * n_faces]))
    robot = robot_of_mesh(tmp_path, text)
    texts = [finding.text for finding in check_robot(robot).findings]
    assert any("mesh 'm.dae': not closed" in text for text in texts) == (n_faces == 11)
