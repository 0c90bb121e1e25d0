"""What settings may say, and what it means: 0 is at once, and a folder is a robot."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from uvms_ocp.identification.settings import CalibrationSettings, calibrated_robot
from uvms_ocp.robot.loading import robot_folder

GIVEN = {"robot": "bluerov2_alpha5", "hull": [[-0.3, -0.2, -0.2], [0.3, 0.2, 0.2]], "learn": {"lag": {}, "delay": {}}}


def settings(**other: object) -> CalibrationSettings:
    return CalibrationSettings.model_validate({**GIVEN, "arm": "taken off", **other})


@pytest.mark.parametrize("name", ["lag", "delay", "dead_zone"])
def test_what_is_given_as_nothing_begins_with_hardly_anything(name: str) -> None:
    actuators = calibrated_robot(settings(**{name: 0}), Path()).vehicle.actuators
    assert 0.0 < getattr(actuators, name) <= 1e-3
    assert getattr(calibrated_robot(settings(**{name: 0.02}), Path()).vehicle.actuators, name) == 0.02
    with pytest.raises(ValueError, match=name):
        settings(**{name: -1})


def test_a_folder_beside_the_settings_is_a_robot(tmp_path: Path) -> None:
    shutil.copytree(robot_folder("bluerov2_alpha5"), tmp_path / "mine")
    one, other = (calibrated_robot(settings(robot=robot), tmp_path) for robot in ("mine", "mine/robot.urdf"))
    assert one.file == other.file == tmp_path / "mine/hydrodynamics.yaml"
    with pytest.raises(LookupError, match="unknown robot 'yours'"):
        calibrated_robot(settings(robot="yours"), tmp_path)
