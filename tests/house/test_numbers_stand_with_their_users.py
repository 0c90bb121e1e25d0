"""A number stands in the file that uses it, in that of the law that it tunes, or in a file of such
numbers: somebody who wants to change it opens that file first.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path

import package_ast as house

_FILES_OF_NUMBERS = {"tuning", "tolerances", "options", "settings", "colours", "line_widths"}
_OF_A_LAW = {
    "uvms_ocp.control.faults.fault_isolation.FORCE_SCALE": "written into its memory",
    "uvms_ocp.control.faults.fault_isolation.MOMENT_SCALE": "written into its memory",
    "uvms_ocp.control.faults.joint_faults.JAM_TRAVEL": "written into its memory",
    "uvms_ocp.robot.proposed_hull.ADDED_MASS_INTERVAL": "how far its law is off, for a comment",
    "uvms_ocp.robot.proposed_hull.DRAG_INTERVAL": "how far its law is off, for a comment",
    "uvms_ocp.trajectories.curve_judge.CHEAPEST": "what its judge calls optimal",
}
"""Numbers that stand with a law which another file applies, and why."""


def test_a_number_with_one_user_stands_with_it() -> None:
    trees = {_module_name(path): house.tree_of(path) for path in house.modules()}
    assert _apart_from_their_user(trees) == set(_OF_A_LAW)


def test_a_number_apart_from_its_user_is_found() -> None:
    sources = {
        "p.law": "SHARE = 0.1\nHERE = -2.0\nTWICE = (1.0, 2.0)\nWORD = 'x'\nuse(HERE)",
        "p.user": "from p.law import SHARE, TWICE, WORD\nfrom p import law\nuse(law.HERE)",
        "p.other": "import p.law as law\nuse(law.TWICE)",
        "p.tuning": "GATE = 25.0",
        "p.third": "from p import tuning\nuse(tuning.GATE)",
    }
    trees = {name: ast.parse(source) for name, source in sources.items()}
    assert _apart_from_their_user(trees) == {"p.law.SHARE"}


def _module_name(path: Path) -> str:
    parts = path.relative_to(house.ROOT.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def _apart_from_their_user(trees: Mapping[str, ast.Module]) -> set[str]:
    """Numbers that one module alone uses, and not the one in which they stand."""
    numbers = set[str]()
    for module, tree in trees.items():
        if module.rpartition(".")[2] not in _FILES_OF_NUMBERS:
            numbers |= {f"{module}.{name}" for name in _numbers_of(tree)}
    users = {number: set[str]() for number in numbers}
    for module, tree in trees.items():
        for used in _names_used(module, tree):
            if used in users:
                users[used].add(module)
    return {
        number
        for number, modules in users.items()
        if len(modules) == 1 and number.rpartition(".")[0] not in modules
    }


def _numbers_of(tree: ast.Module) -> set[str]:
    """Names at the top of a module that are numbers, or tuples of numbers."""
    names = set[str]()
    for node in tree.body:
        if isinstance(node, ast.Assign) and _is_number(node.value):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return names


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.Tuple):
        return all(_is_number(item) for item in node.elts)
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def _names_used(module: str, tree: ast.Module) -> set[str]:
    """Full names that a module imports or reads, of its own those that it reads."""
    full = dict[str, str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            full |= {name.asname or name.name: f"{node.module}.{name.name}" for name in node.names}
        elif isinstance(node, ast.Import):
            full |= {name.asname: name.name for name in node.names if name.asname}
    used = set(full.values())
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            used.add(f"{module}.{node.id}")
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            used.add(f"{full.get(node.value.id, node.value.id)}.{node.attr}")
    return used
