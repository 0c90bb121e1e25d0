"""Names for what signatures take: arrays, ranges of numbers, shapes, frozen mappings and arrays."""

from __future__ import annotations

import types
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from mmap import mmap
from typing import Annotated, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

DAY = 86_400.0
"""[s] Beyond it no run, plan or solution is waited for."""
_OF = "length of "
"""Prefix of the name of a length, so that it is not taken for an argument."""

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Range:
    """In an annotation: the numbers that are allowed, from `low` to `high`. NaN is never inside."""

    low: float = -np.inf
    """[any] lower end."""
    high: float = np.inf
    """[any] upper end."""
    open: bool = False
    """Both ends are left out: of an infinite one, infinity."""

    def holds(self, value: float) -> bool:
        """Return whether the value [any] is inside."""
        if self.open:
            return self.low < value < self.high
        return self.low <= value <= self.high

    def doubt(self, name: str) -> str:
        """Return source that is true where the number `name` is not inside; ``_inf`` is
        infinity.
        """
        low = repr(float(self.low)).replace("inf", "_inf")
        high = repr(float(self.high)).replace("inf", "_inf")
        sign = "<" if self.open else "<="
        return f"not {low} {sign} {name} {sign} {high}"

    def __str__(self) -> str:
        has_low = not np.isinf(self.low)
        has_high = not np.isinf(self.high)
        if self.open:
            if has_high:
                return f" between {self.low:g} and {self.high:g}"
            if has_low:
                return f" > {self.low:g}, finite"
            return ", finite"
        if has_high:
            return f" from {self.low:g} to {self.high:g}"
        if has_low:
            return f" >= {self.low:g}"
        return ", not NaN"


class Shape:
    """In an annotation: the shape of an array, where `...` stands for any axes before the others.

    A name stands for one length throughout a call; one with dots, such as ``self.robot.n_q``, is
    read from its arguments.
    """

    def __init__(self, *sizes: int | str | types.EllipsisType) -> None:
        self._any_before = ... in sizes
        """True where any axes may stand before the others."""
        self._sizes = tuple(size for size in sizes if not isinstance(size, types.EllipsisType))
        """Lengths of the last axes, or their names."""

    def __repr__(self) -> str:
        return f"Shape({', '.join(self._words())})"

    def holds(self, value: Any) -> bool:
        """Return whether an array has such a shape."""
        shape = np.shape(value)
        n = len(self._sizes)
        if len(shape) < n or (len(shape) > n and not self._any_before):
            return False
        last_axes = shape[len(shape) - n :]
        for size, length in zip(self._sizes, last_axes, strict=True):
            if not isinstance(size, str) and size != length:
                return False
        return True

    def doubt(self, name: str) -> str:
        """Return source that is true where the array `name` has other axes than the value knows
        whose method it is.
        """
        n = len(self._sizes)
        sign = "<" if self._any_before else "!="
        doubts = [f"{name}.ndim {sign} {n}"]
        for i, size in enumerate(self._sizes):
            if isinstance(size, int) or size.startswith("self."):
                doubts.append(f"{name}.shape[{i - n}] != {size}")
        return " or ".join(doubts)

    def among(self, arguments: Mapping[str, object]) -> Shape:
        """Return the shape with the lengths that the arguments of a call have."""
        sizes: list[int | str | types.EllipsisType] = []
        if self._any_before:
            sizes.append(...)
        for size in self._sizes:
            if isinstance(size, str):
                size = _length(size, arguments)
            sizes.append(size)
        return Shape(*sizes)

    def named(self, value: Any) -> dict[str, int]:
        """Return the lengths that an array of such a shape gives to names."""
        last_axes = np.shape(value)[np.ndim(value) - len(self._sizes) :]
        lengths = {}
        for size, n in zip(self._sizes, last_axes, strict=True):
            if isinstance(size, str):
                lengths[f"{_OF}{size}"] = n
        return lengths

    @property
    def names(self) -> list[str]:
        """Keys of the lengths that `named` returns."""
        return [f"{_OF}{size}" for size in self._sizes if isinstance(size, str)]

    def __str__(self) -> str:
        words = self._words()
        if len(words) == 1 and not self._any_before:  # as Python writes a tuple of one
            return f"({words[0]},)"
        return f"({', '.join(words)})"

    def _words(self) -> list[str]:
        words = [str(size) for size in self._sizes]
        if self._any_before:
            words.insert(0, "...")
        return words


def _length(name: str, values: Mapping[str, object]) -> int | str:
    """Return the length of this name, or of an attribute of an argument, such as ``robot.n_q``; the
    name itself where the values do not tell it.
    """
    argument, *attributes = name.split(".")
    if attributes:
        value = values.get(argument)
    else:
        value = values.get(f"{_OF}{name}")
    for attribute in attributes:
        value = getattr(value, attribute, None)
    if isinstance(value, int):
        return value
    return name


Finite = Annotated[float, Range(open=True)]
Positive = Annotated[float, Range(0.0, open=True)]
Count = Annotated[int, Range(0)]
AtLeastOne = Annotated[int, Range(1)]
Magnitude = Annotated[float, Range(0.0, 1e6)]
"""[m], [rad], [s] Never negative, and finite."""
Lead = Annotated[float, Range(1.0, 1e6)]
"""How many times faster than its lag a thruster is driven."""
Bound = Annotated[float, Range()]
"""Infinite where there is no bound, never NaN."""
Period = Annotated[float, Range(0.0, DAY, open=True)]
"""[s] Of control, of a step, of an action: no longer than a day."""
Vector3 = Annotated[np.ndarray, Shape(3)]
Point = Annotated[Sequence[float], Shape(3), Range(open=True)]


@dataclass(frozen=True, slots=True)
class Keyed:
    """An argument of what `functools.lru_cache` keeps, equal to others of the same key."""

    key: Hashable
    value: Any = field(compare=False)


class FrozenDict(dict[Any, Any]):
    """A dictionary that stays as it was made; it can be pickled, copied and written as JSON."""

    __slots__ = ()

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError(
            "this mapping is part of a frozen value; make a new one, as by dict(...) or"
            " dataclasses.replace"
        )

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type[FrozenDict], tuple[dict[Any, Any]]]:
        return FrozenDict, (dict(self),)


def frozen_mapping(items: Mapping[Any, Any]) -> FrozenDict:
    """Return a mapping of these entries that cannot be changed."""
    if type(items) is FrozenDict:
        return items
    return FrozenDict(items)


def read_only(values: ArrayLike, dtype: type | None = None) -> np.ndarray:
    """Return ``values`` (...) [any] as an array that neither its holder nor its giver can write to:
    a copy unless it is one.
    """
    array = np.asarray(values, dtype=dtype)
    base = memory_of(array)
    is_read_only_memory = isinstance(base, bytes | mmap) and memoryview(base).readonly
    is_fixed = base is values or is_read_only_memory
    if array.flags.writeable or not is_fixed:
        array = np.array(array)
        array.flags.writeable = False
    return array


def memory_of(array: np.ndarray) -> Any:
    """Return the owner of the memory of an array (...) [any]: another array, itself, bytes, or a
    mapped file.
    """
    base: Any = array
    while isinstance(base, np.ndarray) and base.base is not None:
        base = base.base
    return base
