"""Run kernels one after the other, again and again, with a row of numbers after each pass: Python
is asked once for many.
"""

from __future__ import annotations

import ctypes
import inspect
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import loaded_library
from uvms_ocp.errors import InvalidInput

Step = tuple[Any, ...]
"""A kernel of `bind_kernels`, and up to four memories that it works on."""
_SOURCE = (files("uvms_ocp.codegen") / "sequence.c").read_text(encoding="utf-8")
_MEMORIES = 4
"""Largest number of memories that a kernel works on."""
# How numbers get into a row, as sequence.c counts the ways.
_SAME = 0
"""Code of a copy without conversion."""
_CONVERSIONS = {
    ("int32", "int64"): 1,
    ("int32", "int8"): 2,
    ("int32", "bool"): 2,
    ("float64", "int64"): 3,
}
"""Codes of conversions, by the types from and to."""
_DIFFERENCE = 4
"""Code of the difference from the value of the step before, for a time."""


class _Step(ctypes.Structure):
    """A kernel and its memories, as sequence.c has them."""

    _fields_ = (("kernel", ctypes.c_void_p), ("memory", ctypes.c_void_p * _MEMORIES))


class _Column(ctypes.Structure):
    """Numbers that are copied to a row at every pass: from where, to where, and how many, as
    sequence.c has it.
    """

    _fields_ = (
        ("from_", ctypes.c_void_p),
        ("to", ctypes.c_void_p),
        ("size", ctypes.c_longlong),
        ("stride", ctypes.c_longlong),
        ("n", ctypes.c_int),
        ("kind", ctypes.c_int),
    )


class Elapsed:
    """Time [s] that steps of the last pass took, as a number of a row."""

    def __init__(self, first: int, last: int) -> None:
        """first, last: indices of steps, the last included."""
        self.first = first
        self.n = last + 1 - first


class KernelSequence:
    """Passes of kernels over memories that stay where they are. Not for use from two threads at
    once.
    """

    def __init__(self, steps: Sequence[Step], stop: np.ndarray) -> None:
        """stop (), a whole number of C in one of the memories: it ends the passes where it is not
        0, after the pass, whose row is not written, or at once above 1. Raises `InvalidInput` for
        kernels that are not in machine code.
        """
        if not compiles(steps):
            raise InvalidInput("kernels in Python; a sequence takes those that are compiled")
        self._table = (_Step * len(steps))(*map(_in_c, steps))
        self._clock = np.zeros(len(steps) + 1)
        self._stop = stop
        self._kept: tuple[Any, ...] = tuple(steps)
        self._columns = (_Column * 0)()

    def write_rows(
        self, sources: Mapping[str, np.ndarray | Elapsed], block: Mapping[str, np.ndarray]
    ) -> None:
        """Write numbers of the memories, (...) by name, or what steps took, into the rows of the
        same names, (n_rows, ...).
        """
        columns = [self._column(source, block[name]) for name, source in sources.items()]
        self._columns = (_Column * len(columns))(*columns)
        self._kept = (*self._kept, sources, block)

    def run(self, n: int, row: int, *, done: bool = False) -> int:
        """Make up to n passes, and write their rows from this one on; return how many rows were
        written.

        done: the first pass has been made already, by the last call, which it ended.
        """
        tables = (len(self._table), self._table, len(self._columns), self._columns)
        stop = ctypes.c_void_p(self._stop.ctypes.data)
        clock = ctypes.c_void_p(self._clock.ctypes.data)
        return int(_runner()(n, ctypes.c_longlong(row), int(done), *tables, stop, clock))

    def _column(self, source: np.ndarray | Elapsed, rows: np.ndarray) -> _Column:
        to = rows.ctypes.data
        stride = rows.strides[0]
        if isinstance(source, Elapsed):
            return _Column(
                self._clock.ctypes.data + 8 * source.first, to, 8, stride, source.n, _DIFFERENCE
            )
        if source.dtype == rows.dtype:
            kind = _SAME
        else:
            kind = _CONVERSIONS[source.dtype.name, rows.dtype.name]
        return _Column(source.ctypes.data, to, source.nbytes, stride, source.size, kind)


def compiles(steps: Sequence[Step]) -> bool:
    """Check that all kernels are in machine code, and what runs them can be."""
    if any(inspect.isfunction(kernel) for kernel, *_ in steps):
        return False
    return _runner() is not None


def _in_c(step: Step) -> _Step:
    """Return the addresses of a kernel and its memories."""
    kernel, *memories = step
    addresses = [ctypes.addressof(memory) for memory in memories]
    return _Step(ctypes.cast(kernel, ctypes.c_void_p), (ctypes.c_void_p * _MEMORIES)(*addresses))


@lru_cache(maxsize=1)
def _runner() -> Any:
    path = compile_library(_SOURCE, name="kernels one after the other")
    if path is None:
        return None
    library = loaded_library(path)
    library.run_sequence.restype = ctypes.c_int
    return library.run_sequence
