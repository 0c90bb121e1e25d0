"""Laws of the rounds in which a problem is solved until its rows are written where its motion is."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest
from reaches import patient, reach

from uvms_ocp.ocp.node_margins import NO_TIGHTENING, NodeMargins, Tightening
from uvms_ocp.ocp.refinement import AGREES, Reach, RefinedResult, Refinement
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.robot.robot import Robot
from uvms_ocp.solvers import NlpStatus


def test_rows_that_stay_off_shorten_the_reach_until_they_agree() -> None:
    reach_now = Reach()
    moves: list[float] = []
    for _ in range(12):
        moved = min(2.0, reach_now.radius)
        moves.append(moved)
        reach_now = reach_now.after(off=0.04, moved=moved)
    assert moves[0] == 2.0
    assert reach_now.radius == pytest.approx(2.0 * 0.5**11)


def test_rows_that_come_closer_keep_the_reach() -> None:
    far = Reach(radius=0.5, off=0.04)
    assert far.after(off=0.01, moved=0.2).radius == 0.5


def test_a_reach_that_is_in_the_way_of_rows_that_agree_grows() -> None:
    bound = Reach(radius=0.5, off=0.04).after(off=0.5 * AGREES, moved=0.5)
    assert bound.was_reached
    assert bound.radius == 1.0
    assert not bound.after(off=0.0, moved=0.7).was_reached


@pytest.mark.sampled
@pytest.mark.parametrize("plugin", ["ipopt", "stagewise"])
def test_joints_go_no_farther_than_the_reach(robot: Robot, plugin: str) -> None:
    planner = patient(reach(robot), plugin)
    hold = hold_guess(planner.problem)
    p = planner.transcription.parameters(written_at=hold.q)
    joints = robot.limited_positions

    def moved(around: tuple[np.ndarray, float] | None) -> float:
        result = planner.solve(p, hold, around=around)
        motion = planner.transcription.unpack(result.x, planner.problem)
        return float(np.abs(motion.q - hold.q)[:, joints].max())

    assert moved(None) > 0.1
    assert moved((hold.q, 0.05)) == pytest.approx(0.05, abs=1e-4)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("ended", "n_solves"), [(NlpStatus.INFEASIBLE, 2), (NlpStatus.INTERRUPTED, 1)]
)
def test_a_round_in_vain_is_solved_again_without_its_reach_unless_it_was_stopped(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, ended: NlpStatus, n_solves: int
) -> None:
    planner = patient(reach(robot))
    hold = hold_guess(planner.problem)
    refinement = Refinement(
        planner=planner, problem=planner.problem, t0=0.0, deadline=perf_counter() + 600.0
    )
    start = refinement.solved_once(hold, hold.q)
    in_vain = replace(
        start.result,
        violation=1.0,
        status=ended,
        level_status=tuple(ended for _ in start.result.level_status),
    )
    reaches: list[float] = []

    def fail(
        _: Refinement, guess: object, q: np.ndarray, more: object, radius: float = np.inf
    ) -> RefinedResult:
        reaches.append(radius)
        return replace(start, result=in_vain)

    monkeypatch.setattr(Refinement, "solved_once", fail)
    result, reach_after = refinement._next_round(
        start.result, hold.q, NO_TIGHTENING, Reach(radius=0.1), allowed_violation=1e-5
    )
    assert reaches == [0.1, np.inf][:n_solves]
    assert result.result.iterations == tuple(n_solves * n for n in start.result.iterations)
    assert np.isinf(reach_after.radius) == (n_solves == 2)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("lacks", "costs", "latest"),
    [
        ((3.0, 0.0), (1.0, 1.0), 1),
        ((3.0, 0.0), (1.0, 1.1), 1),
        ((0.0, 3.0), (1.0, 0.5), 0),
        ((0.0, 0.0), (1.0, 0.5), 1),
        ((3.0, 2.0, 0.0), (1.0, 1.0, 1.0), 2),
    ],
)
def test_of_all_restarts_the_motion_that_keeps_most_is_returned_and_of_these_the_cheapest(
    robot: Robot,
    monkeypatch: pytest.MonkeyPatch,
    lacks: tuple[float, ...],
    costs: tuple[float, ...],
    latest: int,
) -> None:
    planner = patient(reach(robot))
    hold = hold_guess(planner.problem)
    refinement = Refinement(
        planner=planner, problem=planner.problem, t0=0.0, deadline=perf_counter() + 600.0
    )
    start = refinement.solved_once(hold, hold.q)
    no_margins = np.zeros((len(hold.q), len(robot.limited_positions)))
    margins = NodeMargins(robot=robot, below=no_margins, above=no_margins)
    rounds = [
        replace(
            start,
            result=replace(start.result, violation=0.0, residuals=(np.zeros(1), np.array([cost]))),
            lack=lack,
            tightened=Tightening(positions=margins),
        )
        for lack, cost in zip(lacks, costs, strict=True)
    ]
    left = iter(rounds)

    def next_of_them(_: Refinement, guess: object, q: np.ndarray) -> RefinedResult:
        return next(left, rounds[-1])

    monkeypatch.setattr(Refinement, "_in_rounds", next_of_them)
    result = refinement.solved(hold)
    assert result.lack == lacks[latest]
    assert result.result.level_residuals[1] == costs[latest]
