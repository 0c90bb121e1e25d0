"""Solve the problem of receding-horizon control again and again: from which guess, within which
bounds, and whether the plan may be flown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from time import perf_counter, process_time

import numpy as np

from uvms_ocp.control.force.computed_torque import TrackingGains, undriven_axes
from uvms_ocp.control.plan_check import CheckedPlan, PlanCheck
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.stagewise.program import program_for, stagewise_or
from uvms_ocp.ocp.trajectory import Trajectory, hold_guess, shift_guess
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers import RealTimeSqp, SqpOptions
from uvms_ocp.solvers.nlp.options import SPARSE_PLUGIN
from uvms_ocp.solvers.nlp.real_time_sqp import TimeBudget

HOLD = -1
"""Number of the plan to stay where the robot was at first, which is in use until there is
another.
"""
_FIRST_SOLVES = 10
"""Solves of the first plan, whose guess is to stay where the robot is."""
_REMEMBERED = 30
"""Number of rejected guesses that are remembered, from which no solve begins again."""
_SAME = 1e-6
"""[unit of the variable] difference below which two guesses count as the same."""
_PLANNED_RATE = 0.97
"""Share of the limit of a rate that plans use: tracking needs the rest."""
_PLANNED_UNDRIVEN_RATE = 0.8
"""Share of the limit of the rate of an axis that nothing drives, such as pitch: no tracking brings
it back.
"""
_UNDRIVEN = 0.5
"""Share of an axis that lies along the undriven ones, from which on it counts as one of them."""


class Replanner:
    """Solver of one problem, again and again. Holds the plans that may be in use, and the newest point as a guess:
    build one per run.

    Whether a plan may be flown is judged by `PlanCheck`. From a guess whose plan may not be flown
    no solve begins again: the next one begins from what the last solve has made of its guess, then
    from the plan in use, then from standing still, and so on in turn, as many of them in one call
    as there is time for.
    """

    def __init__(
        self,
        problem: OcpProblem,
        *,
        options: SqpOptions | None,
        gains: TrackingGains | None = None,
        time_limit: float,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        """problem: with Gauss-Newton Hessian. gains: of the law that tracks plans.

        time_limit [s]: after which no further step begins. clock [s]: by which solves are timed.
        """
        self._problem = problem
        self._time_limit = time_limit
        self._clock = clock
        self._transcription = Transcription(problem)
        self._bounds = planned_bounds(self._transcription)
        options = options or SqpOptions()
        plugin = options.plugin or stagewise_or(SPARSE_PLUGIN, problem)
        self._sqp = RealTimeSqp(program_for(plugin, self._transcription), options)
        self._check = PlanCheck(self._transcription, accuracy=options.accuracy, gains=gains)
        self._plans: dict[int, TimedPlan] = {}
        self._newest: TimedPlan | None = None
        """End of the last solve, whether it may be flown or not."""
        self._guess = GuessKind.NEWEST
        """Guess with which the next solve begins."""
        self._rejected: deque[np.ndarray] = deque(maxlen=_REMEMBERED)
        """Inputs of solves that led to no plan, since the last one that did."""
        self._solves = 0

    def __call__(self, request: ReplanningRequest) -> ReplanningResult:
        """Return a plan that begins as long after it was asked for as the request has it, or the
        first one.
        """
        wall = self._clock()
        processor = process_time()
        first = self._newest is None
        if first:
            planned, reason = self._first(request)
        else:
            planned, reason = self._replanned(request)
        spent = self._clock() - wall
        return ReplanningResult(
            planned=planned,
            reason=reason,
            first=first,
            solve_time=spent,
            processor_time=process_time() - processor,
        )

    def _first(self, request: ReplanningRequest) -> tuple[TimedPlan | None, str]:
        """Converge the first plan by a few solves, from the guess to stay; where there is one after
        the time until it is to begin, it is not improved any more.
        """
        stay = hold_guess(self._problem, request.state)
        hold = TimedPlan(number=HOLD, trajectory=stay, begin=request.t)
        self._newest = hold
        self._plans[HOLD] = hold
        lead = request.begin - request.t
        began = self._clock()
        best = None
        reason = ""
        last = stay
        for _ in range(_FIRST_SOLVES):
            last, checked = self._solved(last, request.state, request.begin, np.inf)
            if checked.motion is None:
                reason = checked.reason
            else:
                best = self._numbered(checked.motion, request.begin)
                last = checked.motion
            if best is not None and self._clock() - began > lead > 0.0:
                break
        if best is None:
            self._newest = self._numbered(last, request.begin)
            return None, reason
        self._newest = best
        self._plans[best.number] = best
        return best, ""

    def _replanned(self, request: ReplanningRequest) -> tuple[TimedPlan | None, str]:
        self._plans = {
            number: plan for number, plan in self._plans.items() if number >= request.in_use
        }
        in_use = replace(self._plans[request.in_use], begin=request.begin)
        if self._newest is not None and self._newest.number == in_use.number:
            self._newest = in_use
        begin = request.t + request.delay
        start = self._expected(in_use, request)
        budget = TimeBudget(self._time_limit, self._clock)
        reason = ""
        for _ in GuessKind:
            guess = self._guess_of(self._guess, in_use, begin, start)
            if self._was_rejected(guess, start, begin):
                self._guess = self._guess.following
                continue
            time_limit = max(self._time_limit - budget.elapsed, 0.0)
            end, checked = self._solved(guess, start, begin, time_limit)
            budget.count()
            motion = end if checked.motion is None else checked.motion
            self._newest = self._numbered(motion, begin)
            if checked.motion is not None:
                self._guess = GuessKind.NEWEST
                self._plans[self._newest.number] = self._newest
                return self._newest, ""
            reason = reason or checked.reason
            self._guess = self._guess.following
            if budget.over:
                break
        return None, reason or "every guess that there is was tried before"

    def _was_rejected(self, guess: Trajectory, start: State, begin: float) -> bool:
        """Check whether a solve from this guess, for the same goals, has led to no plan that may be
        flown.
        """
        inputs = self._inputs(guess, start, begin)
        return any(np.abs(inputs - rejected).max() < _SAME for rejected in self._rejected)

    def _inputs(self, guess: Trajectory, start: State, begin: float) -> np.ndarray:
        """Return all numbers that a solve begins with: variables, then parameters."""
        p = self._transcription.parameters(t0=begin, start=start, written_at=guess.q)
        return np.concatenate([self._transcription.pack(guess), p])

    def _guess_of(
        self, kind: GuessKind, in_use: TimedPlan, begin: float, start: State
    ) -> Trajectory:
        """Return a guess for a plan that begins at `begin` [s] in a start."""
        if kind is GuessKind.HOLD:
            return hold_guess(self._problem, start)
        if self._newest is None or kind is GuessKind.IN_USE:
            plan = in_use
        else:
            plan = self._newest
        return shift_guess(self._problem, plan.trajectory, begin - plan.begin, start)

    def _numbered(self, trajectory: Trajectory, begin: float) -> TimedPlan:
        self._solves += 1
        return TimedPlan(number=self._solves, trajectory=trajectory, begin=begin)

    def _solved(
        self, guess: Trajectory, start: State, t0: float, time_limit: float
    ) -> tuple[Trajectory, CheckedPlan]:
        """Return the end of a solve, or the guess where it has none, and what may be flown."""
        inputs = self._inputs(guess, start, t0)
        x, p = np.split(inputs, [self._transcription.n_x])
        result = self._sqp.solve(
            x,
            p=p,
            x_lower=self._bounds[0],
            x_upper=self._bounds[1],
            time_limit=time_limit,
            clock=self._clock,
        )
        end = self._transcription.unpack(result.x)
        checked = self._check.judged(end, start, t0, result.violation)
        if checked.motion is None:
            self._rejected.append(inputs)
        else:
            self._rejected.clear()
        return end, checked

    def _expected(self, in_use: TimedPlan, request: ReplanningRequest) -> State:
        """Return the state in which the plan will begin: what the robot makes of the plan in use
        until then, from the measured state. No plan brings back an axis that nothing drives.
        """
        age = request.t - in_use.begin
        return self._check.planned_motion.state_after(
            in_use.trajectory, request.state, age, request.delay
        )


class GuessKind(Enum):
    """Kind of the guess from which a solve begins."""

    NEWEST = 0
    """The end of the last solve, moved on in time."""
    IN_USE = 1
    """The plan that is tracked, moved on in time."""
    HOLD = 2
    """Standing still."""

    @property
    def following(self) -> GuessKind:
        """Kind of guess that is tried after this one."""
        return GuessKind((self.value + 1) % len(GuessKind))


def planned_bounds(transcription: Transcription) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (n_x,) of the variables of a plan that is tracked: those of the problem,
    with a share of the limits of all rates.
    """
    robot = transcription.problem.robot
    undriven = np.linalg.norm(undriven_axes(robot), axis=1) > _UNDRIVEN
    share = np.where(undriven, _PLANNED_UNDRIVEN_RATE, _PLANNED_RATE)
    lower, upper = transcription.bounds()
    lower = lower.copy()
    upper = upper.copy()
    columns = transcription.variables.all_columns[1:, transcription.model.layout.v]
    lower[columns] *= share
    upper[columns] *= share
    return lower, upper


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TimedPlan:
    """A plan, and when it begins."""

    number: int
    """Number of the solve that made the plan."""
    trajectory: Trajectory
    """Trajectory, with times from its first node."""
    begin: float
    """[s] time of the first node."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReplanningRequest:
    """Start of a solve."""

    state: State
    """Measured state."""
    t: float
    """[s] time of the measurement."""
    in_use: int
    """Number of the plan that is tracked then."""
    begin: float
    """[s] beginning of that plan, which is later than planned for a first plan that came late; in
    the request for the first plan, the time at which that is to begin.
    """
    delay: float
    """[s] time from t to the beginning of the plan; without effect for the first one."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReplanningResult:
    """Result of a solve."""

    planned: TimedPlan | None
    """Plan to fly; None where none may be flown, so that the last one goes on."""
    reason: str
    """Reason why no plan may be flown; else empty."""
    first: bool
    """The plan is the first, for which the robot stays where it is."""
    solve_time: float
    """[s] by the clock that was given."""
    processor_time: float
    """[s] processor time of the solve, without other processes."""
