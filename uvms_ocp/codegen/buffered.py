"""Call CasADi functions through fixed memory: ten times less overhead than ``Function.call``.

Where all of them are machine code they are made by machine code: between two short functions the
interpreter takes as long as they do, and holds its lock.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from itertools import pairwise, product
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_on_failure
from uvms_ocp.codegen.compile import (
    compile_library,
    compiled_symbol,
    has_compiler,
    is_being_compiled,
    loaded_library,
    two_calls,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Array

_SOURCE = (files("uvms_ocp.codegen") / "calls.c").read_text(encoding="utf-8")


# Fast numeric calls of a CasADi function: ten times less overhead than ``Function.call``.


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
        self._buffer, self.evaluate = _buffer_on(function, self._arguments, self.results)
        """And the function of no arguments that reads those which were written last, or are
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
        shape = self._arguments[i].shape
        array = np.asarray(argument, dtype=np.float64)
        if (
            array.size == self._arguments[i].size
            and array.squeeze().shape == self._arguments[i].squeeze().shape
        ):
            return array.reshape(shape)
        if array.shape == shape[:1]:
            return array[:, None]
        name = f"{self.function.name()}: {self.function.name_in(i)}"
        raise InvalidInput(f"{name} of shape {array.shape} given; allowed: {shape}")


def argument_sizes(function: ca.Function) -> list[int]:
    """Numbers of every argument, then of every result."""
    return [function.numel_in(i) for i in range(function.n_in())] + [
        function.numel_out(i) for i in range(function.n_out())
    ]


def _buffer_on(
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
    return (array.T if array.flags.f_contiguous else array).data


def _memory(size: tuple[int, int]) -> Array:
    if size[1] == 1:
        return np.zeros(size[0])
    return np.zeros(size, order="F")


# Calls of CasADi functions on memory that stays where it is; results that nobody wants are not
# written.
#
# Where all of them are machine code they are made by machine code: between two short functions the
# interpreter takes as long as they do, and holds its lock.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Call:
    """A function with the memory of its arguments and results; a result of None is not written."""

    function: ca.Function
    arguments: Sequence[Array]
    results: Sequence[Array | None]

    def fail(self) -> None:
        """Clear the results: they are unknown, and must not be taken for those of an earlier
        call.
        """
        for result in self.results:
            if result is not None:
                result[...] = np.nan


class BoundCalls:
    """Calls of CasADi functions, one after the other, on memory that stays in place. The results of
    one that fails are nan. Not for use from two threads at once.

    Until machine code is there CasADi's virtual machine makes them, with the same results.
    """

    __slots__ = ("_calls", "_for_now", "_make")

    def __init__(self) -> None:
        self._calls: list[_Call] = []
        self._make: Callable[[], None] | None = None
        self._for_now = False

    def add(
        self, function: ca.Function, arguments: Sequence[Array], results: Sequence[Array | None]
    ) -> None:
        """Add a call; arguments and results, (m,) or (m, n) [any], are contiguous, column by column
        as CasADi has them, of sparse ones the entries.

        Raises `InvalidInput` for memory of another size.
        """
        for i, argument in enumerate(arguments):
            _require(function, argument, function.nnz_in(i))
        requested = [result if result is not None and result.size else None for result in results]
        for i, result in enumerate(requested):
            if result is not None:
                _require(function, result, function.nnz_out(i))
        self._calls.append(
            _Call(function=function, arguments=tuple(arguments), results=tuple(requested))
        )
        self._make = None

    def __call__(self) -> None:
        """Make all calls."""
        if self._make is None or self._for_now:
            self._bind()
        assert self._make is not None
        self._make()

    def _bind(self) -> None:
        waits = any(is_being_compiled(call.function) for call in self._calls)
        if self._make is None or not waits:
            self._make = (None if waits else _in_machine_code(self._calls)) or _by_buffers(
                self._calls
            )
        self._for_now = waits


def _require(function: ca.Function, array: Array, size: int) -> None:
    if array.size != size or array.dtype != np.float64 or not array.flags.c_contiguous:
        raise InvalidInput(
            f"{function.name()}: memory of shape {array.shape}; give {size} numbers side by side"
        )


def _by_buffers(calls: Sequence[_Call]) -> Callable[[], None]:
    bound = [(*_buffer_on(call.function, call.arguments, call.results), call) for call in calls]

    def make() -> None:
        for buffer, evaluate, call in bound:
            evaluate()
            if buffer.ret():
                call.fail()

    return make


def _in_machine_code(calls: Sequence[_Call]) -> Callable[[], None] | None:
    """Return the calls in machine code, None where one of the functions has none; each function is
    looked up once, as that takes long for one that cannot be compiled.
    """
    if has_compiler():
        library = calls_library()
    else:
        library = None
    if library is None:
        return None
    symbols = {
        function: compiled_symbol(function)
        for function in dict.fromkeys(call.function for call in calls)
    }
    if None in symbols.values():
        return None
    return _MachineCode(library, [symbols[call.function] for call in calls], calls)


class _MachineCode:
    """Calls that machine code makes, from a table of addresses."""

    __slots__ = ("_calls", "_given", "_kept", "_make")

    def __init__(
        self, library: ctypes.CDLL, symbols: Sequence[int | None], calls: Sequence[_Call]
    ) -> None:
        argument_addresses = [_addresses(call.arguments, call.function.sz_arg()) for call in calls]
        result_addresses = [_addresses(call.results, call.function.sz_res()) for call in calls]
        rows = [
            (*at, a.ctypes.data, r.ctypes.data)
            for *at, a, r in zip(
                symbols, _pairs(calls), argument_addresses, result_addresses, strict=True
            )
        ]
        table = np.array(rows, dtype=np.uintp)
        integer_work = np.zeros(
            max((call.function.sz_iw() for call in calls), default=0), dtype=np.int64
        )
        work = np.zeros(max((call.function.sz_w() for call in calls), default=0))
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (table, integer_work, work))
        self._make = library.make_calls
        self._given = (ctypes.c_int(len(calls)), *pointers)
        self._calls = calls
        self._kept = (argument_addresses, result_addresses, table, integer_work, work)

    def __call__(self) -> None:
        failed = self._make(0, *self._given)
        n = len(self._calls)
        while failed < n:
            self._calls[failed].fail()
            failed = self._make(failed + 1, *self._given)


def _pairs(calls: Sequence[_Call]) -> list[int]:
    """Return (n,) addresses of the code that makes a call and the next one at once, where these do
    not build on each other; else 0.
    """
    pairs = [0] * len(calls)
    for i, (first, second) in enumerate(pairwise(calls)):
        if first.function is second.function and not (i and pairs[i - 1]):
            twice = two_calls(first.function)
        else:
            twice = None
        if twice and not any(
            np.may_share_memory(*pair) for pair in product(first.results, second.arguments)
        ):
            pairs[i] = twice
    return pairs


def _addresses(arrays: Sequence[Array | None], size: int) -> np.ndarray:
    """Return (size,) addresses of the memory of arrays, 0 for none; functions use the places behind
    them.
    """
    addresses = np.zeros(max(size, len(arrays)), dtype=np.uintp)
    addresses[: len(arrays)] = [0 if array is None else array.ctypes.data for array in arrays]
    return addresses


@lru_cache(maxsize=1)
def calls_library() -> ctypes.CDLL | None:
    """Return the library of calls.c, which makes `BoundCalls`, compiled at the first call."""
    path = compile_library(_SOURCE, name="calls one after the other")
    if path is None:
        return None
    return loaded_library(path)
