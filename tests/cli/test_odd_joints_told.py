"""From the files of a robot with an odd joint to a mission that is accepted, flown and drawn, without a line edited."""

from __future__ import annotations

from pathlib import Path

import pytest
from odd_robots import ODD
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app


def told(*words: str) -> str:
    result = CliRunner().invoke(app, list(words))
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("kind", ODD)
def test_the_mission_of_the_template_is_accepted(kind: str, tmp_path: Path) -> None:
    robot, mission = tmp_path / "robot", tmp_path / "m.py"
    robot.mkdir()
    ODD[kind][0].write(robot)
    assert "usable" in told("check-robot", str(robot))
    told("new-mission", str(mission), "--robot", str(robot))
    assert "accepted" in told("check", str(mission))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ODD)
def test_the_mission_of_the_template_is_completed(kind: str, tmp_path: Path) -> None:
    robot, mission = tmp_path / "robot", tmp_path / "m.py"
    robot.mkdir()
    ODD[kind][0].write(robot)
    told("new-mission", str(mission), "--robot", str(robot))
    assert "complete" in told("run", str(mission), "--out", str(tmp_path / "run"))
    assert (tmp_path / "run" / "report.json").is_file()
