"""From the files of a robot, odd or shipped, to a mission that is accepted and completed, without a
line edited.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from odd_robots import ODD
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.loading import list_robots
from uvms_ocp.scenario.cases import reach


def told(*words: str) -> str:
    result = CliRunner().invoke(app, list(words))
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ODD)
def test_the_mission_of_the_template_is_accepted(kind: str, tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    mission = tmp_path / "m.py"
    robot.mkdir()
    ODD[kind][0].write(robot)
    assert "usable" in told("check-robot", str(robot))
    told("new-mission", str(mission), "--robot", str(robot))
    assert "accepted" in told("check", str(mission))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ODD)
def test_the_mission_of_the_template_is_completed(kind: str, tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    mission = tmp_path / "m.py"
    robot.mkdir()
    ODD[kind][0].write(robot)
    told("new-mission", str(mission), "--robot", str(robot))
    assert "complete" in told("run", str(mission), "--out", str(tmp_path / "run"))
    assert (tmp_path / "run" / "report.json").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "solver"), [*((name, "active_set") for name in list_robots()), ("planar5", "icat")]
)
def test_the_mission_of_the_template_is_completed_by_every_shipped_robot(
    name: str, solver: str, tmp_path: Path
) -> None:
    told("new-mission", str(tmp_path / "m.py"), "--robot", name)
    words = (
        "--plant",
        "kinematic",
        "--solver",
        solver,
        "--out",
        str(tmp_path / "run"),
        "--figures",
        "none",
    )
    assert "complete" in told("run", str(tmp_path / "m.py"), *words)


def test_a_scenario_of_vehicles_says_what_a_robot_without_one_is_given() -> None:
    with pytest.raises(
        InvalidInput,
        match="planar5: a fixed base; give a vehicle, or run what `uvms-ocp new-mission` writes",
    ):
        reach(robot="planar5")
