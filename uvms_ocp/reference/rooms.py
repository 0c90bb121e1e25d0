"""Which modules the reference documents: rooms with what they export, and what docstrings and theory refer to."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
from pathlib import Path
from types import ModuleType

from uvms_ocp.exceptions import NameNotFound

ROOT = Path(__file__).resolve().parents[1]
_APART = ("robots", "templates", "reference", "cli")
CITED = re.compile(r"`(uvms_ocp(?:\.\w+)+)`")
"""A name in full, as docstrings and pages write it."""


def exported_names(init: Path) -> tuple[str, ...]:
    """The names that a room passes on, by ``from x import Y as Y`` in its ``__init__.py``."""
    imports = (
        node for node in ast.walk(ast.parse(init.read_text(encoding="utf-8"))) if isinstance(node, ast.ImportFrom)
    )
    return tuple(alias.name for node in imports for alias in node.names if alias.asname == alias.name)


def documented_modules(pages: str) -> tuple[str, ...]:
    """Rooms that export something, and all modules that their docstrings, those of the modules so found, and `pages` refer to.

    Each room gets its exports as ``__all__``, which is how the generator knows them.
    """
    found: dict[str, None] = {}
    for init in sorted(ROOT.rglob("__init__.py")):
        parts = init.parent.relative_to(ROOT).parts
        names = exported_names(init)
        if names and not set(_APART) & set(parts):
            room = importlib.import_module(".".join(("uvms_ocp", *parts)))
            vars(room)["__all__"] = [name for name in names if not inspect.ismodule(getattr(room, name))]
            found[room.__name__] = None
    waiting = [*_modules_of(pages), *(name for room in list(found) for name in _modules_of(_source_of(room)))]
    while waiting:
        module = waiting.pop()
        if module not in found:
            found[module] = None
            waiting += _modules_of(_source_of(module))
    return tuple(sorted(found))


def _modules_of(text: str) -> list[str]:
    return [place_of(name)[0].__name__ for name in CITED.findall(text)]


def _source_of(module: str) -> str:
    return inspect.getsource(importlib.import_module(module))


def place_of(name: str) -> tuple[ModuleType, str]:
    """The module of a name in full, and the rest of it. Raises `NameNotFound` where there is no such thing."""
    parts = name.split(".")
    n = next(k for k in range(len(parts), 0, -1) if _is_module(".".join(parts[:k])))
    thing: object = importlib.import_module(".".join(parts[:n]))
    module = thing
    for part in parts[n:]:
        fields = getattr(thing, "__annotations__", {})
        if not hasattr(thing, part) and part not in fields:
            raise NameNotFound(f"name in {'.'.join(parts[:n])}", part, [key for key in dir(thing) if key[0] != "_"])
        thing = getattr(thing, part, None)
    assert isinstance(module, ModuleType)
    return module, ".".join(parts[n:])


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False
