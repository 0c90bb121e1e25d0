"""Kernels as things to call: compiled once, in Python where that cannot be."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from inspect import signature
from pathlib import Path
from typing import Any, get_type_hints

from uvms_ocp.functions.compile import compile_library, loaded_library
from uvms_ocp.functions.kernels.expressions import PREFIX
from uvms_ocp.functions.kernels.layout import Layout
from uvms_ocp.functions.kernels.program import c_program, shape_of
from uvms_ocp.functions.kernels.smooth import connect

_PLAIN: dict[Any, Any] = {float: ctypes.c_double, int: ctypes.c_int, bool: ctypes.c_int}


def bind_kernels(
    kernels: Sequence[Callable[..., Any]], structures: Iterable[type[ctypes.Structure]], *, compiled: bool = True
) -> tuple[Callable[..., Any], ...]:
    """The `kernels`, in C unless `compiled` is false or there is no compiler; themselves otherwise.

    structures: those that they work on, as `structure_of` makes them. A vector is given as an array in a structure. Raises
    `InvalidInput` for a function that is no kernel.
    """
    return _bound(tuple(kernels), tuple(structures)) if compiled else tuple(kernels)


def memory_of(
    structure: type[ctypes.Structure], kernels: Sequence[Callable[..., Any]], *, compiled: bool = True
) -> tuple[ctypes.Structure, tuple[Callable[..., Any], ...]]:
    """A new memory whose functions are at their places, and the `kernels` that work on it, as `bind_kernels` gives them.

    Where one of its functions cannot be compiled the kernels stay in Python.
    """
    memory = structure()
    return memory, bind_to(memory, kernels, compiled=compiled)


def bind_to(
    memory: ctypes.Structure, kernels: Sequence[Callable[..., Any]], *, compiled: bool = True
) -> tuple[Callable[..., Any], ...]:
    """The `kernels` for a memory, as `memory_of` gives them, once its functions are at their places."""
    return bind_kernels(kernels, (type(memory),), compiled=compiled and connect(memory))


@lru_cache(maxsize=64)
def _bound(
    kernels: tuple[Callable[..., Any], ...], structures: tuple[type[ctypes.Structure], ...]
) -> tuple[Callable[..., Any], ...]:
    path = _compiled(kernels, _Shapes(structures))
    if path is None:
        return kernels
    library = loaded_library(path)
    by_name = {structure.__name__: structure for structure in structures}
    return tuple(_function(library, kernel, by_name) for kernel in kernels)


class _Shapes:
    """Structures that are equal where C sees no difference between them: functions of one name and size are exchangeable."""

    def __init__(self, structures: tuple[type[ctypes.Structure], ...]) -> None:
        self.structures, self._shapes = structures, tuple(map(shape_of, structures))

    def __hash__(self) -> int:
        return hash(self._shapes)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Shapes) and self._shapes == other._shapes


@lru_cache(maxsize=64)
def _compiled(kernels: tuple[Callable[..., Any], ...], shapes: _Shapes) -> Path | None:
    program = c_program(kernels, shapes.structures)
    return compile_library(program.types + program.code, name=", ".join(kernel.__name__ for kernel in kernels))


def _function(
    library: ctypes.CDLL, kernel: Callable[..., Any], structures: dict[str, type[ctypes.Structure]]
) -> Callable[..., Any]:
    function = library[f"{PREFIX}{kernel.__name__}"]
    hints = get_type_hints(kernel)
    function.argtypes = [_passed(hints[name], structures) for name in signature(kernel).parameters]
    function.restype = _PLAIN.get(hints.get("return"))
    return function


def _passed(hint: Any, structures: dict[str, type[ctypes.Structure]]) -> Any:
    if isinstance(hint, type) and issubclass(hint, Layout):
        return ctypes.POINTER(structures[hint.__name__])
    return _PLAIN.get(hint, ctypes.POINTER(ctypes.c_double))
