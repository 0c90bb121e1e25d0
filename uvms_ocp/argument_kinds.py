"""Kinds of argument: numbers, words, arrays, paths and values of a class, and containers, alternatives and functions of these."""

from __future__ import annotations

import inspect
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.types import Range, Shape, frozen_mapping, read_only

# What an argument of one type may be: numbers, words, arrays, paths, values of a class.

_SHOWN = 60  # characters of a wrong value
_LARGEST = 2**63 - 1  # whole number that NumPy, C and files of ours can hold
_REAL = ("numbers", "biuf")
_OF_TYPE: dict[type | None, tuple[str, str]] = {np.bool_: ("truth values", "b"), np.intp: ("whole numbers", "iu")}
"""Contents of arrays, in words and as NumPy's letters."""


@dataclass(frozen=True)
class Violation:
    """A value that does not fit: where it is, what is wrong with it and what is allowed there."""

    place: str
    found: str
    allowed: str

    def __str__(self) -> str:
        return f"{self.place} {self.found}; give {self.allowed}"


def short(value: object) -> str:
    """A value as messages show it: on one line, of 60 characters at most."""
    try:
        text = " ".join(repr(value).split())
    except Exception:
        text = f"a {type(value).__name__}"
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


class Kind:
    """Anything; base of all kinds."""

    allowed = "a value"
    """In words."""
    converts = False
    """True where `taken` or `kept` may differ from the value."""
    shaped = False
    """True where `shape_of` may give a shape."""

    def holds(self, value: object) -> bool:
        """Return whether the value fits."""
        return True

    def wrong(self, place: str, value: object) -> Violation:
        """Say what is wrong with a value that does not fit, as deep inside as can be said."""
        return Violation(place, f"= {short(value)}", self.allowed)

    def shape_of(self, value: object) -> Shape | None:
        """The shape that a value should have."""
        return None

    def taken(self, value: Any) -> Any:
        """Return the value as a function gets it."""
        return value

    def kept(self, value: Any) -> Any:
        """Return the value as a frozen dataclass keeps it: nothing that its giver could change later."""
        return value


@dataclass(frozen=True)
class Instance(Kind):
    """A value of a class."""

    cls: type

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        name = self.cls.__name__
        return {"str": "a string", "bool": "True or False", "NoneType": "None", "dict": "a dictionary"}.get(
            name, f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
        )

    def holds(self, value: object) -> bool:
        return isinstance(value, self.cls)


class Boolean(Kind):
    """True or False, of Python or NumPy."""

    allowed = "True or False"

    def holds(self, value: object) -> bool:
        return isinstance(value, (bool, np.bool_))


@dataclass(frozen=True)
class Pose(Kind):
    """A pose whose numbers are finite; a frozen value keeps a copy."""

    cls: type
    allowed = "a pinocchio.SE3 of finite numbers"
    converts = True

    def holds(self, value: object) -> bool:
        return isinstance(value, self.cls) and bool(np.isfinite(value.homogeneous).all())  # type: ignore[attr-defined]

    def kept(self, value: Any) -> Any:
        return value.copy()


@dataclass(frozen=True)
class FilePath(Kind):
    """A path, or the text of one."""

    text: bool = False
    allowed = "a path without control characters"

    def holds(self, value: object) -> bool:
        known = isinstance(value, Path) or (self.text and isinstance(value, str))
        return known and str(value) != "" and all(letter >= " " for letter in str(value))


@dataclass(frozen=True)
class Number(Kind):
    """A real number; NaN and infinity too unless a range says otherwise, since who asks for it often knows better why."""

    inside: Range | None = None
    converts = True

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return f"a number{self.inside or ''}"

    def holds(self, value: object) -> bool:
        if isinstance(value, (bool, np.bool_, str, bytes)) or not hasattr(value, "__float__"):
            return False
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError, RuntimeError):
            return False
        return self.inside is None or self.inside.holds(number)

    def taken(self, value: Any) -> Any:
        # NumPy cannot say of a whole number of thirty digits whether it is finite.
        return float(value) if type(value) is int else value

    def kept(self, value: Any) -> Any:
        return self.taken(value)


@dataclass(frozen=True)
class Whole(Kind):
    """A whole number."""

    inside: Range | None = None

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return f"a whole number{self.inside or ''}"

    def holds(self, value: object) -> bool:
        number = _whole(value)
        return number is not None and abs(number) <= _LARGEST and self._inside(number)

    def wrong(self, place: str, value: object) -> Violation:
        number = _whole(value)
        if number is None or not self._inside(number):
            return super().wrong(place, value)
        return Violation(place, f"is {short(value)}", f"{self.allowed}, of at most {_LARGEST} in size")

    def _inside(self, number: int) -> bool:
        return self.inside is None or self.inside.holds(number)


def _whole(value: object) -> int | None:
    if isinstance(value, (bool, np.bool_)):
        return None
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        return None


@dataclass(frozen=True)
class Numbers(Kind):
    """An array, or what NumPy makes one of: of real numbers, of whole ones or of truth values."""

    dtype: type | None = None
    shape: Shape | None = None
    inside: Range | None = None
    plain: bool = False
    """A function asks for an array; otherwise it converts itself."""
    converts = True

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        what, _ = _OF_TYPE.get(self.dtype, _REAL)
        return f"an array{f' {self.shape}' if self.shape else ''} of {what}{self.inside or ''}"

    def holds(self, value: object) -> bool:
        array = _array(value)
        if array is None or (self.plain and array.ndim == 0 and self.shape is None):
            return False
        if self.shape is not None and not self.shape.holds(array):
            return False
        if array.size and array.dtype.kind not in _OF_TYPE.get(self.dtype, _REAL)[1]:
            return False
        return self.inside is None or not array.size or all(map(self.inside.holds, (array.min(), array.max())))

    def wrong(self, place: str, value: object) -> Violation:
        array = _array(value)
        if array is None or array.dtype.kind not in "biuf":
            return super().wrong(place, value)
        if self.shape is not None and not self.shape.holds(array):
            return Violation(place, f"has shape {array.shape}", self.allowed)
        spoilt = np.argwhere(np.isnan(array))
        if len(spoilt) and self.inside is not None:
            return Violation(place, f"has NaN at {spoilt[0].tolist()}", self.allowed)
        return super().wrong(place, value)

    @property
    def shaped(self) -> bool:  # type: ignore[override]
        """True where there is a shape."""
        return self.shape is not None

    def shape_of(self, value: object) -> Shape | None:
        return self.shape

    def taken(self, value: Any) -> Any:
        if not self.plain:
            return value
        return np.asarray(value, dtype=self.dtype) if self.dtype else np.asarray(value)

    def kept(self, value: Any) -> Any:
        if not self.plain and np.ndim(value) == 0:
            return value
        return read_only(value, self.dtype)


def _array(value: object) -> np.ndarray | None:
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, (str, bytes)) or value is None:
        return None
    try:
        return np.asarray(value)
    except Exception:  # what converts itself to an array may fail as it likes
        return None


# What an argument of a composed type may be: alternatives, sequences, mappings, functions, things with certain methods.

_TEXT = (str, bytes)


@dataclass(frozen=True)
class Choice(Kind):
    """One of some plain values."""

    values: tuple[Any, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return " or ".join(map(repr, self.values))

    def holds(self, value: object) -> bool:
        return isinstance(value, (str, int, bytes, type(None))) and value in self.values


@dataclass(frozen=True)
class Either(Kind):
    """Any of some kinds."""

    kinds: tuple[Kind, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return " or ".join(dict.fromkeys(kind.allowed for kind in self.kinds))

    @property
    def converts(self) -> bool:  # type: ignore[override]
        """True where one of them does."""
        return any(kind.converts for kind in self.kinds)

    @property
    def shaped(self) -> bool:  # type: ignore[override]
        """True where one of them is."""
        return any(kind.shaped for kind in self.kinds)

    def holds(self, value: object) -> bool:
        return any(kind.holds(value) for kind in self.kinds)

    def wrong(self, place: str, value: object) -> Violation:
        # An alternative that finds its fault deep inside was the one that was meant.
        found = [kind.wrong(place, value) for kind in self.kinds]
        deeper = [fault for fault in found if fault.place != place or not fault.found.startswith("=")]
        return deeper[0] if deeper else super().wrong(place, value)

    def shape_of(self, value: object) -> Shape | None:
        return next((kind.shape_of(value) for kind in self.kinds if kind.holds(value)), None)

    def taken(self, value: Any) -> Any:
        return self._of(value).taken(value)

    def kept(self, value: Any) -> Any:
        return self._of(value).kept(value)

    def _of(self, value: object) -> Kind:
        return next(kind for kind in self.kinds if kind.holds(value))


@dataclass(frozen=True)
class Items(Kind):
    """Several values of one kind: a tuple, a list, any sequence, or anything to iterate over."""

    holder: type
    kind: Kind

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        name = "sequence" if self.holder in (Sequence, Iterable) else self.holder.__name__
        inner = self.kind.allowed
        return f"a {name}" + ("" if type(self.kind) is Kind else f" of which each is {inner}")

    @property
    def converts(self) -> bool:  # type: ignore[override]
        """A frozen value keeps a tuple."""
        return self.kind.converts or self.holder in (Sequence, list)

    def holds(self, value: object) -> bool:
        if not self._is_holder(value):
            return False
        return not isinstance(value, (Sequence, np.ndarray, set, frozenset)) or all(map(self.kind.holds, value))

    def wrong(self, place: str, value: object) -> Violation:
        if self._is_holder(value):
            for index, item in enumerate(value):  # type: ignore[var-annotated, arg-type]
                if not self.kind.holds(item):
                    return self.kind.wrong(f"{place}[{index}]", item)
        return super().wrong(place, value)

    def taken(self, value: Any) -> Any:
        return (
            type(value)(map(self.kind.taken, value)) if self.kind.converts and type(value) in (tuple, list) else value
        )

    def kept(self, value: Any) -> Any:
        return tuple(map(self.kind.kept, value)) if isinstance(value, (tuple, list)) else value

    def _is_holder(self, value: object) -> bool:
        if isinstance(value, _TEXT):
            return False
        numbers = isinstance(self.kind, (Number, Whole, Numbers)) and self.holder in (Sequence, Iterable)
        return isinstance(value, self.holder) or (numbers and isinstance(value, np.ndarray) and value.ndim > 0)


@dataclass(frozen=True)
class Several(Kind):
    """A tuple of a given length; where numbers are asked for, any sequence of them will do."""

    kinds: tuple[Kind, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return f"({', '.join(kind.allowed for kind in self.kinds)})"

    @property
    def converts(self) -> bool:  # type: ignore[override]
        """Numbers in a list or array become a tuple."""
        return True

    def holds(self, value: object) -> bool:
        if not self._is_holder(value) or len(value) != len(self.kinds):  # type: ignore[arg-type]
            return False
        return all(kind.holds(item) for kind, item in zip(self.kinds, value, strict=True))  # type: ignore[call-overload]

    def wrong(self, place: str, value: object) -> Violation:
        if self._is_holder(value) and len(value) == len(self.kinds):  # type: ignore[arg-type]
            for index, (kind, item) in enumerate(zip(self.kinds, value, strict=True)):  # type: ignore[call-overload]
                if not kind.holds(item):
                    return kind.wrong(f"{place}[{index}]", item)
        return super().wrong(place, value)

    def taken(self, value: Any) -> Any:
        return value if isinstance(value, tuple) else tuple(value)

    def kept(self, value: Any) -> Any:
        return tuple(kind.kept(item) for kind, item in zip(self.kinds, value, strict=True))

    def _is_holder(self, value: object) -> bool:
        numbers = all(isinstance(kind, (Number, Whole)) for kind in self.kinds)
        return isinstance(value, tuple) or (
            numbers and isinstance(value, (list, np.ndarray)) and getattr(value, "ndim", 1) == 1
        )


@dataclass(frozen=True)
class Table(Kind):
    """A mapping."""

    key: Kind
    item: Kind
    allowed = "a mapping"
    converts = True

    def holds(self, value: object) -> bool:
        return isinstance(value, Mapping) and not any(True for _ in self._faults("", value))

    def wrong(self, place: str, value: object) -> Violation:
        if isinstance(value, Mapping):
            return next(self._faults(place, value))
        return super().wrong(place, value)

    def kept(self, value: Any) -> Any:
        return frozen_mapping(
            {key: self.item.kept(item) for key, item in value.items()} if self.item.converts else value
        )

    def _faults(self, place: str, value: Mapping[Any, Any]) -> Iterator[Violation]:
        for key, item in value.items():
            if not self.key.holds(key):
                yield self.key.wrong(f"a key of {place}", key)
            if not self.item.holds(item):
                yield self.item.wrong(f"{place}[{short(key)}]", item)


@dataclass(frozen=True)
class Filled(Kind):
    """A value of a generic class of which some fields are of certain kinds."""

    cls: type
    parts: tuple[tuple[str, Kind], ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        inner = " and ".join(f"`{name}` is {kind.allowed}" for name, kind in self.parts)
        return f"a {self.cls.__name__} of which {inner}"

    def holds(self, value: object) -> bool:
        return isinstance(value, self.cls) and all(kind.holds(getattr(value, name)) for name, kind in self.parts)

    def wrong(self, place: str, value: object) -> Violation:
        if isinstance(value, self.cls):
            for name, kind in self.parts:
                if not kind.holds(item := getattr(value, name)):
                    return kind.wrong(f"{place}.{name}", item)
        return super().wrong(place, value)


@dataclass(frozen=True)
class Function(Kind):
    """Something to call, with so many arguments as far as its signature can be read."""

    n_arguments: int | None = None

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return "a function" + ("" if self.n_arguments is None else f" of {self.n_arguments} arguments")

    def holds(self, value: object) -> bool:
        if not callable(value):
            return False
        try:
            inspect.signature(value).bind(*[None] * (self.n_arguments or 0))
        except TypeError:
            return self.n_arguments is None
        except ValueError:  # built in
            return True
        return True


@dataclass(frozen=True)
class ProtocolKind(Kind):
    """A value, of whatever class, with the methods of a protocol."""

    protocol: type
    methods: tuple[str, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return f"a value with the methods of {self.protocol.__name__} ({', '.join(self.methods)})"

    def holds(self, value: object) -> bool:
        return not isinstance(value, type) and all(hasattr(value, name) for name in self.methods)
