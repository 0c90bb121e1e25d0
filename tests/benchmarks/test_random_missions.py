"""Random missions: the tests take six of the two hundred that `benchmarks/random_missions.py`
makes.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from compiler import long_without_compiler
from studies.random_missions import boulder_clearance, random_mission, random_missions, totals
from studies.study import StudyResult

from uvms_ocp.scenario.scenario import Scenario

pytestmark = [
    pytest.mark.filterwarnings(
        "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::FutureWarning"
    ),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def result() -> StudyResult:
    return random_missions(n=6, plant="kinematic").run()


@long_without_compiler
def test_what_pre_flight_accepts_completes(result: StudyResult) -> None:
    (total,) = result.table
    assert total["missions"] == 6
    assert 2 * total["accepted"] > total["missions"]
    assert total["completed"] == total["accepted"]
    assert total["share"] == 1.0


@long_without_compiler
def test_nothing_collides_while_minimum_altitude_or_clearance_is_on(result: StudyResult) -> None:
    (total,) = result.table
    assert total["collided"] == 0
    assert total["smallest_clearance_m"] > 0.1
    assert total["smallest_boulder_clearance_m"] > 0.1


@long_without_compiler
def test_the_boulder_would_be_hit_without_the_clearance_task() -> None:
    """Else a clearance kept proves nothing; the first three missions with a boulder, without the
    task.
    """
    scenarios = (random_mission(seed=seed, plant="kinematic") for seed in range(20))
    with_boulder = [scenario for scenario in scenarios if scenario.environment.obstacles][:3]
    missions = [blind(scenario) for scenario in with_boulder]
    assert any(boulder_clearance(mission, mission.run()) < 0.05 for mission in missions)


def blind(scenario: Scenario) -> Scenario:
    phases = tuple(
        replace(phase, activations={**phase.activations, "CL": 0.0})
        for phase in scenario.mission.phases
    )
    return replace(scenario, mission=replace(scenario.mission, phases=phases), duration=30.0)


@long_without_compiler
def test_what_is_refused_has_a_reason(result: StudyResult) -> None:
    assert all(row["text"] for row in result.cases)
    assert {row["cause"] for row in result.cases} <= {
        "completed",
        "refused",
        "given up",
        "stalled",
        "slow",
    }


@long_without_compiler
def test_a_mission_on_the_dynamic_plant_in_a_current_completes() -> None:
    record = random_mission(seed=1).run()
    assert record.meta.completed
    assert record["thruster_energy"][-1].sum() > 10.0


def test_the_same_seed_gives_the_same_mission() -> None:
    first = random_mission(seed=5)
    second = random_mission(seed=5)
    assert (first.start == second.start).all()
    assert first.markers == second.markers
    assert first.markers != random_mission(seed=6).markers


def test_totals_tell_failures_by_seed_and_cause() -> None:
    common = {"accepted": True, "clearance_m": 1.0, "boulder_clearance_m": None}
    rows = [
        {**common, "seed": 0, "completed": True, "cause": "completed", "text": ""},
        {**common, "seed": 1, "completed": False, "cause": "stalled", "text": "why"},
    ]
    (total,) = totals(rows)
    assert (total["share"], total["causes"]) == (0.5, "1: stalled, why")


def test_totals_count_contact_with_the_floor_and_with_the_boulder() -> None:
    common = {"accepted": True, "completed": True, "cause": "completed", "text": ""}
    clearances = ((1.0, None), (0.0, None), (0.3, -0.01), (0.3, 0.2))
    rows = []
    for k, (floor, boulder) in enumerate(clearances):
        clearance = {"clearance_m": floor, "boulder_clearance_m": boulder}
        rows.append({**common, "seed": k, **clearance})
    (total,) = totals(rows)
    assert total["collided"] == 2
    assert (total["smallest_clearance_m"], total["smallest_boulder_clearance_m"]) == (0.0, -0.01)


def test_totals_count_refused_missions_that_complete_when_forced() -> None:
    common = {"accepted": False, "clearance_m": 1.0, "boulder_clearance_m": None, "text": ""}
    rows = [
        {**common, "seed": 0, "completed": True, "cause": "completed"},
        {**common, "seed": 1, "completed": False, "cause": "stalled"},
        {**common, "seed": 2, "completed": False, "cause": "refused"},
    ]
    (total,) = totals(rows)
    assert (total["refused_and_forced"], total["of_which_completed"]) == (2, 1)
