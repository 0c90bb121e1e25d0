"""What the filter gets to see, reading by reading, and in which words the rest is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from health_run import FLOOR

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.filter_memory import NUMBER
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    IDEAL_SENSORS,
    Reading,
    Readings,
    SensorSpec,
    State,
    StateEstimate,
)
from uvms_ocp.sim.sensors import SensorSuite

DT = 0.01
SPECS = replace(IDEAL_SENSORS, linear_velocity=SensorSpec(sigma=0.001))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


class Vetting:
    """A robot at rest with ideal sensors and a DVL with noise, of whose readings some are
    replaced.
    """

    def __init__(self, robot: Robot) -> None:
        self.state = State(q=robot.configuration(position=(0.0, 0.0, -36.0)), v=np.zeros(robot.n_v))
        self.suite = SensorSuite(robot, FLOOR, SPECS)
        self.monitor = HealthMonitor(robot, SPECS)
        self.t = -DT
        self.given = Readings()

    def step(self, **readings: Reading[Any] | None) -> Readings:
        """What is left of the readings of the next tick, with others in their place."""
        self.t += DT
        self.given = replace_unchecked(
            self.suite.read(self.state, self.t), **readings
        )  # arrays of any shape too
        vetted = self.monitor.screen(self.given, self.t)
        self.monitor.judge(
            StateEstimate(q=self.state.q, v=self.state.v, altimeter_range=4.0), self.t
        )
        return vetted


@pytest.fixture
def vetting(robot: Robot) -> Vetting:
    vetting = Vetting(robot)
    for _ in range(20):
        assert vetting.step() is vetting.given
    return vetting


def test_in_place_of_a_refused_reading_the_filter_sees_the_last_one_that_was_used(
    vetting: Vetting,
) -> None:
    sound = vetting.given
    vetted = vetting.step(depth=Reading(value=math.nan, t=vetting.t + DT))
    assert vetted.depth is sound.depth
    for name in vetting.monitor.channels:
        assert name == "depth" or getattr(vetted, name) is getattr(vetting.given, name)
    assert vetting.step() is vetting.given


def test_a_reading_that_is_withdrawn_stays(vetting: Vetting) -> None:
    sound = vetting.given
    assert vetting.step(position=None).position is sound.position


def test_a_second_value_of_the_same_time_is_not_looked_at(vetting: Vetting) -> None:
    sound = vetting.given
    depth_reading = Reading(value=-35.9, t=vetting.t)
    assert vetting.step(depth=depth_reading).depth is sound.depth


def test_a_channel_that_the_robot_does_not_have_is_not_passed_on(vetting: Vetting) -> None:
    assert (
        vetting.step(specific_force=Reading(value=np.zeros(3), t=vetting.t + DT)).specific_force
        is None
    )


def test_lists_and_whole_numbers_are_values_too(vetting: Vetting) -> None:
    readings: dict[str, Reading[Any]] = {
        "position": Reading(value=[0.0, 0.0, -36.0], t=vetting.t + DT),
        "depth": Reading(value=-36, t=vetting.t + DT),
    }
    assert vetting.step(**readings) is vetting.given
    assert vetting.monitor.alarms == []


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("position", np.zeros(2), "a value of shape (2,) in place of (3,)"),
        ("depth", np.zeros((1, 2)), "a value of shape (1, 2) in place of a number"),
        ("joint_positions", 0.0, "a value of shape () in place of (7,)"),
        ("attitude", np.full(4, 0.6), "a quaternion of length 1.2"),
        ("angular_velocity", np.array([0.0, math.inf, 0.0]), "a value that is no number"),
        ("linear_velocity", np.array([50.0, 0.0, 0.0]), "50 m/s, more than the "),
        ("altimeter_range", -2.0, "a range of -2 m"),
        ("depth", -30.0, "6 m off the estimate, allowed 0.1"),
    ],
)
def test_a_value_that_cannot_be_is_refused_in_these_words(
    vetting: Vetting, name: str, value: Any, why: str
) -> None:
    sound = getattr(vetting.given, name)
    vetted = vetting.step(**{name: Reading(value=value, t=vetting.t + DT)})
    assert getattr(vetted, name) is sound
    assert [text.startswith(f"{name} suspect: {why}") for _, text in vetting.monitor.alarms] == [
        True
    ]


@pytest.mark.parametrize(
    ("stamp", "why"),
    [
        (math.nan, "a time stamp of nan"),
        (5.0, "a time stamp 4.8 s in the future"),
        (-1.0, "a time stamp 1.19 s before that of the reading before"),
    ],
)
def test_a_time_stamp_that_cannot_be_is_refused_in_these_words(
    vetting: Vetting, stamp: float, why: str
) -> None:
    vetting.step(depth=Reading(value=-36.0, t=stamp))
    assert [text for _, text in vetting.monitor.alarms] == [f"depth suspect: {why}"]


def test_outcomes_of_all_channels_are_those_of_each(robot: Robot) -> None:
    suite = SensorSuite(robot, FLOOR)
    estimator = Estimator(robot)
    outcomes = estimator.outcomes
    state = State(q=robot.configuration(position=(0.0, 0.0, -36.0)), v=np.zeros(robot.n_v))
    for k in range(100):
        estimator(suite.read(state, k * DT), k * DT)
    for name, number in NUMBER.items():
        outcome = estimator.outcome(name)
        assert np.isnan(outcomes[number, 0]) == (outcome is None)
        if outcome is not None:
            told = [outcome.t, outcome.squared, outcome.degrees, outcome.accepted]
            np.testing.assert_array_equal(outcomes[number], told)
