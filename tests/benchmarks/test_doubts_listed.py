"""Every doubt that the package can raise stands in the table of the benchmark and is spoiled for:
none is forgotten.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterator
from importlib import import_module
from pathlib import Path

import pytest

import uvms_ocp.identification as package
from uvms_ocp.identification import (
    column_scale_checks,
    command_checks,
    euler_orders,
    gravity_checks,
    joint_checks,
    mapped_recordings,
    mounting_checks,
    rate_checks,
    resolution_checks,
    run_recordings,
    sample_checks,
    sender_checks,
    series_agreement,
    settings_checks,
    shared_motion_checks,
    stuck_checks,
    turning_checks,
)

DOUBTS = import_module("spoiled.doubts").DOUBTS
KINDS = import_module("spoiled.kinds").KINDS
PARTS = (
    "deg, or of another format",
    ": the motion repeats",
    "give missing: ",
    "pulses of 0, which are none",
    "s after",
    "s before",
    "give time_unit: ",
    "give rows that tell them apart, or ",
    "give rows: {NAME: VALUE}",
    "a fit takes the command before them",
    "is the other in",
    "up to § m/s §",
    "% as they are",
    "§, as the file says",
    "deg about z: format",
    "§: in §",
    "§ § +- §",
    "§ +- § about §",
    "§ % of §",
    " as the attitude does",
    " as the position does",
    "the turns by the gyro",
    "the way by the velocity",
)
"""Parts of doubts that stand by themselves in the code, and notes of what was read."""
CHECKS = (
    sample_checks,
    series_agreement,
    gravity_checks,
    stuck_checks,
    rate_checks,
    joint_checks,
    command_checks,
    column_scale_checks,
    mounting_checks,
    turning_checks,
    sender_checks,
    shared_motion_checks,
    euler_orders,
    resolution_checks,
)
"""Modules whose texts are all doubts."""
PARTLY = {
    mapped_recordings: (
        "_doubts",
        "_factors",
        "_pressure_remarks",
        "_depth_doubts",
        "_time_doubts",
    ),
    run_recordings: ("_spoiled",),
    settings_checks: ("check_settings", "_of_current", "_of_thrust"),
}
"""Functions with doubts of modules in which other texts stand too."""
FEWEST = 3
"""Blanks of a text that says something."""


def texts(node: ast.AST, docstrings: frozenset[int]) -> Iterator[str]:
    """Strings of code, with § for what is filled in."""
    if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in docstrings:
        parts = node.values if isinstance(node, ast.JoinedStr) else [node]
        yield "".join(str(part.value) if isinstance(part, ast.Constant) else "§" for part in parts)
        within = [part for part in parts if isinstance(part, ast.FormattedValue)]
    else:
        within = list(ast.iter_child_nodes(node))
    for part in within:
        yield from texts(part, docstrings)


def said(path: Path, functions: Collection[str] = ()) -> Iterator[str]:
    """All strings of a module, or of some of its functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    statements = [node for node in ast.walk(tree) if isinstance(node, ast.Expr)]
    docstrings = frozenset(id(statement.value) for statement in statements)
    if not functions:
        yield from texts(tree, docstrings)
        return
    for node in tree.body:
        if getattr(node, "name", None) in functions:
            yield from texts(node, docstrings)


def all_texts() -> set[str]:
    """Of all modules of identification."""
    code = set()
    for path in Path(str(package.__file__)).parent.glob("*.py"):
        code.update(said(path))
    return code


def doubtful_texts() -> set[str]:
    """Of the code that raises doubts."""
    doubtful = set()
    for module in (*CHECKS, *PARTLY):
        for text in said(Path(str(module.__file__)), PARTLY.get(module, ())):
            if text.count(" ") >= FEWEST:
                doubtful.add(text)
    return doubtful


CODE = all_texts()
DOUBTFUL = doubtful_texts()


@pytest.mark.parametrize("text", sorted(DOUBTFUL))
def test_every_doubt_of_the_code_is_listed(text: str) -> None:
    listed = [doubt.says for doubt in DOUBTS if re.search(doubt.says, text)]
    assert len(listed) == 1 or any(part in text for part in PARTS), (
        f"list it in benchmarks/spoiled/doubts.py: {text}"
    )


@pytest.mark.parametrize("doubt", DOUBTS, ids=lambda doubt: doubt.looks_for)
def test_every_listed_doubt_is_raised_by_code_and_has_recordings_that_are_spoiled_for_it(
    doubt: object,
) -> None:
    says = doubt.says  # type: ignore[attr-defined]
    for pattern in says.split("|"):
        assert any(re.search(pattern, text) for text in CODE)
    is_spoiled_for = any(says in kind.meant for kind in KINDS)
    assert is_spoiled_for != doubt.stated  # type: ignore[attr-defined]


def test_every_kind_of_spoiling_is_meant_for_doubts_that_there_are() -> None:
    patterns = {doubt.says for doubt in DOUBTS}
    for kind in KINDS:
        assert set(kind.meant) <= patterns
    assert len({kind.how for kind in KINDS}) == len(KINDS)
