"""Compile in threads beside other work; another process completes compilations that are unfinished
when this one ends.
"""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from multiprocessing.pool import AsyncResult, ThreadPool
from pathlib import Path
from typing import Any, TypeVar

from uvms_ocp.codegen import c_compiler
from uvms_ocp.codegen.libraries import BEHIND_OTHERS

_MAX_COMPILERS = 4
"""Largest number of compilers that a process runs at once, as a campaign has many processes."""
_BEGUN: list[tuple[AsyncResult[Any], Callable[[], Any]]] = []
"""Compilations in the background, whether anybody waits for them or not, with the work of each."""

T = TypeVar("T")


def start_beside(work: Callable[[], T]) -> AsyncResult[T]:
    """Start a compilation in the background; where this process ends first, another one finishes
    it. work: can be pickled, by its name or as a bound method.
    """
    _BEGUN[:] = [begun for begun in _BEGUN if not begun[0].ready()]
    result = _workers(os.getpid()).apply_async(work)
    _BEGUN.append((result, work))
    return result


def await_result(result: AsyncResult[T]) -> T:
    """Wait for a compilation that was started. Ctrl-C here ends all of them, and no other process
    completes them.
    """
    try:
        return result.get()
    except KeyboardInterrupt:
        _BEGUN.clear()
        raise


def n_processors() -> int:
    """Count the processors that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _workers(process: int) -> ThreadPool:
    """Return the compiler threads of a process, which a fork of it does not have; they end with the
    process, whatever is still being compiled.
    """
    pool = ThreadPool(min(_MAX_COMPILERS, n_processors()))

    def terminate() -> None:
        if os.getpid() == process:
            pool.terminate()

    atexit.register(terminate)
    return pool


@atexit.register
def _end_compilations() -> None:
    """Stop all compilers as the process ends, which threads that wait for them do not notice."""
    c_compiler.refuse_compilers()
    unfinished = [work for result, work in _BEGUN if not result.ready()]
    c_compiler.stop_compilers()
    if unfinished:
        _hand_over(unfinished)


def _hand_over(unfinished: Sequence[Callable[[], object]]) -> None:
    """Give unfinished compilations to a process of their own, so that the next process finds their
    libraries.
    """
    is_python = "python" in Path(sys.executable or "").name.lower()
    if not is_python:  # a program that embeds Python, which would start anew
        return
    imports = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import compile_what_is_left"
    with suppress(OSError, AttributeError, pickle.PicklingError), tempfile.TemporaryFile() as file:
        pickle.dump(unfinished, file)
        file.seek(0)
        subprocess.Popen(
            [sys.executable, "-c", f"{imports}; compile_what_is_left()"],
            stdin=file,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def compile_what_is_left() -> None:
    """Compile the unfinished compilations of another process, pickled on stdin, at the lowest
    priority.
    """
    if sys.platform != "win32":
        os.nice(19)
    BEHIND_OTHERS.set()
    jobs = pickle.load(sys.stdin.buffer)
    workers = _workers(os.getpid())
    results = [workers.apply_async(job) for job in jobs]
    for result in results:
        result.wait()


if sys.platform != "win32":
    # Compilations go on in the threads of the parent, which a fork does not have.
    os.register_at_fork(after_in_child=_BEGUN.clear)
