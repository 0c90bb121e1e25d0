"""Read from annotations which kinds of argument a function takes."""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.argument_kinds import (
    CONTENT_BY_DTYPE,
    REAL_NUMBERS,
    Alternatives,
    ArrayKind,
    FixedTuple,
    GenericValue,
    Items,
    Kind,
    PoseKind,
    RealNumber,
    Table,
    WholeNumber,
)
from uvms_ocp.types import Range, Shape

_PATH = "a path without control characters"
_ARRAY_LIKE = frozenset(typing.get_args(ArrayLike))


def kinds_of(function: Callable[..., Any], owner: type | None = None) -> dict[str, Kind]:
    """Return the kind of each parameter, by name; `owner` is the class of which `function` is the
    constructor.
    """
    # Annotations of inherited fields are names of their own module, not of the constructor's.
    is_generated = function.__code__.co_filename == "<string>"
    hints = _hints(owner if owner is not None and is_generated else function)
    parameters = inspect.signature(function).parameters
    if owner is not None and not set(parameters) - {"self"} <= set(hints):
        hints |= _hints(function)
    return {name: _kind_of(hints[name]) for name in parameters if name in hints}


def _hints(thing: Any) -> dict[str, Any]:
    """Return the annotations of a class or function; none where one of them cannot be resolved."""
    with suppress(NameError):  # such as the name of a class inside a function
        return typing.get_type_hints(thing, include_extras=True)
    return {}


def _kind_of(annotation: Any) -> Kind:
    """Return the kind of value that an annotation allows; any value where nothing of it can be
    checked.
    """
    if annotation in _PLAIN_KINDS:
        return _PLAIN_KINDS[annotation]
    if annotation is ArrayLike:
        return _array_kind()
    origin = typing.get_origin(annotation)
    arguments = typing.get_args(annotation)
    if origin is Annotated:
        return _annotated(*arguments)
    if origin in (Union, types.UnionType):
        return _alternatives(arguments)
    if isinstance(annotation, TypeVar) and annotation.__constraints__:
        return _alternatives(annotation.__constraints__)
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


def _is_a(*classes: type) -> Callable[[Any], bool]:
    """Return a check for instances of classes."""
    return lambda value: isinstance(value, classes)


def _is_path(*classes: type) -> Callable[[Any], bool]:
    """Return a check for paths of classes, not empty and without control characters."""

    def is_path(value: Any) -> bool:
        if not isinstance(value, classes) or str(value) == "":
            return False
        return all(letter >= " " for letter in str(value))

    return is_path


_PLAIN_KINDS: dict[Any, Kind] = {
    bool: Kind("True or False", _is_a(bool, np.bool_)),
    Path: Kind(_PATH, _is_path(Path)),
    None: Kind("None", _is_a(type(None))),
    Any: Kind(),
}


def _array_kind(**settings: Any) -> ArrayKind:
    """Return the kind of an array, with words that describe it. settings: fields of `ArrayKind`."""
    kind = ArrayKind(**settings)
    shape = f" {kind.shape}" if kind.shape else ""
    content, _ = CONTENT_BY_DTYPE.get(kind.dtype, REAL_NUMBERS)
    return ArrayKind(f"an array{shape} of {content}{kind.inside or ''}", **settings)


def _annotated(base: Any, *extras: object) -> Kind:
    """Return the kind of an annotation with a `Range`, a `Shape` or both."""
    kind = _kind_of(base)
    inside = None
    shape = None
    for extra in reversed(extras):
        if isinstance(extra, Range):
            inside = extra
        if isinstance(extra, Shape):
            shape = extra
    if isinstance(kind, Items) and shape is not None:
        return _array_kind(shape=shape, inside=inside)
    if isinstance(kind, ArrayKind):
        return _array_kind(dtype=kind.dtype, plain=kind.plain, shape=shape, inside=inside)
    if isinstance(kind, (RealNumber, WholeNumber)):
        return type(kind)(f"{kind.allowed}{inside or ''}", inside=inside)
    return kind


def _alternatives(arguments: tuple[Any, ...]) -> Kind:
    """Return the kind of a union."""
    members = dict.fromkeys(arguments)
    choices: list[Kind] = []
    if {Path, str} <= members.keys():
        members = dict.fromkeys(member for member in members if member not in (Path, str))
        choices.append(Kind(_PATH, _is_path(Path, str)))
    # A union of unions is flat, so that the members of `ArrayLike` are among the others.
    if members.keys() >= _ARRAY_LIKE:
        members = dict.fromkeys(member for member in members if member not in _ARRAY_LIKE)
        choices.append(_array_kind())
    choices += map(_kind_of, members)
    if len(choices) == 1:
        return choices[0]
    words = dict.fromkeys(kind.allowed for kind in choices)
    return Alternatives(" or ".join(words), kinds=tuple(choices))


def _generic(origin: Any, arguments: tuple[Any, ...]) -> Kind:
    """Return the kind of a generic annotation, such as ``tuple[str, ...]``, from its origin and its
    arguments.
    """
    if origin is np.ndarray:
        scalar, *_ = typing.get_args(arguments[1]) or (None,)
        return _array_kind(dtype=scalar if isinstance(scalar, type) else None, plain=True)
    if origin is tuple and not (len(arguments) == 2 and arguments[1] is Ellipsis):
        kinds = tuple(map(_kind_of, arguments))
        words = ", ".join(kind.allowed for kind in kinds)
        return FixedTuple(f"({words})", kinds=kinds)
    if origin is Callable:
        return _function_kind(arguments[0])
    if not isinstance(origin, type):
        return Kind()
    if issubclass(origin, Mapping):
        return Table("a mapping", _is_a(Mapping), *map(_kind_of, arguments))
    if origin in (tuple, list, set, frozenset, Sequence, Iterable):
        name = "sequence" if origin in (Sequence, Iterable) else origin.__name__
        kind = _kind_of(arguments[0])
        if kind == Kind():
            return Items(f"a {name}", holder=origin, kind=kind)
        return Items(f"a {name} of which each is {kind.allowed}", holder=origin, kind=kind)
    if is_dataclass(origin):
        return _generic_dataclass(origin, arguments)
    return _kind_of_class(origin)


def _generic_dataclass(origin: Any, arguments: tuple[Any, ...]) -> Kind:
    """Return the kind of a generic dataclass, with the kinds of fields that its arguments give."""
    meanings = dict(zip(origin.__parameters__, arguments, strict=True))
    parts = []
    words = []
    for name, hint in _hints(origin).items():
        if hint in meanings:
            kind = _kind_of(meanings[hint])
            parts.append((name, kind))
            words.append(f"`{name}` is {kind.allowed}")
    allowed = f"a {origin.__name__} of which {' and '.join(words)}"
    return GenericValue(allowed, _is_a(origin), tuple(parts))


def _function_kind(parameters: Any) -> Kind:
    """Return the kind of a function; parameters: a list of their annotations, or `...`."""
    if not isinstance(parameters, list):
        return Kind("a function", lambda value: _is_function(value, None))
    n = len(parameters)
    return Kind(f"a function of {n} arguments", lambda value: _is_function(value, n))


def _is_function(value: Any, n_arguments: int | None) -> bool:
    """Check for a function, which takes so many arguments if its signature can be read; `None`: any
    number.
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
    """Return the kind of the instances of a class."""
    if cls is np.ndarray:
        return _array_kind(plain=True)
    if cls is float:
        return RealNumber("a number")
    if cls is int:
        return WholeNumber("a whole number")
    if getattr(cls, "_is_protocol", False):
        return _protocol_kind(cls)
    if issubclass(cls, Mapping):
        return Table("a mapping", _is_a(Mapping))
    if cls is Callable:
        return Kind("a function", callable)
    # `pinocchio.SE3`, recognised without importing Pinocchio, which readers of records do not need.
    if hasattr(cls, "homogeneous"):
        return PoseKind(
            "a pinocchio.SE3 of finite numbers (uvms_ocp.pose_at makes one)",
            lambda value: isinstance(value, cls) and bool(np.isfinite(value.homogeneous).all()),
        )
    name = cls.__name__
    article = "an" if name[0] in "AEIOU" else "a"
    words = {"str": "a string", "NoneType": "None"}
    return Kind(words.get(name, f"{article} {name}"), _is_a(cls))


def _protocol_kind(cls: type) -> Kind:
    """Return the kind of a value with the members of a protocol."""
    members = dict[str, None]()
    for base in cls.__mro__:
        if getattr(base, "_is_protocol", False):
            members |= dict.fromkeys([*vars(base), *inspect.get_annotations(base)])
    names = [name for name in members if not name.startswith("_") or name == "__call__"]

    def has_members(value: Any) -> bool:
        return not isinstance(value, type) and all(hasattr(value, name) for name in names)

    return Kind(f"a value with the methods of {cls.__name__} ({', '.join(names)})", has_members)
