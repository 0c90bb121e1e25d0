"""Every scenario does what its docstring promises, in numbers."""

from __future__ import annotations

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.record.record import Record, quantity
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.cases.bluerov import bluerov_inspection
from uvms_ocp.scenario.cases.case1 import current_drift, priority_swap, two_targets
from uvms_ocp.scenario.cases.case2 import ToolPath, case2
from uvms_ocp.scenario.cases.transit import obstacle_field, transit
from uvms_ocp.sim.nearest_passage import closest_approach


def largest_tilt(record: Record) -> float:
    tilt = quantity(record, "HA.tilt")
    assert tilt is not None
    return float(tilt.max())


def test_every_scenario_promises_something() -> None:
    assert all(build.__doc__ and len(build.__doc__) > 80 for build in SCENARIOS.values())


@long_without_compiler
def test_the_swap_loses_the_attitude_that_the_right_order_keeps() -> None:
    lost, held_record = (
        priority_swap(swapped=swapped, plant="kinematic", duration=20.0).run()
        for swapped in (True, False)
    )
    assert largest_tilt(lost) > 0.25
    assert largest_tilt(held_record) < 0.1


@long_without_compiler
def test_two_targets_are_reached_one_after_the_other() -> None:
    scenario = two_targets(plant="kinematic")
    assert scenario.check().accepted
    report = summarize(scenario.run())
    assert report["completed"]
    assert [phase["name"] for phase in report["phases"]] == [
        "A1",
        "B1",
        "C1",
        "D1",
        "A2",
        "B2",
        "C2",
        "D2",
    ]
    for name in ("D1", "D2"):
        final = next(phase for phase in report["phases"] if phase["name"] == name)["final_errors"]
        assert final["T.position_error"] < 1e-3
        assert final["T.orientation_error"] < 1e-3
    moved = next(row for row in report["resources"] if row["phase"] == "A2")
    assert moved["path_length_m"] > 1.5


@pytest.mark.slow
@long_without_compiler
def test_a_current_that_sets_in_sends_the_mission_back_and_it_ends_well() -> None:
    report = summarize(current_drift(dt=0.01).run())
    assert report["completed"]
    assert [phase["name"] for phase in report["phases"]] == ["A", "B", "C", "D"] * 2
    assert report["phases"][3]["reason"].startswith("PC.horizontal_error = 0.5")
    assert report["tool_position_error_m"] < 1e-3


@pytest.mark.slow
@long_without_compiler
def test_without_back_steps_the_current_loses_the_target() -> None:
    report = summarize(current_drift(back_steps=False, dt=0.01, duration=75.0).run())
    assert not report["completed"]
    assert report["vehicle_drift_in_last_phase_m"] > 0.3
    assert report["tool_position_error_m"] > 0.2
    assert report["cause"]["kind"] in ("stalled", "slow")


@pytest.mark.slow
@long_without_compiler
def test_retries_that_are_used_up_end_the_mission_with_a_cause() -> None:
    report = summarize(current_drift(retries=0, dt=0.01, duration=75.0).run())
    assert not report["completed"]
    assert report["cause"]["kind"] == "given up"
    assert "0 retries are used up: PC.horizontal_error" in report["cause"]["text"]


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(("relief", "min_altitude"), [("flat", 1.0), ("large", 10.0)])
def test_a_transit_ends_above_its_way_point(relief: str, min_altitude: float) -> None:
    record = transit(relief=relief, min_altitude=min_altitude, length=12.0, dt=0.02).run()
    altitude = quantity(record, "MAC.altitude")
    assert altitude is not None
    assert record.meta.completed
    assert np.ptp(record.meta.surroundings.floor.z) > 0.0
    assert altitude[len(altitude) // 2 :].min() > 0.7 * min_altitude
    assert np.isfinite(record["q"]).all()


def in_phase(record: Record, name: str) -> np.ndarray:
    """Mask (n,) of the ticks of a phase."""
    names = [phase.name for phase in record.meta.phases]
    return record["phase"] == names.index(name)


@long_without_compiler
def test_the_arm_follows_its_plan_past_the_rock() -> None:
    scenario = case2(plant="kinematic")
    assert scenario.check().accepted
    record = scenario.run()
    report = summarize(record)
    assert report["completed"]
    assert report["tool_position_error_m"] < 1e-3
    activations = record["activations"][50:, scenario.mission.hierarchy.index("JL")]
    assert (activations == 1.0).all()
    assert (
        closest_approach(
            scenario.robot, scenario.environment, record["q"][::10], floor=False
        ).distance
        > 0.02
    )
    error = quantity(record, "T.position_error")
    assert error is not None
    assert error[in_phase(record, "D")][300:].max() < 0.05


@long_without_compiler
def test_the_preferred_motion_follows_its_plan_closer_than_the_arm_does_without_it() -> None:
    """Deviation of the last four joints from their plan during D, with MP and without."""
    scenario = case2(plant="kinematic", dt=0.02)
    deviations = []
    plan = scenario.mission.phases[-1].goals["MP"]
    for run in (scenario, case2(with_mp=False, plant="kinematic", dt=0.02)):
        record = run.run()
        rows = in_phase(record, "D")
        t = record["t"][rows]
        planned = np.array([plan(time - t[0])[0] for time in t])
        deviations.append(float(np.sqrt(np.mean((record["q"][rows, -4:] - planned) ** 2))))
    assert deviations[0] < 0.8 * deviations[1]


def test_the_planned_tool_path_ends_at_the_goal() -> None:
    scenario = case2(plant="kinematic")
    path = scenario.mission.phases[-1].goals["T"]
    assert isinstance(path, ToolPath)
    pose, rate = path(1e3)
    np.testing.assert_allclose(pose.translation, [12.2025, 37.3748, -39.886], atol=1e-5)
    np.testing.assert_array_equal(rate, 0.0)
    ahead, behind = (path(2.0 + step)[0].translation for step in (1e-5, -1e-5))
    np.testing.assert_allclose(path(2.0)[1][:3], (ahead - behind) / 2e-5, atol=1e-6)


@long_without_compiler
def test_the_valve_is_turned_in_view_of_the_camera() -> None:
    scenario = bluerov_inspection(plant="kinematic", dt=0.02)
    assert scenario.check().accepted
    record = scenario.run()
    assert record.meta.completed
    turning = in_phase(record, "C")
    error = quantity(record, "TP.position_error")
    angle = quantity(record, "FV.angle")
    assert error is not None
    assert angle is not None
    assert error[turning].max() < 0.02
    assert angle[turning].max() < 0.4


@pytest.mark.slow
@long_without_compiler
def test_clearance_keeps_the_whole_robot_away_from_the_obstacles_that_it_would_hit() -> None:
    scenario = obstacle_field(dt=0.02)
    full_record = scenario.run()
    lost = obstacle_field(with_clearance=False, dt=0.02, duration=12.0).run()
    assert full_record.meta.completed
    assert [item.name for item in full_record.meta.surroundings.obstacles] == [
        "boulder",
        "pillar",
        "wreck",
    ]
    closest = closest_approach(
        scenario.robot, scenario.environment, full_record["q"][::5], self_collision=True
    )
    assert closest.distance > 0.02
    assert (
        closest_approach(scenario.robot, scenario.environment, full_record["q"][::5]).distance > 0.1
    )
    assert closest_approach(scenario.robot, scenario.environment, lost["q"][::5]).distance < 0


@pytest.mark.slow
@long_without_compiler
def test_without_water_the_obstacles_are_kept_at_the_threshold() -> None:
    scenario = obstacle_field(plant="kinematic", dt=0.02)
    record = scenario.run()
    assert record.meta.completed
    assert (
        closest_approach(scenario.robot, scenario.environment, record["q"]).distance > 0.15 - 1e-6
    )
