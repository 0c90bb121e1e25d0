"""Jobs that write files, shared with a process beside this one: Matplotlib and meshcat keep one processor busy each."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

Job = Callable[[], object]


def share(jobs: Sequence[Job], telling: AbstractContextManager[object] | None = None) -> None:
    """Do all jobs, at most 255, in any order, here and in a copy of this process where the system makes one.

    What counts is what they write; each must bear to be done twice. telling: entered here alone, once there is a copy, as a
    thread that prints would be missing in it. Raises what a job raises.
    """
    places = _numbers(len(jobs))
    try:
        copy = _copy(lambda: _take(jobs, places))
        try:
            with telling or nullcontext():
                _take(jobs, places)
        except BaseException:
            _end(copy)
            raise
        if not _is_done(copy):
            for job in jobs:  # what went wrong there goes wrong here, and is told
                job()
    finally:
        os.close(places)


def _numbers(n: int) -> int:
    """A pipe with the numbers of all jobs, which whoever is free reads one by one."""
    reading, writing = os.pipe()
    os.write(writing, bytes(range(n)))
    os.close(writing)
    return reading


def _take(jobs: Sequence[Job], places: int) -> None:
    while place := os.read(places, 1):
        jobs[place[0]]()


def _copy(work: Job) -> int:
    """The process that does the work too; 0 for none."""
    if sys.platform in ("win32", "darwin") or (os.cpu_count() or 1) < 2:
        return 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads of libraries, which wait for work
        copy = os.fork()
    if copy:
        return copy
    code = 1
    try:
        with open(os.devnull, "w") as silence:
            sys.stdout = sys.stderr = silence
            work()
        code = 0
    finally:
        os._exit(code)


def _is_done(copy: int) -> bool:
    return copy == 0 or os.waitpid(copy, 0)[1] == 0


def _end(copy: int) -> None:
    if copy:
        os.kill(copy, signal.SIGKILL)
        os.waitpid(copy, 0)
