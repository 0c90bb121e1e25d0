"""Fast numeric calls of a CasADi function: ten times less overhead than ``Function.call``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments import late
from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput


@late
class BufferedFunction:
    """Call a function of dense inputs and outputs through fixed memory.

    Arguments and results are shaped as CasADi shapes them, (m, n), but columns are (m,). A column may also be given as
    (m, 1), and one column (m,) for all n columns of a matrix. Results are fresh arrays in C order. Not for use from two
    threads at once: every thread needs its own.
    """

    __slots__ = ("_arguments", "_buffer", "evaluate", "function", "results")

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._buffer: Any
        self.evaluate: Any
        """The function of no arguments that reads those which were written last, or are adopted, and writes `results`."""
        self._buffer, self.evaluate = function.buffer()
        self._arguments = [_memory(function.size_in(i)) for i in range(function.n_in())]
        self.results = [_memory(function.size_out(i)) for i in range(function.n_out())]
        """(m,) or (m, n) [any] of the last evaluation, overwritten by the next; matrices in column-major order."""
        # CasADi reads column-major memory and refuses views that are not C-contiguous.
        for i, argument in enumerate(self._arguments):
            self._buffer.set_arg(i, argument.T.data)
        for i, result in enumerate(self.results):
            self._buffer.set_res(i, result.T.data)

    def __reduce__(self) -> tuple[Any, ...]:
        return BufferedFunction, (self.function,)

    def __call__(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        """Evaluate. Raises `InvalidInput` for a wrong number of arguments, or one of the wrong shape."""
        if len(arguments) != len(self._arguments):
            raise InvalidInput(f"{self.function.name()}: {len(arguments)} arguments given; allowed: {self._names()}")
        for i, memory in enumerate(self._arguments):
            argument = arguments[i]
            if type(argument) is not np.ndarray or argument.shape != memory.shape:
                argument = self._fitted(i, argument)
            memory[...] = argument
        self.evaluate()
        return tuple([result.copy() for result in self.results])

    def adopt(self, *arguments: Array) -> None:
        """From now on `evaluate` reads these arguments, (m,) or (m, n) [any], where they are, and a call writes there.

        Raises `InvalidInput` for another shape, and matrices that are not in column-major order.
        """
        for i, argument in enumerate(arguments):
            if argument.shape != self._arguments[i].shape or not argument.flags.f_contiguous:
                name = f"{self.function.name()}: {self.function.name_in(i)}"
                raise InvalidInput(
                    f"{name} of shape {argument.shape} given; allowed: {self._arguments[i].shape}, column-major"
                )
            self._arguments[i] = argument
            self._buffer.set_arg(i, argument.T.data)

    @property
    def failed(self) -> bool:
        """True if the last evaluation was abandoned, which leaves its results meaningless."""
        return bool(self._buffer.ret())

    def _fitted(self, i: int, argument: ArrayLike) -> Array:
        shape, array = self._arguments[i].shape, np.asarray(argument, dtype=np.float64)
        if array.size == self._arguments[i].size and array.squeeze().shape == self._arguments[i].squeeze().shape:
            return array.reshape(shape)
        if array.shape == shape[:1]:
            return array[:, None]
        name = f"{self.function.name()}: {self.function.name_in(i)}"
        raise InvalidInput(f"{name} of shape {array.shape} given; allowed: {shape}")

    def _names(self) -> str:
        return f"{len(self._arguments)}, {', '.join(self.function.name_in())}"


class BoundFunction:
    """A function on memory of the caller's, which writes its arguments there and reads its results.

    Nothing is copied or looked at in a call. Not for use from two threads at once.
    """

    __slots__ = ("_kept", "evaluate")

    def __init__(self, function: ca.Function, arguments: Sequence[Array], results: Sequence[Array]) -> None:
        """arguments and results, (m,) or (m, n) [any]: matrices in column-major order.

        Raises `InvalidInput` for another size or order.
        """
        sizes, given = sizes_of(function), [*arguments, *results]
        if [a.size for a in given] != sizes or not all(a.flags.f_contiguous and a.dtype == np.float64 for a in given):
            shapes = ", ".join(str(a.shape) for a in given)
            raise InvalidInput(
                f"{function.name()}: memory of shapes {shapes}; give column-major numbers of sizes {sizes}"
            )
        buffer, self.evaluate = function.buffer()
        for i, argument in enumerate(arguments):
            buffer.set_arg(i, argument.T.data)
        for i, result in enumerate(results):
            buffer.set_res(i, result.T.data)
        self._kept = function, buffer, given

    def __call__(self) -> None:
        """Evaluate."""
        self.evaluate()


def sizes_of(function: ca.Function) -> list[int]:
    """Numbers [-] of every argument, then of every result."""
    taken = [function.numel_in(i) for i in range(function.n_in())]
    return taken + [function.numel_out(i) for i in range(function.n_out())]


def _memory(size: tuple[int, int]) -> Array:
    return np.zeros(size[0]) if size[1] == 1 else np.zeros(size, order="F")
