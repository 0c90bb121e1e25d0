"""A vehicle whose velocity is known late, or was told wrongly, stays on its way."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from math import inf
from typing import Any

import numpy as np
import pytest
from compiler import long_without_compiler
from scipy.spatial import cKDTree

from uvms_ocp.robot.signals import Command, Reading, Readings
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import parse_fault

# [s]
ONSET = 20.0
END = 40.0
USUAL = {"noise": True, "dt": 1 / 50, "duration": END}


@cache
def usual_way() -> np.ndarray:
    """Positions (n, 3) [m] where nothing fails."""
    return case1(**USUAL).run()["q"][:, :3]


@pytest.mark.slow
@long_without_compiler
def test_a_vehicle_whose_dvl_falls_silent_stays_on_its_way() -> None:
    way = usual_way()
    without = case1(**USUAL, faults=(parse_fault(f"linear_velocity:lost@{ONSET:g}"),)).run()
    assert cKDTree(way).query(without["q"][:, :3])[0].max() < 0.3
    late = without["t"] > ONSET + 5.0
    assert np.abs(without["v"][late, :3]).max() < 0.3


@pytest.mark.slow
@long_without_compiler
def test_a_dvl_that_is_off_is_found_out_by_position_fixes() -> None:
    way = usual_way()
    biased = case1(**USUAL, faults=(parse_fault(f"linear_velocity:bias=0.3,0,0@{ONSET:g}"),)).run()
    assert cKDTree(way).query(biased["q"][:, :3])[0].max() < 5.0
    estimated = biased["q_estimated"][:, :3]
    true = biased["q"][:, :3]
    assert np.abs(estimated - true)[biased["t"] > ONSET + 8.0].max() < 0.2


@pytest.mark.slow
@long_without_compiler
def test_encoders_that_are_late_shake_neither_arm_nor_vehicle() -> None:
    """Fed back at full bandwidth, joints that are known 50 ms late swing up as soon as the arm is
    to move.
    """
    usual = {"noise": True, "duration": 55.0}
    way = case1(**usual).run()["q"][:, :3]
    late = case1(**usual, faults=(parse_fault("joint_positions:late=0.05@28.6"),)).run()
    assert cKDTree(way).query(late["q"][:, :3])[0].max() < 1.0
    assert np.abs(late["v"][:, 6:]).max() < 0.6


@dataclass(frozen=True, kw_only=True)
class Drift:
    """A DVL that is off along x by ever more, by `rate` [m/s2] from `onset` [s] on."""

    rate: float
    onset: float
    end: float = inf
    kind: str = "drift"

    def __call__(self, scenario: Scenario) -> Any:
        return DriftOfRun(self)


class DriftOfRun:
    def __init__(self, fault: Drift) -> None:
        self.fault = fault
        self.seen = None
        self.told = None

    def readings(self, readings: Readings, t: float) -> Readings:
        reading = readings.linear_velocity
        if reading is None or reading.t < self.fault.onset:
            return readings
        if reading is not self.seen:
            off = np.array([self.fault.rate * (reading.t - self.fault.onset), 0.0, 0.0])
            self.seen = reading
            self.told = Reading(value=reading.value + off, t=reading.t)
        return replace(readings, linear_velocity=self.told)

    def command(self, command: Command, t: float) -> Command:
        return command


@pytest.mark.slow
@long_without_compiler
def test_a_dvl_that_is_doubted_while_the_arm_works_at_the_floor_kicks_no_joint() -> None:
    """The correction of the velocity went to the joints: true rates of 1.5 times their limit,
    encoders blamed.
    """
    scenario = case1(noise=True, dt=1 / 50, duration=43.0)
    record = replace(scenario, faults=(Drift(rate=0.02, onset=34.0),)).run()
    doubted = [
        alarm.t
        for alarm in record.run_meta.alarms
        if alarm.text.startswith("linear_velocity suspect")
    ]
    assert doubted
    assert not [alarm.text for alarm in record.run_meta.alarms if "joint" in alarm.text]
    after = record["t"] >= doubted[0]
    rates = np.abs(record["v"][after, 6:]) / scenario.robot.limits.velocity[6:]
    assert rates.max() <= 1.02
    assert np.abs(np.diff(record["v_estimated"][after, :3], axis=0)).max() < 0.2
