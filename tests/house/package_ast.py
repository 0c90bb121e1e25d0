"""The package as text: its modules, public classes, fields, functions and what they raise."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import uvms_ocp

ROOT = Path(uvms_ocp.__file__).parent
"""Folder of the package, wherever it is installed."""
PROJECT = Path(__file__).parents[2]
"""Folder of README, tests and benchmarks."""
NUMBERS = re.compile(r"\b(float|ndarray|NDArray|ArrayLike|Array)\b")
ARRAYS = re.compile(r"\b(ndarray|NDArray|ArrayLike|Array)\b")


@dataclass(frozen=True, kw_only=True)
class Place:
    """A function or class with the module it stands in."""

    module: Path
    node: ast.FunctionDef | ast.ClassDef
    owner: ast.ClassDef | None = None

    @property
    def name(self) -> str:
        owner = f"{self.owner.name}." if self.owner else ""
        return f"{self.module.relative_to(ROOT).as_posix()}: {owner}{self.node.name}"


def modules() -> list[Path]:
    """Every Python file of the package."""
    return sorted(path for path in ROOT.rglob("*.py") if "robots" not in path.parts)


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def public_classes() -> Iterator[Place]:
    for path in modules():
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                yield Place(module=path, node=node)


def public_functions() -> Iterator[Place]:
    """Functions, and methods of public classes; constructors count, other special methods that take
    numbers as well.
    """
    for path in modules():
        for node in tree_of(path).body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                yield Place(module=path, node=node)
    for place in public_classes():
        for node in place.node.body:
            if not isinstance(node, ast.FunctionDef):
                continue
            is_private = node.name.startswith("_") and not node.name.startswith("__")
            if not is_private:
                yield Place(module=place.module, node=node, owner=place.node)  # type: ignore[arg-type]


def fields() -> Iterator[tuple[Place, ast.AnnAssign, str]]:
    """Annotated fields of public classes with the text below them."""
    for place in public_classes():
        body = place.node.body
        for statement, after in zip(body, [*body[1:], None], strict=True):
            if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
                yield place, statement, _text(after) or _described(statement)


def parameters(function: ast.FunctionDef) -> Iterator[tuple[str, str]]:
    """Names and annotations."""
    arguments = function.args
    for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        if argument.annotation is not None:
            yield argument.arg, ast.unparse(argument.annotation)


def documentation(place: Place) -> str:
    """What stands at the function, at its class, or at the method it overrides."""
    docstring = ast.get_docstring(place.node) or ""
    if place.owner is None:
        return docstring
    above = ast.get_docstring(place.owner) or ""
    if place.node.name in ("__init__", "__post_init__", "__call__"):
        return f"{docstring}\n\n{above}"
    return docstring or _inherited(place)


def raised(place: Place) -> set[str]:
    """Names of the exceptions that a function raises itself or through private helpers of its
    module and class.
    """
    helpers = {n.name: n for n in ast.walk(tree_of(place.module)) if isinstance(n, ast.FunctionDef)}
    errors: set[str] = set()
    visited: set[str] = set()
    _collect(place.node, helpers, errors, visited)
    return errors


def _collect(
    node: ast.AST, helpers: dict[str, ast.FunctionDef], errors: set[str], visited: set[str]
) -> None:
    for item in ast.walk(node):
        if isinstance(item, ast.Raise) and isinstance(item.exc, ast.Call):
            errors.add(ast.unparse(item.exc.func).rpartition(".")[2])
        if isinstance(item, ast.Call):
            name = ast.unparse(item.func).rpartition(".")[2]
            if name == "require_known":
                errors.add("NameNotFound")
            # A constructor is that of another class, whose own docstring says what it raises.
            is_helper = name.startswith("_") and not name.startswith("__") and name in helpers
            if is_helper and name not in visited:
                visited.add(name)
                _collect(helpers[name], helpers, errors, visited)


def _inherited(place: Place) -> str:
    """The docstring of the method that this one overrides."""
    module = ".".join(("uvms_ocp", *place.module.relative_to(ROOT).with_suffix("").parts))
    cls = getattr(__import__(module, fromlist=["_"]), place.owner.name)  # type: ignore[union-attr]
    return inspect.getdoc(getattr(cls, place.node.name, None)) or ""


def _text(node: ast.stmt | None) -> str:
    if (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ):
        return node.value.value
    return ""


def _described(node: ast.AnnAssign) -> str:
    """The description of a pydantic field."""
    calls = [node.value, *ast.walk(node.annotation)]
    for call in calls:
        if isinstance(call, ast.Call):
            for keyword in call.keywords:
                if keyword.arg == "description" and isinstance(keyword.value, ast.Constant):
                    return str(keyword.value.value)
    return ""
