"""Public names without a word of explanation."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Collection, Iterator
from enum import Enum
from typing import Any

_ABOUT_ITSELF = (Enum, BaseException)


def undocumented_names(modules: Collection[str]) -> Iterator[str]:
    """Modules, and of what they make public the functions, classes and methods, that have no
    docstring, not even inherited.
    """
    for name in modules:
        module = importlib.import_module(name)
        if not module.__doc__:
            yield name
        for key in getattr(module, "__all__", None) or _own_names(module):
            yield from _silent(f"{name}.{key}", getattr(module, key))


def _own_names(module: Any) -> list[str]:
    return [
        key
        for key, value in vars(module).items()
        if key[0] != "_" and getattr(value, "__module__", "") == module.__name__
    ]


def _silent(name: str, thing: Any) -> Iterator[str]:
    if inspect.isfunction(thing) and not inspect.getdoc(thing):
        yield name
    if not inspect.isclass(thing):
        return
    if not (thing.__doc__ or issubclass(thing, _ABOUT_ITSELF)):
        yield name
    for key, member in vars(thing).items():
        if key[0] != "_" and inspect.isfunction(member) and not inspect.getdoc(getattr(thing, key)):
            yield f"{name}.{key}"
