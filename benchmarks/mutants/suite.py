"""Which tests run which line, and how long each takes: recorded once, without any mutant."""

from __future__ import annotations

import ast
import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mutants.sample import Mutant
from mutants.tree import ROOT, Tree, fingerprint

SLOW = 20.0
"""[s] of a test that is left out."""
BUDGET = 120.0
"""[s] of tests for one mutant, the quick ones first."""
_HOURS = 3 * 3600.0  # [s] for the whole suite
_ELSEWHERE = ("tests/test_notebooks.py", "tests/benchmarks", "tests/house")
"""Run the package in other processes, or do not run it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Suite:
    """Times, failures and coverage of the tests."""

    tests: str
    """Fingerprint of what was recorded."""
    seconds: dict[str, float]
    """[s] of every test, compiled code taken from the cache only."""
    failing: tuple[str, ...]
    """Tests that do not pass in a copy of the repository, or need a compiler."""
    contexts: dict[str, dict[int, list[str]]]
    """The tests by file and line; the empty name is the import."""

    @property
    def left_out(self) -> dict[str, str]:
        """Tests that no mutant runs, and why."""
        reasons = {}
        for name, seconds in self.seconds.items():
            if seconds > SLOW:
                reasons[name] = f"takes {seconds:.0f} s"
        for name in self.failing:
            reasons[name] = "fails in another folder, or without a compiler"
        return reasons

    def tests_of(self, mutant: Mutant) -> list[str]:
        """Choose the tests that run the line, quick ones first, then the others of their files,
        which may share what the first made.
        """
        tests_by_line = self.contexts.get(mutant.file, {})
        names = set[str]()
        for line in statement(mutant):
            names.update(tests_by_line.get(line, ()))
        if names == {""}:  # runs at the import, for all that use the file
            names.update(*tests_by_line.values())
        direct = self._usable(names)
        files = set(map(_file_of, direct))
        same_files = [name for name in self._usable(self.seconds) if _file_of(name) in files]
        return self._affordable(dict.fromkeys([*direct, *same_files]))

    def _usable(self, names: Iterable[str]) -> list[str]:
        """Sort the tests that are timed and not left out, quick ones first."""
        left_out = self.left_out
        usable = [name for name in names if name in self.seconds and name not in left_out]
        return sorted(usable, key=lambda name: (self.seconds[name], name))

    def _affordable(self, names: Iterable[str]) -> list[str]:
        chosen = []
        total = 0.0
        for name in names:
            total += self.seconds[name]
            if total > BUDGET:
                break
            chosen.append(name)
        return chosen


def _file_of(test: str) -> str:
    """Return the file of a test, by its name."""
    return test.partition("::")[0]


def statement(mutant: Mutant) -> range:
    """The lines of the innermost statement around the changed one; of one with a body, those above
    it.
    """
    tree = ast.parse((ROOT / mutant.file).read_text(encoding="utf-8"))
    innermost = range(mutant.line, mutant.line + 1)
    ranges = []
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and mutant.line in _lines(node):
            ranges.append(_lines(node))
    return min(ranges, key=len, default=innermost)


def _lines(node: ast.stmt) -> range:
    body = getattr(node, "body", None)
    if body:
        return range(node.lineno, max(node.lineno + 1, body[0].lineno))
    last = node.end_lineno or node.lineno
    return range(node.lineno, last + 1)


def recorded(work: Path, tests: Sequence[str], jobs: int) -> Suite:
    """Run all tests twice, with coverage and then as mutants will; or read that from the folder
    `work`.
    """
    file = work / "suite.json"
    current = fingerprint("uvms_ocp", "tests", "robots")
    if file.exists():
        stored = json.loads(file.read_text())
        if stored["tests"] == current:
            return Suite(
                tests=current,
                seconds=stored["seconds"],
                failing=tuple(stored["failing"]),
                contexts=_contexts(work),
            )
    tree = Tree(work, "recorded")
    share = ["-n", str(jobs), "--dist", "loadfile"]
    share += [f"--ignore={path}" for path in _ELSEWHERE]
    coverage = ("--cov=uvms_ocp", "--cov-context=test", "--cov-report=")
    first = tree.test(tests, timeout=_HOURS, compiles=True, options=(*share, *coverage))
    second = tree.test(tests, timeout=_HOURS, options=share)
    if not (first.code in (0, 1) and second.code in (0, 1) and second.seconds):
        raise SystemExit(f"the tests do not run without mutants: {first.text}; {second.text}")
    elsewhere = (name for name in second.seconds if str(tree.root) in name)  # in no other tree
    failing = sorted({*first.failed, *second.failed, *elsewhere})
    file.write_text(json.dumps({"tests": current, "seconds": second.seconds, "failing": failing}))
    return Suite(
        tests=current, seconds=second.seconds, failing=tuple(failing), contexts=_contexts(work)
    )


def _contexts(work: Path) -> dict[str, dict[int, list[str]]]:
    from coverage import CoverageData

    data = CoverageData(str(work / "coverage"))
    root = work / "recorded"
    data.read()
    contexts_of_file: dict[str, dict[int, list[str]]] = defaultdict(dict)
    for path in data.measured_files():
        name = Path(path).relative_to(root.resolve()).as_posix()
        for line, contexts in data.contexts_by_lineno(path).items():
            tests = {context.partition("|")[0] for context in contexts}
            contexts_of_file[name][line] = sorted(tests)
    return dict(contexts_of_file)
