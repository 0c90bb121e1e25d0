"""The solves of receding-horizon control, one after the other: the same in line and in a process beside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import trusted
from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.stagewise.stagewise_program import program_for, quickest
from uvms_ocp.ocp.trajectory import Trajectory, hold, shifted
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.real_time_sqp import RealTimeSqp, SqpResult
from uvms_ocp.solvers.nlp.sqp_options import SqpOptions

_state = trusted(State)
HOLD = -1
"""[-] Number of the plan to stay where the robot was at first, which is in use until there is another."""
_FIRST_SOLVES = 10
"""[-] for the first plan, whose guess is to stay where the robot is."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Planned:
    """A plan, and when it begins."""

    number: int
    """[-] of the solve that made it."""
    trajectory: Trajectory
    """With times from its first node."""
    begin: float
    """[s] of its first node."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Request:
    """What a solve starts from."""

    state: State
    """Measured."""
    t: float
    """[s] when."""
    in_use: int
    """[-] number of the plan that is tracked then."""
    begin: float
    """[s] when that one began, which is later than planned for a first plan that came late; of the request for the first plan,
    when that is to begin."""
    delay: float
    """[s] from t to the beginning of the plan; for the first one it does not count."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Answer:
    """What a solve led to."""

    planned: Planned | None
    """None where no plan keeps the constraints, so that the last one goes on."""
    first: bool
    """The plan is the first, for which the robot stays where it is."""
    solve_time: float
    """[s] by the clock that was given."""
    processor_time: float
    """[s] without what other processes took."""


class Replanner:
    """Solves of one problem. Holds the plans that may be in use, and the newest point as a guess: build one per run."""

    def __init__(
        self,
        problem: OcpProblem,
        *,
        options: SqpOptions | None,
        time_limit: float,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        """problem: with Gauss-Newton Hessian.

        time_limit [s]: after which no further step begins. clock [s]: by which solves are timed.
        """
        self._problem, self._time_limit, self._clock = problem, time_limit, clock
        self._transcription = Transcription(problem)
        self._bounds = self._transcription.bounds()
        chosen = options or SqpOptions()
        program = program_for(chosen.plugin or quickest(problem), self._transcription)
        self._sqp = RealTimeSqp(program, chosen)
        self._plans: dict[int, Planned] = {}
        self._newest: Planned | None = None
        """Fit for use or not."""
        self._solves = 0

    def __call__(self, request: Request) -> Answer:
        """A plan that begins as long after it was asked for as the request has it, or the first one."""
        wall, processor = self._clock(), process_time()
        first = self._newest is None
        planned = self._first(request) if first else self._replanned(request)
        return Answer(
            planned=planned,
            first=first,
            solve_time=self._clock() - wall,
            processor_time=process_time() - processor,
        )

    def _first(self, request: Request) -> Planned | None:
        """As good as a few solves make it, from the guess to stay."""
        stay = last = hold(self._problem, request.state)
        self._plans[HOLD] = self._newest = best = Planned(number=HOLD, trajectory=stay, begin=request.t)
        for _ in range(_FIRST_SOLVES):
            result = self._solved(last, request.state, request.begin, np.inf)
            last = self._transcription.unpack(result.x)
            if result.status is NlpStatus.SOLVED:
                best = self._numbered(last, request.begin)
        self._plans[best.number] = self._newest = best
        return best

    def _replanned(self, request: Request) -> Planned | None:
        self._plans = {number: plan for number, plan in self._plans.items() if number >= request.in_use}
        now, begin = replace(self._plans[request.in_use], begin=request.begin), request.t + request.delay
        last = now if self._newest is None or self._newest.number == now.number else self._newest
        start = self._expected(now, request)
        guess = shifted(self._problem, last.trajectory, begin - last.begin, start)
        result = self._solved(guess, start, begin, self._time_limit)
        found = self._numbered(self._transcription.unpack(result.x), begin)
        # From a point of no use whatever, the present plan is the better guess.
        self._newest = found if np.isfinite(result.violation) else now
        if result.status is not NlpStatus.SOLVED:
            return None
        self._plans[found.number] = found
        return found

    def _numbered(self, trajectory: Trajectory, begin: float) -> Planned:
        self._solves += 1
        return Planned(number=self._solves, trajectory=trajectory, begin=begin)

    def _solved(self, guess: Trajectory, start: State, t0: float, time_limit: float) -> SqpResult:
        return self._sqp.solve(
            self._transcription.pack(guess),
            p=self._transcription.parameters(t0=t0, start=start, near=guess.q),
            x_lower=self._bounds[0],
            x_upper=self._bounds[1],
            time_limit=time_limit,
            clock=self._clock,
        )

    def _expected(self, now: Planned, request: Request) -> State:
        """The state in which the plan will begin: the measured one, moved as planned."""
        model, age, state = self._problem.robot.model, request.t - now.begin, request.state
        q, v, _ = now.trajectory.state_at(model, age)
        q_next, v_next, _ = now.trajectory.state_at(model, age + request.delay)
        return _state(q=pin.integrate(model, state.q, pin.difference(model, q, q_next)), v=state.v + v_next - v)
