"""Laws of plans by every solver: optimality by the derivatives of the sparse program, levels that
keep what they have, prices.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from reaches import CHEAP, patient, reach, tool_goal
from same_words import require_same_words

from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.problem import Actuation, OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Effort, Posture, TaskTerm
from uvms_ocp.ocp.trajectory import admissible, hold_guess
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import PLUGINS
from uvms_ocp.tasks.pose import VehiclePose

TOLERANCE = 1e-6  # of `NlpOptions`
N = 8


def vehicle_level(problem: OcpProblem) -> OcpLevel:
    q = problem.start.q
    stay = VehiclePose(goal=pin.SE3(pin.Quaternion(q[3:7]).matrix(), q[:3]))
    return OcpLevel(name="vehicle", terms=(TaskTerm(task=stay),))


@pytest.fixture(scope="module")
def in_conflict(robot: Robot) -> OcpProblem:
    """The tool has its goal where the vehicle would have to leave its own."""
    problem = reach(robot, n_steps=N)
    return replace(problem, levels=(problem.levels[0], vehicle_level(problem), CHEAP))


@pytest.fixture(scope="module")
def transcription(in_conflict: OcpProblem) -> Transcription:
    return Transcription(in_conflict)


@pytest.fixture(scope="module")
def plan(in_conflict: OcpProblem, plugin: str) -> Plan:
    return patient(in_conflict, plugin).plan(diagnose=False)


@pytest.fixture(scope="module")
def by_ipopt(in_conflict: OcpProblem) -> Plan:
    return patient(in_conflict).plan(diagnose=False)


def on_arm(n_levels: int) -> OcpProblem:
    """A tool's goal out of reach, a posture that is none of those nearest to it, and least
    effort.
    """
    arm = load_robot("planar5")
    q = arm.configuration()
    tool = OcpLevel(name="tool", terms=(TaskTerm(task=tool_goal(arm, q, (0.0, 0.0, 2.0))),))
    posture = OcpLevel(name="posture", terms=(Posture(q=q + 0.3),))
    return single_phase(
        robot=arm,
        start=State(q=q, v=np.zeros(arm.n_v)),
        duration=4.0,
        n_steps=N,
        levels=[tool, posture, OcpLevel(name="effort", terms=(Effort(),))][:n_levels],
        constraints=(AtRest(),),
        water=False,
    )


def stationarity(transcription: Transcription, plan: Plan, level: int) -> float:
    """What of the gradient of a level's cost the multipliers of inequalities leave, and laws and
    equalities cannot take.

    Relative to the gradient, or 1. Multipliers of equalities are those that leave least.
    """
    point = plan.result.points[level]
    nlp = transcription.program.nlps[level]
    p = transcription.parameters()
    _, gradient = (np.array(part).ravel() for part in nlp.functions["nlp_grad_f"](point.x, p))
    J = np.array(nlp.functions["nlp_jac_g"](point.x, p)[1])
    left = gradient + point.x_multipliers + J.T @ point.row_multipliers[nlp.rows]
    equal = transcription.ranges().lower == transcription.ranges().upper
    own = J[: len(equal)][equal]
    rest = left - own.T @ np.linalg.lstsq(own.T, left, rcond=None)[0]
    return float(np.abs(rest).max() / max(1.0, np.abs(gradient).max()))


@pytest.mark.slow
@pytest.mark.parametrize("level", [0, 1])
def test_a_level_that_is_solved_is_stationary_by_the_derivatives_of_the_sparse_program(
    plan: Plan, transcription: Transcription, level: int
) -> None:
    assert plan.levels[level].status == "solved"
    assert plan.result.violation < 1e-6
    assert stationarity(transcription, plan, level) < 1e-4


@pytest.mark.sampled
def test_no_level_rises_by_more_than_the_tolerance_where_levels_are_added_below(
    plugin: str,
) -> None:
    plans = [patient(on_arm(n), plugin).plan(diagnose=False) for n in (1, 2, 3)]
    assert min(level.residual for level in plans[2].levels) > 0.01  # none has all it wants
    for fewer, more in pairwise(plans):
        for alone, with_more in zip(fewer.levels, more.levels, strict=False):
            # Two solves agree to so many digits.
            assert with_more.residual <= (1.0 + 1e-4) * alone.residual + TOLERANCE


@pytest.mark.slow
def test_levels_that_exclude_each_other_end_where_ipopt_ends(plan: Plan, by_ipopt: Plan) -> None:
    assert plan.status is by_ipopt.status is OcpStatus.MISSED
    assert plan.levels[0].residual < 2 * TOLERANCE
    assert plan.levels[1].residual == pytest.approx(by_ipopt.levels[1].residual, rel=1e-5)
    require_same_words(plan.reason, by_ipopt.reason)


@pytest.mark.slow
def test_a_level_costs_those_below_what_ipopt_says(plan: Plan, by_ipopt: Plan) -> None:
    for own, theirs in zip(plan.levels[:2], by_ipopt.levels, strict=False):
        assert own.prices == pytest.approx(theirs.prices, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("plugin", PLUGINS[1:])
@pytest.mark.parametrize(
    "options",
    [{"actuation": Actuation.WRENCH}, {"current": np.array([0.1, 0.0, 0.0])}],
    ids=["wrench", "current"],
)
def test_a_goal_costs_effort_what_ipopt_says(
    robot: Robot, options: dict[str, object], plugin: str
) -> None:
    own, theirs = (
        patient(reach(robot, n_steps=N, **options), name).plan(diagnose=False)
        for name in (plugin, "ipopt")
    )
    assert len(own.levels[1].prices) == 1
    assert own.levels[1].residual == pytest.approx(theirs.levels[1].residual, rel=1e-5)
    assert own.levels[1].prices == pytest.approx(theirs.levels[1].prices, rel=1e-3)


@pytest.mark.parametrize("beyond", [9e-6, 1e-2])
def test_what_a_solver_passes_a_limit_by_within_its_tolerance_is_no_part_of_its_plan(
    beyond: float, robot: Robot
) -> None:
    problem = reach(robot)
    guess = hold_guess(problem)
    q = guess.q.copy()
    lowest = robot.limits.position_lower[0]
    place = robot.joints[0].q.start
    q[3, place] = lowest - beyond
    q[3, 3:7] *= 1.0 + 1e-6
    kept = admissible(replace(guess, q=q), robot)
    assert np.linalg.norm(kept.q[3, 3:7]) == pytest.approx(1.0, abs=1e-15)
    assert kept.q[3, place] == (lowest if beyond < 1e-4 else q[3, place]), (
        "a limit that is broken stays so"
    )
    np.testing.assert_allclose(
        np.delete(kept.q[3], place), np.delete(guess.q[3], place), atol=1e-15
    )
