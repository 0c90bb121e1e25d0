"""Run steps one after the other, again and again, with a row of numbers after each pass: kernels in
machine code for many passes at once, and between them functions of Python, which are called.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import loaded_library


class Step(NamedTuple):
    """A step of a sequence."""

    name: str
    """Name of the step, which no other step of a sequence has."""
    kernel: Callable[..., Any]
    """A kernel of `bind_kernels`, or any function of Python."""
    memories: tuple[Any, ...] = ()
    """Up to four memories that the kernel works on, its arguments in order."""


class Elapsed(NamedTuple):
    """Time [s] that steps of the last pass took, as a number of a row."""

    first: str
    """Name of the first of these steps."""
    last: str
    """Name of the last one, which is included."""


Source = np.ndarray | Elapsed
"""Source of a series, copied after each pass: an array that stays where it is, or a time."""


def values_of(series: Mapping[str, Source]) -> dict[str, Any]:
    """Return the present values of series that are in memory: copies of arrays, and numbers."""
    values = dict[str, Any]()
    for name, source in series.items():
        assert isinstance(source, np.ndarray)
        values[name] = source.copy() if source.ndim else source.item()
    return values


GO = 0
"""Passes go on."""
LOOK = 1
"""Passes end after this one, whose row is left."""
DIVERGED = 2
"""Passes end within this one, whose row is left."""
RAISED = 3
"""Passes end within this one: a function of Python has raised."""

_SOURCE = (files("uvms_ocp.codegen") / "sequence.c").read_text(encoding="utf-8")
_N_MEMORIES = 4
"""Largest number of memories that a kernel works on."""
# How numbers get into a row, as sequence.c counts the ways.
_SAME = 0
"""Code of a copy without conversion."""
_CONVERSIONS = {
    ("int32", "int64"): 1,
    ("int32", "int8"): 2,
    ("int32", "bool"): 2,
}
"""Codes of conversions, by the types from and to."""
_DIFFERENCE = 3
"""Code of the difference from the value of another step, for a time."""
_CALL = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * _N_MEMORIES)


_MACHINE_CODE: Any = _CALL.__base__
"""Class of the functions of libraries."""


class _Step(ctypes.Structure):
    """A kernel and its memories, and whether it is a function of Python, as sequence.c has them."""

    _fields_ = (
        ("kernel", ctypes.c_void_p),
        ("memory", ctypes.c_void_p * _N_MEMORIES),
        ("asked", ctypes.c_int),
    )


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


class StepSequence:
    """Passes of steps over memories that stay where they are. Not for use from two threads at once.

    Without a compiler Python calls the steps and writes the rows, with the same numbers.
    """

    def __init__(
        self, steps: Sequence[Step], stop: np.ndarray, presses: Sequence[object] = ()
    ) -> None:
        """stop (), a whole number of C in one of the memories, `GO` at the beginning of each pass:
        it ends the passes where it is `LOOK` or more. presses: no longer empty once somebody wants
        to stop, which functions of Python take for `LOOK`.
        """
        self._steps = tuple(steps)
        self._place = {step.name: k for k, step in enumerate(steps)}
        self._stop = stop
        self._presses = presses
        self._clock = np.zeros(len(steps) + 1)
        self._raised = _Raised()
        self._rows: tuple[tuple[Source, np.ndarray], ...] = ()
        self._run = _runner()
        self._calls = [_call_of(step, stop, presses, self._raised) for step in steps]
        self._callbacks: list[Any] = []
        """Functions that C calls for steps in Python, kept alive here."""
        self._table = (_Step * len(steps))(*map(self._in_c, steps, self._calls))
        self._columns = (_Column * 0)()

    def write_rows(self, sources: Mapping[str, Source], block: Mapping[str, np.ndarray]) -> None:
        """Write numbers of the memories, (...) by name, or what steps took, into the rows of the
        same names, (n_rows, ...).
        """
        self._rows = tuple((source, block[name]) for name, source in sources.items())
        columns = [self._column(source, rows) for source, rows in self._rows]
        self._columns = (_Column * len(columns))(*columns)

    def run(self, n: int, row: int, *, done: bool = False) -> int:
        """Make up to n passes, and write their rows from this one on; return how many rows were
        written.

        done: the first pass has been made already, by the last call, which it ended. What a function
        of Python raises ends the passes, see `check`.
        """
        if self._run is None:
            written = self._run_in_python(n, row, done=done)
        else:
            tables = (len(self._table), self._table, len(self._columns), self._columns)
            stop = ctypes.c_void_p(self._stop.ctypes.data)
            clock = ctypes.c_void_p(self._clock.ctypes.data)
            written = int(self._run(n, ctypes.c_longlong(row), int(done), *tables, stop, clock))
        return written

    def check(self) -> None:
        """Raise what a function of Python has raised, and `KeyboardInterrupt` where Ctrl-C kept one
        from being called, which ctypes prints and does not pass on.
        """
        self._raised.check()
        if self._stop == RAISED:
            raise KeyboardInterrupt

    def _run_in_python(self, n: int, row: int, *, done: bool) -> int:
        """Do what sequence.c does."""
        for k in range(n):
            if not done and self._pass() != GO:
                return k
            done = False
            for source, rows in self._rows:
                rows[row + k] = self.value(source)
        return n

    def _pass(self) -> int:
        """Make one pass; return how it ended."""
        self._stop[...] = GO
        for k, call in enumerate(self._calls):
            before = int(self._stop)
            self._clock[k] = perf_counter()
            call()
            if self._stop > LOOK:
                break
            if self._stop < before:
                self._stop[...] = before
        self._clock[-1] = perf_counter()
        return int(self._stop)

    def value(self, source: Source) -> Any:
        """Return what a row has of a source after the last pass."""
        if isinstance(source, Elapsed):
            first, last = self._places(source)
            return self._clock[last] - self._clock[first]
        return source.copy()[()]

    def _places(self, elapsed: Elapsed) -> tuple[int, int]:
        """Return where the time begins and ends in the clock."""
        return self._place[elapsed.first], self._place[elapsed.last] + 1

    def _in_c(self, step: Step, call: Callable[..., None]) -> _Step:
        """Return the addresses of a kernel and its memories."""
        kernel: Any = step.kernel
        is_asked = not isinstance(kernel, _MACHINE_CODE)
        if is_asked:
            kernel = _CALL(call)
            self._callbacks.append(kernel)
        addresses = [ctypes.addressof(memory) for memory in step.memories]
        return _Step(
            # `ctypes.cast` would have the function keep hold of itself, and of all it works on.
            kernel=ctypes.c_void_p.from_buffer(kernel),
            memory=(ctypes.c_void_p * _N_MEMORIES)(*addresses),
            asked=is_asked,
        )

    def _column(self, source: Source, rows: np.ndarray) -> _Column:
        to = rows.ctypes.data
        stride = rows.strides[0]
        if isinstance(source, Elapsed):
            first, last = self._places(source)
            begin = self._clock.ctypes.data + 8 * first
            return _Column(begin, to, 8, stride, last - first, _DIFFERENCE)
        if source.dtype == rows.dtype:
            kind = _SAME
        else:
            kind = _CONVERSIONS[source.dtype.name, rows.dtype.name]
        return _Column(source.ctypes.data, to, source.nbytes, stride, source.size, kind)


class _Raised:
    """Exception of a step in Python, kept until C has returned."""

    __slots__ = ("error",)

    def __init__(self) -> None:
        self.error: BaseException | None = None

    def check(self) -> None:
        """Raise it, once."""
        error = self.error
        self.error = None
        if error is not None:
            raise error


def _call_of(
    step: Step, stop: np.ndarray, presses: Sequence[object], raised: _Raised
) -> Callable[..., None]:
    """Return the function that is called for a step in Python, by C too."""
    kernel = step.kernel
    memories = step.memories

    def call(*addresses: int) -> None:
        try:
            stop[...] = GO  # C takes it for `RAISED` until here
            kernel(*memories)
        except BaseException as error:
            raised.error = error
            stop[...] = RAISED
        if presses and stop == GO:
            stop[...] = LOOK

    return call


@lru_cache(maxsize=1)
def _runner() -> Any:
    path = compile_library(_SOURCE, name="kernels one after the other")
    if path is None:
        return None
    library = loaded_library(path)
    library.run_sequence.restype = ctypes.c_int
    return library.run_sequence
