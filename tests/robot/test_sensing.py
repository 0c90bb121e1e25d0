"""Sensors of a robot: defaults, what its file says, and mistakes in it."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.description import Channel, read_description
from uvms_ocp.robot.signals import CHANNELS, SensorSpec, SensorSpecs, robot_sensors


def described(tmp_path: Path, text: str) -> SensorSpecs:
    path = tmp_path / "hydrodynamics.yaml"
    path.write_text(text)
    return robot_sensors(read_description(path))


def test_the_channels_of_a_file_are_those_of_the_readings() -> None:
    assert set(get_args(Channel)) == set(CHANNELS)


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    specs = described(
        tmp_path,
        "sensors: {altimeter_range: {sigma: 0.05}, depth: null, joint_velocities: {rate: 50}}",
    )
    assert specs.altimeter_range == SensorSpec(rate=10.0, sigma=0.05)
    assert specs.depth is None
    assert specs.joint_velocities == SensorSpec(rate=50.0)
    assert specs.position == SensorSpecs().position


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sensors: {sonar: {rate: 1}}", "sensors.sonar"),
        ("sensors: {depth: {rate: 0}}", "sensors.depth.rate: given 0; allowed: greater than 0"),
        (
            "sensors: {depth: {sigma: -1}}",
            "sensors.depth.sigma: given -1; allowed: greater than or equal to 0",
        ),
        ("sensors: {depth: {rate: .nan}}", "sensors.depth.rate: given nan"),
        ("sensors: {depth: {dropout: 2}}", "sensors.depth.dropout: given 2"),
    ],
)
def test_mistakes_name_file_key_and_range(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(RobotDataError, match=message) as caught:
        described(tmp_path, text)
    assert "hydrodynamics.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
