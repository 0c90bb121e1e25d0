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
from uvms_ocp.reference.cited_names import exported_names
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
    calls: dict[str, Call] = {}
    for exported in _exported():
        for call in _calls(exported):
            calls.setdefault(call.title, call)
    return sorted(calls.values(), key=lambda call: call.title)


def _exported() -> Iterator[Any]:
    yield from (getattr(uvms_ocp, name) for name in uvms_ocp.__all__)
    for init in sorted(ROOT.rglob("__init__.py")):
        if not set(APART) & set(init.relative_to(ROOT).parts):
            package = import_module(".".join(("uvms_ocp", *init.parent.relative_to(ROOT).parts)))
            yield from (getattr(package, name) for name in exported_names(init))
    yield Watchdog
    for module in OTHERS:
        for item in vars(module).values():
            if inspect.isclass(item) and item.__module__ == module.__name__:
                yield item


def _calls(exported: Any) -> Iterator[Call]:
    if inspect.isfunction(exported):
        yield from _call(exported.__name__, exported, None)
    if (
        not inspect.isclass(exported)
        or issubclass(exported, (BaseException, Enum))
        or getattr(exported, "_is_protocol", False)
    ):
        return
    if not inspect.isabstract(exported):
        yield from _call(exported.__name__, exported, None)
    for name, member in vars(exported).items():
        if name.startswith("_") and name != "__call__":
            continue
        if isinstance(member, (staticmethod, classmethod)):
            yield from _call(f"{exported.__name__}.{name}", getattr(exported, name), None)
        elif inspect.isfunction(member) and not getattr(member, "__isabstractmethod__", False):
            yield from _call(f"{exported.__name__}.{name}", member, exported)


def inherited_methods() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public methods that exported classes have from bases of the package, with their titles."""
    for exported in _exported():
        if not inspect.isclass(exported) or getattr(exported, "_is_protocol", False):
            continue
        for base in exported.__mro__[1:]:
            is_of_package = base.__module__.startswith(f"{uvms_ocp.__name__}.")
            if not is_of_package or getattr(base, "_is_protocol", False):
                continue
            for name, member in vars(base).items():
                if name.startswith("_") or name in vars(exported):
                    continue
                if inspect.isfunction(member) and list(_call(name, member, base)):
                    yield f"{exported.__name__}.{name}", getattr(exported, name)


def _call(title: str, function: Callable[..., Any], owner: type | None) -> Iterator[Call]:
    signature = inspect.signature(inspect.unwrap(function))  # without what completion is shown
    parameters = dict(signature.parameters)
    parameters.pop("self", None)
    if parameters:
        yield Call(title=title, function=function, owner=owner, parameters=parameters)
