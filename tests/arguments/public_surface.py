"""Every public callable: what the package and its subpackages export, with constructors and public
methods.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import uvms_ocp
from uvms_ocp.estimation.fallbacks import Watchdog
from uvms_ocp.reference.build import exported_names
from uvms_ocp.robot import dynamics, signals

ROOT = Path(uvms_ocp.__file__).parent
OTHERS = (signals, dynamics)
"""Modules whose classes users make although no package exports them."""
APART = ("cli", "robots", "identification")
"""Commands are tried by words, and files and settings of identification by what stands in them."""


@dataclass(frozen=True)
class Call:
    """One public callable, and its parameters without `self`."""

    title: str
    function: Callable[..., Any]
    owner: type | None
    """Of a method; None for functions, constructors and static methods."""
    parameters: dict[str, inspect.Parameter]


def surface() -> list[Call]:
    """Everything public that takes arguments, by name."""
    found: dict[str, Call] = {}
    for thing in _exported():
        for call in _calls(thing):
            found.setdefault(call.title, call)
    return sorted(found.values(), key=lambda call: call.title)


def _exported() -> Iterator[Any]:
    yield from (getattr(uvms_ocp, name) for name in uvms_ocp.__all__)
    for init in sorted(ROOT.rglob("__init__.py")):
        if not set(APART) & set(init.relative_to(ROOT).parts):
            package = import_module(".".join(("uvms_ocp", *init.parent.relative_to(ROOT).parts)))
            yield from (getattr(package, name) for name in exported_names(init))
    yield Watchdog
    for module in OTHERS:
        yield from (
            item
            for item in vars(module).values()
            if inspect.isclass(item) and item.__module__ == module.__name__
        )


def _calls(thing: Any) -> Iterator[Call]:
    if inspect.isfunction(thing):
        yield from _call(thing.__name__, thing, None)
    if (
        not inspect.isclass(thing)
        or issubclass(thing, (BaseException, Enum))
        or getattr(thing, "_is_protocol", False)
    ):
        return
    if not inspect.isabstract(thing):
        yield from _call(thing.__name__, thing, None)
    for name, member in vars(thing).items():
        if name.startswith("_") and name != "__call__":
            continue
        if isinstance(member, (staticmethod, classmethod)):
            yield from _call(f"{thing.__name__}.{name}", getattr(thing, name), None)
        elif inspect.isfunction(member) and not getattr(member, "__isabstractmethod__", False):
            yield from _call(f"{thing.__name__}.{name}", member, thing)


def _call(title: str, function: Callable[..., Any], owner: type | None) -> Iterator[Call]:
    parameters = dict(
        inspect.signature(inspect.unwrap(function)).parameters
    )  # its own, without what completion is shown
    parameters.pop("self", None)
    if parameters:
        yield Call(title=title, function=function, owner=owner, parameters=parameters)
