"""A robot whose files are as they were is read once: the same robot, with the same warnings, and
anew where one has changed.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path

import pytest

import uvms_ocp as uo
from uvms_ocp.record.untrusted import record_files_read
from uvms_ocp.robot import loading
from uvms_ocp.robot.robot import Robot

URDF = """<robot name="box"><link name="base_link"><inertial><mass value="{mass}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="hull.stl"/></geometry></visual>
<collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>"""
STL = """solid hull
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex {size} 0 0
vertex 0 {size} 0
endloop
endfacet
endsolid
"""


def _written(
    folder: Path, *, mass: float = 10.0, size: float | None = 1.0, drag: float = 5.0
) -> None:
    """A robot of one link with a picture; size [m]: of the picture, which is missing without
    one.
    """
    (folder / "robot.urdf").write_text(URDF.format(mass=mass))
    (folder / "hydrodynamics.yaml").write_text(
        f"tool: base_link\nlinks: {{base_link: {{coefficients: {{linear_drag: [{drag}, 5, 5, 1, 1,"
        " 1]}}}\n"
    )
    if size is not None:
        (folder / "hull.stl").write_text(STL.format(size=size))


def _loaded(folder: Path) -> Robot:
    return uo.load_robot(urdf=folder / "robot.urdf", hydrodynamics=folder / "hydrodynamics.yaml")


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """One entry for each time that a URDF is read."""
    readings = list[int]()
    read = loading.models_and_notes
    monkeypatch.setattr(
        loading,
        "models_and_notes",
        lambda *files, **options: readings.append(1) or read(*files, **options),
    )
    return readings


def test_unchanged_files_are_read_once_with_the_same_warnings(
    tmp_path: Path, reads: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    _written(tmp_path)
    warnings = []
    robots = []
    for _ in range(2):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            robots.append(_loaded(tmp_path))
        warnings.append(caplog.messages.copy())
    assert robots[0] is robots[1]
    assert warnings[0] == warnings[1]
    assert len(reads) == 1


@pytest.mark.parametrize(
    "change", [{"mass": 11.0}, {"size": 2.0}, {"drag": 6.0}], ids=["URDF", "mesh", "description"]
)
def test_a_changed_file_is_read_anew(
    tmp_path: Path, change: dict[str, float], reads: list[int]
) -> None:
    _written(tmp_path)
    before = _loaded(tmp_path)
    _written(tmp_path, **change)
    assert _loaded(tmp_path) is not before
    assert len(reads) == 2


def test_another_way_of_loading_is_another_robot(tmp_path: Path) -> None:
    _written(tmp_path)
    urdf = tmp_path / "robot.urdf"
    yaml = tmp_path / "hydrodynamics.yaml"
    robots = {
        _loaded(tmp_path),
        uo.load_robot(urdf=urdf, hydrodynamics=yaml, base="fixed"),
        uo.load_robot(urdf=urdf),
    }
    assert len(robots) == 3


def test_a_mesh_that_was_missing_is_seen_once_it_is_there(tmp_path: Path) -> None:
    _written(tmp_path, size=None)
    before = _loaded(tmp_path)
    _written(tmp_path)
    assert len(_loaded(tmp_path).visual_model.geometryObjects) > len(
        before.visual_model.geometryObjects
    )


def test_a_file_of_the_same_size_that_was_given_its_old_time_is_read_anew(tmp_path: Path) -> None:
    _written(tmp_path)
    urdf = tmp_path / "robot.urdf"
    before = _loaded(tmp_path)
    stamp = urdf.stat()
    urdf.write_text(URDF.format(mass=11.0))
    os.utime(
        urdf, ns=(stamp.st_atime_ns, stamp.st_mtime_ns)
    )  # as `cp -p` and `rsync -t --inplace` do
    assert urdf.stat().st_size == stamp.st_size
    assert _loaded(tmp_path).model.inertias[1].mass == before.model.inertias[1].mass + 1.0


def _heavier(robot: Robot) -> None:
    robot.model.inertias[1].mass += 5.0


def _moved(robot: Robot) -> None:
    shape = robot.visual_model.geometryObjects[0]
    shape.placement.translation = shape.placement.translation + 1.0


@pytest.mark.parametrize("change", [_heavier, _moved])
def test_a_robot_that_its_user_has_changed_is_not_the_next_ones(
    change: Callable[[Robot], None], tmp_path: Path
) -> None:
    _written(tmp_path)
    changed = _loaded(tmp_path)
    model = changed.model.copy()
    shapes = changed.visual_model.clone()
    change(changed)
    next_robot = _loaded(tmp_path)
    assert next_robot is not changed
    assert next_robot.model == model
    assert next_robot.visual_model == shapes


def test_packages_are_those_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _written(tmp_path)
    text = (tmp_path / "robot.urdf").read_text().replace("hull.stl", "package://own/hull.stl")
    (tmp_path / "robot.urdf").write_text(text)
    meshes = []
    for name in ("here", "there"):
        package = tmp_path / name / "packages" / "own"
        package.mkdir(parents=True)
        (package / "hull.stl").write_text(STL.format(size=len(name)))
        monkeypatch.chdir(tmp_path / name)
        robot = uo.load_robot(urdf=tmp_path / "robot.urdf", package_dirs=["packages"])
        meshes.append((robot, robot.visual_model.geometryObjects[0].meshPath))
    assert [Path(mesh).parents[2].name for _, mesh in meshes] == ["here", "there"]


def test_results_of_a_robot_that_is_given_again_depend_on_its_files(tmp_path: Path) -> None:
    _written(tmp_path)
    with record_files_read() as first:
        robot = uo.load_robot(tmp_path)
    with record_files_read() as second:
        assert uo.load_robot(tmp_path) is robot
    assert (
        {path.name for path in first}
        == {path.name for path in second}
        == {"robot.urdf", "hydrodynamics.yaml", "hull.stl"}
    )
