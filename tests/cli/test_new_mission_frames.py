"""A mission written for a robot names roles, which its links have, whatever their names."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner
from yaml import safe_dump, safe_load

from uvms_ocp.cli.commands import app
from uvms_ocp.report import summarize
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot, robot_folder
from uvms_ocp.robot.static_balance import static_residual, with_trim, without_trim
from uvms_ocp.scenario.own_code import own_code
from uvms_ocp.scenario.preflight.robot_check import check_robot


def test_a_mission_of_a_robot_with_frames_of_other_names_can_be_made(tmp_path: Path) -> None:
    folder = robot_folder("girona_maris7")
    urdf = (folder / "robot.urdf").read_text(encoding="utf-8")
    water = safe_load(
        (folder / "hydrodynamics.yaml").read_text(encoding="utf-8").replace("base_link", "hull")
    )
    for name in ("trim", "thrusters"):
        water[name] = [{"link": "hull"} | entry for entry in water[name]]
    (tmp_path / "robot.urdf").write_text(
        urdf.replace("base_link", "hull").replace('"tool"', '"gripper"')
    )
    (tmp_path / "hydrodynamics.yaml").write_text(safe_dump(water))
    told = CliRunner().invoke(
        app, ["new-mission", str(tmp_path / "m.py"), "--robot", str(tmp_path)]
    )
    assert told.exit_code == 0, told.output
    code = own_code(str(tmp_path / "m.py"))
    assert code is not None
    scenario = code.load()()
    frames = {
        task.frame for task in scenario.mission.hierarchy.tasks if getattr(task, "frame", None)
    }
    assert frames == {"base_link", "tool"}
    kinematics = Kinematics(scenario.robot, scenario.start)
    assert kinematics.pose("base_link") == kinematics.pose("hull")
    assert kinematics.pose("tool") == kinematics.pose("gripper")


@pytest.mark.slow
@pytest.mark.parametrize("current", [(0.0, 0.0, 0.0), (0.0, 0.2, 0.0)])
def test_two_arms_on_six_thrusters_reach_both_targets(
    current: tuple[float, float, float], tmp_path: Path
) -> None:
    """Within 10 mm, on a vehicle whose pitch nobody drives and which both arms, carried ahead,
    pitch by some 0.4 rad.
    """
    folder, six = (robot_folder(name) for name in ("bluerov2_two_alpha5", "bluerov2"))
    water, driven = (
        safe_load((place / "hydrodynamics.yaml").read_text(encoding="utf-8"))
        for place in (folder, six)
    )
    (tmp_path / "robot.urdf").write_text(
        (folder / "robot.urdf").read_text(encoding="utf-8"), encoding="utf-8"
    )
    (tmp_path / "hydrodynamics.yaml").write_text(
        safe_dump(water | {"thrusters": driven["thrusters"]}), encoding="utf-8"
    )
    assert (
        CliRunner()
        .invoke(app, ["new-mission", str(tmp_path / "m.py"), "--robot", str(tmp_path)])
        .exit_code
        == 0
    )
    mission = tmp_path / "m.py"
    mission.write_text(
        mission.read_text(encoding="utf-8").replace("limit=0.02)", "limit=0.01)"), encoding="utf-8"
    )
    code = own_code(str(mission))
    assert code is not None
    report = summarize(code.load()(current=current).run())
    assert report["completed"], report["cause"]
    assert report["swings"] == []
    assert all(tool["position"] < 0.01 for tool in report["tools"].values())
    assert len(report["tools"]) == 2


def test_the_body_that_check_robot_advises_trims_the_robot() -> None:
    robot = without_trim(load_robot("girona_maris7"))
    text = next(
        finding.text for finding in check_robot(robot).findings if finding.subject == "trim"
    )
    bodies = [TrimBody(**body) for body in safe_load(text.partition("; trim: ")[2])]
    force, moment = static_residual(with_trim(robot, bodies), robot.configuration())
    assert abs(force) < 0.5
    assert abs(moment).max() < 1.0
