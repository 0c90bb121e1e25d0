"""Controllers of one's own: the record, the phases and the report are those of our own
controller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.report import summarize
from uvms_ocp.robot.signals import Command, StateEstimate
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.part_factories import our_controller
from uvms_ocp.scenario.scenario import Scenario

Controller = Callable[[StateEstimate, float], Command]


def copied(scenario: Scenario) -> Controller:
    """Our controller, as if it were somebody else's."""
    ours = our_controller(scenario)

    def control(measurement: StateEstimate, t: float) -> Command:
        command = ours(measurement, t)
        return replace(command, finished=False, telemetry={"own_number": 2.0 * t})

    return control


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["kinematic", "dynamic"])
def test_our_controller_under_another_name_gives_the_same_record(plant: str) -> None:
    ours = case1(plant=plant, dt=0.02, duration=40.0)
    theirs = replace(ours, controller=copied)
    record = ours.run()
    watched = theirs.run()
    for name in ("q", "command", "phase", "quantities"):
        np.testing.assert_array_equal(watched[name], record[name], err_msg=name)
    assert [event.target for event in watched.run_meta.events] == [
        event.target for event in record.run_meta.events
    ]
    np.testing.assert_allclose(watched["own_number"], 2.0 * watched["t"])


def still(scenario: Scenario) -> Controller:
    n_v = scenario.robot.n_v
    n_thrusters = len(scenario.robot.description.thrusters)
    zero = Command(
        v=np.zeros(n_v), thrust=np.zeros(n_thrusters), torque=np.zeros(scenario.robot.n_joints)
    )
    return lambda measurement, t: zero


def test_a_controller_that_does_nothing_is_reported_like_any_other() -> None:
    scenario = replace(case1(dt=0.02, duration=2.0), controller=still)
    record = scenario.run()
    assert not record.run_meta.completed
    assert summarize(record)["scenario"] == "case1"
    np.testing.assert_array_equal(record["command"], 0.0)


def test_a_changed_scenario_keeps_its_controller() -> None:
    scenario = replace(replace(case1(duration=0.1), controller=still), duration=0.2)
    assert type(scenario.controller()).__name__ == "SupervisedController"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"v": np.zeros(3)},
            r"the command of controller wrong has v of shape \(3,\); give 13 finite numbers",
        ),
        ({"thrust": None}, "has thrust None; give 8 finite numbers"),
        ({"torque": np.full(7, np.nan)}, "has torque not finite; give 7 finite numbers"),
        (
            {"telemetry": {"phase": 1}},
            "telemetry of controller wrong has 'phase', which the mission tells; rename it",
        ),
        ({"telemetry": {"q": 1}}, r"telemetry \['q'\] is what the loop records; rename it"),
    ],
)
def test_a_command_that_no_plant_can_take_is_refused_in_one_line(
    change: dict[str, Any], message: str
) -> None:
    def wrong(scenario: Scenario) -> Controller:
        right = still(scenario)
        return lambda measurement, t: replace(right(measurement, t), **change)

    with pytest.raises(InvalidInput, match=message):
        replace(case1(duration=0.1), controller=wrong).run()


@pytest.mark.parametrize(
    ("maker", "message"),
    [
        (
            lambda scenario: None,
            r"controller made NoneType; make a callable \(StateEstimate, t\) -> Command",
        ),
        (
            lambda scenario: lambda measurement, t: 3.0,
            "controller lambda returned float; return a Command",
        ),
    ],
)
def test_what_is_no_controller_is_refused_in_one_line(maker: Any, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        replace(case1(duration=0.1), controller=maker).run()
