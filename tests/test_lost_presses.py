"""A press that Python loses ends the block all the same, at its end."""

from __future__ import annotations

import gc
import signal
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from pressed import PYTHON_MAY_LOSE_IT

from uvms_ocp.interrupts import Stopped, raised_outside_casadi

pytestmark = PYTHON_MAY_LOSE_IT


class Referent:
    """What a weak reference may be of."""


@contextmanager
def called_by_gc(press: Callable[[], object]) -> Iterator[None]:
    def watch(phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            press()

    gc.callbacks.append(watch)
    try:
        yield
    finally:
        gc.callbacks.remove(watch)


def press() -> None:
    """Ctrl-C; the handler runs before this returns."""
    signal.raise_signal(signal.SIGINT)


@pytest.fixture(autouse=True)
def _interruptible() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_press_within_what_garbage_collection_calls_ends_the_block() -> None:
    with called_by_gc(press), pytest.raises(Stopped), raised_outside_casadi():
        gc.collect()


def test_a_press_within_a_callback_of_a_weak_reference_ends_the_block() -> None:
    referent = Referent()
    keeper = weakref.ref(referent, lambda _: press())
    with pytest.raises(Stopped), raised_outside_casadi():
        del referent
    assert keeper() is None
