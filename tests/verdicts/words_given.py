"""Find where the package gives a word: members of every kind of status, and public functions,
properties and fields that are named after a word of judgement.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import uvms_ocp

WORDS = frozenset(
    "accepted aborted certified clear complete completed converged determined diverged equal exact"
    " exceeded failed feasible finished free healthy informed is kept late lost met ok passed"
    " possible proven reachable reached refused rejected solved sound stopped succeeded success"
    " successful truth trusted unexplained undecided undetermined unreachable usable valid verdict"
    " verdicts viable white".split()
)
"""Parts of names that promise something."""
STATUS_BASES = frozenset({"AdvisedStatus", "Enum", "IntEnum"})
KINDS_OF_STATUS = ("Status", "Verdict", "Severity", "Freshness", "Terminal", "Reason")
"""Ends of names of enumerations that are verdicts; others, such as of integrators, are choices."""

PACKAGE = Path(uvms_ocp.__file__).parent


def words_given() -> set[str]:
    """Names ``module:Class.member`` of all of them."""
    found: set[str] = set()
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        found.update(f"{module.removesuffix('.__init__')}:{name}" for name in _names(tree.body))
    return found


def _names(body: list[ast.stmt], owner: str = "") -> Iterator[str]:
    for node in body:
        name = _name(node)
        if name is None or name.startswith("_"):
            continue
        if isinstance(node, ast.ClassDef):
            if _is_status(node):
                yield from (f"{name}.{member}" for member in _members(node))
            yield from _names(node.body, f"{name}.")
        elif WORDS.intersection(name.lower().split("_")) and not _is_number(node):
            yield f"{owner}{name}"


def _name(node: ast.stmt) -> str | None:
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        return node.name
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return node.target.id
    return None


def _is_status(node: ast.ClassDef) -> bool:
    bases = {base.id for base in node.bases if isinstance(base, ast.Name)}
    return bool(bases & STATUS_BASES) and node.name.endswith(KINDS_OF_STATUS)


def _members(node: ast.ClassDef) -> Iterator[str]:
    for statement in node.body:
        if isinstance(statement, ast.Assign):
            yield from (target.id for target in statement.targets if isinstance(target, ast.Name))


def _is_number(node: ast.stmt) -> bool:
    """A quantity, as the delay `late` [s]: it says how much, and promises nothing."""
    annotation = node.returns if isinstance(node, ast.FunctionDef) else node.annotation
    text = "" if annotation is None else ast.unparse(annotation)
    return text in ("float", "Positive", "Magnitude", "Finite", "Count", "Period")
