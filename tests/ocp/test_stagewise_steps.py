"""Laws of steps from stage to stage: which of them a filter lets pass, and the way back to rows
that no linear step keeps.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from reaches import PATIENCE

from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.stagewise.filter import Filter, FilterMerit
from uvms_ocp.ocp.stagewise.sqp import StageSqp
from uvms_ocp.ocp.terms import At, Effort, residual_term
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions


def test_a_filter_refuses_what_a_point_before_beats_in_cost_and_violation() -> None:
    point_filter = Filter(first_violation=1.0, largest_violation=10.0)
    merit = FilterMerit(cost=1.0, violation=1e-2)
    point_filter.entries.append(merit)
    assert not point_filter.accepts(FilterMerit(cost=1.1, violation=2e-2), merit, 0.0, 1.0)
    assert not point_filter.accepts(FilterMerit(cost=0.0, violation=11.0), merit, 0.0, 1.0)
    assert point_filter.accepts(FilterMerit(cost=1.1, violation=5e-3), merit, 0.0, 1.0)
    assert point_filter.accepts(FilterMerit(cost=0.9, violation=2e-2), merit, 0.0, 1.0)


@pytest.mark.parametrize("violation", [1.0, 1e-4, 1e-9])
def test_a_filter_allows_no_rise_of_the_cost_for_a_hair_of_a_violation(violation: float) -> None:
    point_filter = Filter(first_violation=1.0, largest_violation=10.0)
    merit = FilterMerit(cost=1.0, violation=violation)
    is_accepted = point_filter.accepts(FilterMerit(cost=1.01, violation=0.0), merit, 0.0, 1.0)
    assert is_accepted == (violation > 1e-6)


@pytest.mark.parametrize("cost", [0.0, 1.0, 1e6])
def test_a_filter_takes_a_worse_cost_of_a_point_without_violation_for_rounding_alone(
    cost: float,
) -> None:
    point_filter = Filter(first_violation=0.0, largest_violation=1.0)
    merit = FilterMerit(cost=cost, violation=0.0)
    for share, passes in ((0.5e-13, True), (1e-12, False)):
        trial = FilterMerit(cost=cost + share * max(1.0, cost), violation=1e-13)
        assert point_filter.accepts(trial, merit, 0.0, 1.0) == passes
        assert not point_filter.accepts(
            FilterMerit(cost=trial.cost, violation=1e-9), merit, 0.0, 1.0
        )


def test_a_level_that_others_follow_ends_where_no_step_is_worth_one_and_the_last_one_tries_for_a_while() -> (
    None
):
    merit = FilterMerit(cost=1.0, violation=0.0)
    above, last = (steps_of_level(level) for level in (0, 1))
    assert above._is_flat(merit, 1e-20)
    assert not last._is_flat(merit, 1e-20)
    above._count = last._count = 10_000
    assert above._is_flat(merit, 1e-20)
    assert last._is_flat(merit, 1e-20)
    assert not above._is_flat(merit, 1.0)
    assert not last._is_flat(merit, 1.0)


def steps_of_level(level: int) -> StageSqp:
    """Of one of two, before its first iteration, where all rows are kept."""
    memory = SimpleNamespace(z=np.zeros(1), n_levels=2)
    steps = StageSqp(SimpleNamespace(memory=memory, level=level), None, NlpOptions(), None, None)  # type: ignore[arg-type]
    steps._worst = 0.0
    steps._count = 1
    return steps


def test_a_plan_from_itself_takes_no_iteration() -> None:
    problem = turn_of_arm(0.5)
    planner = Planner(problem, NlpOptions(time_limit=PATIENCE, plugin="stagewise"))
    plan = planner.plan()
    again = planner.plan(guess=plan)
    assert plan.status is again.status is OcpStatus.SOLVED
    assert plan.iterations > 0
    assert again.iterations == 0


def turn_of_arm(theta1: float) -> OcpProblem:
    """A joint that has turned so far that its square is 0.3 or more at the end, with little
    effort.
    """
    arm = load_robot("planar5")
    bent = residual_term(
        "bent", lambda stage: stage.tick.q[3] ** 2, lower=0.3, upper=np.inf, at=At.END
    )
    return single_phase(
        robot=arm,
        start=State(q=arm.configuration(joints={"theta1": theta1}), v=np.zeros(arm.n_v)),
        duration=4.0,
        n_steps=4,
        levels=[OcpLevel(name="effort", terms=(Effort(),))],
        constraints=(bent,),
        water=False,
    )


def test_rows_that_no_linear_step_within_the_limits_keeps_are_reached_by_several() -> None:
    """Where the slope is small a step to the rows would have to be longer than joints can turn."""
    plan = Planner(turn_of_arm(0.02), NlpOptions(time_limit=PATIENCE, plugin="stagewise")).plan(
        diagnose=False
    )
    assert plan.status is OcpStatus.SOLVED, plan.reason
    assert plan.trajectory.q[-1, 3] ** 2 == pytest.approx(0.3, abs=1e-6)
