"""Kinds of argument: numbers, words, arrays, paths, values of a class, and what is composed of
these; `uvms_ocp.annotation_kinds` reads them from annotations.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from uvms_ocp.errors import short
from uvms_ocp.types import Range, Shape, frozen_mapping, read_only

LARGEST_WHOLE = 2**63 - 1  # whole number that NumPy, C and files of ours can hold
REAL_NUMBERS = ("numbers", "biuf")
CONTENT_BY_DTYPE: dict[type | None, tuple[str, str]] = {
    np.bool_: ("truth values", "b"),
    np.intp: ("whole numbers", "iu"),
}
"""Contents of arrays, in words and as NumPy's letters; of any other type, `REAL_NUMBERS`."""


class Violation(NamedTuple):
    """A value that does not fit."""

    place: str
    """Place of the wrong value in the arguments, such as ``phases[2].name``."""
    problem: str
    """Predicate of a sentence whose subject is the place, such as ``= -1``."""
    allowed: str
    """Values that would be right, in words, such as ``a number >= 0``."""


@dataclass(frozen=True)
class Kind:
    """A value of which a test holds, and whose parts are of kinds of their own; by default
    anything.
    """

    allowed: str = "a value"
    """The kind in words."""
    test: Callable[[Any], bool] = lambda value: True
    """True for a value of this kind, its parts apart."""
    converts: ClassVar[Any] = False
    """True where `converted` may differ from the value."""
    shape: ClassVar[Any] = None
    """The shape that an array should have."""

    def fits(self, value: Any) -> bool:
        """Return whether the value may be of this kind, its parts apart."""
        return self.test(value)

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        """List the parts of a value that fits: place, kind and value of each."""
        return ()

    def holds(self, value: Any) -> bool:
        """Return whether the value is of this kind."""
        if not self.fits(value):
            return False
        return all(kind.holds(item) for _, kind, item in self.parts("", value))

    def wrong(self, place: str, value: Any) -> Violation:
        """Say what is wrong with a value that does not fit, as deep inside as can be said."""
        if self.fits(value):
            for part_place, kind, part in self.parts(place, value):
                if not kind.holds(part):
                    return kind.wrong(part_place, part)
        return Violation(place, f"= {short(value)}", self.allowed)

    def among(self, value: Any) -> Kind:
        """Return the kind, of alternatives, that a value is of."""
        return self

    def converted(self, value: Any, keep: bool) -> Any:
        """Return the value as a function gets it, or as a frozen dataclass keeps it, where nobody
        can change it later.
        """
        return value


@dataclass(frozen=True)
class PoseKind(Kind):
    """A pose whose numbers are finite; a frozen value keeps a copy."""

    converts = True

    def converted(self, value: Any, keep: bool) -> Any:
        if keep:
            return value.copy()
        return value


@dataclass(frozen=True)
class RealNumber(Kind):
    """A real number; NaN and infinity too unless a range says otherwise, since who asks for it
    often knows better why.
    """

    inside: Range | None = None
    """Range of the numbers that are allowed."""
    converts = True

    def fits(self, value: Any) -> bool:
        if isinstance(value, (bool, np.bool_, str, bytes)) or not hasattr(value, "__float__"):
            return False
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError, RuntimeError):
            return False
        return self.inside is None or self.inside.holds(number)

    def converted(self, value: Any, keep: bool) -> Any:
        # NumPy cannot say of a whole number of thirty digits whether it is finite.
        if type(value) is int:
            return float(value)
        return value


@dataclass(frozen=True)
class WholeNumber(Kind):
    """A whole number."""

    inside: Range | None = None
    """Range of the numbers that are allowed."""

    def fits(self, value: Any) -> bool:
        return self._is_inside(value) and abs(operator.index(value)) <= LARGEST_WHOLE

    def wrong(self, place: str, value: Any) -> Violation:
        if not self._is_inside(value):
            return super().wrong(place, value)
        allowed = f"{self.allowed}, of at most {LARGEST_WHOLE} in size"
        return Violation(place, f"is {short(value)}", allowed)

    def _is_inside(self, value: Any) -> bool:
        if isinstance(value, (bool, np.bool_)):
            return False
        try:
            number = operator.index(value)
        except TypeError:
            return False
        return self.inside is None or self.inside.holds(number)


@dataclass(frozen=True)
class ArrayKind(Kind):
    """An array, or what NumPy makes one of: of real numbers, of whole ones or of truth values."""

    dtype: type | None = None
    """NumPy's type of its entries; `None` for real numbers."""
    shape: Shape | None = None  # type: ignore[misc]
    inside: Range | None = None
    """Range of the numbers that are allowed."""
    plain: bool = False
    """A function asks for an array; otherwise it converts itself."""
    converts = True

    def fits(self, value: Any) -> bool:
        array = _array(value)
        if array is None or (self.plain and array.ndim == 0 and self.shape is None):
            return False
        if self.shape is not None and not self.shape.holds(array):
            return False
        if not array.size:
            return True
        _, letters = CONTENT_BY_DTYPE.get(self.dtype, REAL_NUMBERS)
        if array.dtype.kind not in letters:
            return False
        if self.inside is None:
            return True
        return self.inside.holds(array.min()) and self.inside.holds(array.max())

    def wrong(self, place: str, value: Any) -> Violation:
        array = _array(value)
        if array is not None and array.dtype.kind in "biuf":
            if self.shape is not None and not self.shape.holds(array):
                return Violation(place, f"has shape {array.shape}", self.allowed)
            spoilt = np.argwhere(np.isnan(array))
            if len(spoilt) and self.inside is not None:
                return Violation(place, f"has NaN at {spoilt[0].tolist()}", self.allowed)
        return super().wrong(place, value)

    def converted(self, value: Any, keep: bool) -> Any:
        if keep and (self.plain or np.ndim(value)):
            return read_only(value, self.dtype)
        if self.plain:
            return np.asarray(value, dtype=self.dtype)
        return value


def _array(value: Any) -> np.ndarray | None:
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, (str, bytes)) or value is None:
        return None
    try:
        return np.asarray(value)
    except Exception:  # what converts itself to an array may fail as it likes
        return None


@dataclass(frozen=True)
class Alternatives(Kind):
    """Any of some kinds."""

    kinds: tuple[Kind, ...] = ()
    """The kinds, the first that holds first."""

    @property
    def converts(self) -> bool:
        return any(kind.converts for kind in self.kinds)

    @property
    def shape(self) -> Shape | None:
        for kind in self.kinds:
            if kind.shape:
                return kind.shape
        return None

    def fits(self, value: Any) -> bool:
        return any(kind.holds(value) for kind in self.kinds)

    def wrong(self, place: str, value: Any) -> Violation:
        # An alternative that finds its fault deep inside was the one that was meant.
        for kind in self.kinds:
            violation = kind.wrong(place, value)
            if violation.place != place or not violation.problem.startswith("="):
                return violation
        return super().wrong(place, value)

    def among(self, value: Any) -> Kind:
        for kind in self.kinds:
            if kind.holds(value):
                return kind.among(value)
        return Kind()

    def converted(self, value: Any, keep: bool) -> Any:
        return self.among(value).converted(value, keep)


@dataclass(frozen=True)
class Items(Kind):
    """Several values of one kind: a tuple, a list, any sequence, or anything to iterate over."""

    holder: type = tuple
    """Class that holds them."""
    kind: Kind = Kind()
    """Kind of each."""

    @property
    def converts(self) -> bool:
        # A frozen value keeps a tuple.
        return self.kind.converts or self.holder in (Sequence, list, tuple)

    def fits(self, value: Any) -> bool:
        if isinstance(value, (str, bytes)):
            return False
        if isinstance(value, np.ndarray) and value.ndim > 0:
            has_numbers = isinstance(self.kind, (RealNumber, WholeNumber, ArrayKind))
            if has_numbers and self.holder in (Sequence, Iterable):
                return True
        holders = (tuple, list) if self.holder is tuple else self.holder
        return isinstance(value, holders)

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        if not isinstance(value, (Sequence, np.ndarray, set, frozenset)):
            return  # an iterator, which can be read once
        for index, item in enumerate(value):
            yield f"{place}[{index}]", self.kind, item

    def converted(self, value: Any, keep: bool) -> Any:
        keep = keep or (self.holder is tuple and isinstance(value, list))
        if keep:
            if not isinstance(value, (tuple, list)):
                return value
            return tuple(self.kind.converted(item, keep) for item in value)
        if self.kind.converts and type(value) in (tuple, list):
            return type(value)(self.kind.converted(item, keep) for item in value)
        return value


@dataclass(frozen=True)
class FixedTuple(Kind):
    """A tuple of a given length; where numbers are asked for, any sequence of them will do."""

    kinds: tuple[Kind, ...] = ()
    """Kind of each item."""
    converts = True

    def fits(self, value: Any) -> bool:
        if not isinstance(value, tuple):
            wants_numbers = all(isinstance(kind, (RealNumber, WholeNumber)) for kind in self.kinds)
            is_row = isinstance(value, (list, np.ndarray)) and getattr(value, "ndim", 1) == 1
            if not (wants_numbers and is_row):
                return False
        return len(value) == len(self.kinds)

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        for index, (kind, item) in enumerate(zip(self.kinds, value, strict=True)):
            yield f"{place}[{index}]", kind, item

    def converted(self, value: Any, keep: bool) -> Any:
        if keep:
            items = zip(self.kinds, value, strict=True)
            return tuple(kind.converted(item, keep) for kind, item in items)
        if isinstance(value, tuple):
            return value
        return tuple(value)


@dataclass(frozen=True)
class Table(Kind):
    """A mapping."""

    key: Kind = Kind()
    """Kind of each key."""
    item: Kind = Kind()
    """Kind of each value."""
    converts = True

    def parts(self, place: str, value: Any) -> Iterator[tuple[str, Kind, Any]]:
        for key, item in value.items():
            yield f"a key of {place}", self.key, key
            yield f"{place}[{short(key)}]", self.item, item

    def converted(self, value: Any, keep: bool) -> Any:
        if not keep:
            return value
        if self.item.converts:
            value = {key: self.item.converted(item, keep) for key, item in value.items()}
        return frozen_mapping(value)


@dataclass(frozen=True)
class GenericValue(Kind):
    """A value of a generic class of which some fields are of certain kinds."""

    fields: tuple[tuple[str, Kind], ...] = ()
    """Name and kind of each of these fields."""

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        for name, kind in self.fields:
            yield f"{place}.{name}", kind, getattr(value, name)
