"""Random missions: the quick run takes ten of the two hundred, which `uvms-ocp run random_missions` makes."""

from __future__ import annotations

import pytest

from uvms_ocp.campaign import random_missions
from uvms_ocp.campaign.random_missions import random_mission, totals
from uvms_ocp.campaign.study import StudyResult


@pytest.fixture(scope="module")
def result() -> StudyResult:
    return random_missions(n=10, plant="kinematic").run()


def test_what_pre_flight_accepts_completes(result: StudyResult) -> None:
    (total,) = result.table
    assert total["missions"] == 10
    assert total["accepted"] >= 3
    assert total["share"] >= 0.95


def test_nothing_collides_while_the_minimum_altitude_is_on(result: StudyResult) -> None:
    (total,) = result.table
    assert total["collided"] == 0
    assert total["smallest_clearance_m"] > 0.5


def test_what_is_refused_has_a_reason(result: StudyResult) -> None:
    assert all(row["text"] for row in result.cases)
    assert {row["cause"] for row in result.cases} <= {"completed", "refused", "given up", "stalled", "slow"}


def test_a_mission_on_the_dynamic_plant_in_a_current_completes() -> None:
    record = random_mission(seed=1).run()
    assert record.meta["completed"]
    assert record["thruster_energy"][-1].sum() > 10.0


def test_the_same_seed_gives_the_same_mission() -> None:
    first, second = random_mission(seed=5), random_mission(seed=5)
    assert (first.start == second.start).all()
    assert first.markers == second.markers
    assert first.markers != random_mission(seed=6).markers


def test_totals_tell_failures_by_seed_and_cause() -> None:
    common = {"accepted": True, "clearance_m": 1.0}
    rows = [
        {**common, "seed": 0, "completed": True, "cause": "completed", "text": ""},
        {**common, "seed": 1, "completed": False, "cause": "stalled", "text": "why"},
    ]
    (total,) = totals(rows)
    assert (total["share"], total["causes"]) == (0.5, "1: stalled, why")
