"""Laws of verdicts: what cannot be planned is told with its reason, and nothing is claimed without
proof.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest
from reaches import CHEAP, PATIENCE, patient, reach, tool_goal

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.diagnosis import Diagnosis
from uvms_ocp.ocp.first_order_gain import level_residuals
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import Actuation, OcpLevel, single_phase
from uvms_ocp.ocp.start_checks import impossible_start
from uvms_ocp.ocp.terms import (
    At,
    AtRest,
    Duration,
    Effort,
    Energy,
    Posture,
    Smoothness,
    StageSymbols,
    TaskTerm,
    Term,
    residual_term,
)
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.ocp.verdict import Verdict, judge_motion
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.solvers.nlp.program import NlpStatus
from uvms_ocp.tasks.task import Residual, zero_residual


@pytest.mark.slow
def test_a_horizon_that_is_too_short_says_how_long_it_should_be(
    planner_of_each: Planner, robot: Robot
) -> None:
    plan = planner_of_each.plan(reach(robot, duration=1.2))
    assert plan.status is OcpStatus.TOO_SHORT
    assert "level 'tool' is missed by" in plan.reason
    assert "would do" in plan.reason


@pytest.mark.sampled
@pytest.mark.parametrize("weight", [1.0, 1e-8])
def test_a_goal_out_of_reach_of_a_fixed_arm_is_unreachable_whatever_its_weight(
    weight: float, plugin: str
) -> None:
    robot = load_robot("planar5")
    q = robot.configuration()
    goal = TaskTerm(task=tool_goal(robot, q, (0.0, 0.0, 2.0)), weight=weight)
    problem = single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=4.0,
        n_steps=10,
        levels=[OcpLevel(name="tool", terms=(goal,)), OcpLevel(name="effort", terms=(Effort(),))],
        water=False,
    )
    plan = patient(problem, plugin).plan()
    assert plan.status is OcpStatus.UNREACHABLE
    assert "more time does not help" in plan.reason
    assert np.isfinite(plan.trajectory.q).all()


def test_a_start_inside_an_obstacle_is_reported_at_once(robot: Robot) -> None:
    ball = Ball(frame="base_link", radius=0.9)
    clearance = BallClearance(
        robot_balls=(ball,), obstacles=(Ball(centre=(0.5, 0.0, -5.0), radius=0.3),)
    )
    plan = patient(reach(robot, constraints=(AtRest(), clearance))).plan()
    assert plan.status is OcpStatus.OBSTRUCTED
    assert "clearance is broken by" in plan.reason


def test_a_constraint_that_is_no_number_at_the_start_is_not_called_an_obstacle(plugin: str) -> None:
    robot = load_robot("planar5")
    rows = residual_term(
        "root", lambda stage: ca.sqrt(stage.tick.q[0] - 50.0), upper=1.0, at=At.PATH
    )
    problem = single_phase(
        robot=robot,
        start=State(q=robot.configuration(), v=np.zeros(robot.n_v)),
        duration=4.0,
        n_steps=2,
        levels=[OcpLevel(name="effort", terms=(Effort(),))],
        constraints=(rows,),
        water=False,
    )
    plan = Planner(problem, NlpOptions(time_limit=PATIENCE, plugin=plugin)).plan()
    assert plan.status is OcpStatus.UNFINISHED
    assert "not a number: at the start root" in plan.reason


def test_a_start_that_is_too_fast_for_the_limits_is_proven_impossible(
    planner: Planner, robot: Robot
) -> None:
    tumbling = np.zeros(robot.n_v)
    tumbling[4] = 5.0
    plan = planner.plan(
        replace(planner.problem, start=State(q=planner.problem.start.q, v=tumbling))
    )
    assert plan.status is OcpStatus.INFEASIBLE
    assert "pitch rate starts at 5" in plan.reason
    assert plan.iterations == 0
    assert np.isfinite(plan.trajectory.q).all()


def test_a_joint_that_runs_into_its_stop_is_proven_impossible(
    planner: Planner, robot: Robot
) -> None:
    q = planner.problem.start.q.copy()
    v = np.zeros(robot.n_v)
    joint = 3
    q[7 + joint] = robot.limits.position_upper[joint] - 1e-3
    v[6 + joint] = robot.limits.velocity[6 + joint]
    plan = planner.plan(replace(planner.problem, start=State(q=q, v=v)))
    assert plan.status is OcpStatus.INFEASIBLE
    assert "'joint4'" in plan.reason
    assert "first step" in plan.reason


@pytest.mark.sampled
def test_the_limits_of_the_first_step_condemn_no_start_that_has_a_plan(
    planner_of_each: Planner, robot: Robot
) -> None:
    moving = np.zeros(robot.n_v)
    moving[0] = 0.3
    moving[9] = 0.2
    problem = replace(
        planner_of_each.problem, start=State(q=planner_of_each.problem.start.q, v=moving)
    )
    assert planner_of_each.plan(problem).status is OcpStatus.SOLVED
    assert impossible_start(problem) is None


@pytest.mark.slow
def test_a_current_that_thrusters_cannot_hold_against_names_level_and_constraint(
    robot: Robot, plugin: str
) -> None:
    problem = reach(robot, current=np.array([3.0, 0.0, 0.0]), n_steps=10)
    plan = Planner(problem, NlpOptions(time_limit=10.0, plugin=plugin)).plan()
    assert plan.status in (OcpStatus.INFEASIBLE, OcpStatus.UNFINISHED)
    assert "level 'tool'" in plan.reason
    assert "broken by" in plan.reason
    assert "loosen" in plan.advice
    assert np.isfinite(plan.trajectory.q).all()


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.02, 0.6])
def test_the_time_limit_holds_for_the_whole_plan_without_a_nan(
    robot: Robot, planner_of_each: Planner, limit: float
) -> None:
    far = TaskTerm(task=tool_goal(robot, planner_of_each.problem.start.q, (100.0, 0.0, 0.0)))
    problem = reach(robot, levels=[OcpLevel(name="tool", terms=(far,)), CHEAP])
    plan = Planner(
        problem,
        NlpOptions(time_limit=limit, max_iterations=3000, plugin=planner_of_each.options.plugin),
    ).plan()
    assert plan.status in (OcpStatus.UNFINISHED, OcpStatus.MISSED, OcpStatus.TOO_SHORT)
    assert plan.iterations < 3000
    assert np.isfinite(plan.trajectory.q).all()


@pytest.mark.slow
def test_a_limit_of_iterations_is_no_proof_of_infeasibility(robot: Robot, plugin: str) -> None:
    """Rounds over what is missing between nodes may bring it to the goal, but not to the optimum."""
    plan = Planner(
        reach(robot), NlpOptions(time_limit=PATIENCE, max_iterations=3, plugin=plugin)
    ).plan()
    assert plan.status in (OcpStatus.UNFINISHED, OcpStatus.IMPROVABLE)
    assert "iteration limit" in plan.reason


@pytest.mark.slow
def test_a_missed_goal_is_not_called_unreachable_before_more_time_was_tried(
    planner_of_each: Planner, robot: Robot
) -> None:
    assert (
        planner_of_each.plan(reach(robot, duration=1.2), diagnose=False).status is OcpStatus.MISSED
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Far(Term):
    """A row that nothing can bring to zero."""

    @property
    def name(self) -> str:
        return "far"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(stage.tick.q[0] ** 2 + 1.0)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fee(Far):
    """The same as a cost."""

    is_goal: ClassVar[bool] = False


@pytest.mark.parametrize(("term", "status"), [(Far(), OcpStatus.MISSED), (Fee(), OcpStatus.SOLVED)])
def test_a_goal_can_be_missed_and_a_cost_cannot(term: Term, status: OcpStatus, plugin: str) -> None:
    robot = load_robot("planar5")
    problem = single_phase(
        robot=robot,
        start=State(q=robot.configuration(), v=np.zeros(robot.n_v)),
        duration=2.0,
        n_steps=4,
        levels=[OcpLevel(name="it", terms=(term, Effort(weight=0.01)))],
        water=False,
    )
    assert patient(problem, plugin).plan(diagnose=False).status is status


def test_costs_of_the_package_are_no_goals(robot: Robot) -> None:
    costs = (Effort(), Energy(), Smoothness(), Duration(), Posture(q=robot.configuration()))
    assert not any(term.is_goal for term in costs)
    assert [term.name for term in costs if term.minimises_time] == ["duration"]


def test_a_level_that_minimises_time_must_leave_the_lower_ones_some(robot: Robot) -> None:
    fast = OcpLevel(name="fast", terms=(Duration(),))
    slow = OcpLevel(name="cheap", terms=(Effort(),))
    with pytest.raises(InvalidInput, match="level 'fast' minimises time: give it `relax`"):
        reach(robot, levels=[fast, slow])
    assert reach(robot, levels=[replace(fast, relax=0.01), slow]).levels[0].relax == 0.01


def test_electrical_power_that_is_not_known_is_neither_minimised_nor_reported_as_none(
    robot: Robot,
) -> None:
    cheap = [OcpLevel(name="cheap", terms=(Energy(),))]
    with pytest.raises(InvalidInput, match="energy: the power of a wrench is not known"):
        reach(robot, levels=cheap, actuation=Actuation.WRENCH)
    thrusters = tuple(
        item.model_copy(update={"power": None}) for item in robot.description.thrusters
    )
    mute = replace(robot, description=robot.description.model_copy(update={"thrusters": thrusters}))
    with pytest.raises(InvalidInput, match="energy: no power is given for thruster"):
        reach(mute, levels=cheap)
    for machine, actuation in (
        (robot, Actuation.WRENCH),
        (mute, Actuation.THRUSTERS),
        (robot, Actuation.THRUSTERS),
    ):
        known = machine is robot and actuation is Actuation.THRUSTERS
        guess = hold_guess(reach(machine, actuation=actuation))
        plan = Plan(
            robot=machine,
            trajectory=guess,
            status=OcpStatus.SOLVED,
            reason="",
            levels=(),
            solve_time=0.0,
        )
        assert (plan.energy is None) != known
        assert (plan.summary()["energy"] is None) != known
        assert np.isnan(plan.powers()[0]).all() != known


def judged_by_values(planner: Planner, result: LexicographicResult) -> Verdict:
    """The verdict on its motion, with the residual of the first level by the values it claims."""
    transcription = planner.transcription
    motion = transcription.unpack(result.x, planner.problem)
    verdict = judge_motion(planner.problem, motion, transcription=transcription)
    residual = level_residuals(transcription, planner.problem, result.values, motion.t)[0]
    if residual < 1e-3:
        return verdict
    first, *others = verdict.report.levels
    first = first.model_copy(update={"residual": residual, "missed": True, "optimal": True})
    report = verdict.report.model_copy(update={"levels": (first, *others)})
    return replace(verdict, status=OcpStatus.MISSED, report=report)


def judge_of(planner: Planner, *trials: LexicographicResult) -> Diagnosis:
    """That of its plans, to which longer horizons end as given; without them there is no time left
    to try any.
    """
    left = iter(trials)
    return Diagnosis(
        transcription=planner.transcription,
        problem=planner.problem,
        p=planner.transcription.parameters(),
        feasibility=1e-4,
        solve=lambda problem, start, limit: next(left),
        judge=lambda result: judged_by_values(planner, result),
        deadline=perf_counter() + PATIENCE if trials else None,
    )


@pytest.fixture(scope="module")
def turning() -> tuple[Planner, LexicographicResult]:
    """A joint to be turned back to its start, and the result, in which nothing is missed."""
    arm = load_robot("planar5")
    turn = residual_term("turn", lambda stage: stage.tick.q[3], at=At.END)
    problem = single_phase(
        robot=arm,
        start=State(q=arm.configuration(), v=np.zeros(arm.n_v)),
        duration=2.0,
        n_steps=2,
        levels=[OcpLevel(name="turn", terms=(turn,)), OcpLevel(name="effort", terms=(Effort(),))],
        constraints=(AtRest(),),
        water=False,
    )
    planner = patient(problem)
    result = planner.plan(diagnose=False).result
    assert result is not None
    return planner, result


def test_constraints_that_are_broken_though_all_levels_ended_well_are_told_of_the_last_one(
    turning: tuple[Planner, LexicographicResult],
) -> None:
    planner, result = turning
    found = judge_of(planner).verdict(replace(result, x=result.x + 0.1, violation=0.1))
    assert found.status is OcpStatus.UNFINISHED
    assert found.reason.startswith("level 'effort': solved with ")
    assert "broken by" in found.reason


def test_a_longer_horizon_that_ends_badly_keeps_none_from_being_tried_that_is_longer_still(
    turning: tuple[Planner, LexicographicResult],
) -> None:
    planner, met = turning
    missed = replace(met, values=(met.values[0] + 0.5, *met.values[1:]))
    astray = replace(met, violation=1.0)
    found = judge_of(planner, astray, met).verdict(missed)
    assert found.status is OcpStatus.TOO_SHORT, found.reason
    assert "8 s would do" in found.reason
    found = judge_of(planner, astray, missed).verdict(missed)
    assert found.status is OcpStatus.MISSED, found.reason
    assert "a horizon of 4 s was tried in vain" in found.reason
    found = judge_of(planner, missed, missed).verdict(missed)
    assert found.status is OcpStatus.UNREACHABLE, found.reason


def test_a_horizon_that_nobody_had_time_to_try_is_not_said_to_have_been_tried(
    turning: tuple[Planner, LexicographicResult],
) -> None:
    planner, met = turning
    missed = replace(met, values=(met.values[0] + 0.5, *met.values[1:]))
    late = replace(judge_of(planner, met), deadline=perf_counter())
    found = late.verdict(missed)
    assert found.status is OcpStatus.MISSED, found.reason
    assert "no time was left to try a horizon of 4 s" in found.reason
    assert "in vain" not in found.reason


def test_a_longer_motion_that_meets_the_goal_shows_that_time_lacks_though_it_is_not_yet_the_best(
    turning: tuple[Planner, LexicographicResult],
) -> None:
    planner, met = turning
    missed = replace(met, values=(met.values[0] + 0.5, *met.values[1:]))
    cut_short = replace(met, level_status=(NlpStatus.TIME_LIMIT, NlpStatus.SKIPPED))
    found = judge_of(planner, cut_short).verdict(missed)
    assert found.status is OcpStatus.TOO_SHORT, found.reason
    assert "4 s would do" in found.reason
