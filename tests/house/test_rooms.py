"""The house stays one where things are found: small rooms, short files, names that mean one thing."""

from __future__ import annotations

import ast
import importlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import package_ast as house
import pytest

LARGEST_ROOM, MOST_NAMES = 14, 34
LONGEST_FILE, LONGEST_FUNCTION, USUAL_FUNCTION, MOST_PARAMETERS = 300, 40, 12, 10
DATA = ("robots", "__pycache__")


def rooms() -> list[Path]:
    return sorted(p for p in (house.ROOT, *house.ROOT.rglob("*")) if p.is_dir() and not set(DATA) & set(p.parts))


def files(room: Path) -> list[Path]:
    return [path for path in room.iterdir() if path.is_file() and path.name != "__init__.py"]


def functions() -> Iterator[tuple[str, int]]:
    """Name and lines of code, docstring and comments aside."""
    for path in house.modules():
        lines = path.read_text(encoding="utf-8").splitlines()
        for node in ast.walk(house.tree_of(path)):
            if isinstance(node, ast.FunctionDef):
                first = node.body[1:] if ast.get_docstring(node) else node.body
                own = lines[first[0].lineno - 1 : node.end_lineno] if first else []
                code = [line for line in own if line.strip() and not line.strip().startswith("#")]
                yield f"{path.relative_to(house.ROOT)}: {node.name}", len(code)


@pytest.mark.parametrize("room", rooms(), ids=lambda room: room.relative_to(house.ROOT.parent).as_posix())
def test_a_room_holds_few_files_and_says_what_comes_in_and_what_goes_out(room: Path) -> None:
    assert len(files(room)) <= LARGEST_ROOM
    if any(path.suffix == ".py" for path in files(room)):
        name = ".".join(("uvms_ocp", *room.relative_to(house.ROOT).parts))
        module = importlib.import_module(name)
        assert module.__doc__, f"{name} has no docstring"
        own = [public for public in dir(module) if not public.startswith("_") and _is_exported(room, public)]
        assert len(own) <= MOST_NAMES, f"{len(own)} public names"


def _is_exported(room: Path, name: str) -> bool:
    tree = house.tree_of(room / "__init__.py")
    return any(
        isinstance(node, ast.ImportFrom) and any(alias.asname == name for alias in node.names)
        for node in ast.walk(tree)
    )


def test_no_file_name_occurs_three_times() -> None:
    names = Counter(path.name for room in rooms() for path in files(room))
    assert [name for name, n in names.items() if n > 2] == []


def test_files_and_functions_are_short() -> None:
    long_files = [str(p) for p in house.modules() if len(p.read_text().splitlines()) > LONGEST_FILE]
    sizes = sorted(functions(), key=lambda entry: entry[1])
    assert long_files == []
    assert sizes[-1][1] <= LONGEST_FUNCTION, sizes[-1]
    assert sizes[int(0.9 * len(sizes))][1] <= USUAL_FUNCTION


def test_no_public_function_takes_many_parameters() -> None:
    many = [
        place.name
        for place in house.public_functions()
        if len([name for name, _ in house.parameters(place.node)]) > MOST_PARAMETERS and "cli" not in place.module.parts
    ]
    assert many == []


def test_attributes_are_first_set_in_the_constructor() -> None:
    wrong = []
    for path in house.modules():
        for cls in (node for node in ast.walk(house.tree_of(path)) if isinstance(node, ast.ClassDef)):
            known = set().union(
                *(_assigned(m) for m in _methods(cls) if m.name in ("__init__", "__post_init__")), set()
            )
            declared = {
                n.target.id for n in cls.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)
            }
            for method in _methods(cls):
                wrong += [f"{path.name}: {cls.name}.{a}" for a in _assigned(method) - known - declared]
    assert wrong == []


def _methods(cls: ast.ClassDef) -> list[ast.FunctionDef]:
    return [node for node in cls.body if isinstance(node, ast.FunctionDef)]


def _assigned(method: ast.FunctionDef) -> set[str]:
    return {
        node.attr
        for node in ast.walk(method)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and isinstance(node.value, ast.Name)
        and node.value.id == "self"
    }
