"""What the page of the tick says of laws, of what flows against the order, and of cores in C."""

from __future__ import annotations

import re
from itertools import takewhile
from pathlib import Path

import pytest

import uvms_ocp

ROOT = Path(uvms_ocp.__file__).parent
PAGE = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text(encoding="utf-8")
TICK = PAGE.split("## One tick")[1].split("\n## ")[0]
SOURCES = {path: path.read_text(encoding="utf-8") for path in sorted(ROOT.rglob("*.py"))}


def _rows(introduction: str) -> list[list[str]]:
    """Columns of the rows behind a sentence."""
    lines = TICK.split(introduction)[1].lstrip("\n").splitlines()
    rows = takewhile(lambda line: line.startswith("    "), lines)
    return [re.split(r"\s{2,}", row.strip()) for row in rows]


LAWS = _rows("Each of its laws is one function, whoever runs the step:")
AGAINST = _rows("What flows against the order is a field that one step writes for another:")
STEPS = {
    word
    for row in _rows("`sim/tick` lists its steps, each with the memories that it works on:")
    for word in re.findall(r"\w+", " ".join(row))
} | {"control"}


@pytest.mark.parametrize(("name", "file"), [row[:2] for row in LAWS])
def test_a_law_of_the_tick_stands_once_where_the_page_says(name: str, file: str) -> None:
    text = (ROOT / f"{file}.py").read_text(encoding="utf-8")
    assert len(re.findall(rf"^ *def {name}\(", text, re.M)) == 1


@pytest.mark.sampled
@pytest.mark.parametrize("name", [row[0] for row in LAWS if row[0] != "sources"])
def test_no_other_function_has_the_name_of_a_law(name: str) -> None:
    found = [path for path, text in SOURCES.items() if re.search(rf"\bdef {name}\(", text)]
    assert len(found) == 1, found


def test_what_flows_against_the_order_is_a_field_that_steps_write_and_read() -> None:
    assert len(AGAINST) == 7
    for fields, writer, readers, *_ in AGAINST:
        assert {writer, *readers.split(", ")} <= STEPS, fields
        for field in fields.split(", "):
            declared = rf"^    {field}: "
            assert any(re.search(declared, text, re.M) for text in SOURCES.values()), field


def test_every_file_of_c_belongs_to_a_core_of_the_page() -> None:
    named = set(re.findall(r"\w+\.c\b", TICK))
    glue = {"casadi.c", "interface.c"}
    files = {path.name for path in (ROOT / "solvers" / "hierarchy").glob("*.c")}
    assert files == named | glue
