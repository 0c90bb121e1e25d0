"""Ctrl-C at any moment of a run ends it, and keeps what was flown until then."""

from __future__ import annotations

import random
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from types import FrameType

import numpy as np
import pytest
from compiler import long_without_compiler

import uvms_ocp as uo
from uvms_ocp.report.summary import cause_of_end
from uvms_ocp.robot.signals import Command

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="timers by signals")
MOMENTS = 20


def scenario() -> uo.Scenario:
    return uo.scenario.reach(plant="kinematic", duration=6.0, dt=0.005)


@contextmanager
def pressed_after(seconds: float) -> Iterator[list[float]]:
    """Ctrl-C after so many seconds [s] of the block; gives a list that is no longer empty then."""
    pressed: list[float] = []

    def press(number: int, frame: FrameType | None) -> None:
        pressed.append(seconds)
        signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGALRM, press), signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield pressed
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before[0])
        signal.signal(signal.SIGINT, before[1])


@long_without_compiler
def test_whenever_it_is_pressed_a_run_ends_with_what_was_flown() -> None:
    scenario().run()  # whatever is compiled once
    begin = perf_counter()
    whole = scenario().run()
    lasts, draw = perf_counter() - begin, random.Random(44)
    ends = set()
    for _ in range(MOMENTS):
        given, record = scenario(), None
        with pressed_after(draw.uniform(0.001, lasts)) as pressed:
            try:
                given.run()
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                end = "finished"
            except uo.Interrupted as stop:
                end, record = "flying", stop.result
            except KeyboardInterrupt:
                end = "set-up"
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert sys.getprofile() is None
        assert (end == "finished") == (not pressed)
        ends.add(end)
        if record is not None:
            assert record.run_meta.stopped == "stopped" or len(record) == len(whole)
            assert {len(series) for series in record.series.values()} == {len(record)}
            np.testing.assert_array_equal(record["q"], whole["q"][: len(record)])
    assert ends > {"finished"} or "finished" not in ends
    np.testing.assert_array_equal(scenario().run()["q"], whole["q"])


def test_the_record_of_a_run_that_was_stopped_says_so() -> None:
    def press(t: float, command: Command) -> None:
        if t >= 0.2:
            signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(uo.Interrupted, match=r"stopped by hand at t = 0\.2 s") as stop:
            scenario().run(press)
    finally:
        signal.signal(signal.SIGINT, before)
    record = stop.value.result
    assert record["t"][-1] == pytest.approx(0.2)
    assert not record.run_meta.completed
    assert cause_of_end(record)["kind"] == "stopped"
    assert cause_of_end(record)["text"].startswith("by hand; phase ")
    assert stop.value._render_traceback_() == [f"{stop.value}; sys.last_value.result has what there is so far"]
