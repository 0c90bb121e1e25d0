"""Names that docstrings and pages cite in full, and the modules that the reference documents for
them.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
from collections.abc import Collection
from pathlib import Path
from types import ModuleType

from uvms_ocp.errors import NameNotFound

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the package."""

CITED = re.compile(r"`(uvms_ocp(?:\.\w+)+)`")
"""A name in full, as docstrings and pages write it."""

_UNDOCUMENTED = frozenset(("robots", "templates", "reference", "cli"))
"""Packages without pages, whatever they export: data, commands, the reference itself."""


def documented_modules(pages: str) -> tuple[str, ...]:
    """Return the packages that export something, and all modules that `pages` and the modules
    documented so far cite.

    Each package gets its exports as ``__all__``, which is how the generator knows them. Raises
    `NameNotFound` for a cited name that there is not.
    """
    documented = set(_exporting_packages())
    waiting = [*documented, *_cited_modules(pages)]
    while waiting:
        name = waiting.pop()
        documented.add(name)
        source = inspect.getsource(importlib.import_module(name))
        for cited in _cited_modules(source):
            if cited not in documented:
                waiting.append(cited)
    return tuple(sorted(documented))


def _exporting_packages() -> list[str]:
    """Return the packages that export something; each gets its exports as ``__all__``."""
    packages = []
    for init in sorted(ROOT.rglob("__init__.py")):
        parts = init.parent.relative_to(ROOT).parts
        names = exported_names(init)
        if names and _UNDOCUMENTED.isdisjoint(parts):
            package = importlib.import_module(".".join(("uvms_ocp", *parts)))
            _list_exports(package, names)
            packages.append(package.__name__)
    return packages


def exported_names(init: Path) -> tuple[str, ...]:
    """Return the names that a package passes on, by ``from x import Y as Y`` in its ``__init__.py``
    or the stub beside it.
    """
    names = []
    for path in (init, init.with_suffix(".pyi")):
        if path.exists():
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom):
                    names += [alias.name for alias in node.names if alias.asname == alias.name]
    return tuple(names)


def _list_exports(package: ModuleType, names: Collection[str]) -> None:
    """Load the exports of a package, which it loads itself only when asked, and list them."""
    exports = {name: getattr(package, name) for name in names}
    public = [name for name, value in exports.items() if not inspect.ismodule(value)]
    vars(package).update(exports, __all__=public)


def _cited_modules(text: str) -> list[str]:
    return [place_of(name)[0].__name__ for name in CITED.findall(text)]


def place_of(name: str) -> tuple[ModuleType, str]:
    """Return the module of a name in full, and the name within it.

    Raises `NameNotFound` where there is no such name.
    """
    parts = name.split(".")
    n_parts = len(parts)
    while not _is_module(".".join(parts[:n_parts])):
        n_parts -= 1
    module_name = ".".join(parts[:n_parts])
    module = importlib.import_module(module_name)
    value: object = module
    for part in parts[n_parts:]:
        fields = getattr(value, "__annotations__", {})
        if not hasattr(value, part) and part not in fields:
            allowed = [key for key in dir(value) if key[0] != "_"]
            raise NameNotFound(f"name in {module_name}", part, allowed)
        value = getattr(value, part, None)
    return module, ".".join(parts[n_parts:])


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def address_of(name: str, modules: Collection[str]) -> str:
    """Return the address of a name from the top folder of the reference: on the page of its module.

    Raises `NameNotFound` where there is no such name.
    """
    module, qualified_name = place_of(name)
    if module.__name__ in modules:
        page = f"{module.__name__.replace('.', '/')}.html"
    else:
        page = "index.html"
    if qualified_name:
        return f"{page}#{qualified_name}"
    return page
