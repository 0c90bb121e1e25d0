"""End runs whose time is over."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

GRACE = 3.0
"""[s] in which Python must leave a run whose time is over; a run in a call that does not come back is
ended.
"""
_ARRIVAL = 50  # [ms] in which an interrupt that is on its way arrives


class OverTime(BaseException):
    """The time of a run is over. No `Exception`, so that whatever a run catches lets it through."""


@contextmanager
def time_limit(seconds: float, stuck: Callable[[], None]) -> Iterator[None]:
    """Raise `OverTime` in the block after so many seconds [s].

    stuck: called where the block has not ended `GRACE` later. The error comes between two steps of
    Python: a single call that never returns, such as a sleep, does not notice it.
    """
    watch = _Watch(threading.get_ident(), stuck)
    timer = threading.Timer(seconds, watch.end)
    timer.daemon = True
    try:
        timer.start()
        yield
    finally:
        try:
            timer.cancel()
        finally:
            watch.leave()


class _Watch:
    """Watchdog of one run in one thread."""

    def __init__(self, thread: int, stuck: Callable[[], None]) -> None:
        self._thread = thread
        self._stuck = stuck
        self._lock = threading.Lock()
        self._left = threading.Event()
        self._fired = False

    def end(self) -> None:
        """Interrupt the run, unless it has ended."""
        with self._lock:
            if self._left.is_set():
                return
            self._fired = True
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(self._thread), ctypes.py_object(OverTime)
            )
        if not self._left.wait(GRACE):
            self._stuck()

    def leave(self) -> None:
        """End the watch of a run; an interrupt on its way arrives here, and not in the next run."""
        try:
            with self._lock:
                self._left.set()
            is_on_its_way = self._fired and not isinstance(sys.exc_info()[1], OverTime)
            if is_on_its_way:
                for _ in range(_ARRIVAL):
                    time.sleep(0.001)
        finally:
            self._left.set()
