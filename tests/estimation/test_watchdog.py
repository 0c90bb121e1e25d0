"""Measurements that stop coming: hold, then stop, and say so."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.fallbacks import Freshness, Watchdog
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.signals import IDEAL_SENSORS, Command, SensorSpec, StateEstimate
from uvms_ocp.scenario.cases.case1 import case1


def test_the_verdict_follows_the_age() -> None:
    watchdog = Watchdog(hold_after=0.5, stop_after=2.0)
    verdicts = [watchdog.judge(age, t) for t, age in enumerate((0.0, 0.6, 2.1, 0.1))]
    assert verdicts == [Freshness.FRESH, Freshness.STALE, Freshness.LOST, Freshness.FRESH]
    assert [t for t, _ in watchdog.alarms] == [1, 2, 3]
    assert "0.60 s old: holding" in watchdog.alarms[0][1]


def test_an_age_that_is_no_number_counts_as_lost() -> None:
    assert Watchdog().judge(math.nan, 0.0) is Freshness.LOST


def test_first_readings_that_are_under_way_are_no_alarm_unless_they_never_come() -> None:
    watchdog = Watchdog(hold_after=0.5, stop_after=2.0)
    assert [watchdog.judge(math.inf, t) for t in (5.0, 5.1)] == [Freshness.LOST, Freshness.LOST]
    assert watchdog.judge(0.1, 5.2) is Freshness.FRESH
    assert watchdog.alarms == []
    watchdog.judge(math.inf, 5.3, "position")
    assert watchdog.alarms == [(5.3, "no position: stopped")]
    silent = Watchdog(hold_after=0.5, stop_after=2.0)
    for t in (0.0, 1.9, 2.1, 2.2):
        silent.judge(math.inf, t, "position")
    assert silent.alarms == [(2.1, "no position: stopped")]


@long_without_compiler
def test_a_noisy_run_whose_first_fix_is_late_begins_without_an_alarm() -> None:
    scenario = case1(duration=0.5, noise=True)
    late = dataclasses.replace(scenario.specs.position, delay=0.1)
    record = dataclasses.replace(
        scenario, sensors=dataclasses.replace(scenario.specs, position=late)
    ).run()
    assert record["freshness"][0] == Freshness.STALE
    assert record["freshness"][-1] == Freshness.FRESH
    assert record.meta.alarms == ()


def test_impossible_times_are_refused() -> None:
    with pytest.raises(InvalidInput, match="give 0 < hold_after < stop_after"):
        Watchdog(hold_after=2.0, stop_after=1.0)


def test_a_controller_brakes_then_cuts_the_thrust_when_sensors_go_silent() -> None:
    scenario = case1()
    kinematic = scenario.kinematic_controller()
    layer = DynamicController(
        robot=scenario.robot, dynamics=robot_dynamics(scenario.robot), kinematic=kinematic
    )
    measured = StateEstimate(q=scenario.start, v=np.zeros(13), altimeter_range=3.0)
    commands: list[Command] = []
    for k in range(1200):
        t = 0.005 * k
        age = max(0.0, t - 1.0)
        commands.append(layer(dataclasses.replace(measured, age=age), t))
    moving = commands[199]
    held_command = commands[500]
    stopped = commands[-1]
    assert np.abs(moving.v).max() > 0.1
    assert not held_command.v.any()
    assert not held_command.stop
    assert stopped.stop
    assert stopped.thrust is not None
    assert np.abs(stopped.thrust).max() < 1e-9
    assert [text.split(": ")[1] for _, text in kinematic.watchdog.alarms] == ["holding", "stopped"]
    steps = np.diff([command.v for command in commands], axis=0)
    assert (np.abs(steps) <= scenario.robot.limits.acceleration * 0.005 + 1e-12).all()


@long_without_compiler
def test_silent_sensors_are_reported_and_the_mission_does_not_go_on() -> None:
    rare = SensorSpec(rate=0.2)
    dead = dataclasses.replace(
        IDEAL_SENSORS, linear_velocity=rare, position=rare
    )  # one stands in for the other
    scenario = dataclasses.replace(case1(duration=6.0), sensors=dead)
    record = scenario.run()
    texts = [alarm.text for alarm in record.meta.alarms]
    assert any("holding" in text for text in texts)
    assert any("going on" in text for text in texts)
    assert record["freshness"].max() >= 1
