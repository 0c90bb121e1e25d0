"""Drawn faults of sensors: each strikes a channel that its robot has, and its row says whom the robot blames."""

from __future__ import annotations

import numpy as np
import pytest
from compiler import long_without_compiler
from recording.rows import column
from studies.drawn_faults import (
    KINDS,
    LONGEST_ONSET,
    ONSET,
    ROBOTS,
    STRENGTHS,
    DrawnFault,
    Sway,
    drawn_fault,
    run_drawn_fault,
    totals,
)

from uvms_ocp.sim.faults import parse_fault

DRAWN = [drawn_fault(seed) for seed in range(300)]


def test_every_robot_channel_and_kind_is_drawn_with_its_times() -> None:
    assert {drawn.robot for drawn in DRAWN} == set(ROBOTS)
    assert {drawn.channel for drawn in DRAWN} == set(STRENGTHS)
    assert {drawn.kind for drawn in DRAWN} == set(KINDS)
    for drawn in DRAWN:
        fault = parse_fault(drawn.text)
        assert (fault.target, fault.kind) == (drawn.channel, drawn.kind)
        assert (fault.onset, fault.end) == (drawn.onset, drawn.end)
        assert ONSET <= fault.onset <= ONSET + LONGEST_ONSET


def test_what_has_no_sensor_of_joint_rates_is_struck_in_none() -> None:
    for drawn in DRAWN:
        assert drawn.has_joint_rates or not drawn.channel.startswith("joint")


def test_a_sway_has_the_rate_that_it_moves_with() -> None:
    h = 1e-5
    sway = Sway()
    for t in (0.0, 1.0, 7.0, 20.0):
        before, _ = sway(t)
        after, _ = sway(t + h)
        _, rate = sway(t + 0.5 * h)
        np.testing.assert_allclose(
            (after.translation - before.translation) / h, rate[:3], atol=1e-6
        )


@pytest.mark.slow
@long_without_compiler
def test_a_lost_channel_is_named_and_no_other() -> None:
    seed = next(seed for seed, drawn in enumerate(DRAWN) if _is_short(drawn))
    row = run_drawn_fault({"seed": seed})
    assert row["outcome"] == "named"
    assert row["passed"]
    (total,) = [total for total in totals([row]) if total["faults"] == "all"]
    assert (total["named"], total["passed"], total["sound_lost"]) == (1, 1, 0)
    assert column([row], "blamed") == [row["channel"]]


def _is_short(drawn: DrawnFault) -> bool:
    return drawn.kind == "lost" and drawn.dt == 0.05 and drawn.robot == "bluerov2"
