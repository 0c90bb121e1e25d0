"""Every scenario does what its docstring promises, in numbers."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.record import Record
from uvms_ocp.report import quantity, summarize
from uvms_ocp.scenarios import SCENARIOS, current_drift, priority_swap, transit, two_targets


def largest_tilt(record: Record) -> float:
    tilt = quantity(record, "HA.tilt")
    assert tilt is not None
    return float(tilt.max())


def test_every_scenario_promises_something() -> None:
    assert all(build.__doc__ and len(build.__doc__) > 80 for build in SCENARIOS.values())


def test_the_swap_loses_the_attitude_that_the_right_order_keeps() -> None:
    lost, kept = (priority_swap(swapped=swapped, plant="kinematic", duration=20.0).run() for swapped in (True, False))
    assert largest_tilt(lost) > 0.25
    assert largest_tilt(kept) < 0.1


def test_two_targets_are_reached_one_after_the_other() -> None:
    scenario = two_targets(plant="kinematic")
    assert scenario.check().accepted
    report = summarize(scenario.run())
    assert report["completed"]
    assert [phase["name"] for phase in report["phases"]] == ["A1", "B1", "C1", "D1", "A2", "B2", "C2", "D2"]
    for name in ("D1", "D2"):
        final = next(phase for phase in report["phases"] if phase["name"] == name)["final_errors"]
        assert final["T.position_error"] < 1e-3
        assert final["T.orientation_error"] < 1e-3
    moved = next(row for row in report["resources"] if row["phase"] == "A2")
    assert moved["path_length_m"] > 1.5


def test_a_current_that_sets_in_sends_the_mission_back_and_it_ends_well() -> None:
    report = summarize(current_drift(dt=0.01).run())
    assert report["completed"]
    assert [phase["name"] for phase in report["phases"]] == ["A", "B", "C", "D"] * 2
    assert report["phases"][3]["reason"].startswith("PC.horizontal_error = 0.5")
    assert report["tool_position_error_m"] < 1e-3


def test_without_back_steps_the_current_loses_the_target() -> None:
    report = summarize(current_drift(back_steps=False, dt=0.01, duration=75.0).run())
    assert not report["completed"]
    assert report["vehicle_drift_in_last_phase_m"] > 0.3
    assert report["tool_position_error_m"] > 0.2
    assert report["cause"]["kind"] in ("stalled", "slow")


def test_retries_that_are_used_up_end_the_mission_with_a_cause() -> None:
    report = summarize(current_drift(retries=0, dt=0.01, duration=75.0).run())
    assert not report["completed"]
    assert report["cause"]["kind"] == "given up"
    assert "0 retries are used up: PC.horizontal_error" in report["cause"]["text"]


@pytest.mark.parametrize(("relief", "threshold"), [("flat", 1.0), ("large", 10.0)])
def test_a_transit_ends_above_its_way_point(relief: str, threshold: float) -> None:
    record = transit(relief=relief, threshold=threshold, length=12.0).run()
    altitude = quantity(record, "MAC.altitude")
    assert altitude is not None
    assert record.meta["completed"]
    assert altitude[len(altitude) // 2 :].min() > 0.7 * threshold
    assert np.isfinite(record["q"]).all()
