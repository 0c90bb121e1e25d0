"""Calls of CasADi functions on memory that stays where it is; results that nobody wants are not written.

Where all of them are machine code they are made by machine code: between two short functions the interpreter takes as long as
they do, and holds its lock.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.compile import compile_library, compiled_symbol, has_compiler, loaded_library

_SOURCE = """
typedef int Function(const double **, double **, long long *, double *, int);
typedef struct { Function *function; const double **arguments; double **results; } Call;

/* From one call on; which one failed, n for none. */
int make_calls(int i, int n, const Call *calls, long long *iw, double *w) {
  while (i < n && calls[i].function(calls[i].arguments, calls[i].results, iw, w, 0) == 0) ++i;
  return i;
}
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Call:
    """One of them; None for results that nobody wants."""

    function: ca.Function
    arguments: Sequence[Array]
    results: Sequence[Array | None]

    def fail(self) -> None:
        """What it was to write is not known, and must not be taken for what an earlier call wrote."""
        for result in self.results:
            if result is not None:
                result[...] = np.nan


class BoundCalls:
    """Calls one after the other. The results of one that fails are nan. Not for use from two threads at once."""

    __slots__ = ("_calls", "_make")

    def __init__(self) -> None:
        self._calls: list[_Call] = []
        self._make: Callable[[], None] | None = None

    def add(self, function: ca.Function, arguments: Sequence[Array], results: Sequence[Array | None]) -> None:
        """One more call; arguments and results, (m,) or (m, n) [any], are contiguous, column by column as CasADi has them.

        Raises `InvalidInput` for memory of another size.
        """
        for i, argument in enumerate(arguments):
            _require(function, argument, function.numel_in(i))
        wanted = [result if result is not None and result.size else None for result in results]
        for i, result in enumerate(wanted):
            if result is not None:
                _require(function, result, function.numel_out(i))
        self._calls.append(_Call(function=function, arguments=tuple(arguments), results=tuple(wanted)))
        self._make = None

    def __call__(self) -> None:
        """Make all calls."""
        if self._make is None:
            self._make = _in_machine_code(self._calls) or _by_buffers(self._calls)
        self._make()


def _require(function: ca.Function, given: Array, size: int) -> None:
    if given.size != size or given.dtype != np.float64 or not given.flags.c_contiguous:
        raise InvalidInput(f"{function.name()}: memory of shape {given.shape}; give {size} numbers side by side")


def _by_buffers(calls: Sequence[_Call]) -> Callable[[], None]:
    bound = []
    for call in calls:
        buffer, evaluate = call.function.buffer()
        for i, argument in enumerate(call.arguments):
            buffer.set_arg(i, argument.reshape(-1).data)
        for i, result in enumerate(call.results):
            if result is not None:
                buffer.set_res(i, result.reshape(-1).data)
        bound.append((evaluate, buffer, call))

    def make() -> None:
        for evaluate, buffer, call in bound:
            evaluate()
            if buffer.ret():
                call.fail()

    return make


def _in_machine_code(calls: Sequence[_Call]) -> Callable[[], None] | None:
    """None where one of them is none; each function is looked for once, as looking for one that cannot be compiled takes long."""
    library = _library() if has_compiler() else None
    if library is None:
        return None
    symbols = {function: compiled_symbol(function) for function in dict.fromkeys(call.function for call in calls)}
    if None in symbols.values():
        return None
    return _MachineCode(library, [symbols[call.function] for call in calls], calls)


class _MachineCode:
    """Calls as a table of addresses."""

    __slots__ = ("_calls", "_given", "_kept", "_make")

    def __init__(self, library: ctypes.CDLL, symbols: Sequence[int | None], calls: Sequence[_Call]) -> None:
        taken = [_addresses(call.arguments, call.function.sz_arg()) for call in calls]
        given = [_addresses(call.results, call.function.sz_res()) for call in calls]
        rows = [(at, a.ctypes.data, r.ctypes.data) for at, a, r in zip(symbols, taken, given, strict=True)]
        table = np.array(rows, dtype=np.uintp)
        whole = np.zeros(max((call.function.sz_iw() for call in calls), default=0), dtype=np.int64)
        work = np.zeros(max((call.function.sz_w() for call in calls), default=0))
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (table, whole, work))
        self._make, self._given = library.make_calls, (ctypes.c_int(len(calls)), *pointers)
        self._calls, self._kept = calls, (taken, given, table, whole, work)

    def __call__(self) -> None:
        failed, n = self._make(0, *self._given), len(self._calls)
        while failed < n:
            self._calls[failed].fail()
            failed = self._make(failed + 1, *self._given)


def _addresses(arrays: Sequence[Array | None], size: int) -> np.ndarray:
    """(size,) of the memory of arrays, 0 for none; functions write into what is left over."""
    found = np.zeros(max(size, len(arrays)), dtype=np.uintp)
    found[: len(arrays)] = [0 if array is None else array.ctypes.data for array in arrays]
    return found


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL | None:
    path = compile_library(_SOURCE, name="calls one after the other")
    if path is None:
        return None
    library = loaded_library(path)
    library.make_calls.restype = ctypes.c_int
    return library
