"""Run the solves of receding-horizon control within the tick, or in a process of their own."""

from __future__ import annotations

import gc
import pickle
import signal
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from selectors import EVENT_READ, DefaultSelector
from time import perf_counter, process_time
from typing import TypeAlias

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control.force.computed_torque import TrackingGains, undriven_axes
from uvms_ocp.control.plan_check import CheckedPlan, PlanCheck
from uvms_ocp.errors import AdvisedStatus, InvalidInput, UvmsError, require_first_reading
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.stagewise.program import program_for, stagewise_or
from uvms_ocp.ocp.trajectory import Trajectory, hold_guess, shift_guess
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers import RealTimeSqp, SqpOptions
from uvms_ocp.solvers.nlp.level_solver import SPARSE_PLUGIN
from uvms_ocp.solvers.nlp.real_time_sqp import TimeBudget
from uvms_ocp.types import Positive

# When a plan that is asked for now will be there, judged by the solves before.

_FORGOTTEN = 0.95
"""what is left of the longest one after every shorter one: twenty solves count."""
_RECENT = 5
"""solves in line by which the next one is judged."""
_SENT = 1e-3
"""[s] for question and answer on their way."""

HOLD = -1
"""Number of the plan to stay where the robot was at first, which is in use until there is
another.
"""
_FIRST_SOLVES = 10
"""solves of the first plan, whose guess is to stay where the robot is."""
_REMEMBERED = 30
"""guesses that were rejected."""
_SAME = 1e-6
"""[unit of the variable] by which guesses differ that are the same."""
_PLANNED_RATE = 0.97
"""share of the limit of a rate that plans use: tracking needs the rest."""
_PLANNED_UNDRIVEN_RATE = 0.8
"""share of the limit of the rate of an axis that nothing drives, such as pitch: no tracking brings
it back.
"""
_UNDRIVEN = 0.5
"""share of an axis that lies along the undriven ones, from which on it counts as one of them."""

_PATIENCE = 3
"""periods after which a solve beside begins no further step: a plan that comes late is of more use
than none.
"""


class SolveDelay:
    """The longest solve of late. A plan that is late all the same keeps its time stamps; one that
    is early has to wait.
    """

    def __init__(self, first: float) -> None:
        """First [s]: before any solve was made."""
        self._longest = first

    @property
    def seconds(self) -> float:
        """Time from the request to the plan."""
        return self._longest + _SENT

    def count(self, solve_time: float) -> None:
        """One more solve took `solve_time` [s]."""
        self._longest = max(solve_time, _FORGOTTEN * self._longest)


class LateSolves:
    """The longest of the last few solves but one, as soon as there are enough of them: one that was
    slow by chance does not count.
    """

    def __init__(self) -> None:
        self._last = deque[float](maxlen=_RECENT)

    @property
    def seconds(self) -> float:
        """Time from the request to the plan; 0 while there is none to judge by."""
        longest = sorted(self._last, reverse=True)
        if len(longest) == _RECENT:
            return longest[1]
        if longest:
            return longest[0]
        return 0.0

    def count(self, solve_time: float) -> None:
        """One more solve took `solve_time` [s]."""
        self._last.append(solve_time)


# The solves of receding-horizon control, one after the other: the same in line and in a process
# beside.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TimedPlan:
    """A plan, and when it begins."""

    number: int
    """Status of the solve that made it."""
    trajectory: Trajectory
    """With times from its first node."""
    begin: float
    """[s] of its first node."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReplanningRequest:
    """Start of a solve."""

    state: State
    """Measured."""
    t: float
    """[s] when."""
    in_use: int
    """Number of the plan that is tracked then."""
    begin: float
    """[s] when that one began, which is later than planned for a first plan that came late; of the
    request for the first plan, when that is to begin.
    """
    delay: float
    """[s] from t to the beginning of the plan; for the first one it does not count."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReplanningResult:
    """Result of a solve."""

    planned: TimedPlan | None
    """None where no plan may be flown, so that the last one goes on."""
    reason: str
    """Why none may; else empty."""
    first: bool
    """The plan is the first, for which the robot stays where it is."""
    solve_time: float
    """[s] by the clock that was given."""
    processor_time: float
    """[s] without what other processes took."""


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
        """The kind that is tried next."""
        return GuessKind((self.value + 1) % len(GuessKind))


def planned_bounds(transcription: Transcription) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (n_x,) of the variables of a plan that is tracked: those of the problem,
    with a share of the limits of all rates.
    """
    robot = transcription.problem.robot
    undriven = np.linalg.norm(undriven_axes(robot), axis=1) > _UNDRIVEN
    share = np.where(undriven, _PLANNED_UNDRIVEN_RATE, _PLANNED_RATE)
    lower, upper = (bound.copy() for bound in transcription.bounds())
    columns = transcription.variables.all_columns[1:, transcription.model.layout.v]
    lower[columns] *= share
    upper[columns] *= share
    return lower, upper


class Replanner:
    """Solves of one problem. Holds the plans that may be in use, and the newest point as a guess:
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
        chosen = options or SqpOptions()
        self._sqp = RealTimeSqp(
            program_for(chosen.plugin or stagewise_or(SPARSE_PLUGIN, problem), self._transcription),
            chosen,
        )
        self._check = PlanCheck(self._transcription, accuracy=chosen.accuracy, gains=gains)
        self._plans: dict[int, TimedPlan] = {}
        self._newest: TimedPlan | None = None
        """Fit for use or not."""
        self._guess = GuessKind.NEWEST
        """Guess with which the next solve begins."""
        self._rejected: deque[np.ndarray] = deque(maxlen=_REMEMBERED)
        """Inputs of solves that led to no plan, since the last one that did."""
        self._solves = 0

    def __call__(self, request: ReplanningRequest) -> ReplanningResult:
        """A plan that begins as long after it was asked for as the request has it, or the first
        one.
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
        self._plans[HOLD] = self._newest = hold
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
        self._plans[best.number] = self._newest = best
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
        p = self._transcription.parameters(t0=begin, start=start, near=guess.q)
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


class WorkerStatus(AdvisedStatus):
    """Plans are still being made. Where they are not, the last one goes on and its end is held."""

    WORKING = "working", "nothing to do"
    CRASHED = (
        "crashed",
        (
            "the process of the solver has ended; see its last words on stderr, and build a new"
            " controller"
        ),
    )
    SILENT = (
        "silent",
        (
            "a solve did not end in time, and its process was stopped; raise timeout, or shorten"
            " the horizon"
        ),
    )
    CLOSED = "closed", "the controller was closed; build a new one"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReplanningJob:
    """Problem that a worker solves again and again."""

    problem: OcpProblem
    period: float
    """[s] of planning."""
    options: SqpOptions | None
    gains: TrackingGains | None
    """Gains of the law that tracks plans."""
    clock: Callable[[], float]
    """[s] by which solves in line are timed; a process has a clock of its own."""


@checked_dataclass()
class SynchronousWorker:
    """Within the tick that asks, which lasts as long: simulations are reproducible. Plans are as
    late as their solves took.
    """


@checked_dataclass()
class ProcessWorker:
    """In a process of its own: no tick waits, and a plan takes over when it is ready.

    It begins where the vehicle will be then, as long after the measurement as solves take of late.

    The process is started anew, not forked: what starts it must be importable (``if __name__ ==
    "__main__":`` around a script), and so must all that the problem is made of, such as functions
    and classes that give moving goals. It ends with the controller, or with the process that
    started it.
    """

    lead: Positive = 1.0
    """[s] from the first call to the beginning of the first plan, which takes several solves."""
    timeout: Positive = 5.0
    """[s] for a solve, after which its process is stopped."""
    start_timeout: Positive = 120.0
    """[s] for the process to be ready, which compiles what is not in the cache."""


def start_worker(worker: SynchronousWorker | ProcessWorker, job: ReplanningJob) -> RunningWorker:
    """A worker that is ready; a process is waited for.

    Raises `InvalidInput` for a problem that cannot be sent to a process, and `UvmsError` where that
    does not get ready.
    """
    if isinstance(worker, ProcessWorker):
        return RunningProcess(job, worker)
    return RunningSynchronously(job)


class RunningSynchronously:
    """A worker at work on one job, within the tick."""

    def __init__(self, job: ReplanningJob) -> None:
        self._replanner = Replanner(
            job.problem,
            options=job.options,
            gains=job.gains,
            time_limit=job.period,
            clock=job.clock,
        )
        self._answer: ReplanningResult | None = None
        self.lead = 0.0
        """[s] from the request for the first plan to its beginning."""
        self.status = WorkerStatus.WORKING
        self._delay = LateSolves()

    def delay(self, period: float) -> float:
        """Time [s] from a request to the beginning of the plan: until the next request, in a period
        [s], so that runs are the same on every machine, unless solves of late took longer.
        """
        return max(period, self._delay.seconds)

    def ask(self, request: ReplanningRequest) -> None:
        """Begin a solve; only where the last one was answered."""
        if self.status is not WorkerStatus.WORKING:
            return
        self._answer = self._replanner(request)
        if not self._answer.first:
            self._delay.count(self._answer.solve_time)

    def answer(self) -> ReplanningResult | None:
        """Return the result of the solve that was asked for, once; `None` while there is none.
        Never waits.
        """
        answer = self._answer
        self._answer = None
        return answer

    def close(self) -> None:
        """End whatever runs beside; may be called twice."""
        self.status = WorkerStatus.CLOSED


class RunningProcess:
    """A worker at work on one job, in a process of its own; members as those of
    `RunningSynchronously`.
    """

    def __init__(self, job: ReplanningJob, limits: ProcessWorker) -> None:
        """Raises `InvalidInput` and `UvmsError` as `start_worker` does."""
        require_first_reading("Scenario.run with a ProcessWorker")
        words = _sent(job)
        self.lead = limits.lead
        context = get_context("spawn")
        self._connection, connection_of_process = context.Pipe()
        self._process: BaseProcess = context.Process(
            target=_serve, args=(connection_of_process, words), daemon=True, name="nmpc"
        )
        self._limits = limits
        self.status = WorkerStatus.WORKING
        self._asked = 0.0
        self._delay = SolveDelay(job.period)
        self._selector = DefaultSelector()
        self._selector.register(self._connection, EVENT_READ)
        self._process.start()
        connection_of_process.close()
        self._await_start()

    def _await_start(self) -> None:
        error: object = (
            f"it was not ready after {self._limits.start_timeout:g} s; raise start_timeout"
        )
        try:
            if self._connection.poll(self._limits.start_timeout):
                error = self._connection.recv()
        except (EOFError, OSError):
            error = "it ended at once; see its last words on stderr"
        if error is None:
            return
        self._end(WorkerStatus.CRASHED)
        raise UvmsError(f"the process of the solver: {error}")

    def delay(self, period: float) -> float:
        """Time [s] from a request to the beginning of the plan, by the solves of late; period [s]:
        until the next request, which does not matter.
        """
        return self._delay.seconds

    def ask(self, request: ReplanningRequest) -> None:
        """Send the request."""
        if self.status is not WorkerStatus.WORKING:
            return
        self._asked = perf_counter()
        try:
            self._connection.send(request)
        except OSError:
            self._end(WorkerStatus.CRASHED)

    def answer(self) -> ReplanningResult | None:
        """Look for an answer, and whether the process is still at it."""
        if self.status is not WorkerStatus.WORKING:
            return None
        try:
            # Connection.poll makes a selector at every call, which takes as long as a tenth of a
            # tick.
            if self._selector.select(0):
                answer: ReplanningResult = self._connection.recv()
                if not answer.first:
                    self._delay.count(answer.solve_time)
                return answer
        except (EOFError, OSError):
            self._end(WorkerStatus.CRASHED)
            return None
        if perf_counter() - self._asked > self._limits.timeout:
            self._end(WorkerStatus.SILENT)
        return None

    def close(self) -> None:
        """Stop the process."""
        if self.status is WorkerStatus.WORKING:
            self._end(WorkerStatus.CLOSED)
        self._process.join()

    def _end(self, status: WorkerStatus) -> None:
        """At once, whatever the process does: a solve in a library listens to nobody."""
        self.status = status
        self._selector.close()
        self._connection.close()
        self._process.kill()


RunningWorker: TypeAlias = RunningSynchronously | RunningProcess


def _sent(job: ReplanningJob) -> bytes:
    try:
        return pickle.dumps((job.problem, job.period, job.options, job.gains))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidInput(
            f"the problem cannot be sent to another process ({error}); define its goals and tasks"
            " at the top level of a module, or solve with SynchronousWorker()"
        ) from error


def _serve(connection: Connection, words: bytes) -> None:
    """The other process: solve until no one asks any more."""
    # Whoever interrupts the controller leaves it to the controller to end this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        problem, period, options, gains = pickle.loads(words)
        replanner = Replanner(problem, options=options, gains=gains, time_limit=_PATIENCE * period)
    except Exception as error:
        connection.send(f"{type(error).__name__}: {error}")
        return
    # All that was built stays: whoever looked through it for garbage would keep a plan waiting for
    # longer than it takes.
    gc.collect()
    gc.freeze()
    connection.send(None)
    while True:
        try:
            connection.send(replanner(connection.recv()))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return
