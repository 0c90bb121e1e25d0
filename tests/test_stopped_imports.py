"""Ctrl-C while a module is loaded ends the statement, and the process can go on."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from uvms_ocp.interrupts import held_back

PROGRAM = """
import signal, sys

class Press:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Press())
import uvms_ocp as uo

try:
    uo.load_robot("bluerov2")
except KeyboardInterrupt:
    print("stopped")
print(uo.load_robot("bluerov2").n_v, {module!r} in sys.modules)
"""


@pytest.mark.sampled
@pytest.mark.parametrize(
    "module", ["numpy.linalg", "numpy.matrixlib", "pinocchio", "casadi", "uvms_ocp.robot.robot"]
)
def test_a_module_that_is_being_loaded_is_loaded_whole(module: str) -> None:
    program = PROGRAM.format(module=module)
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert process.stdout.splitlines() == ["stopped", "6 True"], process.stderr


def test_a_press_that_is_held_back_is_answered_once_at_the_end_of_the_outermost_block() -> None:
    answers: list[str] = []
    steps: list[str] = []
    before = signal.signal(signal.SIGINT, lambda *_: answers.append("pressed"))
    try:
        with held_back():
            with held_back():
                signal.raise_signal(signal.SIGINT)
            steps.append("inner block is over")
            assert not answers
        assert answers == ["pressed"]
        assert steps
        signal.raise_signal(signal.SIGINT)
        assert len(answers) == 2
    finally:
        signal.signal(signal.SIGINT, before)
