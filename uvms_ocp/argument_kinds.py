"""Kinds of argument, read from annotations: numbers, words, arrays, paths, values of a class, and
what is composed of these.
"""

from __future__ import annotations

import inspect
import operator
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.errors import short
from uvms_ocp.types import Range, Shape, frozen_mapping, read_only

_LARGEST = 2**63 - 1  # whole number that NumPy, C and files of ours can hold
_REAL = ("numbers", "biuf")
_OF_TYPE: dict[type | None, tuple[str, str]] = {
    np.bool_: ("truth values", "b"),
    np.intp: ("whole numbers", "iu"),
}
"""Contents of arrays, in words and as NumPy's letters."""

_PATH = "a path without control characters"
_ARRAY_LIKE = frozenset(typing.get_args(ArrayLike))


class _Violation(NamedTuple):
    """A value that does not fit: where it is, what is wrong with it and what is allowed there."""

    place: str
    found: str
    allowed: str


@dataclass(frozen=True)
class Kind:
    """A value of which a test holds, and whose parts are of kinds of their own; by default
    anything.
    """

    allowed: str = "a value"
    """In words."""
    test: Callable[[Any], bool] = lambda value: True
    converts: typing.ClassVar[Any] = False
    """True where `converted` may differ from the value."""
    shape: typing.ClassVar[Any] = None
    """The shape that an array should have."""

    def fits(self, value: Any) -> bool:
        """Return whether the value may be of this kind, its parts apart."""
        return self.test(value)

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        """List the parts of a value that fits: place, kind and value of each."""
        return ()

    def holds(self, value: Any) -> bool:
        """Return whether the value is of this kind."""
        return self.fits(value) and all(kind.holds(item) for _, kind, item in self.parts("", value))

    def wrong(self, place: str, value: Any) -> _Violation:
        """Say what is wrong with a value that does not fit, as deep inside as can be said."""
        for where, kind, item in self.parts(place, value) if self.fits(value) else ():
            if not kind.holds(item):
                return kind.wrong(where, item)
        return _Violation(place, f"= {short(value)}", self.allowed)

    def among(self, value: Any) -> Kind:
        """The kind, of alternatives, that a value is of."""
        return self

    def converted(self, value: Any, keep: bool) -> Any:
        """Return the value as a function gets it, or as a frozen dataclass keeps it, where nobody
        can change it later.
        """
        return value


@dataclass(frozen=True)
class _Pose(Kind):
    """A pose whose numbers are finite; a frozen value keeps a copy."""

    converts = True

    def converted(self, value: Any, keep: bool) -> Any:
        if keep:
            return value.copy()
        return value


@dataclass(frozen=True)
class _Number(Kind):
    """A real number; NaN and infinity too unless a range says otherwise, since who asks for it
    often knows better why.
    """

    inside: Range | None = None
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
class _Whole(Kind):
    """A whole number."""

    inside: Range | None = None

    def fits(self, value: Any) -> bool:
        return self._is_inside(value) and abs(operator.index(value)) <= _LARGEST

    def wrong(self, place: str, value: Any) -> _Violation:
        if not self._is_inside(value):
            return super().wrong(place, value)
        return _Violation(
            place, f"is {short(value)}", f"{self.allowed}, of at most {_LARGEST} in size"
        )

    def _is_inside(self, value: Any) -> bool:
        try:
            number = operator.index(value)
        except TypeError:
            return False
        return not isinstance(value, (bool, np.bool_)) and (
            self.inside is None or self.inside.holds(number)
        )


@dataclass(frozen=True)
class _Numbers(Kind):
    """An array, or what NumPy makes one of: of real numbers, of whole ones or of truth values."""

    dtype: type | None = None
    shape: Shape | None = None  # type: ignore[misc]
    inside: Range | None = None
    plain: bool = False
    """A function asks for an array; otherwise it converts itself."""
    converts = True

    def fits(self, value: Any) -> bool:
        array = _array(value)
        if array is None or (self.plain and array.ndim == 0 and self.shape is None):
            return False
        if self.shape is not None and not self.shape.holds(array):
            return False
        if array.size and array.dtype.kind not in _OF_TYPE.get(self.dtype, _REAL)[1]:
            return False
        return (
            self.inside is None
            or not array.size
            or all(map(self.inside.holds, (array.min(), array.max())))
        )

    def wrong(self, place: str, value: Any) -> _Violation:
        array = _array(value)
        if array is not None and array.dtype.kind in "biuf":
            if self.shape is not None and not self.shape.holds(array):
                return _Violation(place, f"has shape {array.shape}", self.allowed)
            spoilt = np.argwhere(np.isnan(array))
            if len(spoilt) and self.inside is not None:
                return _Violation(place, f"has NaN at {spoilt[0].tolist()}", self.allowed)
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
class _Either(Kind):
    """Any of some kinds."""

    kinds: tuple[Kind, ...] = ()

    @property
    def converts(self) -> bool:
        return any(kind.converts for kind in self.kinds)

    @property
    def shape(self) -> Shape | None:
        return next((kind.shape for kind in self.kinds if kind.shape), None)

    def fits(self, value: Any) -> bool:
        return any(kind.holds(value) for kind in self.kinds)

    def wrong(self, place: str, value: Any) -> _Violation:
        # An alternative that finds its fault deep inside was the one that was meant.
        violations = [kind.wrong(place, value) for kind in self.kinds]
        deeper = [
            fault for fault in violations if fault.place != place or not fault.found.startswith("=")
        ]
        if deeper:
            return deeper[0]
        return super().wrong(place, value)

    def among(self, value: Any) -> Kind:
        return next((kind.among(value) for kind in self.kinds if kind.holds(value)), Kind())

    def converted(self, value: Any, keep: bool) -> Any:
        return self.among(value).converted(value, keep)


@dataclass(frozen=True)
class _Items(Kind):
    """Several values of one kind: a tuple, a list, any sequence, or anything to iterate over."""

    holder: type = tuple
    kind: Kind = Kind()

    @property
    def converts(self) -> bool:
        return self.kind.converts or self.holder in (
            Sequence,
            list,
            tuple,
        )  # a frozen value keeps a tuple

    def fits(self, value: Any) -> bool:
        if isinstance(value, (str, bytes)):
            return False
        numbers = isinstance(self.kind, (_Number, _Whole, _Numbers)) and self.holder in (
            Sequence,
            Iterable,
        )
        holders = (tuple, list) if self.holder is tuple else self.holder
        return isinstance(value, holders) or (
            numbers and isinstance(value, np.ndarray) and value.ndim > 0
        )

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        if isinstance(value, (Sequence, np.ndarray, set, frozenset)):
            yield from ((f"{place}[{index}]", self.kind, item) for index, item in enumerate(value))

    def converted(self, value: Any, keep: bool) -> Any:
        keep = keep or (self.holder is tuple and isinstance(value, list))
        if (keep and isinstance(value, (tuple, list))) or (
            self.kind.converts and type(value) in (tuple, list)
        ):
            return (tuple if keep else type(value))(
                self.kind.converted(item, keep) for item in value
            )
        return value


@dataclass(frozen=True)
class _Several(Kind):
    """A tuple of a given length; where numbers are asked for, any sequence of them will do."""

    kinds: tuple[Kind, ...] = ()
    converts = True

    def fits(self, value: Any) -> bool:
        numbers = all(isinstance(kind, (_Number, _Whole)) for kind in self.kinds)
        is_row_of_numbers = (
            numbers and isinstance(value, (list, np.ndarray)) and getattr(value, "ndim", 1) == 1
        )
        return (isinstance(value, tuple) or is_row_of_numbers) and len(value) == len(self.kinds)

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        return (
            (f"{place}[{i}]", kind, item)
            for i, (kind, item) in enumerate(zip(self.kinds, value, strict=True))
        )

    def converted(self, value: Any, keep: bool) -> Any:
        if keep:
            return tuple(
                kind.converted(item, keep) for kind, item in zip(self.kinds, value, strict=True)
            )
        if isinstance(value, tuple):
            return value
        return tuple(value)


@dataclass(frozen=True)
class _Table(Kind):
    """A mapping."""

    key: Kind = Kind()
    item: Kind = Kind()
    converts = True

    def parts(self, place: str, value: Any) -> Iterator[tuple[str, Kind, Any]]:
        for key, item in value.items():
            yield f"a key of {place}", self.key, key
            yield f"{place}[{short(key)}]", self.item, item

    def converted(self, value: Any, keep: bool) -> Any:
        if not keep:
            return value
        return frozen_mapping(
            {k: self.item.converted(item, keep) for k, item in value.items()}
            if self.item.converts
            else value
        )


@dataclass(frozen=True)
class _Filled(Kind):
    """A value of a generic class of which some fields are of certain kinds."""

    fields: tuple[tuple[str, Kind], ...] = ()

    def parts(self, place: str, value: Any) -> Iterable[tuple[str, Kind, Any]]:
        return ((f"{place}.{name}", kind, getattr(value, name)) for name, kind in self.fields)


# From an annotation to the kind of value that it allows.


def _is_a(*classes: type) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, classes)


def _is_path(*classes: type) -> Callable[[Any], bool]:
    return lambda value: (
        isinstance(value, classes)
        and str(value) != ""
        and all(letter >= " " for letter in str(value))
    )


_PLAIN_KINDS: dict[Any, Kind] = {
    bool: Kind("True or False", _is_a(bool, np.bool_)),
    Path: Kind(_PATH, _is_path(Path)),
    None: Kind("None", _is_a(type(None))),
    Any: Kind(),
}


def kinds_of(function: Callable[..., Any], owner: type | None = None) -> dict[str, Kind]:
    """Return the kind of each parameter, by name; `owner` is the class of which `function` is the
    constructor.
    """
    # The annotations of fields that are inherited are read where they stand, not where the
    # constructor was made.
    generated = function.__code__.co_filename == "<string>"
    hints = _hints(owner if owner is not None and generated else function)
    parameters = inspect.signature(function).parameters
    if owner is not None and not set(parameters) - {"self"} <= set(hints):
        hints |= _hints(function)
    return {name: _kind_of(hints[name]) for name in parameters if name in hints}


def _kind_of(annotation: Any) -> Kind:
    """Return the kind of value that this annotation allows; anything, where the annotation says
    nothing that can be checked.
    """
    if annotation in _PLAIN_KINDS:
        return _PLAIN_KINDS[annotation]
    if annotation is ArrayLike:
        return _numbers()
    origin = typing.get_origin(annotation)
    arguments = typing.get_args(annotation)
    if origin is Annotated:
        return _annotated(*arguments)
    if origin in (Union, types.UnionType):
        return _either(arguments)
    if isinstance(annotation, TypeVar) and annotation.__constraints__:
        return _either(annotation.__constraints__)
    if origin is Literal:
        is_literal_type = _is_a(str, int, bytes, type(None))
        return Kind(
            " or ".join(map(repr, arguments)),
            lambda value: is_literal_type(value) and value in arguments,
        )
    if origin is not None:
        return _generic(origin, arguments)
    if isinstance(annotation, type):
        return _kind_of_class(annotation)
    return Kind()


def _hints(thing: Any) -> dict[str, Any]:
    with suppress(NameError):  # a name that only its author's scope knows
        return typing.get_type_hints(thing, include_extras=True)
    return {}


def _numbers(**settings: Any) -> Kind:
    kind = _Numbers(**settings)
    shape = f" {kind.shape}" if kind.shape else ""
    content, _ = _OF_TYPE.get(kind.dtype, _REAL)
    return _Numbers(f"an array{shape} of {content}{kind.inside or ''}", **settings)


def _annotated(base: Any, *extras: object) -> Kind:
    kind = _kind_of(base)
    inside = next((extra for extra in extras if isinstance(extra, Range)), None)
    shape = next((extra for extra in extras if isinstance(extra, Shape)), None)
    if isinstance(kind, _Items) and shape is not None:
        return _numbers(shape=shape, inside=inside)
    if isinstance(kind, _Numbers):
        return _numbers(dtype=kind.dtype, plain=kind.plain, shape=shape, inside=inside)
    if isinstance(kind, (_Number, _Whole)):
        return type(kind)(f"{kind.allowed}{inside or ''}", inside=inside)
    return kind


def _either(arguments: tuple[Any, ...]) -> Kind:
    choices: list[Kind] = []
    if {Path, str} <= set(arguments):
        arguments = tuple(a for a in arguments if a not in (Path, str))
        choices.append(Kind(_PATH, _is_path(Path, str)))
    if (
        set(arguments) >= _ARRAY_LIKE
    ):  # a union of unions is flat: what numpy calls array-like has come apart
        arguments = tuple(a for a in arguments if a not in _ARRAY_LIKE)
        choices.append(_numbers())
    choices += map(_kind_of, arguments)
    if len(choices) == 1:
        return choices[0]
    return _Either(
        " or ".join(dict.fromkeys(kind.allowed for kind in choices)), kinds=tuple(choices)
    )


def _generic(origin: Any, arguments: tuple[Any, ...]) -> Kind:
    if origin is np.ndarray:
        (scalar, *_) = typing.get_args(arguments[1]) or (None,)
        return _numbers(dtype=scalar if isinstance(scalar, type) else None, plain=True)
    if origin is tuple and not (len(arguments) == 2 and arguments[1] is Ellipsis):
        kinds = tuple(map(_kind_of, arguments))
        return _Several(f"({', '.join(kind.allowed for kind in kinds)})", kinds=kinds)
    if origin is Callable:
        if isinstance(arguments[0], list):
            n = len(arguments[0])
        else:
            n = None
        return Kind(
            "a function" + ("" if n is None else f" of {n} arguments"),
            lambda value: _is_function(value, n),
        )
    if not isinstance(origin, type):
        return Kind()
    if issubclass(origin, Mapping):
        return _Table("a mapping", _is_a(Mapping), *map(_kind_of, arguments))
    if origin in (tuple, list, set, frozenset, Sequence, Iterable):
        kind = _kind_of(arguments[0])
        name = "sequence" if origin in (Sequence, Iterable) else origin.__name__
        if kind == Kind():
            each = ""
        else:
            each = f" of which each is {kind.allowed}"
        return _Items(f"a {name}{each}", holder=origin, kind=kind)
    if not is_dataclass(origin):
        return _kind_of_class(origin)
    # A generic dataclass, whose fields are what its parameters stand for.
    meant = dict(zip(origin.__parameters__, arguments, strict=True))  # type: ignore[attr-defined]
    parts = [
        (name, _kind_of(meant[hint])) for name, hint in _hints(origin).items() if hint in meant
    ]
    inner = " and ".join(f"`{name}` is {kind.allowed}" for name, kind in parts)
    return _Filled(f"a {origin.__name__} of which {inner}", _is_a(origin), tuple(parts))


def _is_function(value: Any, n_arguments: int | None) -> bool:
    """Return whether it can be called, with so many arguments as far as its signature can be
    read.
    """
    if not callable(value):
        return False
    try:
        inspect.signature(value).bind(*[None] * (n_arguments or 0))
    except TypeError:
        return n_arguments is None
    except ValueError:  # built in
        return True
    return True


def _kind_of_class(cls: type) -> Kind:
    if cls is np.ndarray:
        return _numbers(plain=True)
    if cls in (float, int):
        if cls is float:
            return _Number("a number")
        return _Whole("a whole number")
    if getattr(cls, "_is_protocol", False):
        parents = [base for base in cls.__mro__ if getattr(base, "_is_protocol", False)]
        members = dict.fromkeys(
            name for base in parents for name in (*vars(base), *inspect.get_annotations(base))
        )
        names = [name for name in members if not name.startswith("_") or name == "__call__"]
        return Kind(
            f"a value with the methods of {cls.__name__} ({', '.join(names)})",
            lambda value: (
                not isinstance(value, type) and all(hasattr(value, name) for name in names)
            ),
        )
    if issubclass(cls, Mapping):
        return _Table("a mapping", _is_a(Mapping))
    if cls is Callable:
        return Kind("a function", callable)
    if hasattr(
        cls, "homogeneous"
    ):  # the pose of Pinocchio, which whoever reads records or solves levels does without
        return _Pose(
            "a pinocchio.SE3 of finite numbers (uvms_ocp.pose_at makes one)",
            lambda value: isinstance(value, cls) and bool(np.isfinite(value.homogeneous).all()),
        )
    name = cls.__name__
    return Kind(
        {"str": "a string", "NoneType": "None"}.get(
            name, f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
        ),
        _is_a(cls),
    )
