"""Of a robot whose hull is a shape, coefficients that are the same are told before anything takes long."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from uvms_ocp import load_robot
from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.settings import CalibrationSettings, calibrated_robot, require_no_shape
from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.loading import robot_folder

SETTINGS = {"robot": "mine", "arm": "taken off", "hull": [[-0.4, -0.25, -0.15], [0.4, 0.25, 0.15]], "learn": {"lag": {}}}
SHAPES = {"box": {"size": [0.8, 0.5, 0.3], "drag_coefficient": 0.8}, "sphere": {"radius": 0.3}}


def shaped(folder: Path, link: dict[str, object]) -> Path:
    """A robot in a folder, with another description of its vehicle's link."""
    (folder / "mine").mkdir(exist_ok=True)
    known = robot_folder("bluerov2_alpha5")
    (folder / "mine/robot.urdf").write_text((known / "robot.urdf").read_text())
    content = yaml.safe_load((known / "hydrodynamics.yaml").read_text())
    content["links"]["base_link"] = link
    (folder / "mine/hydrodynamics.yaml").write_text(yaml.safe_dump(content))
    (folder / "my.yaml").write_text(yaml.safe_dump(SETTINGS))
    return folder


@pytest.mark.parametrize("name", SHAPES)
def test_the_coefficients_that_are_told_are_those_of_the_shape(name: str, tmp_path: Path) -> None:
    folder = shaped(tmp_path, {name: SHAPES[name]})
    with pytest.raises(InvalidInput) as stopped:
        require_no_shape(calibrated_robot(CalibrationSettings.model_validate(SETTINGS), folder))
    told = re.search(r"\{coefficients: .*\}\}", str(stopped.value))
    assert told
    before = load_robot(urdf=folder / "mine/robot.urdf", hydrodynamics=folder / "mine/hydrodynamics.yaml")
    shaped(tmp_path, yaml.safe_load(told[0]))
    after = calibrated_robot(CalibrationSettings.model_validate(SETTINGS), folder)
    require_no_shape(after)
    for one, other in zip(*(links_in_water(robot.description) for robot in (before, after.robot)), strict=False):
        for field in ("added_mass", "linear_drag", "quadratic_drag", "volume", "centre_of_buoyancy"):
            np.testing.assert_allclose(getattr(other, field), getattr(one, field), rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("command", ["excite", "identify"])
def test_commands_tell_it_at_once(command: str, tmp_path: Path) -> None:
    folder = shaped(tmp_path, {"box": SHAPES["box"]})
    words = [command, str(folder / "my.yaml"), *["none.csv"] * (command == "identify"), "--out", str(folder / "out")]
    found = CliRunner().invoke(app, words).exception
    assert "base_link: give it coefficients in the link frame in place of its shape; the same are" in str(found)
