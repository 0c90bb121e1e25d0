"""Ctrl-C at any moment of a run ends it, and keeps what was flown until then."""

from __future__ import annotations

import cProfile
import pstats
import random
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

import casadi as ca
import numpy as np
import pytest
from compiler import long_without_compiler
from pressed import PYTHON_MAY_LOSE_IT, pressed_after

import uvms_ocp as uo
from uvms_ocp.interrupts import Stopped, on_interrupt
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.robot.signals import Command

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="timers by signals")
MOMENTS = 50


def scenario() -> uo.Scenario:
    return uo.scenario.reach(plant="kinematic", duration=6.0, dt=0.005)


@contextmanager
def default_answer() -> Iterator[None]:
    """Ctrl-C is answered by Python, as in a program of its own."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@PYTHON_MAY_LOSE_IT
@long_without_compiler
def test_whenever_it_is_pressed_a_run_ends_with_what_was_flown() -> None:
    scenario().run()  # whatever is compiled once
    begin = perf_counter()
    whole = scenario().run()
    lasts = perf_counter() - begin
    draw = random.Random(44)
    before = sys.getprofile()
    for _ in range(MOMENTS):
        tested_scenario = scenario()
        record = None
        with pressed_after(draw.uniform(0.001, lasts)) as pressed:
            try:
                tested_scenario.run()
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                end = "finished"
            except uo.Interrupted as stop:
                end = "flying"
                record = stop.result
            except KeyboardInterrupt:
                end = "set-up"
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert sys.getprofile() is before
        assert (end == "finished") == (not pressed)
        if record is not None:
            assert record.run_meta.stopped == "stopped" or len(record) == len(whole)
            assert {len(series) for series in record.series.values()} == {len(record)}
            np.testing.assert_array_equal(record["q"], whole["q"][: len(record)])
    np.testing.assert_array_equal(scenario().run()["q"], whole["q"])


class PressWithinCasadi(ca.Callback):
    """What is raised in it is lost."""

    def __init__(self) -> None:
        super().__init__()
        self.construct("press", {})

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        """Press."""
        signal.raise_signal(signal.SIGINT)
        return [arg[0]]


@pytest.mark.parametrize(
    "press", [lambda: PressWithinCasadi()(1.0), lambda: signal.raise_signal(signal.SIGINT)]
)
def test_a_press_while_a_run_is_set_up_ends_it(
    press: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    sensors = uo.Scenario._sensors
    profile = sys.getprofile()

    def pressed(self: uo.Scenario) -> object:
        press()
        return sensors(self)

    monkeypatch.setattr(uo.Scenario, "_sensors", pressed)
    with default_answer(), pytest.raises(Stopped) as stop:
        scenario().run()
    assert not isinstance(stop.value, uo.Interrupted)
    assert stop.value._render_traceback_() == [str(stop.value)]  # in a notebook
    assert "stopped by hand" in str(stop.value)
    assert sys.getprofile() is profile


def test_a_run_may_be_profiled() -> None:
    profile = cProfile.Profile()
    assert len(profile.runcall(scenario().run)) > 1
    assert any(function == "simulate" for _, _, function in pstats.Stats(profile).stats)  # type: ignore[attr-defined]


def test_a_second_press_ends_all_blocks() -> None:
    presses: list[object] = []
    with default_answer(), pytest.raises(KeyboardInterrupt), on_interrupt(presses.append):
        with on_interrupt(presses.append):
            signal.raise_signal(signal.SIGINT)
        assert len(presses) == 2
        signal.raise_signal(signal.SIGINT)
    assert len(presses) == 2


def test_the_record_of_a_run_that_was_stopped_says_so() -> None:
    def press(t: float, command: Command) -> None:
        if t >= 0.2:
            signal.raise_signal(signal.SIGINT)

    with (
        default_answer(),
        pytest.raises(uo.Interrupted, match=r"stopped by hand at t = 0\.2 s") as stop,
    ):
        scenario().run(press)
    record = stop.value.result
    assert record["t"][-1] == pytest.approx(0.2)
    assert not record.run_meta.completed
    assert cause_of_end(record)["kind"] == "stopped"
    assert cause_of_end(record)["text"].startswith("by hand; phase ")
    assert stop.value._render_traceback_() == [
        f"{stop.value}; sys.last_value.result has what there is so far"
    ]
