"""Drawn robots: each is refused with a reason that is true, or flies, and neither flees nor
touches, nor swings unseen.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from studies.drawn_conditions import (
    GYRO_DELAY,
    OUT_OF_TRIM,
    PERIODS,
    POSITION_DELAY,
    drawn_conditions,
    out_of_trim,
)
from studies.drawn_robots import (
    OUTCOMES,
    REASONS,
    WRONGS,
    blamed_channels,
    drawn_body,
    drawn_robots,
    reason_of,
    run_robot,
    totals,
    write_robot,
)

from uvms_ocp.campaign.jobs import Row
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix, unactuated_axes

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


def rows_of(seeds: range, *, flies: bool) -> list[Row]:
    study = drawn_robots(n=len(seeds), seed=seeds.start, flies=flies)
    return [run_robot(case) for case in study.cases]


def check(rows: list[Row]) -> None:
    for row in rows:
        told = f"seed {row['seed']}: {row}"
        assert row["outcome"] in OUTCOMES[:-1], told
        assert row["outcome"] != "refused" or reason_of(row["text"]), told
        assert row["outcome"] == "accepted" or row["text"], told
        # What sensors with noise make of a vehicle that is quicker than its limits say is recorded,
        # and not promised.
        assert row["noise"] or not any(name in row["wrong"] for name in WRONGS[:3]), told


def seeds_of(n: int, joints: int, first: int) -> list[int]:
    """The first seeds of robots with so many joints at most: what has more takes long."""
    seeds = list[int]()
    for seed in count(first):
        if len(seeds) == n:
            break
        if sum(drawn_body(np.random.default_rng(seed)).arms) <= joints:
            seeds.append(seed)
    return seeds


_BARE = seeds_of(40, 0, 500)


@pytest.mark.sampled
@pytest.mark.parametrize(
    "seed", [*_BARE[:6], *(pytest.param(seed, marks=pytest.mark.slow) for seed in _BARE[6:])]
)
def test_a_drawn_robot_is_accepted_or_refused_with_a_reason(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # what runs once is not worth compiling
    monkeypatch.setattr("uvms_ocp.codegen.c_compiler.find_compiler", lambda: None)
    check(rows_of(range(seed, seed + 1), flies=False))


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds_of(20, 3, 1000))
def test_a_drawn_robot_neither_flees_nor_touches_nor_swings_unseen(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    check(rows_of(range(seed, seed + 1), flies=True))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [42, 78, 276])
def test_what_was_refused_without_need_is_flown(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lift that comes with a pitch was called none, and roll and pitch that go together no axes."""
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    (row,) = rows_of(range(seed, seed + 1), flies=True)
    assert (row["outcome"], row["wrong"]) == ("completed", ""), row


@pytest.mark.slow
def test_a_refusal_that_is_true_is_none_without_need(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    (row,) = rows_of(range(20, 21), flies=True)
    assert (row["outcome"], row["wrong"]) == ("refused", "")
    assert row["flown"].startswith("gave up")


def test_what_is_drawn_is_within_what_is_said(tmp_path: Path) -> None:
    bodies = [drawn_body(np.random.default_rng(seed)) for seed in range(200)]
    assert {len(body.arms) for body in bodies} == {0, 1, 2}
    for body in bodies:
        assert 10.0 <= body.mass <= 1500.0
        assert 4 <= body.thrusters <= 10
        assert all(1 <= joints <= 8 for joints in body.arms)
        assert 0.0 <= body.load <= 0.05 * body.mass
    rng = np.random.default_rng(2)
    body = drawn_body(rng)
    robot = write_robot(body, rng, tmp_path)
    assert len(robot.description.thrusters) == body.thrusters
    assert robot.n_joints >= sum(body.arms) > 0


def test_conditions_are_within_what_is_said_and_of_half_of_the_robots() -> None:
    conditions = [drawn_conditions(seed) for seed in range(400)]
    for drawn in conditions:
        assert PERIODS[0] <= drawn.dt <= PERIODS[1]
        assert 0.0 <= drawn.position_delay <= POSITION_DELAY
        assert 0.0 <= drawn.gyro_delay <= GYRO_DELAY
        assert 0.0 <= drawn.trim <= 1.0
    for name in ("position_delay", "gyro_delay", "trim"):
        assert 150 < sum(getattr(drawn, name) > 0.0 for drawn in conditions) < 250


def test_a_robot_out_of_trim_is_held_by_the_share_of_the_thrust_that_is_drawn(
    tmp_path: Path,
) -> None:
    n_trimmed = 0
    for seed in _BARE[:8]:
        rng = np.random.default_rng(seed)
        floating = write_robot(drawn_body(rng), rng, tmp_path)
        robot = out_of_trim(floating, replace(drawn_conditions(seed), trim=1.0), tmp_path)
        if robot is floating:
            continue
        n_trimmed += 1
        still = np.zeros(robot.n_v)
        wrench = robot_dynamics(robot).inverse_dynamics(robot.configuration(), still, still)[:6]
        driven = [axis for axis in range(6) if axis not in unactuated_axes(robot)]
        thrust = np.linalg.pinv(thruster_matrix(robot)[driven]) @ wrench[driven]
        lower, upper = thrust_limits(robot)
        largest_share = np.maximum(thrust / upper, thrust / lower).max()
        assert largest_share == pytest.approx(OUT_OF_TRIM, rel=1e-6)
    assert n_trimmed >= 4


def test_a_sensor_is_blamed_that_is_lost_unless_it_is_silent() -> None:
    texts = [
        "position lost: 17.4 times the innovation expected",
        "altimeter_range lost: no echo for 2.1 s",
        "depth suspect: 0.3 m off",
        "depth lost: silent for 3.00 s; angular_velocity lost: 2 rad/s off the estimate",
    ]
    assert blamed_channels(texts) == ["angular_velocity", "position"]


@pytest.mark.parametrize("reason", REASONS)
def test_a_reason_is_found_in_what_is_said(reason: str) -> None:
    assert reason_of(f"PC: {REASONS[reason]} so") == reason


def test_totals_count_each_robot_once_by_its_arms_and_once_among_all() -> None:
    rows = [
        {"joints": "", "outcome": "completed", "wrong": ""},
        {"joints": "3", "outcome": "gave up", "wrong": "flees"},
        {"joints": "2+4", "outcome": "refused", "wrong": ""},
    ]
    total = {row["arms"]: row for row in totals(rows)}
    assert [total[arms]["robots"] for arms in ("none", "one", "two", "all")] == [1, 1, 1, 3]
    assert (total["all"]["completed"], total["one"]["flees"], total["two"]["refused"]) == (1, 1, 1)
