"""Calls of CasADi functions on memory that stays in place; results that nobody wants are not
written.

Where all functions are machine code, machine code calls them: between two short functions the
interpreter takes as long as they do, and holds its lock.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from itertools import pairwise, product

import casadi as ca
import numpy as np

from uvms_ocp.codegen.buffered import buffer_on
from uvms_ocp.codegen.c_compiler import has_compiler
from uvms_ocp.codegen.compile import compiled_symbol, is_being_compiled, two_calls
from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import loaded_library
from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Array

_SOURCE = (files("uvms_ocp.codegen") / "calls.c").read_text(encoding="utf-8")


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

    __slots__ = ("_calls", "_is_interim", "_make")

    def __init__(self) -> None:
        self._calls: list[_Call] = []
        self._make: Callable[[], None] | None = None
        """Makes all calls; `None` until they are bound."""
        self._is_interim = False
        """True while a function is still being compiled, so that the virtual machine calls it."""

    def add(
        self, function: ca.Function, arguments: Sequence[Array], results: Sequence[Array | None]
    ) -> None:
        """Add a call; arguments and results, (m,) or (m, n) [any], are contiguous, column by column
        as CasADi has them, of sparse ones the entries.

        Raises `InvalidInput` for memory of another size.
        """
        for i, argument in enumerate(arguments):
            _require(function, argument, function.nnz_in(i))
        requested = list[Array | None]()
        for i, result in enumerate(results):
            if result is None or not result.size:
                requested.append(None)
                continue
            _require(function, result, function.nnz_out(i))
            requested.append(result)
        self._calls.append(
            _Call(function=function, arguments=tuple(arguments), results=tuple(requested))
        )
        self._make = None

    def __call__(self) -> None:
        """Make all calls."""
        if self._make is None or self._is_interim:
            self._bind()
        assert self._make is not None
        self._make()

    def _bind(self) -> None:
        """Bind the calls to machine code, or as long as it is not there to the virtual machine."""
        self._is_interim = any(is_being_compiled(call.function) for call in self._calls)
        if not self._is_interim:
            self._make = _in_machine_code(self._calls) or _by_buffers(self._calls)
        elif self._make is None:
            self._make = _by_buffers(self._calls)


def _require(function: ca.Function, array: Array, size: int) -> None:
    """Raise `InvalidInput` for memory that is not `size` numbers side by side."""
    if array.size != size or array.dtype != np.float64 or not array.flags.c_contiguous:
        raise InvalidInput(
            f"{function.name()}: memory of shape {array.shape}; give {size} numbers side by side"
        )


def _by_buffers(calls: Sequence[_Call]) -> Callable[[], None]:
    """Return the calls as CasADi's virtual machine makes them."""
    bound_calls = []
    for call in calls:
        buffer, evaluate = buffer_on(call.function, call.arguments, call.results)
        bound_calls.append((buffer, evaluate, call))

    def make() -> None:
        for buffer, evaluate, call in bound_calls:
            evaluate()
            if buffer.ret():
                call.fail()

    return make


def _in_machine_code(calls: Sequence[_Call]) -> Callable[[], None] | None:
    """Return the calls in machine code, None where one of the functions has none; each function is
    looked up once, as that takes long for one that cannot be compiled.
    """
    if not has_compiler():
        return None
    library = calls_library()
    if library is None:
        return None
    symbols = dict[ca.Function, int | None]()
    for call in calls:
        if call.function not in symbols:
            symbols[call.function] = compiled_symbol(call.function)
    if None in symbols.values():
        return None
    return _MachineCode(library, [symbols[call.function] for call in calls], calls)


class _MachineCode:
    """Calls that machine code makes, from a table of addresses."""

    __slots__ = ("_calls", "_inputs", "_make", "_memory")

    def __init__(
        self, library: ctypes.CDLL, symbols: Sequence[int | None], calls: Sequence[_Call]
    ) -> None:
        rows = []
        addresses = []
        n_integers = 0
        n_numbers = 0
        for symbol, symbol_of_pair, call in zip(symbols, _pairs(calls), calls, strict=True):
            arguments = _addresses(call.arguments, call.function.sz_arg())
            results = _addresses(call.results, call.function.sz_res())
            addresses += [arguments, results]
            rows.append((symbol, symbol_of_pair, arguments.ctypes.data, results.ctypes.data))
            n_integers = max(n_integers, call.function.sz_iw())
            n_numbers = max(n_numbers, call.function.sz_w())
        table = np.array(rows, dtype=np.uintp)
        integer_work = np.zeros(n_integers, dtype=np.int64)
        work = np.zeros(n_numbers)
        self._make = library.make_calls
        self._inputs = (
            ctypes.c_int(len(calls)),
            ctypes.c_void_p(table.ctypes.data),
            ctypes.c_void_p(integer_work.ctypes.data),
            ctypes.c_void_p(work.ctypes.data),
        )
        self._calls = calls
        self._memory = (addresses, table, integer_work, work)

    def __call__(self) -> None:
        failed = self._make(0, *self._inputs)
        n = len(self._calls)
        while failed < n:
            self._calls[failed].fail()
            failed = self._make(failed + 1, *self._inputs)


def _pairs(calls: Sequence[_Call]) -> list[int]:
    """Return (n,) addresses of the code that makes a call and the next one at once, where these do
    not build on each other; else 0.
    """
    pairs = [0] * len(calls)
    for i, (first, second) in enumerate(pairwise(calls)):
        is_second_of_pair = i > 0 and pairs[i - 1]
        if first.function is not second.function or is_second_of_pair:
            continue
        twice = two_calls(first.function)
        if twice and not _builds_on(second, first):
            pairs[i] = twice
    return pairs


def _builds_on(call: _Call, earlier: _Call) -> bool:
    """Check whether a call reads memory that an earlier one writes."""
    pairs = product(earlier.results, call.arguments)
    return any(np.may_share_memory(result, argument) for result, argument in pairs)


def _addresses(arrays: Sequence[Array | None], size: int) -> np.ndarray:
    """Return (size,) addresses of the memory of arrays, 0 for none; functions use the places behind
    them.
    """
    addresses = np.zeros(max(size, len(arrays)), dtype=np.uintp)
    for i, array in enumerate(arrays):
        if array is not None:
            addresses[i] = array.ctypes.data
    return addresses


@lru_cache(maxsize=1)
def calls_library() -> ctypes.CDLL | None:
    """Return the library of calls.c, which makes `BoundCalls`, compiled at the first call."""
    path = compile_library(_SOURCE, name="calls one after the other")
    if path is None:
        return None
    return loaded_library(path)
