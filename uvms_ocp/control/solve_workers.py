"""Run the solves of receding-horizon control within the tick, or in a process of their own."""

from __future__ import annotations

import gc
import pickle
import signal
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from selectors import EVENT_READ, DefaultSelector
from time import perf_counter
from typing import TypeAlias

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control.force.computed_torque import TrackingGains
from uvms_ocp.control.replanning import Replanner, ReplanningRequest, ReplanningResult
from uvms_ocp.errors import AdvisedStatus, InvalidInput, UvmsError, require_first_reading
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.solvers import SqpOptions
from uvms_ocp.types import Positive

_FORGOTTEN = 0.95
"""Share of the longest solve time that is left after every shorter one: twenty solves count."""
_RECENT = 5
"""Solves in line by which the next one is judged."""
_SENT = 1e-3
"""[s] time that a request and its result take between processes."""
_FAREWELL = 1.0
"""[s] in which a process that is closed may end by itself."""
_PATIENCE = 3
"""Periods after which a solve beside begins no further step: a plan that comes late is of more use
than none.
"""


class WorkerStatus(AdvisedStatus):
    """State of a worker. Where it makes no more plans, the last one goes on and its end is held."""

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
    """[s] planning period."""
    options: SqpOptions | None
    gains: TrackingGains | None
    """Gains of the law that tracks plans."""
    clock: Callable[[], float]
    """Clock [s] by which solves within the tick are timed; a process has a clock of its own."""


@checked_dataclass()
class SynchronousWorker:
    """Worker that solves within the tick that asks, so that simulations are reproducible. Plans are as
    late as their solves took.
    """


@checked_dataclass()
class ProcessWorker:
    """Worker in a process of its own: no tick waits, and a plan takes over when it is ready.

    A plan begins where the vehicle will be when it is ready, as long after the measurement as
    recent solves took.

    The process is started anew, not forked: the script that starts it must be importable (``if
    __name__ == "__main__":`` around its calls), and so must all parts of the problem, such as
    functions and classes that give moving goals. The process ends with the controller, or with the
    process that started it.
    """

    lead: Positive = 1.0
    """[s] time from the first call to the beginning of the first plan, which takes several solves.
    """
    timeout: Positive = 5.0
    """[s] time limit of a solve, after which its process is stopped."""
    start_timeout: Positive = 120.0
    """[s] time limit of the start of the process, which compiles what is not in the cache."""


def start_worker(worker: SynchronousWorker | ProcessWorker, job: ReplanningJob) -> RunningWorker:
    """Start a worker, and wait until it is ready.

    Raises `InvalidInput` for a problem that cannot be sent to a process, and `UvmsError` where the
    process does not get ready.
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
        """[s] time from the request for the first plan to its beginning."""
        self.status = WorkerStatus.WORKING
        self._delay = LateSolves()

    def delay(self, period: float) -> float:
        """Return the time [s] from a request to the beginning of the plan: the period [s] between
        requests, so that runs are the same on every machine, unless recent solves took longer.
        """
        return max(period, self._delay.seconds)

    def ask(self, request: ReplanningRequest) -> None:
        """Solve at once, unless the worker was closed."""
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
        """Take no further requests; may be called twice."""
        self.status = WorkerStatus.CLOSED


class RunningProcess:
    """A worker at work on one job, in a process of its own, with the interface of
    `RunningSynchronously`.
    """

    def __init__(self, job: ReplanningJob, limits: ProcessWorker) -> None:
        """Start the process. Raises `InvalidInput` for a job that cannot be sent to it, and
        `UvmsError` where it does not get ready.
        """
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
        """Wait until the process is ready. Raises `UvmsError` where it does not get ready."""
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
        """Return the time [s] from a request to the beginning of the plan, by recent solves; period
        [s]: between requests, not used.
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
        """Return the answer if there is one, else `None`; stops a process that has crashed or takes
        too long. Never waits.
        """
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
        """Stop the process: a closed one gets a moment to give back its system resources; any other
        one is killed, as a solve in a library cannot be asked to stop.
        """
        self.status = status
        self._selector.close()
        self._connection.close()
        if status is WorkerStatus.CLOSED:
            self._process.join(_FAREWELL)
        self._process.kill()


RunningWorker: TypeAlias = RunningSynchronously | RunningProcess


class SolveDelay:
    """Delay of plans by the longest recent solve. A plan that is later than that keeps its time
    stamps; one that is earlier has to wait.
    """

    def __init__(self, first: float) -> None:
        """first [s]: delay before any solve was made."""
        self._longest = first

    @property
    def seconds(self) -> float:
        """Time [s] from the request to the plan."""
        return self._longest + _SENT

    def count(self, solve_time: float) -> None:
        """Take note of a solve that took `solve_time` [s]."""
        self._longest = max(solve_time, _FORGOTTEN * self._longest)


class LateSolves:
    """Delay of plans by the second longest of the last few solves, as a single one may be slow by
    chance; by the longest while there are too few.
    """

    def __init__(self) -> None:
        self._last = deque[float](maxlen=_RECENT)

    @property
    def seconds(self) -> float:
        """Time [s] from the request to the plan; 0 while there is none to judge by."""
        longest = sorted(self._last, reverse=True)
        if len(longest) == _RECENT:
            return longest[1]
        if longest:
            return longest[0]
        return 0.0

    def count(self, solve_time: float) -> None:
        """Take note of a solve that took `solve_time` [s]."""
        self._last.append(solve_time)


def _sent(job: ReplanningJob) -> bytes:
    """Pickle a job for a process. Raises `InvalidInput`."""
    try:
        return pickle.dumps((job.problem, job.period, job.options, job.gains))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidInput(
            f"the problem cannot be sent to another process ({error}); define its goals and tasks"
            " at the top level of a module, or solve with SynchronousWorker()"
        ) from error


def _serve(connection: Connection, words: bytes) -> None:
    """Run the process of a worker: solve requests until the connection is closed."""
    # Ctrl-C reaches this process too, but the controller ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        problem, period, options, gains = pickle.loads(words)
        replanner = Replanner(problem, options=options, gains=gains, time_limit=_PATIENCE * period)
    except Exception as error:
        connection.send(f"{type(error).__name__}: {error}")
        return
    # All that was built stays: a garbage collection that looks through it takes longer than a
    # solve.
    gc.collect()
    gc.freeze()
    connection.send(None)
    while True:
        try:
            connection.send(replanner(connection.recv()))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return
