"""From an annotation to the kind of value that it allows."""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments.containers import Choice, Duck, Either, Filled, Function, Items, Several, Subclass, Table
from uvms_ocp.arguments.extents import Range, Shape
from uvms_ocp.arguments.kinds import (
    Boolean,
    FilePath,
    Instance,
    Kind,
    Number,
    Numbers,
    Pose,
    Whole,
)

_ARRAY_LIKE = frozenset(typing.get_args(ArrayLike))
_PLAIN: dict[Any, Kind] = {bool: Boolean(), Path: FilePath(), None: Instance(type(None)), Any: Kind()}


def kinds_of(function: Callable[..., Any], owner: type | None = None) -> dict[str, Kind]:
    """By the name of each parameter, what it may be; `owner` is the class of which `function` is the constructor."""
    # The annotations of fields that are inherited are read where they stand, not where the constructor was made.
    generated = function.__code__.co_filename == "<string>"
    hints = _hints(owner if owner is not None and generated else function)
    kinds = {name: kind_of(hint) for name, hint in hints.items() if name != "return"}
    own = inspect.signature(function).parameters
    if owner is not None and not set(own) - {"self"} <= set(kinds):
        kinds |= {name: kind_of(hint) for name, hint in _hints(function).items() if name != "return"}
    return {name: kinds[name] for name in own if name in kinds}


def kind_of(annotation: Any) -> Kind:
    """What a value of this annotation may be; anything, where the annotation says nothing that can be checked."""
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    if annotation is ArrayLike:
        return Numbers()
    origin = typing.get_origin(annotation)
    if origin is Annotated:
        return _annotated(*typing.get_args(annotation))
    if origin in (Union, types.UnionType):
        return _either(typing.get_args(annotation))
    if isinstance(annotation, TypeVar) and annotation.__constraints__:
        return _either(annotation.__constraints__)
    if origin is Literal:
        return Choice(typing.get_args(annotation))
    if origin is not None:
        return _generic(origin, typing.get_args(annotation))
    return _class(annotation) if isinstance(annotation, type) else Kind()


def _hints(thing: Any) -> dict[str, Any]:
    try:
        return typing.get_type_hints(thing, include_extras=True)
    except NameError:  # a name that only its author's scope knows
        return {}


def _annotated(base: Any, *extras: object) -> Kind:
    kind = kind_of(base)
    inside = next((extra for extra in extras if isinstance(extra, Range)), None)
    shape = next((extra for extra in extras if isinstance(extra, Shape)), None)
    if isinstance(kind, Items) and shape is not None:
        kind = Numbers()
    if isinstance(kind, Numbers):
        return Numbers(dtype=kind.dtype, plain=kind.plain, shape=shape, inside=inside)
    if isinstance(kind, Number):
        return Number(inside=inside)
    return Whole(inside=inside) if isinstance(kind, Whole) else kind


def _either(arguments: tuple[Any, ...]) -> Kind:
    found: list[Kind] = []
    if {Path, str} <= set(arguments):
        arguments = tuple(a for a in arguments if a not in (Path, str))
        found.append(FilePath(text=True))
    if set(arguments) >= _ARRAY_LIKE:  # a union of unions is flat: what numpy calls array-like has come apart
        arguments = tuple(a for a in arguments if a not in _ARRAY_LIKE)
        found.append(Numbers())
    found += [kind_of(argument) for argument in arguments]
    return found[0] if len(found) == 1 else Either(tuple(found))


def _generic(origin: Any, arguments: tuple[Any, ...]) -> Kind:
    if origin is np.ndarray:
        return Numbers(dtype=_dtype(arguments), plain=True)
    if origin is tuple and not (len(arguments) == 2 and arguments[1] is Ellipsis):
        return Several(tuple(map(kind_of, arguments)))
    if origin is type:
        return Subclass(arguments[0]) if isinstance(arguments[0], type) else Kind()
    if origin is Callable:
        return Function(len(arguments[0]) if isinstance(arguments[0], list) else None)
    if not isinstance(origin, type):
        return Kind()
    if issubclass(origin, Mapping):
        return Table(kind_of(arguments[0]), kind_of(arguments[1]))
    if issubclass(origin, Iterable) and origin in (tuple, list, set, frozenset, Sequence, Iterable):
        return Items(origin, kind_of(arguments[0]))
    return _filled(origin, arguments) if is_dataclass(origin) else _class(origin)


def _filled(cls: type, arguments: tuple[Any, ...]) -> Kind:
    """A generic dataclass, whose fields are what its parameters stand for."""
    meant = dict(zip(cls.__parameters__, arguments, strict=True))  # type: ignore[attr-defined]
    parts = [(name, kind_of(meant[hint])) for name, hint in _hints(cls).items() if hint in meant]
    return Filled(cls, tuple(parts))


def _dtype(arguments: tuple[Any, ...]) -> type | None:
    scalar = typing.get_args(arguments[1])
    return scalar[0] if scalar and isinstance(scalar[0], type) else None


def _class(cls: type) -> Kind:
    if cls is np.ndarray:
        return Numbers(plain=True)
    if issubclass(cls, (float, int)) and cls in (float, int):
        return Number() if cls is float else Whole()
    if getattr(cls, "_is_protocol", False):
        return Duck(cls, _methods(cls))
    if issubclass(cls, Mapping):
        return Table(Kind(), Kind())
    if cls is Callable:
        return Function()
    # The pose of Pinocchio, which whoever reads records or solves levels does without.
    return Pose(cls) if hasattr(cls, "homogeneous") else Instance(cls)


def _methods(protocol: type) -> tuple[str, ...]:
    parents = [base for base in protocol.__mro__ if getattr(base, "_is_protocol", False)]
    names = (name for base in parents for name in (*vars(base), *inspect.get_annotations(base)))
    return tuple(dict.fromkeys(name for name in names if not name.startswith("_") or name == "__call__"))
