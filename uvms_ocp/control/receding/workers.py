"""Where the solves of receding-horizon control run: within the tick, or in a process beside it."""

from __future__ import annotations

import gc
import pickle
import signal
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from selectors import EVENT_READ, DefaultSelector
from time import perf_counter

from uvms_ocp.arguments import Positive, checked
from uvms_ocp.control.receding.messages import answer_message, answer_of, request_message, request_of
from uvms_ocp.control.receding.replanning import Answer, Replanner, Request
from uvms_ocp.control.receding.solve_delay import SolveDelay
from uvms_ocp.exceptions import InvalidInput, UvmsError
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.solvers.nlp.sqp_options import SqpOptions
from uvms_ocp.status import AdvisedStatus

_PATIENCE = 3
"""[-] periods after which a solve beside begins no further step: a plan that comes late is of more use than none."""


class WorkerStatus(AdvisedStatus):
    """Whether plans are still being made. Where they are not, the last one goes on and its end is held."""

    WORKING = "working", "nothing to do"
    CRASHED = "crashed", "the process of the solver has ended; see its last words on stderr, and build a new controller"
    SILENT = "silent", "a solve did not end in time, and its process was stopped; raise timeout, or shorten the horizon"
    CLOSED = "closed", "the controller was closed; build a new one"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Job:
    """What a worker is to solve again and again."""

    problem: OcpProblem
    period: float
    """[s] of planning."""
    options: SqpOptions | None
    clock: Callable[[], float]
    """[s] by which solves in line are timed; a process has a clock of its own."""


class Running(ABC):
    """A worker at work on one job."""

    lead: float
    """[s] from the request for the first plan to its beginning."""

    @property
    @abstractmethod
    def delay(self) -> float:
        """[s] from any other request to the beginning of the plan."""

    @property
    @abstractmethod
    def status(self) -> WorkerStatus:
        """Now."""

    @abstractmethod
    def ask(self, request: Request) -> None:
        """Begin a solve; only where the last one was answered."""

    @abstractmethod
    def answer(self) -> Answer | None:
        """Of the solve that was asked for, once; None while there is none. Never waits."""

    @abstractmethod
    def close(self) -> None:
        """End whatever runs beside; may be called twice."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class InLine:
    """Within the tick that asks, which lasts as long: simulations are reproducible. Plans are as late as their solves took."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Beside:
    """In a process of its own: no tick waits, and a plan takes over when it is ready.

    It begins where the vehicle will be then, as long after the measurement as solves take of late.

    The process is started anew, not forked: what starts it must be importable (``if __name__ == "__main__":`` around a
    script), and so must all that the problem is made of, such as functions and classes that give moving goals. It ends
    with the controller, or with the process that started it.
    """

    lead: Positive = 1.0
    """[s] from the first call to the beginning of the first plan, which takes several solves."""
    timeout: Positive = 5.0
    """[s] for a solve, after which its process is stopped."""
    start_timeout: Positive = 120.0
    """[s] for the process to be ready, which compiles what is not in the cache."""


def started(worker: InLine | Beside, job: Job) -> Running:
    """A worker that is ready; a process is waited for.

    Raises `InvalidInput` for a problem that cannot be sent to a process, and `UvmsError` where that does not get ready.
    """
    return _Beside(job, worker) if isinstance(worker, Beside) else _InLine(job)


class _InLine(Running):
    def __init__(self, job: Job) -> None:
        self._replanner = Replanner(job.problem, options=job.options, time_limit=job.period, clock=job.clock)
        self._answer: Answer | None = None
        self.lead, self._delay = 0.0, job.period
        self._status = WorkerStatus.WORKING

    @property
    def delay(self) -> float:
        # However long a solve takes: runs are the same on every machine.
        return self._delay

    @property
    def status(self) -> WorkerStatus:
        return self._status

    def ask(self, request: Request) -> None:
        if self._status is WorkerStatus.WORKING:
            self._answer = self._replanner(request)

    def answer(self) -> Answer | None:
        answer, self._answer = self._answer, None
        return answer

    def close(self) -> None:
        self._status = WorkerStatus.CLOSED


class _Beside(Running):
    def __init__(self, job: Job, limits: Beside) -> None:
        words, self.lead = _sent(job), limits.lead
        context = get_context("spawn")
        self._connection, other = context.Pipe()
        self._process: BaseProcess = context.Process(target=_serve, args=(other, words), daemon=True, name="nmpc")
        self._limits, self._status, self._asked = limits, WorkerStatus.WORKING, 0.0
        self._delay = SolveDelay(job.period)
        self._selector = DefaultSelector()
        self._selector.register(self._connection, EVENT_READ)
        self._process.start()
        other.close()
        self._await_start()

    def _await_start(self) -> None:
        error: object = f"it was not ready after {self._limits.start_timeout:g} s; raise start_timeout"
        try:
            if self._connection.poll(self._limits.start_timeout):
                error = self._connection.recv()
        except (EOFError, OSError):
            error = "it ended at once; see its last words on stderr"
        if error is None:
            return
        self._end(WorkerStatus.CRASHED)
        raise UvmsError(f"the process of the solver: {error}")

    @property
    def status(self) -> WorkerStatus:
        return self._status

    @property
    def delay(self) -> float:
        return self._delay.seconds

    def ask(self, request: Request) -> None:
        if self._status is not WorkerStatus.WORKING:
            return
        self._asked = perf_counter()
        try:
            self._connection.send(request_message(request))
        except OSError:
            self._end(WorkerStatus.CRASHED)

    def answer(self) -> Answer | None:
        if self._status is not WorkerStatus.WORKING:
            return None
        try:
            # Connection.poll makes a selector at every call, which takes as long as a tenth of a tick.
            if self._selector.select(0):
                return self._counted(answer_of(self._connection.recv()))
        except (EOFError, OSError):
            self._end(WorkerStatus.CRASHED)
            return None
        if perf_counter() - self._asked > self._limits.timeout:
            self._end(WorkerStatus.SILENT)
        return None

    def _counted(self, answer: Answer) -> Answer:
        if not answer.first:
            self._delay.count(answer.solve_time)
        return answer

    def close(self) -> None:
        if self._status is WorkerStatus.WORKING:
            self._end(WorkerStatus.CLOSED)
        self._process.join()

    def _end(self, status: WorkerStatus) -> None:
        """At once, whatever the process does: a solve in a library listens to nobody."""
        self._status = status
        self._selector.close()
        self._connection.close()
        self._process.kill()


def _sent(job: Job) -> bytes:
    try:
        return pickle.dumps((job.problem, job.period, job.options))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidInput(
            f"the problem cannot be sent to another process ({error}); define its goals and tasks at the top level of a"
            " module, or solve with InLine()"
        ) from error


def _serve(connection: Connection, words: bytes) -> None:
    """The other process: solve until no one asks any more."""
    # Whoever interrupts the controller leaves it to the controller to end this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        problem, period, options = pickle.loads(words)
        replanner = Replanner(problem, options=options, time_limit=_PATIENCE * period)
    except Exception as error:
        connection.send(f"{type(error).__name__}: {error}")
        return
    # All that was built stays: whoever looked through it for garbage would keep a plan waiting for longer than it takes.
    gc.collect()
    gc.freeze()
    connection.send(None)
    while True:
        try:
            connection.send(answer_message(replanner(request_of(connection.recv()))))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return
