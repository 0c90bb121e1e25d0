"""CasADi functions inside of layouts, which kernels call."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.functions.compile import compiled_symbol


class Smooth:
    """A field of a layout: a function that kernels call as ``m.levels(q, v, J, lower)``, what it reads first, then what it fills.

    ``structure_of(Memory, levels=function)`` says which. Every argument is a vector of its own size, column after column, or a
    layout of nothing but arrays of numbers, which is their column. A number is a vector of one to read; None is zeros to read,
    or nothing to fill.
    """

    def __call__(self, *vectors: Any) -> None:
        """What stands in a kernel."""


class SmoothStructure(ctypes.Structure):
    """Of one function: its address, and the memory that it works in."""

    __slots__ = ()
    function: ca.Function
    """Which it is."""

    def __call__(self, *vectors: Any) -> None:
        """As C does it, without a compiler."""
        call, n = _buffered(self.function), self.function.n_in()
        found = call(*(_given(vector, self.function.size_in(i)) for i, vector in enumerate(vectors[:n])))
        for target, values in zip(vectors[n:], found, strict=True):
            if target is not None:
                _numbers(target)[: values.size] = values.ravel(order="F")


@lru_cache(maxsize=256)
def smooth_structure(function: ca.Function) -> type[SmoothStructure]:
    """The type of the field. Raises `InvalidInput` for a function with structural zeros among what it takes or gives."""
    if not all(function.sparsity_in(i).is_dense() for i in range(function.n_in())) or not all(
        function.sparsity_out(i).is_dense() for i in range(function.n_out())
    ):
        raise InvalidInput(f"{function.name()} has sparse arguments; make them dense")
    sizes = work_sizes(function)
    kinds: tuple[Any, ...] = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_longlong, ctypes.c_double)
    memory = [(name, kind * size) for name, kind, size in zip(("arg", "res", "iw", "w"), kinds, sizes, strict=True)]
    fields: list[tuple[str, Any]] = [("call", ctypes.c_void_p), *memory]
    name = "Smooth_" + "_".join(map(str, (function.name(), *sizes)))
    return type(name, (SmoothStructure,), {"__slots__": (), "_fields_": fields, "function": function})


def work_sizes(function: ca.Function) -> tuple[int, int, int, int]:
    """Pointers to arguments and results, whole numbers and numbers [-] that a call needs memory for."""
    return tuple(max(1, size) for size in (function.sz_arg(), function.sz_res(), function.sz_iw(), function.sz_w()))


def connect(memory: ctypes.Structure) -> bool:
    """Give the functions in `memory` the addresses of their machine code; false where one of them cannot be compiled."""
    done = True
    for part in functions_in(memory):
        if part.function.n_out():
            part.call = compiled_symbol(part.function)
            done &= part.call is not None
    return done


def functions_in(memory: Any) -> Iterator[SmoothStructure]:
    """Those of a memory, of its parts, and of arrays of parts."""
    if isinstance(memory, SmoothStructure):
        yield memory
    elif isinstance(memory, ctypes.Structure):
        for name, *_ in type(memory)._fields_:
            yield from functions_in(getattr(memory, name))
    elif isinstance(memory, ctypes.Array) and issubclass(memory._type_, ctypes.Structure):
        for part in memory:
            yield from functions_in(part)


@lru_cache(maxsize=256)
def _buffered(function: ca.Function) -> BufferedFunction:
    return BufferedFunction(function)


def column_view(layout: ctypes.Structure) -> np.ndarray:
    """A layout of nothing but arrays of numbers as one array of them (n,) [any] on the same memory."""
    n = ctypes.sizeof(layout) // ctypes.sizeof(ctypes.c_double)
    return np.ctypeslib.as_array((ctypes.c_double * n).from_buffer(layout))


def _numbers(vector: Any) -> np.ndarray:
    """On the memory of the vector, if it is one of ctypes."""
    if isinstance(vector, ctypes.Structure):
        return column_view(vector)
    return np.ctypeslib.as_array(vector) if isinstance(vector, ctypes.Array) else np.array(vector, dtype=float)


def _given(vector: Any, size: tuple[int, int]) -> Any:
    if vector is None:
        return np.zeros(size)
    return _numbers(vector).ravel()[: size[0] * size[1]].reshape(size, order="F")
