"""A run or a plan of a robot of one's own is shown without a word about the robot, wherever both
have gone together.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput, RobotDataError, UvmsError
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, single_phase
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.planning.request import PlanRequest, PostureGoal, plan_path
from uvms_ocp.record.meta_values import RobotFilesMeta
from uvms_ocp.record.record import Record
from uvms_ocp.report.planned_motion import motion_record
from uvms_ocp.robot import loading
from uvms_ocp.robot.loading import list_variants, load_robot, robot_called, robot_folder
from uvms_ocp.robot.recorded_robots import recorded_robot, robot_meta
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.scenario.own_code import load_scenario
from uvms_ocp.viz.scene.show import robot_of as shown_robot


def told(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    if isinstance(result.exception, UvmsError):
        return str(result.exception)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a robot, and water of another place."""
    place = tmp_path / "é project"
    (place / "water").mkdir(parents=True)
    monkeypatch.chdir(place)
    told("new-robot", "mine")
    told("new-mission", "m.py", "--robot", "mine")
    shutil.copy(place / "mine" / "hydrodynamics.yaml", place / "water" / "other.yaml")
    return place


def ran(robot: Robot) -> Record:
    """A record of a few rows."""
    options = {"plant": "kinematic", "duration": 0.04, "dt": 0.02, "robot": robot}
    return load_scenario("m.py", options, {}).run()


def planned(robot: Robot) -> Record:
    goal = PostureGoal(position=(0.5, 0.0, -5.0))
    plan_result = plan_path(
        PlanRequest(robot=robot, start=robot.configuration(position=(0.0, 0.0, -5.0)), goal=goal)
    )
    assert plan_result.plan is not None
    return motion_record(plan_result, plan_result.plan)


READINGS: dict[str, dict[str, Any]] = {
    "a folder": {},
    "water of another place": {"hydrodynamics": "water/other.yaml"},
    "a locked joint": {"loading": {"lock": {"wrist": 0.3}}},
    "no meshes, another tool": {
        "loading": {"meshes": False, "tool": "base_link", "package_dirs": ["water"]}
    },
}


@pytest.mark.parametrize("kind", READINGS)
def test_a_record_finds_the_robot_that_it_was_made_with(
    kind: str, project: Path, tmp_path: Path
) -> None:
    robot = robot_called("mine", **READINGS[kind])
    folder = project / "runs" / "X"
    folder.mkdir(parents=True)
    planned(robot).save(folder / "record.npz")
    moved_run = project.rename(tmp_path / "elsewhere") / "runs" / "X"
    files = Record.load(moved_run / "record.npz").meta.robot_files
    assert files is not None
    assert str(tmp_path) not in files.model_dump_json()
    loaded_robot = recorded_robot(robot.name, files, moved_run)
    assert loaded_robot is not None
    assert loaded_robot.description == robot.description
    assert loaded_robot.model == robot.model


@pytest.mark.sampled
@pytest.mark.parametrize("motion", [ran, planned])
def test_a_motion_of_ones_own_robot_is_shown_until_its_folder_moves(
    motion: Any, project: Path
) -> None:
    motion(robot_called("mine")).save(project / "record.npz")
    assert "scene.html" in told("show", "record.npz", "--out", "scene.html")
    (project / "mine").rename(project / "other")
    output = told("show", "record.npz", "--out", "second.html")
    assert "which is no longer at mine/robot.urdf; give it: --robot DIR" in output
    assert not (project / "second.html").exists()
    assert "third.html" in told("show", "record.npz", "--robot", "other", "--out", "third.html")


ARM = "bluerov2_alpha5"
LIBRARY: dict[str, dict[str, Any]] = {
    "a locked joint": {"lock": {"joint1": 0.2}},
    "water of one's own": {"hydrodynamics": "own.yaml"},
    "a description": {"hydrodynamics": load_robot(ARM).description},
    "another data set": {"variant": list_variants(ARM)[0]},
}


@pytest.mark.parametrize("kind", LIBRARY)
def test_a_robot_of_the_library_that_is_read_in_another_way_is_known_to_any_machine(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other_machine = shutil.copytree(robot_folder(ARM), tmp_path / "another machine" / ARM)
    shutil.copy(other_machine / "hydrodynamics.yaml", tmp_path / "own.yaml")
    monkeypatch.chdir(tmp_path)
    robot = load_robot(ARM, **LIBRARY[kind])
    files = robot_meta(robot)["robot_files"]
    assert files.urdf is None
    assert load_robot(ARM).urdf is None
    monkeypatch.setattr(loading, "robots_folder", lambda: other_machine.parent)
    loaded_robot = recorded_robot(ARM, files, tmp_path)
    assert loaded_robot is not None
    assert loaded_robot.description == robot.description
    assert loaded_robot.model == robot.model
    assert loaded_robot.urdf == (other_machine / "robot.urdf").resolve()


def test_a_robot_of_the_library_that_is_read_in_another_way_is_shown_as_it_was_read(
    project: Path,
) -> None:
    planned(load_robot(ARM, lock={"joint1": 0.2})).save(project / "record.npz")
    assert "scene.html" in told("show", "record.npz", "--out", "scene.html")


@pytest.mark.parametrize("name", ["mine", ARM])
def test_frames_that_were_moved_in_python_are_where_they_were(name: str, project: Path) -> None:
    robot = robot_called(name)
    nudge = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.1), np.array([0.05, 0.02, -0.03]))
    for frame in ("tool", "altimeter", "tool"):
        robot = robot.with_frame_pose(
            frame, nudge * robot.model.frames[robot.frame_id(frame)].placement
        )
    planned(robot).save(project / "record.npz")
    loaded_robot = shown_robot(Record.load(project / "record.npz"), project)
    assert loaded_robot.description == robot.description
    for loaded_frame, other in zip(loaded_robot.model.frames, robot.model.frames, strict=True):
        assert loaded_frame.placement.isApprox(other.placement, 1e-12), loaded_frame.name


def test_a_frame_of_a_file_that_cannot_be_moved_is_refused_by_name(project: Path) -> None:
    yaml = project / "mine" / "hydrodynamics.yaml"
    for frame, wrong in (("base_link", "is a moving link"), ("sonar", "unknown frame")):
        (project / "mine" / "moved.yaml").write_text(
            yaml.read_text(encoding="utf-8")
            + f"\nloading: {{frames: [{{frame: {frame}, position: [0, 0, 1]}}]}}\n",
            encoding="utf-8",
        )
        with pytest.raises(
            RobotDataError,
            match=f"loading.frames: .*{frame}.*{wrong}|loading.frames: {wrong}.*{frame}",
        ):
            robot_called("mine", "mine/moved.yaml")


def renamed(name: str, folder: Path) -> Path:
    """A folder with planar5 under that name."""
    shutil.copytree(robot_folder("planar5"), folder)
    urdf = folder / "robot.urdf"
    urdf.write_text(
        urdf.read_text(encoding="utf-8").replace('name="planar5"', f'name="{name}"'),
        encoding="utf-8",
    )
    return folder


def test_a_record_is_drawn_with_the_robot_of_its_own_project(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in "ab":
        renamed("own", tmp_path / place / "arm")
    files = RobotFilesMeta(urdf="arm/robot.urdf", description="{}")
    monkeypatch.chdir(tmp_path / "b")
    loaded_robot = recorded_robot("own", files, Path("../a/runs/X"))
    assert loaded_robot is not None
    assert loaded_robot.urdf == (tmp_path / "a" / "arm" / "robot.urdf").resolve()
    with pytest.raises(
        InvalidInput, match=r"a record of mine, but .* is own; give it: --robot DIR"
    ):
        recorded_robot("mine", files, tmp_path)


def test_a_record_whose_robot_is_not_read_says_so_in_one_line(tmp_path: Path) -> None:
    renamed("own", tmp_path / "arm")
    for broken in ('{"of_later": 1}', "{"):
        with pytest.raises(
            InvalidInput, match=r"description of own is not read .* give it: --robot DIR"
        ) as caught:
            recorded_robot(
                "own", RobotFilesMeta(urdf="arm/robot.urdf", description=broken), tmp_path
            )
        assert "\n" not in str(caught.value)
        assert (
            recorded_robot(
                "own", RobotFilesMeta(urdf="gone/robot.urdf", description=broken), tmp_path
            )
            is None
        )
    assert (
        recorded_robot("own", RobotFilesMeta(urdf="a" * 4096, description="{}"), tmp_path) is None
    )
    with pytest.raises(ValidationError, match="at most 4096"):
        RobotFilesMeta(urdf="a" * 4097, description="{}")


def test_packages_are_seen_from_the_urdf_that_a_record_names(tmp_path: Path) -> None:
    real = renamed("own", tmp_path / "a" / "real")
    linked = tmp_path / "linked"
    meshes = tmp_path / "meshes"
    linked.mkdir()
    meshes.mkdir()
    (linked / "robot.urdf").symlink_to(real / "robot.urdf")
    robot = load_robot(urdf=linked / "robot.urdf", package_dirs=[meshes])
    assert robot.urdf is not None
    assert (robot.urdf.parent / robot.description.loading.packages[0]).resolve() == meshes.resolve()
    assert robot.description.loading.packages == ("../meshes",)


def test_no_record_names_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "somebody"
    outside = tmp_path / "elsewhere"
    robot = robot_called(str(renamed("own", home / "robots" / "arm")))
    monkeypatch.setenv("HOME", str(home))
    for working_folder, place in (
        (home / "missions", "../robots/arm/robot.urdf"),
        (outside, "arm/robot.urdf"),
    ):
        working_folder.mkdir()
        monkeypatch.chdir(working_folder)
        assert robot_meta(robot)["robot_files"].urdf == place
    monkeypatch.setenv("HOME", str(robot.urdf.parent))  # type: ignore[union-attr]
    assert robot_meta(robot)["robot_files"].urdf == "robot.urdf"


@pytest.mark.parametrize("way", ["absolute", "relative", "given"])
def test_no_record_names_the_home_folder_by_packages(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "somebody"
    arm = renamed("own", tmp_path / "arm")
    meshes = home / "ws" / "src"
    meshes.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(tmp_path)
    folder = {"absolute": str(meshes), "relative": "../somebody/ws/src", "given": None}[way]
    if folder:
        (arm / "own.yaml").write_text(
            f"base: fixed\nloading: {{packages: ['{folder}']}}\n", encoding="utf-8"
        )
    robot = load_robot(
        urdf=arm / "robot.urdf",
        hydrodynamics=arm / "own.yaml" if folder else None,
        package_dirs=() if folder else [meshes],
    )
    files = robot_meta(robot)["robot_files"].model_dump_json()
    assert "somebody" not in files
    assert "ws/src" in files


def test_a_plan_alone_is_shown_with_its_robot(project: Path) -> None:
    arm = robot_called(str(renamed("own", project / "arm").name))
    start = State(q=arm.configuration(), v=np.zeros(arm.n_v))
    levels = [OcpLevel(name="effort", terms=(Effort(),))]
    problem = single_phase(
        robot=arm, start=start, duration=1.0, n_steps=2, levels=levels, water=False
    )
    Planner(problem).plan().save(project / "plan.npz")
    assert "give the record.npz beside it" in told("show", "plan.npz", "--out", "scene.html")
    assert "scene.html" in told("show", "plan.npz", "--robot", "arm", "--out", "scene.html")


def test_what_is_outside_of_the_working_directory_is_found_from_there_and_from_the_record(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (project / "runs").mkdir()
    monkeypatch.chdir(project / "runs")
    record = planned(robot_called("../mine"))
    record.save(tmp_path / "record.npz")
    record.save(project / "runs" / "record.npz")
    assert "scene.html" in told("show", tmp_path / "record.npz", "--out", "scene.html")
    monkeypatch.chdir(tmp_path)
    assert "scene.html" in told("show", project / "runs" / "record.npz", "--out", "scene.html")
