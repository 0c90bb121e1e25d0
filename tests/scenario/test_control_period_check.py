"""A loop that is closed so seldom that an arm may swing is warned of before it is flown, with the period that
would do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.scenario.cases import reach
from uvms_ocp.scenario.preflight import Severity
from uvms_ocp.scenario.preflight.delays import check_period
from uvms_ocp.scenario.scenario import Scenario


def warnings_of(scenario: Scenario) -> list[str]:
    findings = list(check_period(scenario.setup()))
    assert all(finding.severity is Severity.WARNING for finding in findings)
    return [finding.text for finding in findings]


def test_an_arm_at_ten_hertz_is_warned_of_with_the_period_that_would_do() -> None:
    """Of three drawn arms at 0.1 s two were caught by their brakes, and one passed its limits."""
    (text,) = warnings_of(reach(dt=0.1))
    assert "a control period of 0.1 s leaves the loops of joints 11 % of" in text
    assert "take 0.056 s or less" in text


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.06, 0.1, 0.15])
def test_a_shipped_arm_that_completes_at_a_long_period_is_not_refused(dt: float) -> None:
    """All of them were refused at more than 0.055 s, though this one reaches its goals."""
    scenario = reach(dt=dt, noise=True, seed=0)
    assert scenario.check().accepted
    record = scenario.run()
    assert record.run_meta.completed
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    assert rates.max() <= 1.02


@pytest.mark.parametrize("dt", [0.005, 0.02, 0.05])
def test_periods_at_which_drawn_arms_are_flown_are_not_warned_of(dt: float) -> None:
    assert not warnings_of(reach(dt=dt))


def test_without_water_or_with_slower_gains_it_may_be_slower() -> None:
    assert not warnings_of(reach(dt=0.1, plant="kinematic"))
    slow = VelocityGains(joints=4.0)
    assert not warnings_of(replace(reach(dt=0.1), gains=slow))
