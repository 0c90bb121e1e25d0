"""One table of channels: whoever names channels, or says what they are, says what it does."""

from __future__ import annotations

import csv
import math
from dataclasses import fields
from importlib.resources import files
from typing import Any, get_args

import numpy as np
import pytest
import tomllib

import uvms_ocp as uo
from uvms_ocp.estimation import Estimator
from uvms_ocp.estimation.degraded_modes import DEGRADED_MODES
from uvms_ocp.estimation.filter_memory import N_JOINT_CHANNELS, NUMBER, ChannelIndex
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.estimation.tuning import GATES
from uvms_ocp.identification.recording import CHANNEL_TABLE
from uvms_ocp.record.series_checks import MEASURED
from uvms_ocp.record.tables import SERIES
from uvms_ocp.robot import Readings, Robot, SensorSpecs, description
from uvms_ocp.robot.channels import (
    CHANNELS,
    OF_MOTION,
    TABLE,
    Channel,
    shape_of,
    shapes_of,
    start_of,
)
from uvms_ocp.robot.signals import UNITS
from uvms_ocp.sim import SensorSuite
from uvms_ocp.sim.sensors import sources_of

ROWS = pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return uo.load_robot("bluerov2_alpha5")


@pytest.fixture(scope="module")
def sensors() -> SensorSpecs:
    """All channels, the optional ones too."""
    usual = {row.name: row.sensor or uo.robot.SensorSpec(rate=100.0, sigma=0.01) for row in TABLE}
    return SensorSpecs(**usual)


def toml(package: str, name: str) -> dict[str, Any]:
    return tomllib.loads((files(package) / name).read_text(encoding="utf-8"))


def test_readings_specifications_and_robot_files_have_the_channels_of_the_table() -> None:
    assert tuple(field.name for field in fields(Readings)) == (*CHANNELS, "own")
    assert tuple(field.name for field in fields(SensorSpecs)) == (*CHANNELS, "own")
    assert get_args(description.Channel) == CHANNELS
    assert SensorSpecs().present == {row.name: row.sensor for row in TABLE if row.sensor}
    assert {row.name: row.unit for row in TABLE} == UNITS


def test_the_filter_has_a_number_for_each_channel_and_those_of_joints_come_first() -> None:
    assert {number.name.lower() for number in ChannelIndex} == set(CHANNELS)
    of_joints = {row.name for row in TABLE if row.of_joints}
    assert {name for name, number in NUMBER.items() if number < N_JOINT_CHANNELS} == of_joints


def test_a_vehicle_moves_by_channels_in_the_order_of_q_and_v() -> None:
    assert OF_MOTION == ("position", "attitude", "linear_velocity", "angular_velocity")


def test_rivals_and_degraded_modes_name_channels_of_the_table() -> None:
    assert {rival for row in TABLE for rival in row.rivals} <= set(CHANNELS)
    assert frozenset().union(*(mode.without for mode in DEGRADED_MODES)) <= set(CHANNELS)
    assert all(len(row.rivals) <= 2 for row in TABLE)


@ROWS
def test_series_of_readings_have_the_frame_the_unit_and_the_size_of_the_row(row: Channel) -> None:
    assert {name.removeprefix("measured_") for name in MEASURED} == set(CHANNELS)
    series = SERIES[f"measured_{row.name}"]
    assert series.frame == row.frame
    unit = "-" if row.name == "attitude" else row.unit
    assert series.unit.replace("²", "2") == f"{unit}, s"
    if not row.of_joints:
        assert len(series.columns) == row.size + 1


@ROWS
def test_recordings_have_the_frame_the_unit_and_the_size_of_the_row(row: Channel) -> None:
    recorded = CHANNEL_TABLE["channels"].get(row.name)
    if recorded is None:  # heights and ranges are not learnt from
        assert row.name in ("depth", "altimeter_range")
        return
    assert recorded["unit"] == ("-" if row.name == "attitude" else row.unit)
    assert recorded.get("frame", "-") == row.frame
    assert len(recorded.get("columns", ())) == row.size


@ROWS
def test_filter_monitor_and_sensors_read_the_row(
    row: Channel, robot: Robot, sensors: SensorSpecs
) -> None:
    number = NUMBER[row.name]
    memory = Estimator(robot, sensors, compiled=False).memory
    sensor = sensors.present[row.name]
    assert (memory.rows[number], memory.orders[number]) == (row.rows, row.orders)
    assert memory.jolt[number] == row.jolt
    assert memory.gate[number] == GATES[row.rows]
    assert memory.sigma[number] == sensor.sigma
    assert memory.period[number] == 1.0 / sensor.rate
    channel = HealthMonitor(robot, sensors, compiled=False).memory.channels[number]
    shape = shape_of(row, robot)
    assert channel.size == math.prod(shape)
    assert shapes_of(robot)[row.name] == shape
    rivals = [NUMBER[rival] for rival in row.rivals]
    assert [channel.rival, channel.other_rival] == [*rivals, -1, -1][:2]
    if channel.gate.exists:
        assert channel.gate.orders == row.orders
        assert channel.gate.start == start_of(row, robot)
        assert channel.gate.jolt == row.jolt
    source = sources_of(robot, has_altimeter=True)[row.name]
    assert (source.size, source.first) == (math.prod(shape), start_of(row, robot))
    assert source.of_velocity == (row.orders < 2)


def test_readings_of_sensors_have_the_shapes_of_the_rows(
    robot: Robot, sensors: SensorSpecs
) -> None:
    suite = SensorSuite(robot, uo.FlatSeafloor(z=-10.0), sensors)
    q = robot.configuration(position=(0.0, 0.0, -5.0))
    n_v = robot.n_v
    state = uo.robot.State(q=q, v=np.zeros(n_v), a=np.zeros(n_v))
    readings = suite.read(state, 0.0)
    for row in TABLE:
        assert np.shape(getattr(readings, row.name).value) == shape_of(row, robot)


def test_every_series_of_the_table_is_read_from_its_file() -> None:
    text = (files("uvms_ocp.record") / "series.csv").read_text(encoding="utf-8")
    names = {line[0] for line in csv.reader(text.splitlines())}
    assert {f"measured_{name}" for name in CHANNELS} <= names
    modes = toml("uvms_ocp.estimation", "degraded_modes.toml")["modes"]
    assert len(modes) == len(DEGRADED_MODES)
