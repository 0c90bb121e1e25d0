"""Check arguments by the annotations of their functions, before the call or once it has failed, or
leave the check out.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import cache, cached_property, wraps
from types import MethodType
from typing import Annotated, Any, ParamSpec, TypeVar, dataclass_transform, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.argument_kinds import Kind, kinds_of
from uvms_ocp.errors import ArgumentNotFound, InvalidInput, UvmsError, short
from uvms_ocp.types import Range, Shape

_T = TypeVar("_T", bound=Callable[..., Any])
_LATE = "_arguments_late"
_NAMING = (("name", ""), ("to", "to "))
"""Arguments of constructors that name the value, and the word before each."""

_CHECKED_BY_CLASS: dict[str, tuple[str, tuple[type, ...]]] = {
    "bool": ("_bool", (bool, np.bool_)),
    "int": ("_int", (int, np.int64, np.int32)),
    "float": ("_float", (float, int, np.float64, np.int64)),
    "str": ("_str", (str,)),
    "np.ndarray": ("_array", (np.ndarray,)),
}
"""Annotations that are checked by class: what sources call the usual class, and with an s all that
will do.
"""
_CLASSES: dict[str, Any] = {"_inf": np.inf}

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

_MARKS: dict[Any, str] = {
    inspect.Parameter.VAR_POSITIONAL: "*",
    inspect.Parameter.VAR_KEYWORD: "**",
}

_P = ParamSpec("_P")
_V = TypeVar("_V")
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


# Numbers that are given, as arrays.


def finite_array(what: str, values: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Return numbers of a shape [any] as an array that nobody can write to; `what` names them.

    Raises `InvalidInput` for another shape, NaN or infinity.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InvalidInput(
            f"{what}: given {short(values)}; allowed: finite numbers of shape {shape}"
        ) from None
    if array.shape != shape:
        raise InvalidInput(f"{what} has shape {array.shape}; allowed: {shape}, finite numbers")
    if not np.isfinite(array).all():
        where = np.flatnonzero(~np.isfinite(array)).tolist()
        raise InvalidInput(
            f"{what} has NaN or infinite entries at {where}; allowed: finite numbers"
        )
    array.flags.writeable = False
    return array


# Decorators that name a wrong argument at the call that took it.


def checked(thing: _T) -> _T:
    """A function or class whose arguments are looked at before every call: of a class, constructor
    and public methods.

    A frozen dataclass keeps copies of arrays and mappings that can no longer be written to. A
    function gets an array where its annotation asks for one. Wrong arguments raise `InvalidInput`,
    in one line that names the argument, and of a constructor the value, by its argument `name` or
    `to`; a name that no argument has raises `ArgumentNotFound`, with the nearest.
    """
    if isinstance(thing, type):
        return _checked_class(thing)
    return _before(thing, None)


def checked_on_failure(thing: _T) -> _T:
    """A function or class whose arguments are looked at only once a call has failed, for what runs
    at every tick.

    Of numbers, words and arrays the class is looked at before the call, with the range of numbers
    and the axes of arrays. A right call costs a fraction of a microsecond more: leave values that
    refuse nothing as they are. Where no argument is wrong the failure is passed on as it is. On a
    method of a `checked` class it makes this method late, and what overrides it.
    """
    if isinstance(thing, type):
        return _checked_class(thing, late_constructor=True, late_methods=True)
    setattr(thing, _LATE, True)
    return (
        thing if "." in thing.__qualname__.rpartition("<locals>.")[2] else _after(thing, None)
    )  # a method


def checked_constructor(cls: _T) -> _T:
    """A class whose constructor is `checked` and whose methods, which run at every tick, are
    `checked_on_failure`.
    """
    return _checked_class(cls, late_methods=True)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(field,))
def checked_dataclass(check: Callable[[Any], Any] = checked, **options: bool) -> Callable[[_T], _T]:
    """Make a frozen dataclass, keyword-only and with slots but where `options` of `dataclass` say
    otherwise.

    check: its decorator, another one where its methods or all of it are looked at late.
    """
    shape: Any = dataclass(**{"frozen": True, "kw_only": True, "slots": True, **options})
    return lambda cls: check(shape(cls))


def _checked_class(cls: Any, *, late_constructor: bool = False, late_methods: bool = False) -> Any:
    for name, member in list(vars(cls).items()):
        if name.startswith("_") and name not in ("__init__", "__call__", "__getitem__"):
            continue
        if isinstance(member, (staticmethod, classmethod)):
            kind = type(member)
        else:
            kind = None
        function = member.__func__ if kind else member
        if inspect.isfunction(function) and _takes_arguments(function):
            late = late_methods or any(
                getattr(method, _LATE, False)
                for method in (function, getattr(super(cls, cls), name, None))
            )
            after = late_constructor if name == "__init__" else late
            wrapped = (_after if after else _before)(function, cls)
            setattr(cls, name, kind(wrapped) if kind else wrapped)
    return cls


def _takes_arguments(function: Callable[..., Any]) -> bool:
    code = function.__code__
    named = set(code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]) - {"self", "cls"}
    return bool(named or code.co_flags & (inspect.CO_VARARGS | inspect.CO_VARKEYWORDS))


class _Arguments:
    """The arguments of one function: their kinds are read from its annotations when first
    needed.
    """

    def __init__(self, function: Callable[..., Any], owner: type | None) -> None:
        self._function = function
        constructor = owner is not None and function.__name__ == "__init__"
        self._class = owner if constructor else None
        self.title = self._class.__name__ if self._class else function.__qualname__

    @cached_property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        return inspect.signature(self._function).parameters

    @cached_property
    def _by_place(self) -> tuple[str, ...]:
        return tuple(
            n
            for n, p in self._parameters.items()
            if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)
        )

    @cached_property
    def _kinds(self) -> dict[str, Kind]:
        starred = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        kinds = kinds_of(self._function, self._class)
        return {
            name: kind for name, kind in kinds.items() if self._parameters[name].kind not in starred
        }

    @cached_property
    def _names(self) -> Mapping[str, Any] | None:
        """Defaults of what may be given by name; any may where there is **."""
        parameters = self._parameters.values()
        if any(p.kind is p.VAR_KEYWORD for p in parameters):
            return None
        return {p.name: p.default for p in parameters if p.kind is not p.VAR_POSITIONAL}

    @cached_property
    def _shaped(self) -> tuple[str, ...]:
        return tuple(name for name, kind in self._kinds.items() if kind.shape)

    @cached_property
    def _converting(self) -> frozenset[str]:
        return frozenset(name for name, kind in self._kinds.items() if kind.converts)

    def check(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        """Raise `InvalidInput` for a wrong argument, and `ArgumentNotFound` for a name that none
        has.
        """
        if self._names is not None and not kwargs.keys() <= self._names.keys():
            unknown = next(name for name in kwargs if name not in self._names)
            raise ArgumentNotFound(
                self.title, unknown, [name for name in self._names if name != "self"]
            )
        arguments = dict(zip(self._by_place, args, strict=False)) | kwargs
        for name, value in arguments.items():
            kind = self._kinds.get(name)
            if (
                kind is not None
                and not kind.holds(value)
                and value is not self._parameters[name].default
            ):
                place, problem, allowed = kind.wrong(name, value)
                raise InvalidInput(
                    f"{self._called(arguments)}: {' '.join(f'{place} {problem}; give {allowed}'.split())}"
                )
        if self._shaped:
            self._check_shapes(arguments)

    def _called(self, arguments: Mapping[str, Any]) -> str:
        """The title, of a constructor with the name that it was given: ``Phase 'A'``, ``Transition
        to 'B'``.
        """
        names = [
            f" {word}{short(arguments[key])}"
            for key, word in _NAMING
            if isinstance(arguments.get(key), str)
        ]
        return "".join([self.title, *names[:1]] if self._class else [self.title])

    def _check_shapes(self, arguments: Mapping[str, Any]) -> None:
        lengths = dict(arguments)
        givers = dict[str, str]()
        for name, value in arguments.items():
            if name in self._shaped:
                shape = self._kinds[name].among(value).shape
            else:
                shape = None
            if shape is not None:
                exact = shape.among(lengths)
                if not exact.holds(value):
                    others = dict.fromkeys(
                        givers[length] for length in shape.names if length in givers
                    )
                    if others:
                        fits = f" to go with {' and '.join(others)}"
                    else:
                        fits = ""
                    raise InvalidInput(
                        f"{self._called(arguments)}: {name} has shape {np.shape(value)}; give"
                        f" {exact}{fits}"
                    )
                lengths |= exact.named(value)
                givers |= dict.fromkeys(exact.named(value), name)

    def converted(
        self, args: tuple[Any, ...], kwargs: dict[str, Any], keep: bool
    ) -> tuple[tuple[Any, ...], Any]:
        """The arguments as the function gets them, or as a frozen value keeps them."""
        if not self._converting:
            return args, kwargs

        def convert(name: str, value: Any) -> Any:
            if name in self._converting:
                return self._kinds[name].converted(value, keep)
            return value

        first = tuple(map(convert, self._by_place, args))
        return first + args[len(first) :], {
            name: convert(name, value) for name, value in kwargs.items()
        }


def _before(function: Any, owner: type | None) -> Any:
    arguments = _Arguments(function, owner)
    frozen = bool(getattr(getattr(owner, "__dataclass_params__", None), "frozen", False))
    keeps = function.__name__ == "__init__" and frozen

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        arguments.check(args, kwargs)
        args, kwargs = arguments.converted(args, kwargs, keeps)
        return function(*args, **kwargs)

    return call


def _after(function: Any, owner: type | None) -> Any:
    arguments = _Arguments(function, owner)

    def explain(*args: Any, **kwargs: Any) -> None:
        arguments.check(args, kwargs)

    # Written out with the parameters of the function, it costs a tenth of what *args and **kwargs
    # do. A constructor says best itself what is wrong; what a method passes on names the arguments
    # of another call.
    passed_on = UvmsError if function.__name__ == "__init__" else ()
    declared, passed, defaults = _parameters_of(function)
    space = {
        "_function": function,
        "_explain": explain,
        "_passed_on": passed_on,
        **defaults,
        **_CLASSES,
    }
    exec(_AFTER.format(declared=declared, passed=passed, doubt=_doubt(function)), space)
    return wraps(function)(space["_call"])


def _doubt(function: Callable[..., Any]) -> str:
    """Source that is true where a plain argument may be wrong: a call that does not read one would
    not fail.
    """
    doubts = []
    for name, word in function.__annotations__.items():
        if isinstance(word, str) and name != "return":
            plain, extras = _plain(word, function.__globals__)
        else:
            plain = ""
            extras = ()
        if plain in _CHECKED_BY_CLASS:
            # The one class that is nearly always found is asked for by itself: that takes half the
            # time.
            usual, _ = _CHECKED_BY_CLASS[plain]
            doubts.append(f"(type({name}) is not {usual} and type({name}) not in {usual}s)")
            kind = Shape if plain == "np.ndarray" else Range
            doubts += [extra.doubt(name) for extra in extras if isinstance(extra, kind)]
    return " or ".join(doubts) or "False"


def _plain(word: str, scope: dict[str, Any]) -> tuple[str, tuple[Any, ...]]:
    """The class that an annotation names, and what it says beyond that where it is, or stands for,
    an `Annotated`.
    """
    module, _, name = word.rpartition(".")
    if module:
        named = getattr(scope.get(module), name, None)
    else:
        named = scope.get(word)
    if word.startswith("Annotated[") and word.endswith("]"):
        thing = eval(word, scope)
    else:
        thing = named
    if get_origin(thing) is not Annotated:
        return word, ()
    base, *extras = get_args(thing)
    base = get_origin(base) or base
    return "np.ndarray" if base is np.ndarray else getattr(base, "__name__", ""), tuple(extras)


for _usual, _known in _CHECKED_BY_CLASS.values():
    _CLASSES |= {_usual: _known[0], f"{_usual}s": _known}


def _parameters_of(function: Callable[..., Any]) -> tuple[str, str, dict[str, Any]]:
    """The parameters of a function as they are declared and as they are passed on, and their
    defaults.
    """
    declared = []
    passed = []
    defaults = {}
    starred = False
    for name, parameter in inspect.signature(function).parameters.items():
        by_name = parameter.kind is parameter.KEYWORD_ONLY
        mark = _MARKS.get(parameter.kind, "")
        if by_name and not starred:
            declared.append("*")
        starred = starred or by_name or mark == "*"
        if parameter.default is parameter.empty:
            default = ""
        else:
            default = f"_default_{name}"
        if default:
            defaults[default] = parameter.default
        declared.append(f"{mark}{name}" + (f"={default}" if default else ""))
        passed.append(f"{name}={name}" if by_name else f"{mark}{name}")
    return ", ".join(declared), ", ".join(passed), defaults


# Frozen values made without a look at their arguments, for what runs at every tick.


def unchecked_constructor(cls: Callable[_P, _V]) -> Callable[_P, _V]:
    """The constructor of a `checked` class without the check, for who makes a value at every tick
    of what is known to fit.

    Nothing is copied: the arrays belong to the value from then on.
    """
    unchecked: Any = getattr(cls.__init__, "__wrapped__", cls.__init__)
    if not _is_plain(cls):

        def made(*args: _P.args, **kwargs: _P.kwargs) -> _V:
            value: Any = object.__new__(cls)  # type: ignore[arg-type]
            unchecked(value, *args, **kwargs)
            return value

        return made
    declared, _, defaults = _parameters_of(unchecked)
    space = {"_new": object.__new__, "_cls": cls, "_Open": _open(cls), **defaults}
    space |= {f"_make_{f.name}": f.default_factory for f in fields(cls)}  # type: ignore[arg-type]
    lines = [f"    _self.{f.name} = {_field(f)}" for f in fields(cls)]  # type: ignore[arg-type]
    exec(_FILLED.format(declared=declared.removeprefix("self, "), lines="\n".join(lines)), space)
    return space["_made"]


def _is_plain(cls: Any) -> bool:
    """Return whether the constructor does nothing but store its arguments in slots."""
    slots = is_dataclass(cls) and "__slots__" in vars(cls)
    return slots and not hasattr(cls, "__post_init__") and all(f.init for f in fields(cls))


def _open(cls: Any) -> type:
    """The class as one whose fields can be written to: a third of the time that a frozen
    constructor takes.
    """
    writable = {
        "__slots__": (),
        "__setattr__": object.__setattr__,
        "__delattr__": object.__delattr__,
    }
    return type(cls)(f"_Open{cls.__name__}", (cls,), writable)


def _field(f: Field[Any]) -> str:
    """Source of its value."""
    name = f.name
    if f.default_factory is MISSING:
        return name
    return f"_make_{name}() if {name} is _default_{name} else {name}"


def replace_unchecked(value: _V, /, **changes: Any) -> _V:
    """Return a frozen value with other values of some fields, as ``dataclasses.replace`` does, but
    without its checks.
    """
    return _changing(type(value))(value, changes)  # type: ignore[arg-type]


def replace_with_symbols(value: _V, /, **fields: Any) -> _V:
    """Return a copy of a frozen value in which CasADi symbols, or numbers that its checks need not
    allow, stand for some fields.

    Neither checks nor ``__post_init__`` run, as both compare numbers, which a symbol is not yet.
    """
    replaced = copy(value)
    for name, symbol in fields.items():
        object.__setattr__(replaced, name, symbol)
    return replaced


@cache
def _changing(cls: Any) -> Callable[[Any, Mapping[str, Any]], Any]:
    """`changed` of one class."""
    names = [f.name for f in fields(cls) if f.init]
    constructor = unchecked_constructor(cls)
    arguments = ", ".join(f"{name}=_changes.get({name!r}, _value.{name})" for name in names)
    space = {"_made": constructor, "_names": frozenset(names)}
    exec(_CHANGED.format(kept=arguments), space)
    return space["_changed"]  # type: ignore[return-value]


def unchecked_method(method: Callable[_P, _V]) -> Callable[_P, _V]:
    """A method of a value without the look at its arguments, for a loop whose caller has been
    looked at.
    """
    bare = getattr(method, "__wrapped__", None)
    return method if bare is None else MethodType(bare, method.__self__)  # type: ignore[attr-defined]
