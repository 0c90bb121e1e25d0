"""Ctrl-C after a time."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import pytest

PYTHON_MAY_LOSE_IT = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""In what garbage collection calls an exception is only told, and a press ends its block at its
end.
"""


@contextmanager
def pressed_after(seconds: float) -> Iterator[list[float]]:
    """Ctrl-C after so many seconds [s] of the block; gives a list that is no longer empty then."""
    pressed: list[float] = []

    def press(number: int, frame: FrameType | None) -> None:
        pressed.append(seconds)
        signal.raise_signal(signal.SIGINT)

    before = (
        signal.signal(signal.SIGALRM, press),
        signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield pressed
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before[0])
        signal.signal(signal.SIGINT, before[1])
