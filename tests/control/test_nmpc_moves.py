"""Laws of receding-horizon control in a mission: it moves, whatever time solves take, or the mission
hears why not; rates stay within their limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from tiny_robots import Tiny, robot_of

import uvms_ocp as uo
from uvms_ocp.control import Nmpc, solve_workers
from uvms_ocp.control.nmpc import PlanningTimes
from uvms_ocp.control.plan_check import CheckedPlan, PlanCheck
from uvms_ocp.control.replanning import (
    HOLD,
    Replanner,
    ReplanningRequest,
    ReplanningResult,
    TimedPlan,
)
from uvms_ocp.control.solve_workers import ReplanningJob, SolveDelay, WorkerStatus
from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.problem import HessianKind, OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, Smoothness, TaskTerm
from uvms_ocp.ocp.trajectory import guess_through, hold_guess
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, State, StateEstimate
from uvms_ocp.tasks.pose import ToolPosition

DT = 0.02
PERIOD = 0.1
HORIZON = 3.0
MOST = 1.02
"""share of its limit that a rate reaches at most."""
ARRIVED = 0.1
"""share of the way that is left at the end."""
READINGS = 8
"""of the clock in a solve of three steps."""


def drawn(seed: int) -> Robot:
    """A vehicle whose thrusters are somewhere, and two joints."""
    rng = np.random.default_rng(seed)
    horizontal = [
        (x, y, 0.0, 1, -1 if x * y > 0 else 1, 0) for x in (0.2, -0.2) for y in (0.2, -0.2)
    ]
    vertical = [(x, y, 0.1, 0, 0, 1) for x in (0.2, -0.2) for y in (0.15, -0.15)]
    places = np.array([*horizontal, *vertical], dtype=float)
    places[:, :2] += rng.uniform(-0.03, 0.03, (len(places), 2))
    limit = '<limit lower="-1.2" upper="1.2" effort="8" velocity="0.7"/>'
    axes = ("0 1 0", "0 0 1")
    return robot_of(
        Tiny(
            joints=tuple(("revolute", axis, limit) for axis in axes),
            thrusters=tuple(map(tuple, places.round(3).tolist())),
        )
    )


@cache
def robot_named(name: str) -> Robot:
    return drawn(3) if name == "drawn" else uo.load_robot(name)


def frame_of(robot: Robot) -> str:
    return "tool" if robot.n_joints else "base_link"


def place_of(robot: Robot, q: np.ndarray) -> pin.SE3:
    return uo.Kinematics(robot, q).pose(frame_of(robot))


def reach(robot: Robot, way: tuple[float, float, float] = (0.76, 0.45, -0.28)) -> OcpProblem:
    """A point that is so far [m] away."""
    start = robot.configuration(position=(0, 0, -5))
    first = place_of(robot, start)
    goal = pin.SE3(first.rotation, first.translation + np.array(way))
    tool = ToolPosition(frame=frame_of(robot), goal=goal)
    return single_phase(
        robot=robot,
        start=State(q=start, v=np.zeros(robot.n_v)),
        duration=HORIZON,
        n_steps=20,
        levels=[
            OcpLevel(
                name="tool",
                terms=(
                    TaskTerm(task=tool, at=At.PATH, weight=10.0),
                    TaskTerm(task=tool, weight=3.0),
                ),
            ),
            OcpLevel(name="cost", terms=(Effort(), Smoothness(weight=0.3))),
        ],
    )


class CountingClock:
    """A clock by which a solve of three steps takes so many seconds."""

    def __init__(self, seconds: float) -> None:
        self._step = seconds / READINGS
        self._time = 0.0

    def __call__(self) -> float:
        self._time += self._step
        return self._time


@dataclass
class Beside:
    """A worker beside the loop, whose solves take the time of a clock: what it answers is there when
    that has passed in the loop.
    """

    clock: Callable[[], float]
    now: float = 0.0
    lead: float = 1.0
    status: WorkerStatus = WorkerStatus.WORKING
    _delay: SolveDelay = field(default_factory=lambda: SolveDelay(PERIOD))
    _answer: tuple[float, ReplanningResult] | None = None

    def begin(self, job: ReplanningJob) -> None:
        self._replanner = Replanner(
            job.problem, options=None, gains=None, time_limit=3 * job.period, clock=self.clock
        )

    def delay(self, period: float) -> float:
        return self._delay.seconds

    def ask(self, request: ReplanningRequest) -> None:
        if self.status is WorkerStatus.WORKING:
            answer = self._replanner(request)
            self._answer = request.t + answer.solve_time, answer

    def answer(self) -> ReplanningResult | None:
        if self.status is not WorkerStatus.WORKING or self._answer is None:
            return None
        ready, answer = self._answer
        if self.now < ready:
            return None
        self._answer = None
        if not answer.first:
            self._delay.count(answer.solve_time)
        return answer

    def close(self) -> None:
        self.status = WorkerStatus.CLOSED


@dataclass
class Flight:
    """A run, and what there is to judge."""

    record: Record
    controller: Nmpc
    left: float
    """share of the way that is left."""
    fastest: float
    """largest rate as a share of its limit."""

    @property
    def told(self) -> list[str]:
        return [alarm.text for alarm in self.record.run_meta.alarms]

    @property
    def outcome(self) -> str:
        return str(uo.summarize(self.record)["cause"]["kind"])


def fly(
    problem: OcpProblem,
    clock: Callable[[], float],
    monkeypatch: pytest.MonkeyPatch,
    beside: bool = False,
    seconds: float = 8.0,
    period: float = PERIOD,
    at_tick: Callable[[float, Beside], None] | None = None,
) -> Flight:
    """Fly a plan's goal in still water with ideal sensors; time alone completes the mission."""
    robot = problem.robot
    worker = Beside(clock)
    if beside:

        def begun(_: object, job: ReplanningJob) -> Beside:
            worker.begin(job)
            return worker

        monkeypatch.setattr(solve_workers, "start_worker", begun)
    controllers = []

    class Ticking(Nmpc):
        """Tells the worker what time it is."""

        def __call__(self, measurement: StateEstimate, t: float) -> Command:
            worker.now = t
            if at_tick is not None:
                at_tick(t, worker)
            return super().__call__(measurement, t)

    def made(_: uo.Scenario) -> Nmpc:
        controllers.append(Ticking(problem, dt=DT, period=period, clock=clock))
        return controllers[-1]

    term = problem.levels[0].terms[0]
    assert isinstance(term, TaskTerm)
    task = replace(term.task, name="TP")
    done = uo.Transition(to=uo.DONE, when=(uo.Above(quantity="mission.time", limit=seconds),))
    phase = uo.Phase(name="go", activations={"TP": 1}, transitions=(done,))
    record = uo.Scenario(
        name="nmpc",
        robot=robot,
        mission=uo.Mission(hierarchy=uo.Hierarchy([task]), phases=(phase,)),
        environment=uo.Environment(seafloor=uo.FlatSeafloor(z=-12.0)),
        start=problem.start.q,
        dt=DT,
        duration=seconds + 1.0,
        controller=made,
    ).run()
    goal = task.goal.translation
    ends = [place_of_any(robot, record["q"][k]) for k in (0, -1)]
    way, remaining = (float(np.linalg.norm(end - goal)) for end in ends)
    rates = np.abs(record["v"]) / robot.limits.velocity
    return Flight(record, controllers[-1], remaining / way, float(rates.max()))


def place_of_any(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(3,) [m] of a true state, which may be a little beyond a joint's limit."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return np.array(data.oMf[robot.frame_id(frame_of(robot))].translation)


QUICK = [("bluerov2", 0.1, False), ("bluerov2", 5.0, True), ("bluerov2_alpha5", 3.0, False)]
ALL = [
    (name, periods, beside)
    for name in ("bluerov2", "bluerov2_alpha5", "drawn")
    for periods in (0.1, 0.5, 1.0, 1.3, 3.0, 5.0, 10.0)
    for beside in (False, True)
]


def law_of_moving(name: str, periods: float, beside: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = CountingClock(periods * PERIOD)
    flight = fly(reach(robot_named(name)), clock, monkeypatch, beside)
    assert flight.left < ARRIVED
    assert flight.fastest < MOST
    assert flight.outcome == "completed"
    late = sum(time > PERIOD + 1e-9 for time in flight.controller.statistics.solve_times)
    assert (late >= 5) <= any("plans are late" in text for text in flight.told)


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "periods", "beside"), QUICK)
def test_it_leaves_its_start_and_arrives(
    name: str, periods: float, beside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    law_of_moving(name, periods, beside, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "periods", "beside"), [case for case in ALL if case not in QUICK])
def test_it_leaves_its_start_and_arrives_whatever_time_solves_take(
    name: str, periods: float, beside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    law_of_moving(name, periods, beside, monkeypatch)


# Where there is nothing to fly, the mission hears of it.


@pytest.mark.sampled
@pytest.mark.parametrize("beside", [False, True])
def test_after_three_plans_that_may_not_be_flown_the_mission_is_given_up(
    beside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> CheckedPlan:
        return CheckedPlan(motion=None, reason="a wall")

    monkeypatch.setattr(PlanCheck, "judged", refused)
    flight = fly(reach(robot_named("bluerov2")), CountingClock(0.01), monkeypatch, beside)
    assert flight.outcome != "completed"
    assert flight.record["t"][-1] <= 4 * PERIOD
    assert any("no plan to fly, 3 in a row: a wall" in text for text in flight.told)
    assert flight.controller.given_up


def test_a_worker_that_ends_is_heard_of_by_the_mission(monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(t: float, worker: Beside) -> None:
        if t > 1.0:
            worker.status = WorkerStatus.CRASHED

    problem = reach(robot_named("bluerov2"))
    flight = fly(problem, CountingClock(0.01), monkeypatch, beside=True, at_tick=killed)
    assert flight.outcome != "completed"
    assert flight.record["t"][-1] < 1.0 + 3 * PERIOD
    assert any("plans are no longer made: crashed" in text for text in flight.told)


def test_a_plan_that_does_not_come_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = reach(robot_named("bluerov2"))
    flight = fly(problem, CountingClock(20.0), monkeypatch, beside=True, seconds=2.0)
    assert any("has not come yet" in text for text in flight.told)


def test_no_guess_that_was_rejected_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> CheckedPlan:
        return CheckedPlan(motion=None, reason="a wall")

    monkeypatch.setattr(PlanCheck, "judged", refused)
    problem = replace(reach(robot_named("bluerov2")), hessian=HessianKind.GAUSS_NEWTON)
    replanner = Replanner(problem, options=None, time_limit=0.0, clock=lambda: 0.0)
    tried: list[np.ndarray] = []
    solve = replanner._sqp.solve

    def noted(x: np.ndarray, **options: object) -> object:
        tried.append(x.copy())
        return solve(x, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(replanner._sqp, "solve", noted)
    for k in range(4):
        t = k * PERIOD
        request = ReplanningRequest(state=problem.start, t=t, in_use=HOLD, begin=0.0, delay=PERIOD)
        assert replanner(request).planned is None
    assert all(np.abs(first - two).max() > 1e-6 for first, two in pairwise(tried))


# Whether a plan may be flown.


def checked(problem: OcpProblem, plan: object, violation: float) -> CheckedPlan:
    replanner = Replanner(
        replace(problem, hessian=HessianKind.GAUSS_NEWTON), options=None, time_limit=1.0
    )
    return replanner._check.judged(plan, problem.start, 0.0, violation)  # type: ignore[arg-type]


def straight(problem: OcpProblem, way: np.ndarray, pitch: float = 0.0) -> object:
    """A guess along a way (3,) [m], which may ask for a pitch [rad]."""
    robot = problem.robot
    times = problem.nominal_times()
    shares = (1.0 - np.cos(np.pi * times / times[-1])) / 2
    rows = [
        robot.configuration(
            position=np.array([0, 0, -5.0]) + share * way, rpy=(0, share * pitch, 0)
        )
        for share in shares
    ]
    return guess_through(problem, times, np.array(rows))


def test_a_plan_that_asks_for_an_undriven_pitch_is_flown_as_what_becomes_of_it() -> None:
    problem = reach(robot_named("bluerov2"))
    plan = straight(problem, np.array([0.7, 0.2, -0.2]), pitch=0.1)
    verdict = checked(problem, plan, violation=50.0)
    assert verdict.reason == ""
    assert verdict.motion is not None
    assert verdict.motion is not plan
    np.testing.assert_allclose(verdict.motion.q[-1, :3], [0.7, 0.2, -5.2], atol=0.1)


def test_a_plan_that_leads_through_an_obstacle_is_not_flown() -> None:
    robot = robot_named("bluerov2")
    ball = BallClearance(
        robot_balls=(Ball(frame="base_link", centre=(0.0, 0.0, 0.0), radius=0.1),),
        obstacles=(Ball(centre=(0.35, 0.1, -5.1), radius=0.1),),
    )
    problem = replace(reach(robot), constraints=(ball,))
    plan = straight(problem, np.array([0.7, 0.2, -0.2]))
    verdict = checked(problem, plan, violation=50.0)
    assert verdict.motion is None
    assert "is broken by" in verdict.reason


def test_a_point_that_no_step_has_led_to_is_no_plan() -> None:
    problem = reach(robot_named("bluerov2"))
    assert checked(problem, hold_guess(problem), violation=np.inf).motion is None


# When plans are asked for.


@pytest.mark.parametrize(
    ("dt", "period"), [(0.02, 0.05), (0.005, 0.05), (0.03, 0.1), (0.02, 0.021)]
)
def test_the_mean_period_of_planning_is_what_was_asked_for(dt: float, period: float) -> None:
    times = PlanningTimes(dt, period)
    times.begin(0.0)
    request_times = [0.0]
    while len(request_times) < 200:
        request_times.append(times.tick_after(request_times[-1]))
    assert np.diff(request_times).mean() == pytest.approx(period, abs=dt / 199)
    multiples = period * np.arange(200)
    assert (request_times - multiples > -1e-9).all()
    assert (request_times - multiples < dt).all()


@pytest.mark.slow
def test_plans_are_made_as_often_as_the_period_says(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = reach(robot_named("bluerov2"))
    flight = fly(problem, lambda: 0.0, monkeypatch, seconds=2.0, period=0.05)
    assert len(flight.controller.statistics.solve_times) == pytest.approx(40, abs=1)


@dataclass
class Scripted:
    """A worker whose plans are to stay, and take what they are told to."""

    problem: OcpProblem
    seconds: float
    lead: float = 0.0
    status: WorkerStatus = WorkerStatus.WORKING
    _number: int = 0
    _longest: float = 0.0
    _answer: ReplanningResult | None = None

    def delay(self, period: float) -> float:
        return max(period, self._longest)

    def ask(self, request: ReplanningRequest) -> None:
        first = self._number == 0
        self._number += 1
        plan = TimedPlan(
            number=self._number,
            trajectory=hold_guess(self.problem, request.state),
            begin=request.begin if first else request.t + request.delay,
        )
        self._longest = self._longest if first else self.seconds
        self._answer = ReplanningResult(
            planned=plan, reason="", first=first, solve_time=self.seconds, processor_time=0.0
        )

    def answer(self) -> ReplanningResult | None:
        answer = self._answer
        self._answer = None
        return answer

    def close(self) -> None:
        pass


def test_a_late_plan_takes_over_when_it_would_be_ready_with_its_own_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = reach(robot_named("bluerov2"))
    monkeypatch.setattr(solve_workers, "start_worker", lambda *_: Scripted(problem, seconds=0.137))
    nmpc = Nmpc(problem, dt=DT, period=PERIOD)
    start = problem.start
    takeovers = [(0.0, 0.0)]
    for k in range(22):
        nmpc(StateEstimate(q=start.q, v=start.v, altimeter_range=np.nan), k * DT)
        assert nmpc._now is not None
        if nmpc._now.begin != takeovers[-1][1]:
            takeovers.append((k * DT, nmpc._now.begin))
    # asked for at 0 s to begin at 0.1, ready at 0.137: from the tick at 0.14 on, 0.04 s old; the
    # next is asked for at 0.2, and begins where it will be ready by then
    np.testing.assert_allclose(takeovers[1:], [(0.14, 0.1), (0.34, 0.337)])
