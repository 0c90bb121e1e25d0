"""Find where the package gives a word: members of every kind of status, and public functions,
properties and fields that are named after a word of judgement.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import uvms_ocp

_WORDS = """
accepted aborted certified complete completed converged determined diverged equal exact failed
feasible finished healthy informed kept late lost met ok passed proven reachable reached refused
rejected settled solved sound stopped succeeded success successful trusted undecided undetermined
unexplained unreachable usable valid verdict verdicts viable white
"""
WORDS = frozenset(_WORDS.split())
"""Parts of names that promise something."""
ADVISED = "AdvisedStatus"
"""Base of what is a status whatever its name."""
ENUMS = frozenset({"Enum", "IntEnum"})
KINDS_OF_STATUS = ("Status", "Verdict", "Severity", "Freshness", "Terminal", "Reason")
"""Ends of names of enumerations that are verdicts; others, such as of integrators, are choices."""
NUMBERS = frozenset({"float", "Positive", "Magnitude", "Finite", "Count", "Period"})
"""Annotations of quantities, as of the delay `late` [s], which promise nothing."""
REQUIRE = "require_"
"""Begins names of functions that raise, and so give no word."""
KERNEL_MEMORY = "Layout"
"""Base of what kernels remember from tick to tick, from which the words of others are made."""

PACKAGE = Path(uvms_ocp.__file__).parent


@cache
def words_given() -> frozenset[str]:
    """Names ``module:Class.member`` of all of them."""
    names: set[str] = set()
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        module = module.removesuffix(".__init__")
        names.update(f"{module}:{name}" for name in _names(tree.body))
    return frozenset(names)


def _names(body: list[ast.stmt], owner: str = "") -> Iterator[str]:
    for node in body:
        name = _name(node)
        if name is None or name.startswith(("_", REQUIRE)):
            continue
        if not isinstance(node, ast.ClassDef):
            if WORDS.intersection(name.lower().split("_")) and not _is_number(node):
                yield f"{owner}{name}"
            continue
        bases = {base.id for base in node.bases if isinstance(base, ast.Name)}
        if KERNEL_MEMORY in bases:
            continue
        if ADVISED in bases or (bases & ENUMS and name.endswith(KINDS_OF_STATUS)):
            yield from (f"{name}.{member}" for member in _members(node))
        yield from _names(node.body, f"{name}.")


def _name(node: ast.stmt) -> str | None:
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        return node.name
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return node.target.id
    return None


def _members(node: ast.ClassDef) -> Iterator[str]:
    for statement in node.body:
        if isinstance(statement, ast.Assign):
            yield from (target.id for target in statement.targets if isinstance(target, ast.Name))


def _is_number(node: ast.stmt) -> bool:
    annotation = node.returns if isinstance(node, ast.FunctionDef) else node.annotation
    return annotation is not None and ast.unparse(annotation) in NUMBERS
