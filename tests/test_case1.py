"""Case 1 from start to end with every solver on the kinematic plant: the paper's figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from uvms_ocp.record.record import Record
from uvms_ocp.report.comparison import transition_series
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.scenario.cases import Thresholds, case1
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.icat import Icat

SOLVERS = {
    "active_set": (LexicographicActiveSet, 0.011),
    "lexqp": (LexicographicQp, 0.011),
    "icat": (Icat, 0.05),
}
"""Solver and the largest change of any component of the command in one tick."""


@dataclass(frozen=True)
class Run:
    scenario: Scenario
    record: Record
    report: dict[str, Any]
    largest_step: float


@pytest.fixture(
    scope="module", params=["active_set", pytest.param("lexqp", marks=pytest.mark.slow), "icat"]
)
def run(request: pytest.FixtureRequest) -> Run:
    solver, largest_step = SOLVERS[request.param]
    scenario = case1(solver=solver(), plant="kinematic")
    record = scenario.run()
    return Run(scenario, record, summarize(record), largest_step)


@pytest.mark.slow
def test_all_phases_complete_in_order_with_a_reason(run: Run) -> None:
    assert run.report["completed"]
    assert [phase["name"] for phase in run.report["phases"]] == ["A", "B", "C", "D"]
    for phase, reason in zip(
        run.report["phases"],
        ("PC.position_error", "AT.misalignment", "LA.altitude", "T.position_error"),
        strict=True,
    ):
        assert phase["reason"].startswith(reason)
        assert phase["end_s"] > phase["start_s"]


@pytest.mark.sampled
def test_the_tool_reaches_the_target(run: Run) -> None:
    assert run.report["tool_position_error_m"] < 1e-3
    assert run.report["tool_orientation_error_rad"] < 1e-3


def test_the_vehicle_stands_still_while_the_arm_works(run: Run) -> None:
    assert run.report["vehicle_drift_in_last_phase_m"] < 1e-3


def test_the_altimeter_keeps_its_distance(run: Run) -> None:
    assert run.report["min_altimeter_m"] > 0.14


def test_joints_stay_inside_position_and_speed_limits(run: Run) -> None:
    limits = run.scenario.robot.limits
    joints = run.record["q"][:, run.scenario.robot.joint_q]
    assert (joints >= limits.position_lower).all()
    assert (joints <= limits.position_upper).all()
    assert (np.abs(run.record["command"]) <= limits.velocity * (1 + 1e-9)).all()


def test_the_command_never_jumps(run: Run) -> None:
    assert run.report["max_velocity_step"] < run.largest_step


def test_what_stands_above_the_action_loses_nothing_through_the_phase_changes(run: Run) -> None:
    """Unless the solver is the regularised one."""
    series = transition_series(run.record)
    lost = float(series["lost"].max())
    if isinstance(run.scenario.solver, Icat):
        assert lost > 1e-3
        return
    assert lost < 1e-8
    assert series["step"].max() <= 1.0 + 1e-6


def test_minimum_altitude_holds_while_it_is_on(run: Run) -> None:
    record = run.record
    gate = record["activations"][:, run.scenario.mission.hierarchy.index("MAC")]
    altitude = record["quantities"][:, record.meta.quantities.index("MAC.altitude")]
    assert altitude[gate == 1].min() > 1.0


def test_a_strict_hierarchy_keeps_every_higher_level_exact() -> None:
    """With the tool far out of reach, the vehicle's null velocity (above it) stays exact."""
    thresholds = Thresholds(way_point=50.0, misalignment=4.0, landing_altitude=50.0)
    record = case1(thresholds=thresholds, plant="kinematic", duration=3.0).run()
    in_d = record["activations"][:, 0] == 1.0
    assert in_d.any()
    settled = record["command"][in_d][100:, :6]
    assert np.abs(settled).max() < 1e-6


def test_the_mission_reports_what_it_waits_for() -> None:
    report = summarize(case1(duration=1.0).run())
    assert not report["completed"]
    assert "PC.position_error" in report["pending"]
    assert report["phases"][-1]["reason"].startswith("time is over, waiting for: PC.position_error")


def test_the_same_scenario_gives_the_same_record() -> None:
    first, second = (case1(noise=True, duration=0.5).run() for _ in range(2))
    np.testing.assert_array_equal(first["q"], second["q"])
    np.testing.assert_array_equal(first["command"], second["command"])


@pytest.mark.slow
def test_every_number_can_be_overridden() -> None:
    scenario = case1(
        robot=load_robot("girona_maris7").with_frame_pose("altimeter", pose_at((0.2, 0.0, -0.3))),
        start=pose_at((9.0, 38.0, -37.0)),
        way_point=pose_at((10.0, 37.0, -38.5)),
        target=(12.0, 37.0, -39.8),
        tool_goal=pose_at((12.0, 37.0, -39.8), (3.0, 0.0, 0.0)),
        seabed=-41.0,
        tasks={"PC": {"gain_linear": 0.3}, "MAC": {"threshold": 1.5}},
        order=("HA", "NR", "JL", "MAC", "AT", "PC", "LA", "T", "MP"),
        thresholds=Thresholds(way_point=0.2),
        solver=Icat(),
        duration=0.1,
    )
    record = scenario.run()
    assert record.meta.robot == "girona_maris7"
    assert [task.name for task in record.meta.tasks[:2]] == ["UA", "HA"]
    np.testing.assert_array_equal(record["q"][0, :3], [9.0, 38.0, -37.0])
    assert record["altimeter_range"][0] == pytest.approx(41.0 - 37.0 - 0.3)


def test_a_mission_works_at_another_rate() -> None:
    record = case1(dt=0.02, duration=0.5).run()
    np.testing.assert_allclose(np.diff(record["t"]), 0.02)
    assert summarize(record)["max_velocity_step"] <= 2.0 * 0.02 * (1 + 1e-6)
