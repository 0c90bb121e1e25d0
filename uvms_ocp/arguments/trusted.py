"""Frozen values made without a look at their arguments, for what runs at every tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from types import MethodType
from typing import Any, ParamSpec, TypeVar

from uvms_ocp.arguments.checked import parameters_of

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


def trusted(cls: Callable[_P, _V]) -> Callable[_P, _V]:
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
    """Whether the constructor does nothing but store its arguments in slots."""
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


def changed(value: _V, /, **changes: Any) -> _V:
    """A frozen value with other values of some fields, as `dataclasses.replace`, but made as by `trusted`."""
    return _changing(type(value))(value, changes)  # type: ignore[arg-type]


@cache
def _changing(cls: Any) -> Callable[[Any, Mapping[str, Any]], Any]:
    """`changed` of one class."""
    names, made = [f.name for f in fields(cls) if f.init], trusted(cls)
    kept = ", ".join(f"{name}=_changes.get({name!r}, _value.{name})" for name in names)
    space = {"_made": made, "_names": frozenset(names)}
    exec(_CHANGED.format(kept=kept), space)
    return space["_changed"]  # type: ignore[return-value]


def unchecked(method: Callable[_P, _V]) -> Callable[_P, _V]:
    """A method of a value without the look at its arguments, for a loop whose caller has been looked at."""
    bare = getattr(method, "__wrapped__", None)
    return method if bare is None else MethodType(bare, method.__self__)  # type: ignore[attr-defined]


def _unchecked(cls: Any) -> Callable[..., None]:
    return getattr(cls.__init__, "__wrapped__", cls.__init__)
