"""Laws of steps that run one after the other: where functions of Python are among kernels, no stop, no
Ctrl-C and no memory is lost.
"""

from __future__ import annotations

import gc
import signal
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from compiler import IN_C_AND_PYTHON, needs_compiler
from pressed import PYTHON_MAY_LOSE_IT

from uvms_ocp.codegen import sequence
from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import loaded_library
from uvms_ocp.codegen.sequence import LOOK, Step, StepSequence

PRESS = "#include <signal.h>\nvoid press(void) { raise(SIGINT); }"


def _stop() -> np.ndarray:
    return np.zeros((), np.intc)


def _do_nothing() -> None:
    pass


@pytest.fixture
def pythons_answer_to_ctrl_c() -> Any:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@needs_compiler
@PYTHON_MAY_LOSE_IT
@pytest.mark.usefixtures("pythons_answer_to_ctrl_c")
def test_ctrl_c_within_machine_code_is_raised() -> None:
    """Python raises it as the next function begins, where ctypes prints it and goes on."""
    path = compile_library(PRESS)
    assert path is not None
    calls = list[int]()
    steps = [
        Step("press", loaded_library(path).press),
        Step("ask", lambda: calls.append(1)),
    ]
    passes = StepSequence(steps, _stop())
    assert passes.run(3, 0) == 0
    with pytest.raises(KeyboardInterrupt):
        passes.check()
    assert not calls


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_functions_that_follow_keep_the_end_that_a_step_has_asked_for(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = _stop()

    def look() -> None:
        stop[...] = LOOK

    if not compiled:
        monkeypatch.setattr(sequence, "_runner", lambda: None)
    passes = StepSequence([Step("look", look), Step("follow", _do_nothing)], stop)
    assert passes.run(3, 0) == 0
    assert stop == LOOK
    passes.check()
    assert passes.run(1, 0, done=True) == 1


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
@pytest.mark.parametrize("first", [0, 1, 2])
def test_what_a_function_raises_ends_the_passes(
    first: int, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once: the next passes go on."""
    n = []

    def fail() -> None:
        n.append(0)
        if len(n) == first + 1:
            raise ValueError("broken")

    if not compiled:
        monkeypatch.setattr(sequence, "_runner", lambda: None)
    passes = StepSequence([Step("fail", fail), Step("follow", _do_nothing)], _stop())
    assert passes.run(5, 0) == first
    with pytest.raises(ValueError, match="broken"):
        passes.check()
    assert passes.run(5, 0) == 5
    passes.check()


def test_steps_let_go_of_what_they_work_on_at_once() -> None:
    """Not when Python looks for cycles: those of a run hold a megabyte."""

    class Part:
        def ask(self) -> None:
            pass

    part: Any = Part()
    gone: Callable[[], Any] = weakref.ref(part)
    gc.disable()
    try:
        passes = StepSequence([Step("ask", part.ask)], _stop())
        passes.run(1, 0)
        del part, passes
        assert gone() is None
    finally:
        gc.enable()
