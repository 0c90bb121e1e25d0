"""Mutants: places in the source where cosmic-ray would change one thing, and a seeded draw of
them.
"""

from __future__ import annotations

import ast
import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

_ARITHMETIC = ("Add", "Sub", "Mul", "Div", "Pow")
_BITS = ("BitOr", "BitAnd", "BitXor")
_ORDER = ("Eq", "NotEq", "Lt", "LtE", "Gt", "GtE")
_IDENTITY = ("Is", "IsNot")
_SINGLE = (
    "ReplaceUnaryOperator_USub_UAdd",
    "ReplaceUnaryOperator_Delete_Invert",
    "ReplaceUnaryOperator_Delete_Not",
    "AddNot",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ExceptionReplacer",
    "NumberReplacer",
    "ZeroIterationForLoop",
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Mutant:
    """One change of one file."""

    file: str
    """Path below the repository."""
    line: int
    operator: str
    """cosmic-ray's name of it."""
    before: str
    """The line, without its indent."""
    after: str
    """What becomes of it; where a statement has several lines, of the first that changes."""
    source: str
    """The whole file, changed."""

    @property
    def key(self) -> str:
        """Name this change in this file as it stands."""
        return _hash(self.file, self.operator, str(self.line), self.source)


def operators() -> tuple[str, ...]:
    """List the operators that change a value into another of its kind: a shift of floats would fail
    at once and say nothing.
    """
    groups = [("Binary", _ARITHMETIC), ("Binary", _BITS)]
    groups += [("Comparison", _ORDER), ("Comparison", _IDENTITY)]
    names = []
    for kind, group in groups:
        pairs = permutations(group, 2)
        names += [f"core/Replace{kind}Operator_{a}_{b}" for a, b in pairs]
    names += [f"core/{name}" for name in _SINGLE]
    return tuple(names)


def draw(root: Path, files: Sequence[str], n: int, seed: int) -> list[Mutant]:
    """At most `n` mutants: places drawn with equal chances, and of each place one change.

    The draw goes by hashes of the lines, so that lines which do not change keep their place in it.
    """
    mutants: list[Mutant] = []
    for _, choices in sorted(_places(root, files, seed)):
        mutant = _first_mutant(root, sorted(choices))
        if mutant is not None:
            mutants.append(mutant)
        if len(mutants) == n:
            break
    return mutants


def _first_mutant(root: Path, choices: Sequence[_Choice]) -> Mutant | None:
    for _, file, operator, occurrence, line in choices:
        mutant = _mutant(root, file, operator, occurrence, line)
        if mutant is not None:
            return mutant
    return None


_Choice = tuple[str, str, str, int, int]
"""Hash, file, operator, occurrence, line."""


def _places(root: Path, files: Sequence[str], seed: int) -> Iterator[tuple[str, list[_Choice]]]:
    from cosmic_ray.ast import ast_nodes, get_ast_from_path

    for file in files:
        names = _named((root / file).read_text(encoding="utf-8").splitlines())
        nodes = list(ast_nodes(get_ast_from_path(root / file)))
        places: dict[tuple[int, int], list[_Choice]] = defaultdict(list)
        for operator in operators():
            for occurrence, (line, column) in enumerate(_positions(nodes, operator)):
                drawn = _hash(str(seed), file, names[line - 1], str(column), operator)
                places[line, column].append((drawn, file, operator, occurrence, line))
        for (line, column), choices in places.items():
            yield _hash(str(seed), file, names[line - 1], str(column)), choices


def _named(lines: Sequence[str]) -> list[str]:
    """Name each line by its text and by how many equal ones stand above it."""
    above: Counter[str] = Counter()
    named = []
    for line in lines:
        named.append(f"{above[line]} {line}")
        above[line] += 1
    return named


def _positions(nodes: Sequence[Any], name: str) -> Iterator[tuple[int, int]]:
    from cosmic_ray.plugins import get_operator

    operator = get_operator(name)()
    for node in nodes:
        for start, _ in operator.mutation_positions(node):
            yield start


def _mutant(root: Path, file: str, operator: str, occurrence: int, line: int) -> Mutant | None:
    """`None` for what is no Python any more, and for a change of what `_what_runs` leaves out
    alone.
    """
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    source = (root / file).read_text(encoding="utf-8")
    changed = mutate_code(source, get_operator(operator)(), occurrence)
    if changed is None or _what_runs(changed) in (None, _what_runs(source)):
        return None
    pairs = zip(source.splitlines(), changed.splitlines(), strict=False)
    before, after = next((a.strip(), b.strip()) for a, b in pairs if a != b)
    return Mutant(
        file=file, line=line, operator=operator, before=before, after=after, source=changed
    )


def _what_runs(source: str) -> str | None:
    """The syntax tree without annotations, decorators and ``zip(strict=...)``, which only asserts;
    `None` for no Python.
    """
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(value=None)
        elif isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
            node.decorator_list = []
        elif isinstance(node, ast.ClassDef):
            node.decorator_list = []
        elif isinstance(node, ast.Call):
            node.keywords = [keyword for keyword in node.keywords if keyword.arg != "strict"]
    return ast.dump(tree)


def _hash(*words: str) -> str:
    return hashlib.sha256("\0".join(words).encode()).hexdigest()
