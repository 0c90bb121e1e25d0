"""What kernels remember: named numbers, arrays and parts, in Python and in C at the same place in memory."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, MutableSequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, TypeAlias, get_args, get_origin, get_type_hints

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.kernels.ask import Ask, AskStructure
from uvms_ocp.functions.kernels.smooth import Smooth, smooth_structure

Vector: TypeAlias = MutableSequence[float]
"""A parameter of a kernel: numbers that it reads or changes in place."""


@dataclass(frozen=True, slots=True, init=False)
class Sized:
    """Sizes of an array in a layout, ``Annotated[Vector, Sized(3, "n")]``: numbers, or names that `structure_of` is given."""

    sizes: tuple[int | str, ...]

    def __init__(self, *sizes: int | str) -> None:
        object.__setattr__(self, "sizes", sizes)


class Layout:
    """Base of classes that only declare: ``float``, ``int``, ``bool``, sized arrays of them, other layouts, `Smooth`, `Ask`.

    ``structure_of(Class, n_joints=4)`` is the type whose instances kernels work on; all of it is zero at first.
    """


_NUMBERS: dict[Any, Any] = {float: ctypes.c_double, int: ctypes.c_int, bool: ctypes.c_int}


def structure_of(layout: type[Layout], **sizes: int | ca.Function | type[ctypes.Structure]) -> type[ctypes.Structure]:
    """The type of a layout in memory, with the sizes [-] that its arrays and those of its parts are declared with, and functions.

    A part whose type is made already is given by its name. Raises `InvalidInput` for a size or function that is not given, and
    a field of another type.
    """
    key: Any = layout
    return _structure(key, tuple(sorted(sizes.items())))


@lru_cache(maxsize=256)
def _structure(layout: Any, sizes: tuple[tuple[str, Any], ...]) -> type[ctypes.Structure]:
    known = dict(sizes)
    hints = get_type_hints(layout, include_extras=True)
    fields = [(name, _field(f"{layout.__name__}.{name}", hint, known)) for name, hint in hints.items()]
    return type(layout.__name__, (ctypes.Structure,), {"__slots__": (), "_fields_": fields, "__doc__": layout.__doc__})


def _field(name: str, hint: Any, sizes: Mapping[str, Any]) -> Any:
    if hint in _NUMBERS:
        return _NUMBERS[hint]
    if isinstance(hint, type) and issubclass(hint, Layout):
        return sizes.get(name.rpartition(".")[2]) or structure_of(hint, **sizes)
    if hint is Ask:
        return AskStructure
    if hint is Smooth:
        return smooth_structure(_known(name, name.rpartition(".")[2], sizes))
    item = _item(hint)
    if item is None:
        raise InvalidInput(
            f"{name} is {hint}; give float, int, bool, a Layout, or a sequence of one of them with its Sized"
        )
    kind = _field(name, item, sizes)
    for size in reversed(get_args(hint)[1].sizes):
        # C knows no empty array.
        kind = kind * max(1, _known(name, size, sizes) if isinstance(size, str) else size)
    return kind


def _known(name: str, asked: str, given: Mapping[str, Any]) -> Any:
    if asked not in given:
        raise InvalidInput(f"{name} needs {asked!r}, which is not given; given: {sorted(given)}")
    return given[asked]


def _item(hint: Any) -> Any:
    """Type of the entries of an array, however many dimensions it has; `None` for anything else.

    What may be an expression elsewhere, and is annotated with Any, is numbers here.
    """
    if get_origin(hint) is not Annotated or not isinstance(get_args(hint)[1], Sized):
        return None
    item = get_args(hint)[0]
    while get_origin(item) is not None:
        item = get_args(item)[0]
    return float if item is Any else item


def declared_sizes(layout: type[Layout], sizes: Mapping[str, int]) -> dict[str, int]:
    """Entries [-] of each array of one dimension in a layout of nothing else, by name, with the `sizes` [-] given for names."""
    declared = {name: get_args(hint)[1].sizes[0] for name, hint in get_type_hints(layout, include_extras=True).items()}
    return {name: sizes[size] if isinstance(size, str) else size for name, size in declared.items()}


def zeros(n: int) -> list[float]:
    """A local array of a kernel: n numbers [-], which is a constant, or the `len` of an array in a layout."""
    return [0.0] * n


def doubles(values: np.ndarray) -> Any:
    """The values (n,) [any] as a vector of a kernel's, on memory of their own."""
    return (ctypes.c_double * len(values))(*values.tolist())


def view(array: Any) -> np.ndarray:
    """An array of a structure as one of NumPy on the same memory; make it once, as that takes long."""
    return np.ctypeslib.as_array(array)
