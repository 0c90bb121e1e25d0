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
        for cls in (
            node for node in ast.walk(house.tree_of(path)) if isinstance(node, ast.ClassDef)
        ):
            known = set().union(
                *(_assigned(m) for m in _methods(cls) if m.name in ("__init__", "__post_init__")),
                set(),
            )
            declared = {
                n.target.id
                for n in cls.body
                if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)
            }
            for method in _methods(cls):
                wrong += [
                    f"{path.name}: {cls.name}.{a}" for a in _assigned(method) - known - declared
                ]
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
