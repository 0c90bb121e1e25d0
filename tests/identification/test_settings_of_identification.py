"""What settings may say, and what it means: 0 is at once, and a folder is a robot."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.calibration_robot import calibrated_robot
from uvms_ocp.identification.completed_recordings import with_thrust
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.robot.thrusters import thrust_limits

GIVEN = {
    "robot": "bluerov2_alpha5",
    "hull": [[-0.3, -0.2, -0.2], [0.3, 0.2, 0.2]],
    "learn": {"lag": {}, "delay": {}},
}


def settings(**other: object) -> CalibrationSettings:
    return CalibrationSettings.model_validate({**GIVEN, "arm": "taken off", **other})


def test_what_is_missing_is_said_with_what_it_is() -> None:
    with pytest.raises(
        InvalidInput,
        match=r"hull: missing; give box that holds the hull, lowest and highest corner \[m\]",
    ):
        CalibrationSettings(**{name: value for name, value in GIVEN.items() if name != "hull"})


@pytest.mark.parametrize("name", ["lag", "dead_zone"])
def test_what_is_given_as_nothing_begins_with_hardly_anything(name: str) -> None:
    actuators = calibrated_robot(settings(**{name: 0}), Path()).vehicle.actuators
    assert 0.0 < getattr(actuators, name) <= 1e-3
    assert (
        getattr(calibrated_robot(settings(**{name: 0.02}), Path()).vehicle.actuators, name) == 0.02
    )
    with pytest.raises(ValueError, match=name):
        settings(**{name: -1})


def test_a_folder_beside_the_settings_is_a_robot(tmp_path: Path) -> None:
    shutil.copytree(robot_folder("bluerov2_alpha5"), tmp_path / "mine")
    subject, other = (
        calibrated_robot(settings(robot=robot), tmp_path) for robot in ("mine", "mine/robot.urdf")
    )
    assert subject.file == other.file == tmp_path / "mine/hydrodynamics.yaml"
    with pytest.raises(LookupError, match="unknown robot 'yours'"):
        calibrated_robot(settings(robot="yours"), tmp_path)


def test_commands_of_propellers_become_the_thrust_of_the_curves() -> None:
    subject = calibrated_robot(settings(commands="propeller_commands"), Path())
    assert subject.vehicle.actuators.commands == "thrust"
    lower, upper = thrust_limits(subject.robot)
    t = np.arange(0.0, 5.0, 0.1)
    thrust = 0.5 * (upper - lower) * np.sin(t[:, None] + np.arange(len(upper))) + 0.5 * (
        upper + lower
    )
    signals = np.where(thrust > 0.0, thrust / upper, -thrust / lower)
    recorded = Recording(name="dive", channels={"propeller_commands": Channel(t=t, values=signals)})
    computed = with_thrust(subject.robot, recorded).channels["thrust"].values
    beyond = np.abs(thrust) > 0.1 * upper  # of the dead band
    np.testing.assert_allclose(computed[beyond], thrust[beyond], rtol=1e-6)
    assert not with_thrust(subject.robot, recorded).issues_in_file
    off = Channel(t=t, values=np.where(t[:, None] < 1.0, -3.75, signals))  # as pulses of 0 are read
    ((name, text),) = with_thrust(
        subject.robot, replace(recorded, channels={"propeller_commands": off})
    ).issues_in_file
    assert name == "propeller_commands"
    assert "20 % of its numbers are beyond the thrust curves" in text
    with pytest.raises(
        InvalidInput,
        match="propeller_commands of 2 thrusters given; allowed: 8, those that drive it",
    ):
        two = Recording(
            name="dive", channels={"propeller_commands": Channel(t=t, values=signals[:, :2])}
        )
        with_thrust(subject.robot, two)
