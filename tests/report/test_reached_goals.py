"""Reports tell the estimate, the truth and what the sensors allow; what is not known is no
number.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler
from typer.testing import CliRunner
from yaml import safe_dump, safe_load

from uvms_ocp.cli.commands import app
from uvms_ocp.mission.phase import Below, Transition
from uvms_ocp.record.record import Record
from uvms_ocp.report.comparison import compare
from uvms_ocp.report.end_of_run import cause_of_end, ended_prematurely, goal_table
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot, robot_folder
from uvms_ocp.scenario.cases.case1 import Thresholds, case1
from uvms_ocp.scenario.scenario import Scenario

LOOSE = Thresholds(
    way_point=50.0,
    misalignment=4.0,
    landing_altitude=50.0,
    tool_position=50.0,
    tool_orientation=4.0,
)


def short(**options: object) -> Scenario:
    """All phases of case 1, one after the other."""
    return case1(thresholds=LOOSE, duration=3.0, dt=0.01, **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def noisy() -> tuple[Scenario, Record]:
    scenario = short(noise=True, plant="kinematic", seed=3)
    return scenario, scenario.run()


@long_without_compiler
def test_the_truth_at_the_end_of_a_phase_is_that_of_the_true_state(
    noisy: tuple[Scenario, Record],
) -> None:
    scenario, record = noisy
    robot = scenario.robot
    rows = [row for row in goal_table(record) if row["quantity"] == "T.position_error"]
    assert rows
    goal = next(task.goal for task in scenario.mission.hierarchy.tasks if task.name == "T")
    data = robot.model.createData()
    for row in rows:
        at = int(np.searchsorted(record["t"], row["t"] - 1e-9))
        for series, value in (("q", row["true"]), ("q_estimated", row["estimated"])):
            pin.framesForwardKinematics(robot.model, data, record[series][at])
            place = data.oMf[robot.frame_id("tool")].translation
            assert np.linalg.norm(place - goal.translation) == pytest.approx(value, rel=1e-9)
        assert row["true"] != row["estimated"]


@long_without_compiler
def test_with_ideal_sensors_the_estimate_is_the_truth() -> None:
    record = short(plant="kinematic").run()
    assert record.run_meta.completed
    assert {row["phase"] for row in goal_table(record)} == {"A", "B", "C", "D"}
    for row in goal_table(record):
        assert row["true"] == pytest.approx(row["estimated"], rel=1e-9, abs=1e-12)
        assert row["sensors_allow"] is None
        assert row["met"]


@long_without_compiler
def test_a_mission_whose_true_error_is_over_its_limit_has_ended_too_early(
    noisy: tuple[Scenario, Record],
) -> None:
    _, record = noisy
    last = record.run_meta.events[-1]
    assert cause_of_end(record)["kind"] == "completed"
    truths = tuple(
        item.model_copy(update={"value": 51.0}) if item.name == "T.position_error" else item
        for item in last.true_quantities
    )
    events = (*record.run_meta.events[:-1], last.model_copy(update={"true_quantities": truths}))
    worse = replace(record, meta=record.run_meta.model_copy(update={"events": events}))
    assert [row["quantity"] for row in ended_prematurely(worse)] == ["T.position_error"]
    report = summarize(worse)
    assert report["completed"]
    assert report["ended_too_early"] == ["D"]
    assert report["cause"]["kind"] == "ended too early"
    allowed = f"{record.run_meta.allowance['T.position_error']:.2g}"
    assert (
        f"but truly 51 against a limit of 50, and the sensors allow {allowed}"
        in report["cause"]["text"]
    )


@long_without_compiler
def test_only_what_ended_a_phase_is_judged(noisy: tuple[Scenario, Record]) -> None:
    """Not what another transition of the phase waits for, were it a limit of the same quantity."""
    scenario, record = noisy
    *phases, last = scenario.mission.phases
    close = Below(quantity="T.position_error", limit=1e-9)
    again = Transition(to=phases[0].name, when=(close,))
    mission = replace(
        scenario.mission, phases=(*phases, replace(last, transitions=(again, *last.transitions)))
    )
    more = replace(scenario, mission=mission).run()
    assert close.limit in [item.limit for item in more.run_meta.thresholds]
    assert [(row["phase"], row["limit"]) for row in goal_table(more)] == [
        (row["phase"], row["limit"]) for row in goal_table(record)
    ]
    assert not ended_prematurely(more)


@long_without_compiler
def test_the_words_of_a_reason_are_for_people(noisy: tuple[Scenario, Record]) -> None:
    _, record = noisy
    meta = record.run_meta
    rows = goal_table(record)
    assert {row["quantity"] for row in rows} >= {
        "PC.position_error",
        "T.position_error",
        "T.orientation_error",
    }
    events = tuple(event.model_copy(update={"reason": "it was time"}) for event in meta.events)
    assert goal_table(replace(record, meta=meta.model_copy(update={"events": events}))) == rows


@long_without_compiler
@pytest.mark.parametrize("completed", [True, False])
def test_a_threshold_of_what_nobody_measures_is_told(
    completed: bool, noisy: tuple[Scenario, Record]
) -> None:
    _, record = noisy
    meta = record.run_meta
    unknown = tuple(item.model_copy(update={"quantity": "odd"}) for item in meta.thresholds)
    odd = replace(
        record,
        meta=meta.model_copy(update={"thresholds": unknown, "completed": completed, "events": ()}),
    )
    report = summarize(odd)
    assert report["cause"]["kind"] == ("truth unknown" if completed else "stalled")
    assert completed or report["cause"]["text"].endswith("no task of the record measures it")


@long_without_compiler
def test_records_that_do_not_tell_what_ended_a_phase_have_no_goals(
    noisy: tuple[Scenario, Record],
) -> None:
    _, record = noisy
    events = tuple(event.model_copy(update={"conditions": ()}) for event in record.run_meta.events)
    older = replace(record, meta=record.run_meta.model_copy(update={"events": events}))
    report = summarize(older)
    assert report["goals"] == report["ended_too_early"] == []


@long_without_compiler
def test_the_report_has_estimate_truth_and_what_the_sensors_allow_side_by_side(
    noisy: tuple[Scenario, Record],
) -> None:
    report = summarize(noisy[1])
    assert report["tool_position_error_m"] != report["estimated_tool_position_error_m"]
    assert report["sensors_allow_tool_position_m"] == pytest.approx(4.4e-3, rel=0.1)
    assert all(
        phase["true_errors"].keys() == phase["final_errors"].keys() for phase in report["phases"]
    )
    rows = {row["figure"]: row for row in compare(noisy[1], noisy[1])}
    assert (
        rows["estimated_tool_position_error_m"]["first"]
        == report["estimated_tool_position_error_m"]
    )


@long_without_compiler
def test_records_that_do_not_tell_the_truth_are_not_judged(noisy: tuple[Scenario, Record]) -> None:
    _, record = noisy
    events = tuple(
        event.model_copy(update={"true_quantities": ()}) for event in record.run_meta.events
    )
    older = replace(
        record, meta=record.run_meta.model_copy(update={"events": events, "sensors_allow": ()})
    )
    assert {row["met"] for row in goal_table(older)} == {None}
    assert summarize(older)["ended_too_early"] == []


@pytest.mark.slow
@long_without_compiler
def test_energy_without_power_data_is_unknown_and_not_zero(tmp_path: Path) -> None:
    content = safe_load(
        (robot_folder("girona_maris7_full") / "hydrodynamics.yaml").read_text(encoding="utf-8")
    )
    del content["thrusters"][0]["power"]
    (tmp_path / "water.yaml").write_text(safe_dump(content), encoding="utf-8")
    robot = load_robot("girona_maris7_full", hydrodynamics=tmp_path / "water.yaml")
    known_run, unknown = (short(robot=machine).run() for machine in ("girona_maris7_full", robot))
    assert np.isnan(unknown["thruster_energy"][-1]).tolist() == [True] + [False] * 7
    for row in summarize(unknown)["resources"]:
        assert row["thruster_energy_j"] is row["energy_j"] is None
        assert row["joint_energy_j"] >= 0.0
    assert '"thruster_energy_j": null' in json.dumps(summarize(unknown))
    for name, record in (("known.npz", known_run), ("unknown.npz", unknown)):
        record.save(tmp_path / name)
    shown = CliRunner().invoke(
        app, ["compare", str(tmp_path / "known.npz"), str(tmp_path / "unknown.npz")]
    )
    (line,) = [line for line in shown.output.splitlines() if "thruster_energy_j" in line]
    assert [word.strip() for word in line.strip("│").split("│")][2:] == ["-", "-"]
