"""Over the readings and commands of a record, filter and health monitor say what they said in the run, to the last bit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from uvms_ocp.record.record import Record
from uvms_ocp.robot import Command, Reading, Readings, StateEstimate
from uvms_ocp.scenario import Scenario, reach
from uvms_ocp.scenario.cases import SCENARIOS

FAULTS = ("position:bias=0.5@2-4", "joint_positions:lost@1-4", "attitude:late=0.2@2", "altimeter:frozen@2", "depth:nan@1-3")
FAULTS_OF_SCENARIOS = {
    "case1": "thruster3:dead@3",
    "case2": "altimeter:frozen@2",
    "bluerov_inspection": "position:bias=0.5@2-4",
    "transit": "attitude:late=0.2@2",
    "two_targets": "joint_positions:lost@1-4",
}


def replayed(record: Record, scenario: Scenario) -> Iterator[StateEstimate]:
    """The estimate at every tick."""
    estimator, last, command = scenario.estimator(), {}, None
    for k, t in enumerate(record["t"].tolist()):
        for channel in record.run_meta.channels:
            *value, taken = record.series[f"measured_{channel}"][k].tolist()
            if np.isfinite(taken):
                scalar = channel in ("depth", "altimeter_range")
                last[channel] = Reading(value=value[0] if scalar else np.array(value), t=taken)
        yield estimator(Readings(**last), t, command)
        command = Command(v=record.series["command"][k], brakes=bool(record.series["brakes"][k]))


def require_the_same(record: Record, scenario: Scenario) -> None:
    for k, found in enumerate(replayed(record, scenario)):
        trusts = [channel.trust for channel in found.health]
        for name, value in (("q_estimated", found.q), ("v_estimated", found.v), ("q_std", found.std), ("health", trusts)):
            assert np.array_equal(value, record.series[name][k]), (name, k)
        assert np.array_equal(found.altimeter_range, record.series["altimeter_range"][k], equal_nan=True)


@pytest.mark.parametrize("fault", FAULTS)
def test_with_a_fault_of_a_sensor(fault: str) -> None:
    scenario = reach(noise=True, duration=5.0, faults=fault)
    require_the_same(scenario.run(), scenario)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS_OF_SCENARIOS)
def test_in_every_scenario(name: str) -> None:
    scenario = SCENARIOS[name](noise=True, duration=5.0, faults=FAULTS_OF_SCENARIOS[name])
    require_the_same(scenario.run(), scenario)
