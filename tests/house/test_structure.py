"""The package stays one where things are found: packages say what they are for, files are one
concept, values are made whole.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import package_ast as house
import pytest

PACKAGES = sorted({path.parent for path in house.modules()})


@pytest.mark.parametrize(
    "folder", PACKAGES, ids=lambda folder: folder.relative_to(house.ROOT.parent).as_posix()
)
def test_a_package_says_what_it_is_for(folder: Path) -> None:
    name = ".".join(("uvms_ocp", *folder.relative_to(house.ROOT).parts))
    assert importlib.import_module(name).__doc__, f"{name} has no docstring"


def test_attributes_are_first_set_in_the_constructor() -> None:
    wrong = []
    for path in house.modules():
        for node in ast.walk(house.tree_of(path)):
            if isinstance(node, ast.ClassDef):
                late = _set_late(node)
                wrong += [f"{path.name}: {node.name}.{attribute}" for attribute in late]
    assert wrong == []


def _set_late(cls: ast.ClassDef) -> set[str]:
    """Attributes that a method other than the constructor sets first."""
    declared = set()
    for node in cls.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            declared.add(node.target.id)
    assigned = set()
    for method in _methods(cls):
        if method.name in ("__init__", "__post_init__"):
            declared |= _assigned(method)
        else:
            assigned |= _assigned(method)
    return assigned - declared


def _methods(cls: ast.ClassDef) -> list[ast.FunctionDef]:
    return [node for node in cls.body if isinstance(node, ast.FunctionDef)]


def _assigned(method: ast.FunctionDef) -> set[str]:
    attributes = set()
    for node in ast.walk(method):
        if not isinstance(node, ast.Attribute) or not isinstance(node.ctx, ast.Store):
            continue
        if isinstance(node.value, ast.Name) and node.value.id == "self":
            attributes.add(node.attr)
    return attributes
