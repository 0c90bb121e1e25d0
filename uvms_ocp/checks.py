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

from uvms_ocp.annotation_kinds import kinds_of
from uvms_ocp.argument_kinds import Kind
from uvms_ocp.errors import ArgumentMissing, ArgumentNotFound, InvalidInput, UvmsError, short
from uvms_ocp.types import Range, Shape
from uvms_ocp.written_functions import (
    NOT_GIVEN,
    is_required,
    parameter_source,
    written_function,
)

_T = TypeVar("_T", bound=Callable[..., Any])
_P = ParamSpec("_P")
_V = TypeVar("_V")

_ON_FAILURE = "_checked_on_failure"
"""Attribute of a method whose arguments are checked once it has failed, in classes derived, too."""
_CHECKED_SPECIAL_METHODS = ("__init__", "__call__", "__getitem__")
_NAMING = (("name", ""), ("to", "to "))
"""Arguments of constructors that name the value, and the word before each."""


def checked(thing: _T) -> _T:
    """Check the arguments of a function or class before every call: of a class, those of its
    constructor and public methods.

    A frozen dataclass keeps copies of arrays and mappings that can no longer be written to. A
    function gets an array where its annotation asks for one. Wrong arguments raise `InvalidInput`,
    in one line that names the argument, and of a constructor the value, by its argument `name` or
    `to`; a name that no argument has raises `ArgumentNotFound`, with the nearest, and a call without
    an argument that it needs `ArgumentMissing`.
    """
    if isinstance(thing, type):
        return _checked_class(thing)
    return _checked_before_call(thing, None)


def checked_on_failure(thing: _T) -> _T:
    """Check the arguments of a function or class only once a call has failed, for what runs at
    every tick.

    Of numbers, words and arrays the class is looked at before the call, with the range of numbers
    and the axes of arrays. A right call costs a fraction of a microsecond more: leave values that
    refuse nothing as they are. Where no argument is wrong the failure is passed on as it is. On a
    method of a `checked` class it makes this method late, and what overrides it.
    """
    if isinstance(thing, type):
        return _checked_class(thing, late_constructor=True, late_methods=True)
    setattr(thing, _ON_FAILURE, True)
    is_method = "." in thing.__qualname__.rpartition("<locals>.")[2]
    if is_method:  # its class, which is checked itself, reads the attribute
        return thing
    return _checked_after_failure(thing, None)


def checked_constructor(cls: _T) -> _T:
    """Check a class whose constructor is `checked` and whose methods, which run at every tick, are
    `checked_on_failure`.
    """
    return _checked_class(cls, late_methods=True)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(field,))
def checked_dataclass(check: Callable[[Any], Any] = checked, **options: bool) -> Callable[[_T], _T]:
    """Make a frozen dataclass, keyword-only and with slots but where `options` of `dataclass` say
    otherwise.

    check: its decorator, another one where its methods or all of it are looked at late.
    """
    make_dataclass: Any = dataclass(**{"frozen": True, "kw_only": True, "slots": True, **options})
    return lambda cls: check(make_dataclass(cls))


def _checked_class(cls: Any, *, late_constructor: bool = False, late_methods: bool = False) -> Any:
    """Replace constructor and public methods of a class by checked ones; late: once a call has
    failed.
    """
    for name, member in list(vars(cls).items()):
        if name.startswith("_") and name not in _CHECKED_SPECIAL_METHODS:
            continue
        is_static = isinstance(member, (staticmethod, classmethod))
        function = member.__func__ if is_static else member
        if not inspect.isfunction(function) or not _takes_arguments(function):
            continue
        if name == "__init__":
            is_late = late_constructor
        else:
            is_late = late_methods or _is_marked_late(cls, name, function)
        if is_late:
            wrapped = _checked_after_failure(function, cls)
        else:
            wrapped = _checked_before_call(function, cls)
        if is_static:
            wrapped = type(member)(wrapped)
        setattr(cls, name, wrapped)
    return cls


def _is_marked_late(cls: Any, name: str, method: Callable[..., Any]) -> bool:
    """Return whether a method, or one that it overrides, is `checked_on_failure`."""
    overridden = getattr(super(cls, cls), name, None)
    return hasattr(method, _ON_FAILURE) or hasattr(overridden, _ON_FAILURE)


def _takes_arguments(function: Callable[..., Any]) -> bool:
    """Return whether a function takes anything but the value whose method it is."""
    code = function.__code__
    n_named = code.co_argcount + code.co_kwonlyargcount
    names = set(code.co_varnames[:n_named]) - {"self", "cls"}
    has_stars = code.co_flags & (inspect.CO_VARARGS | inspect.CO_VARKEYWORDS)
    return bool(names or has_stars)


def _checked_before_call(function: Any, owner: type | None) -> Any:
    """Return a function that checks and converts its arguments first; owner: its class."""
    arguments = _Arguments(function, owner)
    dataclass_options = getattr(owner, "__dataclass_params__", None)
    is_frozen = bool(getattr(dataclass_options, "frozen", False))
    keeps_arguments = function.__name__ == "__init__" and is_frozen

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        arguments.check(args, kwargs)
        args, kwargs = arguments.converted(args, kwargs, keeps_arguments)
        return function(*args, **kwargs)

    return call


class _Arguments:
    """The arguments of one function: their kinds are read from its annotations when first
    needed.
    """

    def __init__(self, function: Callable[..., Any], owner: type | None) -> None:
        self._function = function
        is_constructor = owner is not None and function.__name__ == "__init__"
        self._class = owner if is_constructor else None
        self.title = self._class.__name__ if self._class else function.__qualname__

    @cached_property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        return inspect.signature(self._function).parameters

    @cached_property
    def _by_place(self) -> tuple[str, ...]:
        """Names of the parameters that may be given by place, in their order."""
        names = []
        for name, parameter in self._parameters.items():
            if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD):
                names.append(name)
        return tuple(names)

    @cached_property
    def _kinds(self) -> dict[str, Kind]:
        """Kinds of values that parameters accept, by name; those with stars have none."""
        kinds = {}
        for name, kind in kinds_of(self._function, self._class).items():
            parameter = self._parameters[name]
            if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                kinds[name] = kind
        return kinds

    @cached_property
    def _names(self) -> dict[str, None] | None:
        """Names of the arguments, in their order; `None` for a function that takes any name, by
        ``**``.
        """
        names = dict[str, None]()
        for name, parameter in self._parameters.items():
            if parameter.kind is parameter.VAR_KEYWORD:
                return None
            if parameter.kind is not parameter.VAR_POSITIONAL:
                names[name] = None
        return names

    @cached_property
    def _required(self) -> tuple[str, ...]:
        """Names of the parameters that have to be given."""
        return tuple(name for name, value in self._parameters.items() if is_required(value))

    @cached_property
    def _shaped(self) -> tuple[str, ...]:
        """Names of the parameters with a declared shape."""
        return tuple(name for name, kind in self._kinds.items() if kind.shape)

    @cached_property
    def _converting(self) -> frozenset[str]:
        """Names of the parameters that get their arguments as something else."""
        return frozenset(name for name, kind in self._kinds.items() if kind.converts)

    def check(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        """Raise `InvalidInput` for a wrong argument, `ArgumentNotFound` for a name that none has,
        and `ArgumentMissing` for one that is needed and not given.
        """
        if self._names is not None and not kwargs.keys() <= self._names.keys():
            unknown_names = [name for name in kwargs if name not in self._names]
            allowed_names = [name for name in self._names if name != "self"]
            raise ArgumentNotFound(self.title, unknown_names[0], allowed_names)
        arguments = dict(zip(self._by_place, args, strict=False)) | kwargs
        for name in self._required:
            if arguments.get(name, NOT_GIVEN) is NOT_GIVEN:
                allowed = self._kinds.get(name, Kind()).allowed
                raise ArgumentMissing(self._title_with(arguments), name, allowed)
        for name, value in arguments.items():
            kind = self._kinds.get(name)
            if kind is None or kind.holds(value) or value is self._parameters[name].default:
                continue
            place, problem, allowed = kind.wrong(name, value)
            sentence = " ".join(f"{place} {problem}; give {allowed}".split())
            raise InvalidInput(f"{self._title_with(arguments)}: {sentence}")
        if self._shaped:
            self._check_shapes(arguments)

    def _title_with(self, arguments: Mapping[str, Any]) -> str:
        """Return the title, of a constructor with the name that it was given: ``Phase 'A'``,
        ``Transition to 'B'``.
        """
        if self._class is None:
            return self.title
        for key, word in _NAMING:
            if isinstance(arguments.get(key), str):
                return f"{self.title} {word}{short(arguments[key])}"
        return self.title

    def _check_shapes(self, arguments: Mapping[str, Any]) -> None:
        """Raise `InvalidInput` for an array whose axes do not fit the arrays before it."""
        lengths = dict(arguments)
        names_by_length = dict[str, str]()
        for name, value in arguments.items():
            if name not in self._shaped:
                continue
            declared_shape = self._kinds[name].among(value).shape
            if declared_shape is None:
                continue
            shape = declared_shape.among(lengths)
            if not shape.holds(value):
                known_lengths = [
                    length for length in declared_shape.names if length in names_by_length
                ]
                companions = dict.fromkeys(names_by_length[length] for length in known_lengths)
                advice = f"give {shape}"
                if companions:
                    advice += f" to go with {' and '.join(companions)}"
                raise InvalidInput(
                    f"{self._title_with(arguments)}: {name} has shape {np.shape(value)}; {advice}"
                )
            lengths |= shape.named(value)
            names_by_length |= dict.fromkeys(shape.named(value), name)

    def converted(
        self, args: tuple[Any, ...], kwargs: dict[str, Any], keep: bool
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Return the arguments as the function gets them, or as a frozen value keeps them."""
        if not self._converting:
            return args, kwargs

        def convert(name: str, value: Any) -> Any:
            if name in self._converting:
                return self._kinds[name].converted(value, keep)
            return value

        by_place = tuple(map(convert, self._by_place, args))
        starred = args[len(by_place) :]
        by_name = {name: convert(name, value) for name, value in kwargs.items()}
        return by_place + starred, by_name


_AFTER_FAILURE = """
def _call({declaration}):
    if {doubt}:
        _explain({arguments})
    try:
        return _function({arguments})
    except _passed_on:
        raise
    except Exception:
        _explain({arguments})
        raise
"""


def _checked_after_failure(function: Any, owner: type | None) -> Any:
    arguments = _Arguments(function, owner)

    def explain(*args: Any, **kwargs: Any) -> None:
        arguments.check(args, kwargs)

    # A constructor says best itself what is wrong; what a method passes on names the arguments of
    # another call.
    passed_on = UvmsError if function.__name__ == "__init__" else ()
    parameters = parameter_source(function, all_optional=True)
    source = _AFTER_FAILURE.format(
        declaration=parameters.declaration, arguments=parameters.arguments, doubt=_doubt(function)
    )
    names = {
        "_function": function,
        "_explain": explain,
        "_passed_on": passed_on,
        "_not_given": NOT_GIVEN,
        **parameters.defaults,
        **_CLASSES,
    }
    return wraps(function)(written_function(source, "_call", names))


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
"""Names in sources: of infinity, and of the classes of `_CHECKED_BY_CLASS`."""
for _usual, _classes in _CHECKED_BY_CLASS.values():
    _CLASSES[_usual] = _classes[0]
    _CLASSES[f"{_usual}s"] = _classes


def _doubt(function: Callable[..., Any]) -> str:
    """Return source that is true where a plain argument may be wrong or one is not given: a call
    that does not read it would not fail.
    """
    # Annotations are read as text: while a module is imported, its names are not all there. Those
    # of five plain classes need none; what else there is, is read by `kinds_of` after a failure.
    doubts = []
    checked_names = set[str]()
    for name, annotation in function.__annotations__.items():
        if name == "return" or not isinstance(annotation, str):
            continue
        class_name, extras = _plain(annotation, function.__globals__)
        if class_name not in _CHECKED_BY_CLASS:
            continue
        # The one class that is nearly always found is asked for by itself: that takes half the
        # time.
        usual, _ = _CHECKED_BY_CLASS[class_name]
        doubts.append(f"(type({name}) is not {usual} and type({name}) not in {usual}s)")
        extra_class = Shape if class_name == "np.ndarray" else Range
        for extra in extras:
            if isinstance(extra, extra_class):
                doubts.append(extra.doubt(name))
        checked_names.add(name)
    for name, parameter in inspect.signature(function).parameters.items():
        if is_required(parameter) and name not in checked_names:
            doubts.append(f"{name} is _not_given")
    return " or ".join(doubts) or "False"


def _plain(annotation: str, scope: dict[str, Any]) -> tuple[str, tuple[Any, ...]]:
    """Return the class that an annotation names, and what it says beyond that where it is, or
    stands for, an `Annotated`.
    """
    module, _, name = annotation.rpartition(".")
    if annotation.startswith("Annotated[") and annotation.endswith("]"):
        # As `typing.get_type_hints` does, which fails where one of many names is not there yet.
        meaning = eval(annotation, scope)
    elif module:
        meaning = getattr(scope.get(module), name, None)
    else:
        meaning = scope.get(annotation)
    if get_origin(meaning) is not Annotated:
        return annotation, ()
    base, *extras = get_args(meaning)
    base = get_origin(base) or base
    if base is np.ndarray:
        return "np.ndarray", tuple(extras)
    return getattr(base, "__name__", ""), tuple(extras)


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


_CONSTRUCTOR = """
def _constructor({declaration}):
    _self = _new(_writable)
{lines}
    _self.__class__ = _cls
    return _self
"""


def unchecked_constructor(cls: Callable[_P, _V]) -> Callable[_P, _V]:
    """Return the constructor of a `checked` class without the check, for who makes a value at every
    tick of what is known to fit.

    Nothing is copied: the arrays belong to the value from then on.
    """
    unchecked: Any = getattr(cls.__init__, "__wrapped__", cls.__init__)
    if not _is_plain(cls):

        def construct(*args: _P.args, **kwargs: _P.kwargs) -> _V:
            value: Any = object.__new__(cls)  # type: ignore[arg-type]
            unchecked(value, *args, **kwargs)
            return value

        return construct
    parameters = parameter_source(unchecked)
    names = {
        "_new": object.__new__,
        "_cls": cls,
        "_writable": _writable_class(cls),
        **parameters.defaults,
    }
    lines = []
    for item in fields(cls):  # type: ignore[arg-type]
        names[f"_make_{item.name}"] = item.default_factory
        lines.append(f"    _self.{item.name} = {_field_source(item)}")
    source = _CONSTRUCTOR.format(
        declaration=parameters.declaration.removeprefix("self, "), lines="\n".join(lines)
    )
    return written_function(source, "_constructor", names)


def _is_plain(cls: Any) -> bool:
    """Return whether the constructor does nothing but store its arguments in slots."""
    has_slots = is_dataclass(cls) and "__slots__" in vars(cls)
    if not has_slots or hasattr(cls, "__post_init__"):
        return False
    return all(item.init for item in fields(cls))


def _writable_class(cls: Any) -> type:
    """Return the class as one whose fields can be written to: a third of the time that a frozen
    constructor takes.
    """
    members = {
        "__slots__": (),
        "__setattr__": object.__setattr__,
        "__delattr__": object.__delattr__,
    }
    return type(cls)(f"_Writable{cls.__name__}", (cls,), members)


def _field_source(item: Field[Any]) -> str:
    """Return source of the value of a field, from its argument."""
    name = item.name
    if item.default_factory is MISSING:
        return name
    return f"_make_{name}() if {name} is _default_{name} else {name}"


def replace_unchecked(value: _V, /, **changes: Any) -> _V:
    """Return a frozen value with other values of some fields, as ``dataclasses.replace`` does, but
    without its checks.
    """
    return _replacement(type(value))(value, changes)  # type: ignore[arg-type]


_REPLACE = """
def _replace(_value, _changes):
    if not _changes.keys() <= _names:
        raise TypeError(f"{{type(_value).__name__}} has no field {{', '.join(_changes.keys() - _names)}}")
    return _constructor({arguments})
"""


@cache
def _replacement(cls: Any) -> Callable[[Any, Mapping[str, Any]], Any]:
    """Return the function of a value of this class and changed fields, by name, that returns the
    changed value.
    """
    names = []
    arguments = []
    for item in fields(cls):
        if item.init:
            names.append(item.name)
            arguments.append(f"{item.name}=_changes.get({item.name!r}, _value.{item.name})")
    return written_function(
        _REPLACE.format(arguments=", ".join(arguments)),
        "_replace",
        {"_constructor": unchecked_constructor(cls), "_names": frozenset(names)},
    )


def replace_with_symbols(value: _V, /, **fields: Any) -> _V:
    """Return a copy of a frozen value in which CasADi symbols, or numbers that its checks need not
    allow, stand for some fields.

    Neither checks nor ``__post_init__`` run, as both compare numbers, which a symbol is not yet.
    """
    replaced = copy(value)
    for name, symbol in fields.items():
        object.__setattr__(replaced, name, symbol)
    return replaced


def unchecked_method(method: Callable[_P, _V]) -> Callable[_P, _V]:
    """Return a method of a value without the check of its arguments, for a loop whose caller has
    been checked.
    """
    unchecked = getattr(method, "__wrapped__", None)
    if unchecked is None:
        return method
    return MethodType(unchecked, method.__self__)  # type: ignore[attr-defined]
