"""What a channel jumped by that was refused and is used again is told once, and kept for the bound
of the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from health_run import HealthRun, resting

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings

# [s]
ONSET = 3.0
END = 12.0
STEPS = {"attitude": 0.08, "joint_positions": 0.1}  # [rad]


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("bluerov2_alpha5")


def stepped(channel: str, reading: Reading[np.ndarray]) -> np.ndarray:
    if channel == "attitude":
        turn = pin.Quaternion(pin.exp3(np.array([0.0, 0.0, STEPS[channel]])))
        return np.asarray((pin.Quaternion(reading.value) * turn).coeffs())
    return np.asarray(reading.value) + STEPS[channel] * (np.arange(len(reading.value)) == 1)


def spoiled(
    channel: str, of: Callable[[Reading[np.ndarray], float], np.ndarray | None]
) -> Callable[[Readings, float], Readings]:
    """Readings of a channel with another value, where `of` gives one."""

    def spoil(readings: Readings, t: float) -> Readings:
        reading = getattr(readings, channel)
        if reading is None:
            return readings
        value = of(reading, reading.t)
        if value is None:
            return readings
        return replace(readings, **{channel: Reading(value=value, t=reading.t)})

    return spoil


def flown(
    robot: Robot,
    channel: str,
    dt: float,
    of: Callable[[Reading[np.ndarray], float], np.ndarray | None],
) -> HealthRun:
    return HealthRun(robot, duration=END, dt=dt, spoil=spoiled(channel, of), motion=resting(robot))


def told(run: HealthRun) -> list[str]:
    return [text for _, text in run.guard.monitor.alarms if "from where it was" in text]


def unexplained(run: HealthRun, channel: str) -> float:
    at = {"attitude": slice(3, 6), "joint_positions": slice(6, None)}[channel]
    return float(run.guard.monitor.unexplained[at].max())


@pytest.mark.sampled
@pytest.mark.parametrize("first", ["step", "nan", "spike"])
@pytest.mark.parametrize("dt", [0.005, 0.02])
@pytest.mark.parametrize("channel", STEPS)
def test_a_step_is_told_and_in_the_bound(channel: str, dt: float, first: str, robot: Robot) -> None:
    """At every rate of control, and whatever else was wrong at its first moment."""

    def of(reading: Reading[np.ndarray], t: float) -> np.ndarray | None:
        if t < ONSET:
            return None
        if t < ONSET + 0.03 and first != "step":
            return np.full(len(reading.value), math.nan if first == "nan" else 1e3)
        return stepped(channel, reading)

    run = flown(robot, channel, dt, of)
    assert len(told(run)) == 1
    assert unexplained(run, channel) == pytest.approx(STEPS[channel], rel=0.1)


@pytest.mark.sampled
@pytest.mark.parametrize("channel", STEPS)
def test_what_comes_back_where_it_was_is_no_step(channel: str, robot: Robot) -> None:
    """Spikes, and an outage of a second and a half."""

    def of(reading: Reading[np.ndarray], t: float) -> np.ndarray | None:
        if 6.0 <= t < 7.5:
            return np.full(len(reading.value), math.nan)
        if t >= ONSET and round(200 * t) % 67 == 0:
            return stepped(channel, reading)
        return None

    run = flown(robot, channel, 0.005, of)
    assert not told(run)
    assert unexplained(run, channel) == 0.0


def test_a_step_is_told_once(robot: Robot) -> None:
    def of(reading: Reading[np.ndarray], t: float) -> np.ndarray | None:
        if 8.0 <= t < 8.5:
            return np.full(4, math.nan)
        if t >= ONSET:
            return stepped("attitude", reading)
        return None

    run = flown(robot, "attitude", 0.02, of)
    assert len(told(run)) == 1
    assert run.guard.monitor.alarms[-1][1] == "attitude good again"
