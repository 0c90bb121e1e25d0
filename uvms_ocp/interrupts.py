"""Answer Ctrl-C where Python's own answer would be lost, as within CasADi, or leave things half
done.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Stopped(KeyboardInterrupt):
    """Ctrl-C, or the stop of a notebook's cell, before there is anything to keep."""

    def __init__(self) -> None:
        super().__init__("stopped by hand, before there was anything to keep")

    def _render_traceback_(self) -> list[str]:
        """Return the one line that IPython prints in place of a traceback."""
        return [str(self)]


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, or the stop of a notebook's cell, with the `result` so far, if there is any: the
    `Record` of a run, the `Plan` of a planner, the table of a campaign.
    """

    def __init__(self, text: str, result: Any = None) -> None:
        super().__init__(text)
        self.result = result

    def _render_traceback_(self) -> list[str]:
        """Return the one line that IPython prints in place of a traceback."""
        if self.result is None:
            return [str(self)]
        return [f"{self}; sys.last_value.result has what there is so far"]


@contextmanager
def on_interrupt(answer: Callable[[FrameType | None], object]) -> Iterator[None]:
    """Answer the first Ctrl-C within the block, and pass it on to the blocks around that do so too.

    answer: gets the frame that was interrupted. A second Ctrl-C ends all of these blocks as Python
    does. Nothing changes in other threads, and where another program answers Ctrl-C.
    """
    handler_before = signal.getsignal(signal.SIGINT)
    is_main_thread = threading.current_thread() is threading.main_thread()
    is_pythons = handler_before is signal.default_int_handler
    if not is_main_thread or not (is_pythons or isinstance(handler_before, _Handler)):
        yield
        return
    handler = _Handler(answer, handler_before)
    signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is handler:
            signal.signal(signal.SIGINT, handler_before)


class _Handler:
    """A handler of SIGINT for one press: it puts back the handler before it, calls that where it is
    of a block around, and answers.
    """

    def __init__(self, answer: Callable[[FrameType | None], object], handler_before: Any) -> None:
        self._answer = answer
        self._handler_before = handler_before

    def __call__(self, number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, self._handler_before)
        if isinstance(self._handler_before, _Handler):  # first, as an answer may raise
            self._handler_before(number, frame)
        self._answer(frame)


@contextmanager
def held_back() -> Iterator[None]:
    """Hold Ctrl-C back until the block ends, where it is answered as it would have been before.

    Nothing changes in other threads, and within another such block.
    """
    handler_before = signal.getsignal(signal.SIGINT)
    is_main_thread = threading.current_thread() is threading.main_thread()
    if not (is_main_thread and callable(handler_before)) or isinstance(handler_before, _Hold):
        yield
        return
    hold = _Hold()
    signal.signal(signal.SIGINT, hold)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler_before)
        if hold.was_pressed:
            signal.raise_signal(signal.SIGINT)


class _Hold:
    """A handler of SIGINT that notes that it was called."""

    def __init__(self) -> None:
        self.was_pressed = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.was_pressed = True


@contextmanager
def raised_outside_casadi() -> Iterator[None]:
    """Raise `Stopped` for Ctrl-C once CasADi has returned: what is raised within it is lost, as in
    callbacks of weak references, for which it is raised at the end of the block.
    """
    presses: list[FrameType | None] = []

    # What a handler raises within a callback of CasADi is printed by CasADi's C++ and lost. Python
    # has one way to be asked again once that has returned: a profiler, which it calls at the next
    # call or return of a function. It is set after a press alone, so that nothing is slower before.
    def once_outside(frame: FrameType | None, *event: object) -> None:
        presses.append(frame)
        if _within_casadi(frame):
            sys.setprofile(once_outside)
            return
        if sys.getprofile() is once_outside:
            sys.setprofile(None)
        raise Stopped

    try:
        with on_interrupt(once_outside):
            yield
        if presses:
            raise Stopped
    finally:
        if sys.getprofile() is once_outside:
            sys.setprofile(None)


def _within_casadi(frame: FrameType | None) -> bool:
    """Return whether a function of CasADi's Python module is among the callers of this frame."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] == "casadi":
            return True
        frame = frame.f_back
    return False
