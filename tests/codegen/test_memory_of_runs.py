"""What runs of one process leave behind does not grow with their number."""

from __future__ import annotations

import ctypes

from compiler import needs_compiler

from uvms_ocp.codegen import compile as codegen
from uvms_ocp.scenario.cases import case1


def _pointers() -> int:
    return len(getattr(ctypes, "_pointer_type_cache", ()))


def _run() -> None:
    case1(plant="kinematic", duration=0.1, dt=0.02).run()


@needs_compiler
def test_machine_code_is_taken_up_once() -> None:
    """Before, 19 functions and 0.7 MB a run were kept for ever."""
    _run()
    known = len(codegen._ADDRESSES), _pointers()
    for _ in range(3):
        _run()
    assert (len(codegen._ADDRESSES), _pointers()) == known
