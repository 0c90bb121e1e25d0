"""Calls of CasADi functions on memory that stays where it is; results that nobody wants are not written."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput


class BoundCalls:
    """Calls one after the other. Not for use from two threads at once."""

    __slots__ = ("_calls", "_kept")

    def __init__(self) -> None:
        self._calls: list[Callable[[], None]] = []
        self._kept: list[object] = []

    def add(self, function: ca.Function, arguments: Sequence[Array], results: Sequence[Array | None]) -> None:
        """One more call; arguments and results, (m,) or (m, n) [any], are contiguous, column by column as CasADi has them.

        Raises `InvalidInput` for memory of another size.
        """
        buffer, evaluate = function.buffer()
        for i, argument in enumerate(arguments):
            buffer.set_arg(i, _memory(function, argument, function.numel_in(i)))
        for i, result in enumerate(results):
            if result is not None and result.size:
                buffer.set_res(i, _memory(function, result, function.numel_out(i)))
        self._calls.append(evaluate)
        self._kept.append((function, buffer, arguments, results))

    def __call__(self) -> None:
        """Make all calls."""
        for call in self._calls:
            call()


def _memory(function: ca.Function, given: Array, size: int) -> memoryview:
    if given.size != size or given.dtype != np.float64 or not given.flags.c_contiguous:
        raise InvalidInput(f"{function.name()}: memory of shape {given.shape}; give {size} numbers side by side")
    return given.reshape(-1).data
