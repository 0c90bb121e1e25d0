"""Laws of a planner that is kept: a changed problem is solved as by a new planner, or refused by
the name of the change.

The changes are all fields of all terms, tasks, levels, phases and problems: a new field is tested
by being there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cache
from typing import Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest
from same_words import require_same_words

from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission_plan.clearances import FloorClearance, Rim
from uvms_ocp.mission_plan.terms import BoundedRows, TaskPreference, ZeroVelocities
from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import HessianKind, OcpLevel, OcpPhase, OcpProblem, single_phase
from uvms_ocp.ocp.shape_clearance import ShapeClearance
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
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.planning import CollisionScene, collision_scene, coordinates
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks.activation import SmoothActivation
from uvms_ocp.tasks.altitude import LandingAltitude, MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment, FieldOfView, HorizontalAttitude
from uvms_ocp.tasks.joints import JointLimits, JointTracking, Manipulability
from uvms_ocp.tasks.pose import ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.task import Residual, Task, zero_residual
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

GOAL = pin.SE3(np.eye(3), np.array([1.0, 0.2, 0.0]))
ROBOT_BALL = Ball(frame="tool", radius=0.1)
STONE = Ball(centre=(3.0, 1.0, 0.0), radius=0.2)
RIM = Rim(joint=5, centre=np.array([0.5, 0.0, 0.0]), axis=np.array([1.0, 0.0, 0.0]), radius=0.1)


def among(x: float, radius: float) -> CollisionScene:
    """The planar robot beside a rock."""
    rock = obstacle("rock", coal.Sphere(radius), [x, 2.0, 0.0])
    return collision_scene(coordinates(load_robot("planar5")), [rock])


TASKS: dict[str, Task] = {
    "NR": NullVelocity(axes=(0, 1)),
    "JL": JointLimits(),
    "MAC": MinimumAltitude(frame="tool"),
    "LA": LandingAltitude(frame="tool"),
    "HA": HorizontalAttitude(frame="tool"),
    "AT": Alignment(goal=np.array([2.0, 1.0, 0.0]), frame="tool"),
    "FV": FieldOfView(goal=np.array([2.0, 1.0, 0.0]), frame="tool"),
    "MU": Manipulability(),
    "PC": VehiclePose(goal=GOAL, frame="tool"),
    "T": ToolPose(goal=GOAL),
    "TP": ToolPosition(goal=GOAL),
    "MP": JointTracking(joints=("x0", "y0"), goal=np.zeros(2)),
}
OF_A_VEHICLE = ("NR",)
"""Tasks of axes that a fixed base has not."""
TERMS: dict[str, Term] = {
    **{name: TaskTerm(task=task) for name, task in TASKS.items()},
    "at rest": AtRest(),
    "effort": Effort(),
    "energy": Energy(),
    "smoothness": Smoothness(),
    "duration": Duration(),
    "posture": Posture(q=np.zeros(5)),
    "balls": BallClearance(robot_balls=(ROBOT_BALL,), obstacles=(STONE,)),
    "own": residual_term(
        "own",
        lambda stage, goal: stage.tick.q[:3] - goal,
        lower=-1.0,
        upper=1.0,
        parameters=np.zeros(3),
    ),
    "shapes": ShapeClearance(
        scene=among(3.0, 0.2), margins=np.full(4, 0.05), n_rows=3, n_own_rows=1
    ),
    "rows": BoundedRows(task=ToolPosition(goal=GOAL), rows=(0, 1), lower=-0.1, upper=0.1),
    "liked": TaskPreference(task=ToolPosition(goal=GOAL)),
    "rest": ZeroVelocities(axes=(0, 1)),
    "floor": FloorClearance(rims=(RIM,), height=5.0),
}
OTHERS: dict[str, Any] = {
    "frame": "link2",
    "name": "another",
    "phase": "stay",
    "activation": SmoothActivation(0.03, 0.09),
    "joints": ("y0", "x0"),
    "axes": (0, 2),
    "axis": (0.0, 1.0, 0.0),
    "goal": lambda t: (np.full(2, t), np.ones(2)),
    "task": TaskTerm(task=ToolPosition(goal=GOAL, frame="link1")).task,
    "robot_balls": (replace(ROBOT_BALL, radius=0.15),),
    "obstacles": (replace(STONE, centre=(1.0, 2.0, 0.1), radius=0.3),),
    "scene": among(2.0, 0.3),
    "moving": {"rock": lambda t: pin.SE3(np.eye(3), np.array([3.0 - t, 2.0, 0.0]))},
    "rims": (replace(RIM, radius=0.3),),
    "rows": (1,),
    "terms": (AtRest(), Effort()),
    "constraints": (AtRest(weight=2.0),),
    "start": State(q=np.full(5, 0.1), v=np.full(5, 0.05)),
    "robot": replace(load_robot("planar5"), name="sister"),
    "relax": 0.2,
    "altimeter_frame": "link2",
    "duration": 5.0,
    "label": "another",
    "start_freedom": np.full(10, 0.1),
}
"""Other values of fields, where one is not simply made from the present one."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem, the same with one change, and the name of the field that changed."""

    problem: OcpProblem
    changed: OcpProblem
    field: str


@cache
def planar() -> Robot:
    return load_robot("planar5")


@cache
def problem_of(name: str) -> OcpProblem:
    robot = load_robot("bluerov2") if name in OF_A_VEHICLE else planar()
    phases = (
        OcpPhase(name="go", n_steps=2, duration=2.0),
        OcpPhase(name="stay", n_steps=1, duration=1.0),
    )
    return OcpProblem(
        robot=robot,
        start=State(q=robot.configuration(joints=np.zeros(robot.n_joints)), v=np.zeros(robot.n_v)),
        phases=phases,
        levels=(
            OcpLevel(name="it", terms=(TERMS[name],), relax=0.1),
            OcpLevel(name="cheap", terms=(Effort(),)),
        ),
        constraints=(AtRest(),),
        floor=-2.0,
        water=False,
        altimeter_frame="tool" if robot.tools else "base_link",
    )


@cache
def kept(problem: OcpProblem) -> Transcription:
    return Transcription(problem)


def other(name: str, value: Any) -> Any:
    if isinstance(value, pin.SE3):
        return pin.SE3(np.eye(3), value.translation + 0.1)
    if isinstance(value, np.ndarray) and value.size != 2:
        return value + 0.1
    if callable(value):
        return lambda stage, goal: 2 * stage.tick.q[:3] - goal
    if name in OTHERS:
        return OTHERS[name]
    if isinstance(value, Enum):
        return next(member for member in type(value) if member is not value)
    if isinstance(value, bool):
        return not value
    return value + (1 if isinstance(value, int) else 0.07)


def with_term(problem: OcpProblem, term: Term) -> OcpProblem:
    return replace(problem, levels=(replace(problem.levels[0], terms=(term,)), *problem.levels[1:]))


def cases() -> Iterator[Any]:
    for name, term in TERMS.items():
        problem = problem_of(name)
        own = () if isinstance(term, TaskTerm) and name not in ("T", "HA") else fields(term)
        for field in own:
            changed = with_term(
                problem, replace(term, **{field.name: other(field.name, getattr(term, field.name))})
            )
            yield pytest.param(
                Case(problem=problem, changed=changed, field=field.name), id=f"{name}-{field.name}"
            )
        for field in fields(term.task) if isinstance(term, TaskTerm) else ():
            task = replace(
                term.task, **{field.name: other(field.name, getattr(term.task, field.name))}
            )
            changed = with_term(problem, replace(term, task=task))
            yield pytest.param(
                Case(problem=problem, changed=changed, field=field.name),
                id=f"{name}-task-{field.name}",
            )
    yield from _cases_of_problems()


def _cases_of_problems() -> Iterator[Any]:
    problem = problem_of("T")
    for field in fields(problem):
        value = getattr(problem, field.name)
        if field.name not in ("phases", "levels"):
            changed = replace(problem, **{field.name: other(field.name, value)})
            yield pytest.param(
                Case(problem=problem, changed=changed, field=field.name), id=f"problem-{field.name}"
            )
    for part in ("phases", "levels"):
        first, *rest = getattr(problem, part)
        for field in fields(first):
            changed_part = replace(
                first, **{field.name: other(field.name, getattr(first, field.name))}
            )
            changed = replace(problem, **{part: (changed_part, *rest)})
            yield pytest.param(
                Case(problem=problem, changed=changed, field=field.name), id=f"{part}-{field.name}"
            )
        changed = replace(problem, **{part: tuple(getattr(problem, part))[:1]})
        yield pytest.param(Case(problem=problem, changed=changed, field=part), id=f"{part}-fewer")


CASES = list(cases())


@pytest.mark.parametrize("case", CASES)
def test_a_changed_field_is_obeyed_or_refused_by_name(case: Case) -> None:
    transcription = kept(case.problem)
    refusal = refused(case)
    if refusal:
        assert case.field in refusal
        assert "build a new Planner" in refusal
        return
    p = transcription.parameters(case.changed, t0=0.3)
    fresh = Transcription(case.changed)
    x = 0.1 * np.random.default_rng(1).standard_normal(fresh.n_x) + 0.2
    for found, wanted in zip(
        numbers(transcription, x, p, case.changed),
        numbers(fresh, x, fresh.parameters(t0=0.3), case.changed),
        strict=True,
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)
    assert transcription.violations(x, p, case.changed) == pytest.approx(
        fresh.violations(x, fresh.parameters(t0=0.3))
    )
    (row, broken), (expected, by) = (
        one.obstruction(case.changed) or ("", 0.0) for one in (transcription, fresh)
    )
    assert row == expected
    assert broken == pytest.approx(by, rel=1e-9)


def refused(case: Case) -> str:
    """What the refusal says; nothing where there is none."""
    try:
        kept(case.problem).parameters(case.changed)
    except InvalidInput as error:
        return str(error)
    return ""


def numbers(
    transcription: Transcription, x: np.ndarray, p: np.ndarray, problem: OcpProblem
) -> list[np.ndarray]:
    """All that an NLP solver is told."""
    ranges = transcription.ranges(problem)
    program = transcription.program
    values = [
        np.array(value).ravel()
        for nlp in program.nlps
        for value in nlp.functions["nlp_jac_g"].call([x, p])
    ]
    values += [
        np.array(value).ravel()
        for nlp in program.nlps
        for value in nlp.functions["nlp_grad_f"].call([x, p])
    ]
    values += [np.array(value).ravel() for value in program.values.call([x, p])]
    values += [ranges.lower, ranges.upper, *transcription.bounds(problem)]
    for level in ranges.levels:
        values += [
            level.lower,
            level.upper,
            np.array([-1.0 if level.relax is None else level.relax]),
        ]
    return values


@pytest.mark.parametrize("name", TERMS)
def test_a_weight_is_a_factor_on_the_squares(name: str) -> None:
    problem = problem_of(name)
    transcription = kept(problem)
    heavier = with_term(problem, replace(TERMS[name], weight=3.0))
    x = 9.0 * np.random.default_rng(2).standard_normal(transcription.n_x)
    cost, three = (
        float(transcription.program.nlps[0].functions["nlp_f"](x, transcription.parameters(one)))
        for one in (problem, heavier)
    )
    assert three == pytest.approx(3.0 * cost, rel=1e-12)
    assert cost > 0 or name in ("MAC", "HA", "balls", "shapes")  # ranges that these states are in


def test_the_registry_knows_every_term_and_every_task_with_rows_over_a_horizon() -> None:
    assert {cls for cls in _below(Term) if not _below(cls)} == {
        type(term) for term in TERMS.values()
    }
    planned = {cls for cls in _below(Task) if not _below(cls) and cls.residual is not Task.residual}
    assert planned == {type(task) for task in TASKS.values()}


def _below(cls: type) -> list[type]:
    below = [found for own in cls.__subclasses__() for found in (own, *_below(own))]
    # Classes with slots are made twice; the first one is no longer anybody's.
    public = [
        own for own in below if getattr(sys.modules[own.__module__], own.__name__, None) is own
    ]
    return [own for own in public if own.__module__.startswith("uvms_ocp.")]


OBEYED = {
    "T-weight",
    "HA-tolerance",
    "T-task-goal",
    "MP-task-goal",
    "MAC-task-threshold",
    "HA-task-aim",
    "JL-task-guard",
    "posture-q",
    "balls-obstacles",
    "balls-margin",
    "shapes-scene",
    "shapes-margins",
    "shapes-moving",
    "problem-start",
    "problem-current",
    "problem-constraints",
    "phases-duration",
    "levels-relax",
}


@pytest.mark.parametrize("case", [case for case in CASES if case.id in OBEYED])
def test_numbers_may_differ(case: Case) -> None:
    assert refused(case) == ""


def test_all_numbers_that_may_differ_are_tested() -> None:
    assert {case.id for case in CASES} >= OBEYED


def reach(**options: Any) -> OcpProblem:
    chosen: dict[str, Any] = {
        "weight": 1.0,
        "stone": STONE,
        "task": ToolPosition(goal=GOAL),
        "duration": 4.0,
    }
    chosen |= {"posture": Posture(q=np.zeros(5), weight=0.1)} | options
    clearance = BallClearance(robot_balls=(ROBOT_BALL,), obstacles=(chosen["stone"],))
    cheap = tuple(term for term in (Effort(), chosen["posture"]) if term is not None)
    return single_phase(
        robot=planar(),
        start=State(q=np.array([0.0, -1.5, 0.3, 0.4, 0.4]), v=np.zeros(5)),
        duration=chosen["duration"],
        n_steps=8,
        levels=[
            OcpLevel(name="tool", terms=(TaskTerm(task=chosen["task"], weight=chosen["weight"]),)),
            OcpLevel(name="cheap", terms=cheap),
        ],
        constraints=(AtRest(), clearance),
        water=False,
        hessian=chosen.get("hessian", HessianKind.EXACT),
    )


@cache
def kept_planner() -> Planner:
    return Planner(reach(), NlpOptions(time_limit=600.0))


PLANS: dict[str, dict[str, Any]] = {
    "weight of a cost": {"posture": Posture(q=np.zeros(5), weight=25.0)},
    "weight of a goal": {
        "weight": 4.0,
        "task": ToolPosition(goal=pin.SE3(np.eye(3), np.array([30.0, 0.0, 0.0]))),
    },
    "moved stone": {"stone": replace(STONE, centre=(1.45, -0.6, 0.0), radius=0.5)},
    "stone at the start": {"stone": replace(STONE, centre=(1.3, -0.8, 0.0), radius=0.5)},
    "other posture": {"posture": Posture(q=np.full(5, 0.6), weight=0.1)},
    "longer": {"duration": 7.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("options", PLANS.values(), ids=PLANS)
def test_a_kept_planner_finds_the_plan_of_a_new_one(options: dict[str, Any]) -> None:
    problem = reach(**options)
    found = kept_planner().plan(problem)
    wanted = Planner(problem).plan()
    before = kept_planner().plan()
    assert found.status is wanted.status
    require_same_words(found.reason, wanted.reason)
    residuals = [[level.residual for level in plan.levels] for plan in (found, wanted, before)]
    np.testing.assert_allclose(residuals[0], residuals[1], rtol=1e-5, atol=1e-6)
    assert (
        not np.allclose(residuals[0], residuals[2], rtol=1e-3)
        if residuals[0]
        else found.status is OcpStatus.OBSTRUCTED
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hessian": HessianKind.GAUSS_NEWTON}, "the problem has hessian"),
        ({"posture": None}, "level 'cheap' has 1 terms, the planner was built for 2"),
        (
            {"task": ToolPose(goal=GOAL)},
            r"level 'tool': term 'T' differs in task \(ToolPose, not ToolPosition\)",
        ),
        ({"task": ToolPosition(goal=GOAL, frame="link2")}, r"differs in task\.frame"),
    ],
)
def test_another_shape_is_refused_with_what_differs(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        kept_planner().plan(reach(**options))


class Reach(Term):
    """As a user may write it: no dataclass of its own."""

    name = "reach"

    def __init__(self, x: float) -> None:
        super().__init__()
        object.__setattr__(self, "x", x)

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(stage.tick.q[0] - self.x)


def test_a_term_is_asked_for_its_rows_once_wherever_it_counts() -> None:
    asked = []

    def rows(stage: StageSymbols) -> ca.SX:
        asked.append(stage)
        return stage.tick.q[:2]

    counted = residual_term(
        "counted", rows, lower=-100.0, upper=100.0, at=At.PATH
    )  # of the state: at the end, too
    Planner(replace(reach(), constraints=(*reach().constraints, counted)))
    assert len(asked) == 1


@pytest.mark.parametrize("slots", [(), ("x",)])
def test_what_a_term_carries_beside_its_fields_is_looked_at(slots: tuple[str, ...]) -> None:
    kind = type("Reach", (Reach,), {"__slots__": slots})
    one, same, other = (with_term(problem_of("T"), kind(x)) for x in (1.0, 1.0, 2.0))
    assert refused(Case(problem=one, changed=same, field="x")) == ""
    assert "term 'reach' differs in x from the planner's" in refused(
        Case(problem=one, changed=other, field="x")
    )


def test_free_durations_stay_in_the_range_of_the_problem_given() -> None:
    quick = [
        replace(
            reach(),
            phases=(OcpPhase(n_steps=8, duration=span),),
            levels=(reach().levels[0], OcpLevel(name="time", terms=(Duration(),))),
        )
        for span in ((2.0, 9.0), (6.0, 9.0))
    ]
    planner = Planner(quick[0], NlpOptions(time_limit=600.0))
    durations = [planner.plan(problem).duration for problem in quick]
    assert durations[0] < 5.9
    assert durations[1] == pytest.approx(6.0, abs=1e-4)


def test_a_plan_of_another_problem_is_no_guess() -> None:
    shorter = replace(reach(), phases=(OcpPhase(n_steps=5, duration=4.0),))
    looser = replace(reach(), constraints=reach().constraints[1:])
    for problem in (shorter, looser):
        guess = Planner(problem).plan()
        with pytest.raises(InvalidInput, match="of another program"):
            kept_planner().plan(guess=guess)
    with pytest.raises(InvalidInput, match="the guess has 5 steps; give one of 8"):
        kept_planner().plan(guess=Planner(shorter).plan().trajectory)


def test_parameters_of_another_length_and_a_limit_that_is_no_time_are_refused_by_name() -> None:
    planner = kept_planner()
    guess = hold_guess(planner.problem)
    p = planner.transcription.parameters()
    with pytest.raises(
        InvalidInput, match=rf"^Planner\.solve: p has shape \(3,\); give \({len(p)},\)$"
    ):
        planner.solve(np.zeros(3), guess)
    with pytest.raises(InvalidInput, match=r"^Planner\.solve: time_limit = nan"):
        planner.solve(p, guess, time_limit=np.nan)
