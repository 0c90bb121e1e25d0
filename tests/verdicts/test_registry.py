"""Every word that the package gives is in `verdicts.csv`, with what it promises, who checks it and
the test that would be red if it lied.
"""

from __future__ import annotations

import ast
import csv
import pickle
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import chain
from pathlib import Path

import pytest
from words_given import words_given

from uvms_ocp.cli.exit_codes import BAD_INPUT, INTERRUPTED, NOT_COMPLETED
from uvms_ocp.errors import AdvisedStatus
from uvms_ocp.report.end_of_run import ENDS

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A row of the table."""

    word: str
    given_by: str
    """Names ``module:attribute`` that give it; ``module:Class.*`` is all members."""
    promise: str
    checked_by: str
    """Who judges, beside the code that it judges."""
    test: str
    """Node of the test that would be red if the word lied."""


def rows(name: str) -> list[dict[str, str]]:
    with (HERE / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


VERDICTS = [Verdict(**row) for row in rows("verdicts.csv")]
NO_VERDICTS = {row["name"]: row["why"] for row in rows("no_verdicts.csv")}
NAMES = list(chain.from_iterable(verdict.given_by.split() for verdict in VERDICTS))
STATUSES = list(chain.from_iterable(AdvisedStatus.__subclasses__()))


def is_listed(name: str) -> bool:
    everything = f"{name.rpartition('.')[0]}.*"
    return name in NAMES or everything in NAMES or name in NO_VERDICTS


def test_every_word_that_the_package_gives_is_listed() -> None:
    missing = sorted(name for name in words_given() if not is_listed(name))
    assert not missing, "list them in verdicts.csv, or say in no_verdicts.csv why they are none"


def test_what_is_listed_as_no_verdict_is_there() -> None:
    assert NO_VERDICTS.keys() <= words_given()


def test_a_new_status_is_noticed() -> None:
    """The search finds members of all statuses that there are when everything is imported."""
    for name in NAMES:
        import_module(name.partition(":")[0])
    words = words_given()
    for status in AdvisedStatus.__subclasses__():
        for member in status:
            assert f"{status.__module__}:{status.__qualname__}.{member.name}" in words


@pytest.mark.parametrize("name", sorted(set(NAMES)))
def test_what_gives_a_word_can_be_imported(name: str) -> None:
    module, _, path = name.partition(":")
    value: object = import_module(module)
    for part in path.removesuffix(".*").split("."):
        fields = getattr(value, "__annotations__", {})
        if not hasattr(value, part):
            assert part in fields, f"{name}: no {part}"
            return
        value = getattr(value, part)


@cache
def names_of_tests(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    return frozenset(name for name in names if name.startswith("test_"))


@pytest.mark.parametrize("verdict", VERDICTS, ids=lambda verdict: verdict.word)
def test_the_test_of_a_word_exists(verdict: Verdict) -> None:
    path, _, name = verdict.test.partition("::")
    assert name in names_of_tests(ROOT / path)
    assert all((verdict.word, verdict.promise, verdict.checked_by))


def test_ends_of_missions_and_exit_codes_are_those_of_the_guide() -> None:
    guide = ROOT / "uvms_ocp" / "reference" / "guide"
    faults = (guide / "faults.md").read_text(encoding="utf-8")
    for end in ENDS:
        assert f"| `{end}` |" in faults
    commands = (guide / "commands_by_example.md").read_text(encoding="utf-8")
    assert "| 0 | complete, and truly so |" in commands
    assert f"| {BAD_INPUT} | bad input, or refused by pre-flight |" in commands
    assert f"| {NOT_COMPLETED} | not completed in time, ended too early, or goal missed" in commands
    assert f"| {INTERRUPTED} | stopped by Ctrl-C" in commands
    assert (BAD_INPUT, NOT_COMPLETED, INTERRUPTED) == (2, 3, 130)


@pytest.mark.parametrize("status", STATUSES, ids=str)
def test_a_status_has_a_text_and_an_advice_of_one_line(status: AdvisedStatus) -> None:
    for text in (status.value, status.advice):
        assert text
        assert "\n" not in text


@pytest.mark.parametrize("status", STATUSES, ids=str)
def test_a_status_is_found_by_its_value_alone(status: AdvisedStatus) -> None:
    assert type(status)(status.value) is status
    assert pickle.loads(pickle.dumps(status)) is status
