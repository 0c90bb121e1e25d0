"""Without a guess a search begins with the cheapest of some motions over few steps, which end in
several postures of the arm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reaches import PATIENCE, reach

from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpPhase, OcpProblem
from uvms_ocp.ocp.trajectory import COARSE_STEPS, coarse_guesses, coarse_problem, hold_guess
from uvms_ocp.robot.robot import Robot
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport

SHIFTS = [
    (-0.5, -0.5, -0.5),
    (0.0, -1.0, 0.0),
]  # of the tool, which reaches there in several postures


@pytest.fixture(scope="module")
def staged(robot: Robot) -> Planner:
    return Planner(reach(robot), NlpOptions(time_limit=PATIENCE, plugin="stagewise"))


def chosen_and_stayed(given: OcpProblem, staged: Planner) -> tuple[Plan, Plan]:
    """Plans without a guess, and from where the robot stays, both solved."""
    chosen = staged.plan(given)
    stayed = staged.plan(given, guess=hold_guess(given))
    assert chosen.status is stayed.status is OcpStatus.SOLVED
    return chosen, stayed


@pytest.mark.slow
@pytest.mark.parametrize("shift", SHIFTS)
def test_a_plan_costs_less_than_one_that_begins_where_the_robot_stays(
    shift: tuple[float, float, float], robot: Robot, staged: Planner
) -> None:
    chosen, stayed = chosen_and_stayed(reach(robot, shift=shift), staged)
    assert chosen.levels[0].residual < 1e-5
    assert chosen.levels[1].residual ** 2 < 0.99 * stayed.levels[1].residual ** 2


@pytest.mark.slow
@pytest.mark.parametrize("shift", [(0.7, -0.9, 0.5), (0.4, -0.2, -0.7), (-0.3, 0.1, -0.4)])
def test_a_plan_is_no_dearer_than_from_where_the_robot_stays(
    shift: tuple[float, float, float], robot: Robot, staged: Planner
) -> None:
    """Of motions over few steps the order may be another than over all: there the best of them are
    compared once more.
    """
    chosen, stayed = chosen_and_stayed(reach(robot, shift=shift), staged)
    assert chosen.levels[1].residual ** 2 < 1.005 * stayed.levels[1].residual ** 2


@pytest.mark.slow
def test_the_search_itself_tells_of_its_own_iterations_alone(robot: Robot, staged: Planner) -> None:
    seen: list[IterationReport] = []
    plan = staged.plan(progress=seen.append)
    assert [report.iteration for report in seen] == list(range(plan.iterations + 1))


@pytest.mark.slow
def test_a_goal_out_of_reach_is_missed_by_as_much_as_from_the_start(
    robot: Robot, staged: Planner
) -> None:
    given = reach(robot, shift=(40.0, 0.0, 0.0))
    chosen, stayed = (
        staged.plan(given, guess=guess, diagnose=False) for guess in (None, hold_guess(given))
    )
    assert chosen.status is stayed.status is not OcpStatus.SOLVED
    assert chosen.levels[0].residual == pytest.approx(stayed.levels[0].residual, rel=1e-3)


def test_motions_over_few_steps_go_to_postures_all_over_the_ranges_of_the_joints(
    robot: Robot,
) -> None:
    problem = coarse_problem(reach(robot))
    assert problem.n_steps == COARSE_STEPS
    first, *others = coarse_guesses(problem)
    np.testing.assert_array_equal(first.q, hold_guess(problem).q)
    lower = robot.limits.position_lower
    upper = robot.limits.position_upper
    shares = np.array([(guess.q[-1, 7:] - lower) / (upper - lower) for guess in others])
    assert ((shares > 0.0) & (shares < 1.0)).all()
    for column in shares.T:  # each joint is sent to either half of its range, and over most of it
        assert column.min() < 0.5 < column.max()
        assert np.ptp(column) > 0.5
    places = problem.start.q[7:]
    ways = [
        np.abs(guess.q[-1, 7:] - places) / np.maximum(upper - places, places - lower)
        for guess in others
    ]
    assert (np.array(ways[1::2]) <= 0.5).all()  # every second one goes half the way
    for guess in others:
        np.testing.assert_array_equal(guess.q[0], problem.start.q)
        np.testing.assert_array_equal(guess.q[:, :7], first.q[:, :7])


def test_few_steps_are_shared_by_all_phases_and_see_the_mean_current(robot: Robot) -> None:
    phases = (
        OcpPhase(name="near", n_steps=30, duration=6.0),
        OcpPhase(name="far", n_steps=1, duration=1.0),
    )
    current = np.linspace(0.0, 0.3, 31)[:, None] * [1.0, 0.0, 0.0]
    few = coarse_problem(replace(reach(robot), phases=phases, current=current))
    assert [phase.n_steps for phase in few.phases] == [8, 1]
    assert [phase.duration for phase in few.phases] == [6.0, 1.0]
    np.testing.assert_allclose(few.current, [0.15, 0.0, 0.0])
