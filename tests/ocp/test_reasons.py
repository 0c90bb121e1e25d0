"""Laws of reasons: a problem that cannot be solved names what makes it so, and what would have to
change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from reaches import CHEAP, PATIENCE, reach, tool_goal

from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.bound_groups import BoundGroup, GroupIndex, RelaxationUnit
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.relaxation import _constraint_rows, _ElasticProgram, bindings, phase_one
from uvms_ocp.ocp.terms import At, AtRest, Effort, StageSymbols, TaskTerm, Term, residual_term
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.pose import ToolPose

N = 10
MISSES = (OcpStatus.MISSED, OcpStatus.TOO_SHORT, OcpStatus.UNREACHABLE)
Case = tuple[OcpProblem, tuple[OcpStatus, ...], str]
"""A problem, what may be said of it, and the cause that is to be named first."""


def level(task: Term) -> OcpLevel:
    return OcpLevel(name="goal", terms=(task,))


def posed(robot: Robot, shift: tuple[float, float, float], **options: object) -> OcpProblem:
    """Of the tool, moved without a turn."""
    q = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))
    tool = Kinematics(robot, q).pose("tool")
    goal = ToolPose(goal=pin.SE3(tool.rotation, tool.translation + np.array(shift)))
    return reach(robot, levels=[level(TaskTerm(task=goal)), CHEAP], n_steps=N, **options)


def along(robot: Robot, name: str, lower: float, upper: float, at: At = At.PATH) -> Term:
    return residual_term(name, lambda stage: stage.tick.q[0], lower=lower, upper=upper, at=at)


def goal_in_an_obstacle(robot: Robot) -> Case:
    problem = posed(robot, (1.0, -0.5, -0.6))
    place = Kinematics(robot, problem.start.q).pose("tool").translation + np.array(
        [1.05, -0.48, -0.57]
    )
    clear = BallClearance(
        robot_balls=(Ball(frame="tool", radius=0.1),),
        obstacles=(Ball(centre=tuple(place.tolist()), radius=0.3),),
    )
    return replace(problem, constraints=(AtRest(), clear)), MISSES, "constraint 'clearance'"


def goal_out_of_reach_of_a_fixed_base(robot: Robot) -> Case:
    arm = load_robot("planar5")
    q = arm.configuration()
    goal = TaskTerm(task=tool_goal(arm, q, (0.0, 0.0, 2.0)))
    return on_arm(arm, q, goal, 4.0), (OcpStatus.UNREACHABLE,), "the robot does not get nearer"


def on_arm(arm: Robot, q: np.ndarray, goal: Term, duration: float) -> OcpProblem:
    levels = [level(goal), OcpLevel(name="effort", terms=(Effort(),))]
    start = State(q=q, v=np.zeros(arm.n_v))
    return single_phase(
        robot=arm,
        start=start,
        duration=duration,
        n_steps=N,
        levels=levels,
        constraints=(AtRest(),),
        water=False,
    )


def tether_too_short(robot: Robot) -> Case:
    q = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))
    anchor = Kinematics(robot, q).pose("tool").translation

    def length(stage: StageSymbols) -> ca.SX:
        return ca.sqrt(ca.sumsqr(stage.tick.kinematics.pose("tool")[1] - ca.DM(anchor)) + 1e-9)

    tether = residual_term("tether", length, lower=-np.inf, upper=0.7, at=At.PATH)
    return (
        posed(robot, (1.0, -0.5, -0.6), constraints=(AtRest(), tether)),
        MISSES,
        "constraint 'tether'",
    )


def thrust_too_weak_for_the_current(robot: Robot) -> Case:
    return (
        reach(robot, current=np.array([3.0, 0.0, 0.0]), n_steps=N),
        (OcpStatus.INFEASIBLE,),
        "the thrust limits",
    )


def torque_too_weak_to_lift(robot: Robot) -> Case:
    arm = load_robot("planar5")
    model = arm.model.copy()
    model.gravity = pin.Motion(np.array([0.0, -9.81, 0.0, 0.0, 0.0, 0.0]))
    q = arm.configuration()
    needed = np.abs(pin.computeGeneralizedGravity(model, model.createData(), q))
    effort = np.where(np.arange(arm.n_v) < 3, 1e3, 0.5 * needed)
    weak = replace(arm, model=model, limits=replace(arm.limits, effort=effort))
    goal = TaskTerm(task=JointTracking(joints=("theta1", "theta2"), goal=q[3:]))
    return on_arm(weak, q, goal, 3.0), (OcpStatus.INFEASIBLE, *MISSES), "the torque limits"


def goal_beyond_joint_limits(robot: Robot) -> Case:
    goal = JointTracking(joints=robot.joint_names, goal=robot.limits.position_upper + 0.3)
    problem = reach(robot, levels=[level(TaskTerm(task=goal)), CHEAP], n_steps=N)
    return problem, MISSES, "the joint limits"


def horizon_too_short(robot: Robot) -> Case:
    return reach(robot, duration=1.2, n_steps=N), (OcpStatus.TOO_SHORT,), "the acceleration limits"


def too_fast_to_stop(robot: Robot) -> Case:
    v = np.zeros(robot.n_v)
    v[0] = 0.9 * robot.limits.velocity[0]
    start = State(q=robot.configuration(position=(0, 0, -5)), v=v)
    wall = along(robot, "wall", -np.inf, 0.02)
    return (
        reach(robot, start=start, constraints=(AtRest(), wall), n_steps=N),
        (OcpStatus.INFEASIBLE,),
        "constraint 'wall'",
    )


def contradictory_constraints(robot: Robot) -> Case:
    left = along(robot, "left", -np.inf, -0.2, At.END)
    right = along(robot, "right", 0.2, np.inf, At.END)
    problem = reach(robot, constraints=(AtRest(), left, right), n_steps=N)
    return problem, (OcpStatus.INFEASIBLE,), "constraint 'right'"


def floor_above_the_goal(robot: Robot) -> Case:
    keep = TaskTerm(task=MinimumAltitude(threshold=1.0), at=At.PATH)
    # what comes as near as it can is thrown about between nodes
    return (
        posed(robot, (0.5, 0.0, -2.5), floor=-6.5, constraints=(AtRest(), keep)),
        (*MISSES, OcpStatus.BROKEN),
        "constraint 'MAC'",
    )


CASES: tuple[Callable[[Robot], Case], ...] = (
    goal_in_an_obstacle,
    goal_out_of_reach_of_a_fixed_base,
    tether_too_short,
    thrust_too_weak_for_the_current,
    torque_too_weak_to_lift,
    goal_beyond_joint_limits,
    horizon_too_short,
    too_fast_to_stop,
    contradictory_constraints,
    floor_above_the_goal,
)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_an_infeasible_problem_names_its_true_cause(
    case: Callable[[Robot], Case], robot: Robot
) -> None:
    problem, allowed, cause = case(robot)
    plan = Planner(problem, NlpOptions(time_limit=PATIENCE)).plan()
    assert plan.status in allowed, plan.reason
    assert cause in plan.reason, plan.reason
    if plan.status is not OcpStatus.UNREACHABLE:
        assert "would have to" in plan.reason


def wall_at(robot: Robot, upper: float) -> OcpProblem:
    return replace(
        too_fast_to_stop(robot)[0], constraints=(AtRest(), along(robot, "wall", -np.inf, upper))
    )


@pytest.mark.slow
def test_what_would_have_to_give_way_is_enough_and_no_more_than_that(robot: Robot) -> None:
    planner = Planner(wall_at(robot, 0.02), NlpOptions(time_limit=PATIENCE))
    p = planner.transcription.parameters()
    x = planner.transcription.pack(hold_guess(planner.problem))
    least = phase_one(planner.transcription, planner.problem, p, x, time_limit=PATIENCE)
    assert least.converged
    assert [item.group.name for item in least.relaxations] == ["constraint 'wall'"]
    needed = least.relaxations[0].amount
    for share, feasible in ((1.02, True), (0.98, False)):
        plan = planner.plan(wall_at(robot, 0.02 + share * needed))
        assert (plan.status is not OcpStatus.INFEASIBLE) == feasible, plan.reason


def test_nothing_gives_way_where_a_motion_keeps_all(planner: Planner) -> None:
    p = planner.transcription.parameters()
    x = planner.transcription.pack(hold_guess(planner.problem))
    least = phase_one(planner.transcription, planner.problem, p, x, time_limit=PATIENCE)
    assert least.converged
    assert not least.relaxations
    assert max(planner.transcription.violations(least.x, p).values()) < 1e-4


def priced(shift: float) -> Plan:
    """The first joint to be somewhere, and the second, priced by what the first costs it, close to
    it.
    """
    arm = load_robot("planar5")

    def first(stage: StageSymbols) -> ca.SX:
        return stage.tick.q[0]

    def close(stage: StageSymbols) -> ca.SX:
        return ca.vertcat(stage.tick.q[0] - 0.1, stage.tick.q[1])

    levels = [
        OcpLevel(name="first", terms=(residual_term("first", first, lower=-np.inf, upper=shift),)),
        OcpLevel(name="close", terms=(residual_term("close", close), Effort(weight=1e-3))),
    ]
    start = State(q=arm.configuration(), v=np.zeros(arm.n_v))
    problem = single_phase(
        robot=arm, start=start, duration=3.0, n_steps=6, levels=levels, water=False
    )
    return Planner(problem, NlpOptions(time_limit=PATIENCE)).plan(diagnose=False)


def test_the_search_for_what_gives_way_begins_where_all_that_can_give_way_does_so_enough() -> None:
    """And hardly more than that: somewhere in each group that is broken, a little less would not
    do.
    """
    arm = load_robot("planar5")
    fast = np.linspace(0.5, 4.0, arm.n_v)
    arm = replace(arm, limits=replace(arm.limits, velocity=fast, acceleration=fast[::-1].copy()))
    problem = on_arm(arm, arm.configuration(), along(arm, "goal", 1.0, 1.0), 2.0)
    transcription = Planner(problem, NlpOptions(time_limit=PATIENCE)).transcription
    p = transcription.parameters()
    hold = transcription.pack(hold_guess(problem))
    elastic = _ElasticProgram(transcription, problem, _constraint_rows(transcription, problem), p)
    x = hold + np.random.default_rng(1).normal(scale=20.0, size=len(hold))
    values = np.concatenate([np.array(elastic.functions["nlp_g"](x, p)).ravel(), x])
    amounts = elastic._sufficient_amounts(values)
    P = elastic.P.full()
    Q = elastic.Q.full()
    soft = Q.any(axis=1)

    def broken(group_amounts: np.ndarray) -> np.ndarray:
        rows = P @ values + Q @ group_amounts
        missed: np.ndarray = np.maximum(
            np.maximum(rows - elastic.upper, elastic.lower - rows), 0.0
        )[soft]
        return missed

    assert broken(amounts).max() == 0.0
    giving_way = np.flatnonzero(amounts > 0.011)
    assert len(giving_way) > 1
    for i in giving_way.tolist():
        fewer = amounts - 0.011 * (np.arange(len(amounts)) == i)
        assert broken(fewer).max() > 0.0


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_the_axes_on_which_most_lies_are_named_whatever_the_unit(unit: float) -> None:
    """Rows of one axis count together, and those of other groups not at all."""
    group = BoundGroup(name="the limits", measure=RelaxationUnit.ROW)
    axes = ("surge", "sway", "heave", "sway", "surge")
    index = GroupIndex(
        groups=(group, group), number=np.array([0, 0, 0, 0, 1]), scale=np.ones(5), axes=axes
    )
    assert index.strongest(0, unit * np.array([0.5, 0.4, 0.0, 0.3, 9.0])) == ("sway", "surge")
    assert index.strongest(1, unit * np.array([0.5, 0.4, 0.0, 0.3, 9.0])) == ("surge",)
    assert index.strongest(0, np.zeros(5)) == ()


def test_the_price_of_a_level_is_the_slope_of_the_cost_below_it() -> None:
    step = 1e-4
    plan = priced(-0.2)
    costs = [0.5 * priced(-0.2 + side * step).levels[1].residual ** 2 for side in (-1, 1)]
    slope = -(costs[1] - costs[0]) / (2 * step)
    assert plan.levels[0].prices == ()
    assert plan.levels[1].prices[0] == pytest.approx(slope, rel=1e-3)
    assert slope > 0.1


def test_a_level_that_costs_nothing_has_no_price() -> None:
    assert priced(0.5).levels[1].prices[0] == pytest.approx(0.0, abs=1e-5)


SHORT: tuple[tuple[float, float, str], ...] = (
    (0.01, 0.3, "the acceleration limits"),
    (0.3, 0.3, "the acceleration limits"),
    (2.0, 2.0, "the velocity limits"),
)
"""Durations [s], ways of all joints [rad], and what has to be named."""


@pytest.mark.slow
@pytest.mark.parametrize(("duration", "way", "cause"), SHORT)
def test_what_is_said_to_hold_back_is_what_gives_the_gain_where_it_is_loosened(
    duration: float, way: float, cause: str
) -> None:
    arm = load_robot("planar5")
    q = arm.configuration()
    goal = TaskTerm(task=JointTracking(joints=("theta1", "theta2"), goal=q[3:] + way))
    planner = Planner(on_arm(arm, q, goal, duration), NlpOptions(time_limit=PATIENCE))
    plan = planner.plan()
    transcription = planner.transcription
    assert plan.status is OcpStatus.TOO_SHORT, plan.reason
    assert cause in plan.reason, plan.reason
    assert plan.result is not None
    found = bindings(
        transcription,
        planner.problem,
        transcription.parameters(),
        plan.result,
        0,
        time_limit=PATIENCE,
    )
    assert found
    left = found[0].left
    share = {item.group.name: 1 + item.amount for item in found[0].relaxations}
    limits = replace(
        arm.limits,
        velocity=arm.limits.velocity * share.pop("the velocity limits", 1.0),
        acceleration=arm.limits.acceleration * share.pop("the acceleration limits", 1.0),
    )
    assert not share, plan.reason
    loosened = Planner(
        on_arm(replace(arm, limits=limits), q, goal, duration), NlpOptions(time_limit=PATIENCE)
    ).plan(diagnose=False)
    missed = plan.levels[0].residual
    assert loosened.levels[0].residual <= left * missed + 0.02 * (1 - left) * missed
