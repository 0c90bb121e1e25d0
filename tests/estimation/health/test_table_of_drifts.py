"""The guide's table of slow drifts, held against runs of a robot at rest."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from health_run import HealthRun, drifting, resting

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpec, SensorSpecs

# [s]
STEP = 0.02
ONSET = 25.0
LONGEST = 45.0  # for which a drift that is never found lasts
WITHIN = 0.3  # share of a time in the table
OF_ONE_READING = 0.3  # [s] by which short times differ: fixes come every 0.2 s

CHANNELS = {  # words of the table: channel, and unit in those of the channel
    "position": ("position", 1.0),
    "depth": ("depth", 1.0),
    "DVL": ("linear_velocity", 1e-3),
    "attitude": ("attitude", 1.0),
    "gyro": ("angular_velocity", 1e-3),
    "altimeter": ("altimeter_range", 1.0),
    "an encoder": ("joint_positions", 1e-3),
}
ALONG = {  # axis of a drift, of joints the number
    "position": 0,
    "linear_velocity": 0,
    "attitude": 2,
    "angular_velocity": 2,
    "joint_positions": 2,
}


@dataclass(frozen=True, kw_only=True, slots=True)
class ToldDrift:
    """A drift of the table."""

    channel: str
    rate: float
    """[unit of the channel per s]"""
    found_after: float
    """[s]; inf for never."""


def told_drifts() -> Iterator[ToldDrift]:
    """List the drifts of the table."""
    guide = files("uvms_ocp.reference") / "guide" / "faults.md"
    table = guide.read_text(encoding="utf-8").split("| drift |")[1].split("\n\n")[0]
    for row in re.finditer(r"^\| (an encoder|\w+) ([\d., ]+) [^|]*\| ([^|]+) \|", table, re.M):
        channel, unit = CHANNELS[row[1]]
        rates = [unit * float(rate) for rate in row[2].split(", ")]
        times = [math.inf] * len(rates)
        if row[3] != "never":
            times = [float(time) for time in row[3].removesuffix(" s").split(", ")]
        for rate, time in zip(rates, times, strict=True):
            yield ToldDrift(channel=channel, rate=rate, found_after=time)


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7")


def test_the_table_has_all_channels() -> None:
    drifts = list(told_drifts())
    assert {drift.channel for drift in drifts} == {channel for channel, _ in CHANNELS.values()}
    assert sum(math.isinf(drift.found_after) for drift in drifts) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "drift", list(told_drifts()), ids=lambda drift: f"{drift.channel} {drift.rate:g}"
)
def test_a_drift_is_found_when_the_guide_says(drift: ToldDrift, robot: Robot) -> None:
    rate: Any = drift.rate
    if drift.channel in ALONG:
        size = robot.n_joints if drift.channel == "joint_positions" else 3
        rate = drift.rate * (np.arange(size) == ALONG[drift.channel])
    specs = SensorSpecs()
    if drift.channel == "joint_positions":
        specs = replace(specs, joint_velocities=SensorSpec(rate=200.0, sigma=2e-3))
    run = HealthRun(
        robot,
        duration=ONSET + min(LONGEST, 1.4 * drift.found_after + 1.0),
        spoil=drifting(drift.channel, rate, ONSET),
        motion=resting(robot),
        dt=STEP,
        specs=specs,
        seed=1,
    )
    found_after = run.first_bad(drift.channel, ONSET)
    if math.isinf(drift.found_after):
        assert math.isinf(found_after)
    else:
        allowed = WITHIN * drift.found_after + OF_ONE_READING
        assert abs(found_after - drift.found_after) <= allowed
