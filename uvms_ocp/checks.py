"""Check arguments by the annotations of their functions, before the call or once it has failed, or leave the check out."""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache, wraps
from pathlib import Path
from types import MethodType
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp import argument_kinds
from uvms_ocp.errors import ArgumentNotFound, InvalidInput, UvmsError
from uvms_ocp.types import Range, Shape

# From an annotation to the kind of value that it allows.

_ARRAY_LIKE = frozenset(typing.get_args(ArrayLike))
_PLAIN_KINDS: dict[Any, argument_kinds.Kind] = {
    bool: argument_kinds.Boolean(),
    Path: argument_kinds.FilePath(),
    None: argument_kinds.Instance(type(None)),
    Any: argument_kinds.Kind(),
}


def kinds_of(function: Callable[..., Any], owner: type | None = None) -> dict[str, argument_kinds.Kind]:
    """Return the kind of each parameter, by name; `owner` is the class of which `function` is the constructor."""
    # The annotations of fields that are inherited are read where they stand, not where the constructor was made.
    generated = function.__code__.co_filename == "<string>"
    hints = _hints(owner if owner is not None and generated else function)
    kinds = {name: kind_of(hint) for name, hint in hints.items() if name != "return"}
    own = inspect.signature(function).parameters
    if owner is not None and not set(own) - {"self"} <= set(kinds):
        kinds |= {name: kind_of(hint) for name, hint in _hints(function).items() if name != "return"}
    return {name: kinds[name] for name in own if name in kinds}


def kind_of(annotation: Any) -> argument_kinds.Kind:
    """Return the kind of value that this annotation allows; anything, where the annotation says nothing that can be checked."""
    if annotation in _PLAIN_KINDS:
        return _PLAIN_KINDS[annotation]
    if annotation is ArrayLike:
        return argument_kinds.Numbers()
    origin = typing.get_origin(annotation)
    if origin is Annotated:
        return _annotated(*typing.get_args(annotation))
    if origin in (Union, types.UnionType):
        return _either(typing.get_args(annotation))
    if isinstance(annotation, TypeVar) and annotation.__constraints__:
        return _either(annotation.__constraints__)
    if origin is Literal:
        return argument_kinds.Choice(typing.get_args(annotation))
    if origin is not None:
        return _generic(origin, typing.get_args(annotation))
    return _kind_of_class(annotation) if isinstance(annotation, type) else argument_kinds.Kind()


def _hints(thing: Any) -> dict[str, Any]:
    try:
        return typing.get_type_hints(thing, include_extras=True)
    except NameError:  # a name that only its author's scope knows
        return {}


def _annotated(base: Any, *extras: object) -> argument_kinds.Kind:
    kind = kind_of(base)
    inside = next((extra for extra in extras if isinstance(extra, Range)), None)
    shape = next((extra for extra in extras if isinstance(extra, Shape)), None)
    if isinstance(kind, argument_kinds.Items) and shape is not None:
        kind = argument_kinds.Numbers()
    if isinstance(kind, argument_kinds.Numbers):
        return argument_kinds.Numbers(dtype=kind.dtype, plain=kind.plain, shape=shape, inside=inside)
    if isinstance(kind, argument_kinds.Number):
        return argument_kinds.Number(inside=inside)
    return argument_kinds.Whole(inside=inside) if isinstance(kind, argument_kinds.Whole) else kind


def _either(arguments: tuple[Any, ...]) -> argument_kinds.Kind:
    found: list[argument_kinds.Kind] = []
    if {Path, str} <= set(arguments):
        arguments = tuple(a for a in arguments if a not in (Path, str))
        found.append(argument_kinds.FilePath(text=True))
    if set(arguments) >= _ARRAY_LIKE:  # a union of unions is flat: what numpy calls array-like has come apart
        arguments = tuple(a for a in arguments if a not in _ARRAY_LIKE)
        found.append(argument_kinds.Numbers())
    found += [kind_of(argument) for argument in arguments]
    return found[0] if len(found) == 1 else argument_kinds.Either(tuple(found))


def _generic(origin: Any, arguments: tuple[Any, ...]) -> argument_kinds.Kind:
    if origin is np.ndarray:
        return argument_kinds.Numbers(dtype=_dtype(arguments), plain=True)
    if origin is tuple and not (len(arguments) == 2 and arguments[1] is Ellipsis):
        return argument_kinds.Several(tuple(map(kind_of, arguments)))
    if origin is Callable:
        return argument_kinds.Function(len(arguments[0]) if isinstance(arguments[0], list) else None)
    if not isinstance(origin, type):
        return argument_kinds.Kind()
    if issubclass(origin, Mapping):
        return argument_kinds.Table(kind_of(arguments[0]), kind_of(arguments[1]))
    if issubclass(origin, Iterable) and origin in (tuple, list, set, frozenset, Sequence, Iterable):
        return argument_kinds.Items(origin, kind_of(arguments[0]))
    return _filled(origin, arguments) if is_dataclass(origin) else _kind_of_class(origin)


def _filled(cls: type, arguments: tuple[Any, ...]) -> argument_kinds.Kind:
    """A generic dataclass, whose fields are what its parameters stand for."""
    meant = dict(zip(cls.__parameters__, arguments, strict=True))  # type: ignore[attr-defined]
    parts = [(name, kind_of(meant[hint])) for name, hint in _hints(cls).items() if hint in meant]
    return argument_kinds.Filled(cls, tuple(parts))


def _dtype(arguments: tuple[Any, ...]) -> type | None:
    scalar = typing.get_args(arguments[1])
    return scalar[0] if scalar and isinstance(scalar[0], type) else None


def _kind_of_class(cls: type) -> argument_kinds.Kind:
    if cls is np.ndarray:
        return argument_kinds.Numbers(plain=True)
    if issubclass(cls, (float, int)) and cls in (float, int):
        return argument_kinds.Number() if cls is float else argument_kinds.Whole()
    if getattr(cls, "_is_protocol", False):
        return argument_kinds.ProtocolKind(cls, _methods(cls))
    if issubclass(cls, Mapping):
        return argument_kinds.Table(argument_kinds.Kind(), argument_kinds.Kind())
    if cls is Callable:
        return argument_kinds.Function()
    # The pose of Pinocchio, which whoever reads records or solves levels does without.
    return argument_kinds.Pose(cls) if hasattr(cls, "homogeneous") else argument_kinds.Instance(cls)


def _methods(protocol: type) -> tuple[str, ...]:
    parents = [base for base in protocol.__mro__ if getattr(base, "_is_protocol", False)]
    names = (name for base in parents for name in (*vars(base), *inspect.get_annotations(base)))
    return tuple(dict.fromkeys(name for name in names if not name.startswith("_") or name == "__call__"))


# Decorators that name a wrong argument at the call that took it.

_T = TypeVar("_T", bound=Callable[..., Any])
_LATE = "_arguments_late"


def checked(thing: _T) -> _T:
    """A function or class whose arguments are looked at before every call: of a class, constructor and public methods.

    A frozen dataclass keeps copies of arrays and mappings that can no longer be written to. A function gets an array where
    its annotation asks for one. Wrong arguments raise `InvalidInput`, in one line that names the argument, and a name that
    no argument has `ArgumentNotFound`, with the nearest.
    """
    return _checked_class(thing, late_all=False) if isinstance(thing, type) else _before(thing, None)


def checked_on_failure(thing: _T) -> _T:
    """A function or class whose arguments are looked at only once a call has failed, for what runs at every tick.

    Of numbers, words and arrays the class is looked at before the call, with the range of numbers and the axes of arrays.
    A right call costs a fraction of a microsecond more: leave values that refuse nothing as they are. Where no argument is
    wrong the failure is passed on as it is. On a method of a `checked` class it makes this method late.
    """
    if isinstance(thing, type):
        return _checked_class(thing, late_all=True)
    setattr(thing, _LATE, True)
    return thing if _is_method(thing) else _after(thing, None)


def _is_method(function: Callable[..., Any]) -> bool:
    return "." in function.__qualname__.rpartition("<locals>.")[2]


def _checked_class(cls: Any, *, late_all: bool) -> Any:
    for name, member in list(vars(cls).items()):
        if name.startswith("_") and name not in ("__init__", "__call__", "__getitem__"):
            continue
        kind = type(member) if isinstance(member, (staticmethod, classmethod)) else None
        function = member.__func__ if kind else member
        if inspect.isfunction(function) and _takes_arguments(function):
            after = late_all or getattr(function, _LATE, False)
            wrapped = (_after if after else _before)(function, cls)
            setattr(cls, name, kind(wrapped) if kind else wrapped)
    return cls


def _takes_arguments(function: Callable[..., Any]) -> bool:
    code = function.__code__
    return bool(set(code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]) - {"self", "cls"}) or _extra(
        function
    )


def _extra(function: Callable[..., Any]) -> bool:
    return bool(function.__code__.co_flags & (inspect.CO_VARARGS | inspect.CO_VARKEYWORDS))


class _Arguments:
    """Kinds of the arguments of one function, read from its annotations when first needed."""

    __slots__ = (
        "_converting",
        "_defaults",
        "_function",
        "_kinds",
        "_names",
        "_owner",
        "_positional",
        "_shaped",
        "title",
    )

    def __init__(self, function: Callable[..., Any], owner: type | None) -> None:
        self._function, self._owner = function, owner
        constructor = owner is not None and function.__name__ == "__init__"
        self.title = owner.__name__ if constructor and owner else function.__qualname__
        self._positional: tuple[tuple[str, argument_kinds.Kind], ...] = ()
        self._kinds: dict[str, argument_kinds.Kind] | None = None
        self._names: frozenset[str] | None = None  # that may be given; any where there is **
        self._defaults: dict[str, Any] = {}
        self._converting: frozenset[str] = frozenset()
        self._shaped: frozenset[str] = frozenset()

    def _of(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> list[tuple[str, argument_kinds.Kind, Any]]:
        """Name, kind and value of each argument that is given and annotated."""
        if self._kinds is None:
            self._read()
        found = [(name, kind, value) for (name, kind), value in zip(self._positional, args, strict=False)]
        kinds = self._kinds or {}
        return found + [(name, kinds[name], value) for name, value in kwargs.items() if name in kinds]

    def check(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> list[tuple[str, argument_kinds.Kind, Any]]:
        """The arguments, as `_of` gives them, if one of them has to be converted.

        Raises `InvalidInput` for a wrong one, and `ArgumentNotFound` for a name that none has.
        """
        converts, shaped, given = False, False, self._of(args, kwargs)
        if self._names is not None and not kwargs.keys() <= self._names:
            unknown = next(name for name in kwargs if name not in self._names)
            raise ArgumentNotFound(self.title, unknown, [name for name in self._defaults if name != "self"])
        for name, kind, value in given:
            if not kind.holds(value) and value is not self._defaults.get(name, _ANYTHING):
                raise InvalidInput(f"{self.title}: {_one_line(kind.wrong(name, value))}")
            converts, shaped = converts or name in self._converting, shaped or name in self._shaped
        if shaped:
            self._check_shapes(given)
        return given if converts else []

    def _check_shapes(self, given: list[tuple[str, argument_kinds.Kind, Any]]) -> None:
        lengths: dict[str, Any] = {name: value for name, _, value in given}
        givers: dict[str, str] = {}
        for name, kind, value in given:
            shape = kind.shape_of(value) if name in self._shaped else None
            if shape is not None:
                exact = shape.among(lengths)
                if not exact.holds(value):
                    others = dict.fromkeys(givers[length] for length in shape.names if length in givers)
                    fits = f" to go with {' and '.join(others)}" if others else ""
                    raise InvalidInput(f"{self.title}: {name} has shape {np.shape(value)}; give {exact}{fits}")
                lengths |= exact.named(value)
                givers |= dict.fromkeys(exact.named(value), name)

    def _read(self) -> None:
        constructor = self._owner if self._function.__name__ == "__init__" else None
        kinds = kinds_of(self._function, constructor)
        parameters = inspect.signature(self._function).parameters
        self._defaults = {name: parameter.default for name, parameter in parameters.items()}
        by_place = [name for name, p in parameters.items() if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
        self._positional = tuple((name, kinds.get(name, _ANYTHING)) for name in by_place)
        self._kinds = {name: kinds[name] for name, p in parameters.items() if name in kinds and p.kind not in _STARRED}
        if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
            self._names = frozenset(name for name, p in parameters.items() if p.kind is not p.VAR_POSITIONAL)
        self._converting = frozenset(name for name, kind in kinds.items() if kind.converts)
        self._shaped = frozenset(name for name, kind in kinds.items() if kind.shaped)


_STARRED = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
_ANYTHING = argument_kinds.Kind()


def _before(function: Any, owner: type | None) -> Any:
    arguments = _Arguments(function, owner)
    keeps = function.__name__ == "__init__" and owner is not None and _is_frozen(owner)

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        given = arguments.check(args, kwargs)
        if given:
            args, kwargs = _converted(given, args, kwargs, keeps)
        return function(*args, **kwargs)

    return call


def _after(function: Any, owner: type | None) -> Any:
    arguments = _Arguments(function, owner)

    def explain(*args: Any, **kwargs: Any) -> None:
        arguments.check(args, kwargs)

    # Written out with the parameters of the function, it costs a tenth of what *args and **kwargs do.
    # A constructor says best itself what is wrong; what a method passes on names the arguments of another call.
    passed_on = UvmsError if function.__name__ == "__init__" else ()
    declared, passed, defaults = parameters_of(function)
    space = {"_function": function, "_explain": explain, "_passed_on": passed_on, **defaults, **_CLASSES}
    exec(_AFTER.format(declared=declared, passed=passed, doubt=_doubt(function)), space)
    return wraps(function)(space["_call"])


def _doubt(function: Callable[..., Any]) -> str:
    """Source that is true where a plain argument may be wrong: a call that does not read one would not fail."""
    doubts = []
    for name, word in function.__annotations__.items():
        plain, extras = _plain(word, function.__globals__) if isinstance(word, str) and name != "return" else ("", ())
        if plain in _CHECKED_BY_CLASS:
            # The one class that is nearly always found is asked for by itself: that takes half the time.
            doubts.append(
                f"(type({name}) is not {_CHECKED_BY_CLASS[plain]} and type({name}) not in {_CHECKED_BY_CLASS[plain]}s)"
            )
            kind = Shape if plain == "np.ndarray" else Range
            doubts += [extra.doubt(name) for extra in extras if isinstance(extra, kind)]
    return " or ".join(doubts) or "False"


def _plain(word: str, scope: dict[str, Any]) -> tuple[str, tuple[Any, ...]]:
    """The class that an annotation names, and what it says beyond that where it is, or stands for, an `Annotated`."""
    thing = eval(word, scope) if word.startswith("Annotated[") and word.endswith("]") else scope.get(word)
    if get_origin(thing) is not Annotated:
        return word, ()
    base, *extras = get_args(thing)
    base = get_origin(base) or base
    return "np.ndarray" if base is np.ndarray else getattr(base, "__name__", ""), tuple(extras)


_CHECKED_BY_CLASS = {"bool": "_bool", "int": "_int", "float": "_float", "str": "_str", "np.ndarray": "_array"}
"""Annotations that are checked by class, and what `_CLASSES` calls the class; with an s, all that will do."""
_CLASSES: dict[str, Any] = {
    "_inf": np.inf,
    "_bool": bool,
    "_bools": (bool, np.bool_),
    "_int": int,
    "_ints": (int, np.int64, np.int32),
    "_float": float,
    "_floats": (float, int, np.float64, np.int64),
    "_str": str,
    "_strs": (str,),
    "_array": np.ndarray,
    "_arrays": (np.ndarray,),
}
_AFTER = """
def _call({declared}):
    if {doubt}:
        _explain({passed})
    try:
        return _function({passed})
    except _passed_on:
        raise
    except Exception:
        _explain({passed})
        raise
"""


_MARKS: dict[Any, str] = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}


def parameters_of(function: Callable[..., Any]) -> tuple[str, str, dict[str, Any]]:
    """The parameters of a function as they are declared and as they are passed on, and their defaults."""
    declared, passed, defaults, starred = [], [], {}, False
    for name, parameter in inspect.signature(function).parameters.items():
        by_name = parameter.kind is parameter.KEYWORD_ONLY
        mark = _MARKS.get(parameter.kind, "")
        if by_name and not starred:
            declared.append("*")
        starred = starred or by_name or mark == "*"
        default = "" if parameter.default is parameter.empty else f"_default_{name}"
        if default:
            defaults[default] = parameter.default
        declared.append(f"{mark}{name}" + (f"={default}" if default else ""))
        passed.append(f"{name}={name}" if by_name else f"{mark}{name}")
    return ", ".join(declared), ", ".join(passed), defaults


def _converted(
    given: Iterable[tuple[str, argument_kinds.Kind, Any]], args: tuple[Any, ...], kwargs: dict[str, Any], keeps: bool
) -> tuple[tuple[Any, ...], dict[str, Any]]:
    values = [(name, kind.kept(value) if keeps else kind.taken(value)) for name, kind, value in given]
    n_named = sum(name in kwargs for name, _ in values)
    first = tuple(value for _, value in values[: len(values) - n_named])
    return first + args[len(first) :], kwargs | dict(values[len(first) :])


def _is_frozen(cls: type) -> bool:
    return bool(getattr(getattr(cls, "__dataclass_params__", None), "frozen", False))


def _one_line(wrong: argument_kinds.Violation) -> str:
    return " ".join(str(wrong).split())


# Frozen values made without a look at their arguments, for what runs at every tick.

_P = ParamSpec("_P")
_V = TypeVar("_V")
_MADE = """
def _made({declared}):
    _self = _new(_cls)
    _unchecked(_self, {passed})
    return _self
"""
_CHANGED = """
def _changed(_value, _changes):
    if not _changes.keys() <= _names:
        raise TypeError(f"{{type(_value).__name__}} has no field {{', '.join(_changes.keys() - _names)}}")
    return _made({kept})
"""
_FILLED = """
def _made({declared}):
    _self = _new(_Open)
{lines}
    _self.__class__ = _cls
    return _self
"""


def unchecked_constructor(cls: Callable[_P, _V]) -> Callable[_P, _V]:
    """The constructor of a `checked` class without the check, for who makes a value at every tick of what is known to fit.

    Nothing is copied: the arrays belong to the value from then on.
    """
    unchecked = _unchecked(cls)
    declared, passed, defaults = parameters_of(unchecked)
    space = {"_new": object.__new__, "_cls": cls, "_unchecked": unchecked, **defaults}
    fields_declared, fields_passed = declared.removeprefix("self, "), passed.removeprefix("self, ")
    if _is_plain(cls):
        space |= {"_Open": _open(cls)} | {f"_make_{f.name}": f.default_factory for f in fields(cls)}  # type: ignore[arg-type]
        lines = [f"    _self.{f.name} = {_field(f)}" for f in fields(cls)]  # type: ignore[arg-type]
        exec(_FILLED.format(declared=fields_declared, lines="\n".join(lines)), space)
    else:
        exec(_MADE.format(declared=fields_declared, passed=fields_passed), space)
    return space["_made"]


def _is_plain(cls: Any) -> bool:
    """Return whether the constructor does nothing but store its arguments in slots."""
    slots = is_dataclass(cls) and "__slots__" in vars(cls)
    return slots and not hasattr(cls, "__post_init__") and all(f.init for f in fields(cls))


def _open(cls: Any) -> type:
    """The class as one whose fields can be written to: a third of the time that a frozen constructor takes."""
    writable = {"__slots__": (), "__setattr__": object.__setattr__, "__delattr__": object.__delattr__}
    return type(cls)(f"_Open{cls.__name__}", (cls,), writable)


def _field(f: Field[Any]) -> str:
    """Source of its value."""
    name = f.name
    return name if f.default_factory is MISSING else f"_make_{name}() if {name} is _default_{name} else {name}"


def replace_unchecked(value: _V, /, **changes: Any) -> _V:
    """A frozen value with other values of some fields, as `dataclasses.replace`, but made as by `trusted`."""
    return _changing(type(value))(value, changes)  # type: ignore[arg-type]


@cache
def _changing(cls: Any) -> Callable[[Any, Mapping[str, Any]], Any]:
    """`changed` of one class."""
    names, made = [f.name for f in fields(cls) if f.init], unchecked_constructor(cls)
    kept = ", ".join(f"{name}=_changes.get({name!r}, _value.{name})" for name in names)
    space = {"_made": made, "_names": frozenset(names)}
    exec(_CHANGED.format(kept=kept), space)
    return space["_changed"]  # type: ignore[return-value]


def unchecked_method(method: Callable[_P, _V]) -> Callable[_P, _V]:
    """A method of a value without the look at its arguments, for a loop whose caller has been looked at."""
    bare = getattr(method, "__wrapped__", None)
    return method if bare is None else MethodType(bare, method.__self__)  # type: ignore[attr-defined]


def _unchecked(cls: Any) -> Callable[..., None]:
    return getattr(cls.__init__, "__wrapped__", cls.__init__)
