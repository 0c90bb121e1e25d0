"""A plan is flown while the mission goes as planned; where it does not the hierarchy takes over,
and the record says why.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.control.plan_following import FollowingTuning
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission_plan import MissionPlan
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases import reach
from uvms_ocp.scenario.scenario import Scenario, pose_at

pytestmark = pytest.mark.slow


def left_at(record: Record) -> tuple[float, str]:
    """When [s] a plan was left, and why."""
    (alarm,) = [alarm for alarm in record.run_meta.alarms if alarm.text.startswith("plan left")]
    return alarm.t, alarm.text


def test_in_water_that_the_plan_does_not_know_the_hierarchy_takes_over(
    planned: MissionPlan,
) -> None:
    record = planned.fly(
        reach(seed=3, current=(1.2, 0.8, 0.0), duration=8.0), tuning=FollowingTuning(position=0.05)
    )
    t, text = left_at(record)
    assert "away from it" in text
    np.testing.assert_array_equal(record["guided"], record["t"] < t)


def test_a_sensor_that_fails_ends_the_plan(planned: MissionPlan) -> None:
    t, text = left_at(
        planned.fly(reach(seed=3, faults="altimeter:frozen@4", noise=True, duration=8.0))
    )
    assert t > 4.0
    assert "altimeter_range" in text


def test_a_phase_that_does_not_end_is_left_to_the_hierarchy_which_completes_it(
    mission: Scenario, planned: MissionPlan
) -> None:
    blunt = replace(planned, trajectory=replace(planned.trajectory, q=stopped_short(planned)))
    record = blunt.fly(mission, tuning=FollowingTuning(late=0.5))
    assert "phase 'B' does not end" in left_at(record)[1]
    assert record.run_meta.completed


def stopped_short(plan: MissionPlan) -> np.ndarray:
    """Configurations (n, n_q) of the plan, 0.05 m beside them."""
    q = plan.trajectory.q.copy()
    q[:, 0] += 0.05
    return q


def test_a_flight_says_what_its_plan_takes_and_what_quick_thrust_adds(
    mission: Scenario, planned: MissionPlan, flown: Record, greedy: Record
) -> None:
    report = summarize(flown)
    assert report["energy_planned_j"] == planned.energy
    assert "energy_planned_j" in str(report)
    assert summarize(greedy)["energy_planned_j"] is None
    noisy = summarize(planned.fly(reach(seed=3, noise=True)))
    more = noisy["energy_j"] - report["energy_j"]
    assert more > 0.0
    assert noisy["energy_of_quick_thrust_j"] - report["energy_of_quick_thrust_j"] == pytest.approx(
        more, rel=0.3
    )


def test_on_the_kinematic_plant_the_plan_is_flown_as_it_is(planned: MissionPlan) -> None:
    scenario = reach(seed=3, plant="kinematic")
    record = planned.fly(scenario)
    assert record.run_meta.completed
    middle = int(0.5 * len(record))
    q = planned.trajectory.state_at(scenario.robot.model, float(record["t"][middle]))[0]
    np.testing.assert_allclose(record["q"][middle], q, atol=5e-3)


def test_a_saved_plan_is_the_plan(planned: MissionPlan, tmp_path: Path) -> None:
    again = MissionPlan.load(planned.save(tmp_path / "plan.npz"))
    assert again.summary() == planned.summary()
    for name in ("t", "q", "v", "a", "thrust", "torque"):
        np.testing.assert_array_equal(
            getattr(again.trajectory, name), getattr(planned.trajectory, name)
        )


@pytest.mark.parametrize(
    ("other", "what"),
    [
        (reach(seed=4), "another mission"),
        (reach(seed=3, start=pose_at((0.1, 0.0, -5.0))), "another start and mission"),
        (reach(seed=3, tolerance=0.02), "another mission"),
    ],
    ids=["goal", "start", "threshold"],
)
def test_the_plan_of_another_mission_is_refused(
    planned: MissionPlan, other: Scenario, what: str
) -> None:
    with pytest.raises(
        InvalidInput, match=f"^the plan is of reach with {what} than reach; plan reach"
    ):
        planned.fly(other)


def garbled(path: Path, **changed: object) -> Path:
    """The file of a plan, with other entries in its summary."""
    arrays = dict(np.load(path))
    told = json.loads(str(arrays["mission_plan"])) | changed
    np.savez(path, **{**arrays, "mission_plan": np.array(json.dumps(told))})
    return path


@pytest.mark.parametrize(
    "changed",
    [{"status": "splendid"}, {"phases": 3}, {"identity": None}, {"phases": [{"name": "A"}]}],
    ids=str,
)
def test_a_garbled_file_is_refused_in_one_line(
    planned: MissionPlan, tmp_path: Path, changed: dict[str, object]
) -> None:
    path = garbled(planned.save(tmp_path / "plan.npz"), **changed)
    with pytest.raises(InvalidInput, match=r"plan\.npz") as caught:
        MissionPlan.load(path)
    assert "\n" not in str(caught.value)


def test_a_summary_that_is_nested_without_end_is_refused_in_one_line(
    planned: MissionPlan, tmp_path: Path
) -> None:
    path = planned.save(tmp_path / "plan.npz")
    arrays = dict(np.load(path)) | {"mission_plan": np.array("[" * 100_000)}
    np.savez(path, **arrays)
    with pytest.raises(InvalidInput, match=r"plan\.npz: a text that is no JSON") as caught:
        MissionPlan.load(path)
    assert "\n" not in str(caught.value)


def test_a_record_is_no_plan(flown: Record, tmp_path: Path) -> None:
    flown.save(tmp_path / "record.npz")
    with pytest.raises(InvalidInput, match="no plan of a mission"):
        MissionPlan.load(tmp_path / "record.npz")
    assert Record.load(tmp_path / "record.npz")["guided"].all()
