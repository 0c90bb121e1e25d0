"""Questions of kernels to Python: for what has no other form."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import casadi as ca

from uvms_ocp.functions.kernels.smooth import smooth_structure

_CALL = ctypes.CFUNCTYPE(ctypes.c_int, *(ctypes.c_void_p,) * 4, ctypes.c_int)
_NOTHING = ca.Function("ask", [], [])


class Ask:
    """A field of a layout: what kernels ask of Python, as ``m.ask()``, and `Answer` answers on the memory; not before."""

    def __call__(self) -> None:
        """What stands in a kernel."""


class AskStructure(smooth_structure(_NOTHING)):  # type: ignore[misc]
    """What `Ask` is in memory: a function of nothing, at the place where a `Smooth` has its machine code."""

    __slots__ = ()

    def __call__(self) -> None:
        """As C does it, without a compiler."""
        _CALL(self.call)(None, None, None, None, 0)


class Answer:
    """The Python function that answers a question in a memory, for as long as this lives."""

    def __init__(self, question: AskStructure, function: Callable[[], None]) -> None:
        self._function = function
        self._error: BaseException | None = None
        self._called = _CALL(self._call)
        question.call = ctypes.cast(self._called, ctypes.c_void_p).value

    def check(self) -> None:
        """Raise what the function has raised, which kernels do not."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _call(self, *nothing: Any) -> int:
        try:
            self._function()
        except BaseException as error:
            self._error = error
            return 1
        return 0
