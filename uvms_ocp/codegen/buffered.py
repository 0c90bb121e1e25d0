"""Call CasADi functions through fixed memory: ten times less overhead than ``Function.call``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Array


@checked_on_failure
class BufferedFunction:
    """Call a function of dense inputs and outputs through fixed memory.

    Arguments and results are shaped as CasADi shapes them, (m, n), but columns are (m,). A column
    may also be given as (m, 1), and one column (m,) for all n columns of a matrix. Results are
    fresh arrays in C order. Not for use from two threads at once: every thread needs its own.
    """

    __slots__ = ("_arguments", "_buffer", "evaluate", "function", "results")

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._arguments = [_memory(function.size_in(i)) for i in range(function.n_in())]
        self.results = [_memory(function.size_out(i)) for i in range(function.n_out())]
        """(m,) or (m, n) [any] of the last evaluation, overwritten by the next; matrices in
        column-major order.
        """
        self._buffer, self.evaluate = buffer_on(function, self._arguments, self.results)
        """Function of no arguments that reads the arguments which were written last, or are
        adopted, and writes `results`.
        """

    def __reduce__(self) -> tuple[Any, ...]:
        return BufferedFunction, (self.function,)

    def __call__(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        """Evaluate. Raises `InvalidInput` for a wrong number of arguments, or one of the wrong
        shape.
        """
        self.write(*arguments)
        self.evaluate()
        return tuple([result.copy() for result in self.results])

    def write(self, *arguments: ArrayLike) -> None:
        """Write arguments for `evaluate`. Raises `InvalidInput` for a wrong number of them, or one
        of the wrong shape.
        """
        if len(arguments) != len(self._arguments):
            allowed = f"{len(self._arguments)}, {', '.join(self.function.name_in())}"
            raise InvalidInput(
                f"{self.function.name()}: {len(arguments)} arguments given; allowed: {allowed}"
            )
        for i, memory in enumerate(self._arguments):
            argument = arguments[i]
            if type(argument) is not np.ndarray or argument.shape != memory.shape:
                argument = self._fitted(i, argument)
            memory[...] = argument

    def adopt(self, *arguments: Array) -> None:
        """Adopt arguments, (m,) or (m, n) [any]: from now on `evaluate` reads them where they are,
        and a call writes there.

        Raises `InvalidInput` for another shape, and matrices that are not in column-major order.
        """
        for i, argument in enumerate(arguments):
            if argument.shape != self._arguments[i].shape or not argument.flags.f_contiguous:
                name = f"{self.function.name()}: {self.function.name_in(i)}"
                raise InvalidInput(
                    f"{name} of shape {argument.shape} given; allowed: {self._arguments[i].shape},"
                    " column-major"
                )
            self._arguments[i] = argument
            self._buffer.set_arg(i, argument.T.data)

    @property
    def failed(self) -> bool:
        """True if the last evaluation was abandoned, which leaves its results meaningless."""
        return bool(self._buffer.ret())

    def _fitted(self, i: int, argument: ArrayLike) -> Array:
        """Return an argument in the shape of its memory, or one column for all columns."""
        shape = self._arguments[i].shape
        array = np.asarray(argument, dtype=np.float64)
        squeezed_shape = self._arguments[i].squeeze().shape
        if array.size == self._arguments[i].size and array.squeeze().shape == squeezed_shape:
            return array.reshape(shape)
        if array.shape == shape[:1]:
            return array[:, None]
        name = f"{self.function.name()}: {self.function.name_in(i)}"
        raise InvalidInput(f"{name} of shape {array.shape} given; allowed: {shape}")


def argument_sizes(function: ca.Function) -> list[int]:
    """Count the numbers of every argument, then of every result."""
    sizes = [function.numel_in(i) for i in range(function.n_in())]
    sizes += [function.numel_out(i) for i in range(function.n_out())]
    return sizes


def buffer_on(
    function: ca.Function, arguments: Sequence[Array], results: Sequence[Array | None]
) -> tuple[Any, Any]:
    """Return a buffer on contiguous memory, and the call that evaluates it; a result of None is not
    written.
    """
    buffer, evaluate = function.buffer()
    for i, argument in enumerate(arguments):
        buffer.set_arg(i, _side_by_side(argument))
    for i, result in enumerate(results):
        if result is not None:
            buffer.set_res(i, _side_by_side(result))
    return buffer, evaluate


def _side_by_side(array: Array) -> memoryview:
    """Return the memory of an array, never a copy, whose address CasADi would keep; arrays with
    gaps are refused.
    """
    if array.flags.f_contiguous:
        return array.T.data
    return array.data


def _memory(size: tuple[int, int]) -> Array:
    """Return zeros (m,) for a column, (m, n) for a matrix."""
    n_rows, n_columns = size
    if n_columns == 1:
        return np.zeros(n_rows)
    return np.zeros(size, order="F")
