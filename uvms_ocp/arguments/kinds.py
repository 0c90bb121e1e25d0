"""What an argument of one type may be: numbers, words, arrays, paths, values of a class."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments.extents import Range, Shape
from uvms_ocp.arguments.frozen import read_only

_SHOWN = 60  # characters of a wrong value
_LARGEST = 2**63 - 1  # whole number that NumPy, C and files of ours can hold
_REAL = ("numbers", "biuf")
_OF_TYPE: dict[type | None, tuple[str, str]] = {np.bool_: ("truth values", "b"), np.intp: ("whole numbers", "iu")}
"""What arrays hold, in words and as NumPy's letters."""


@dataclass(frozen=True)
class Wrong:
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
    """Whether `taken` or `kept` may differ from the value."""
    shaped = False
    """Whether `shape_of` may give a shape."""

    def holds(self, value: object) -> bool:
        """Whether the value fits."""
        return True

    def wrong(self, place: str, value: object) -> Wrong:
        """What is wrong with a value that does not fit, as deep inside as can be said."""
        return Wrong(place, f"= {short(value)}", self.allowed)

    def shape_of(self, value: object) -> Shape | None:
        """The shape that a value should have."""
        return None

    def taken(self, value: Any) -> Any:
        """What a function gets."""
        return value

    def kept(self, value: Any) -> Any:
        """What a frozen value keeps: nothing that its giver could change later."""
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

    def wrong(self, place: str, value: object) -> Wrong:
        number = _whole(value)
        if number is None or not self._inside(number):
            return super().wrong(place, value)
        return Wrong(place, f"is {short(value)}", f"{self.allowed}, of at most {_LARGEST} in size")

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

    def wrong(self, place: str, value: object) -> Wrong:
        array = _array(value)
        if array is None or array.dtype.kind not in "biuf":
            return super().wrong(place, value)
        if self.shape is not None and not self.shape.holds(array):
            return Wrong(place, f"has shape {array.shape}", self.allowed)
        spoilt = np.argwhere(np.isnan(array))
        if len(spoilt) and self.inside is not None:
            return Wrong(place, f"has NaN at {spoilt[0].tolist()}", self.allowed)
        return super().wrong(place, value)

    @property
    def shaped(self) -> bool:  # type: ignore[override]
        """Whether there is a shape."""
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
