"""A loop that is closed too seldom to hold an arm is refused before it is flown, with the period that would do."""

from __future__ import annotations

from dataclasses import replace

import pytest

from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.scenario.cases import reach
from uvms_ocp.scenario.preflight import Severity
from uvms_ocp.scenario.preflight.delays import check_period
from uvms_ocp.scenario.scenario import Scenario


def refused(scenario: Scenario) -> list[str]:
    findings = list(check_period(scenario.setup()))
    assert all(finding.severity is Severity.ERROR for finding in findings)
    return [finding.text for finding in findings]


def test_an_arm_at_ten_hertz_is_refused_with_the_period_that_would_do() -> None:
    """Of three drawn arms at 0.1 s two were caught by their brakes, and one passed its limits."""
    (text,) = refused(reach(dt=0.1))
    assert "a control period of 0.1 s leaves the loops of joints 11 % of" in text
    assert "take 0.056 s or less" in text


@pytest.mark.parametrize("dt", [0.005, 0.02, 0.05])
def test_periods_at_which_drawn_arms_are_flown_are_accepted(dt: float) -> None:
    assert not refused(reach(dt=dt))


def test_without_water_or_with_slower_gains_it_may_be_slower() -> None:
    assert not refused(reach(dt=0.1, plant="kinematic"))
    slow = VelocityGains(joints=4.0)
    assert not refused(replace(reach(dt=0.1), gains=slow))
