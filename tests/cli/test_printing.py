"""What commands print reads on a console of 80 columns: no line is wider, no short word is broken,
nothing is left out.
"""

from __future__ import annotations

import io
import re
import sys
from typing import Any

import numpy as np
import pytest
from studies.fault_study import by_kind
from typer.testing import CliRunner

from uvms_ocp.cli import commands
from uvms_ocp.cli.commands import app
from uvms_ocp.cli.printing import console_of, print_line, table_of

WIDTH = 80
FAULT = {
    "kind": "altimeter_stuck",
    "end": "given up",
    "faults": "altimeter:stuck=1@8",
    "named": True,
    "alarms_before": 0,
    "to_detect_s": 1.234,
    "ends_in_contact": False,
    "contact_m": 0.01234,
    "joints_rad": 0.001234,
    "rate_share": 0.9876,
    "arm_m": 1.234,
    "astray_m": 0.1234,
    "tool_m": 0.0001234,
    "passed": True,
}


def printed(show: Any, width: int = WIDTH) -> str:
    console = console_of()
    console.file = io.StringIO()
    console.width = width
    show(console)
    return console.file.getvalue()


def cells(text: str) -> list[list[str]]:
    rows = [line.strip("│┃") for line in text.splitlines() if line.startswith(("│", "┃"))]
    return [[cell.strip() for cell in re.split("[│┃]", row)] for row in rows]


def test_a_table_with_too_many_columns_goes_on_below_with_its_first_column_again() -> None:
    rows = by_kind([{**FAULT, "kind": kind} for kind in ("altimeter_stuck", "gyro_biased")])
    text = printed(lambda console: console.print(table_of("faults", rows, tuple(rows[0]))))
    assert max(map(len, text.splitlines())) <= WIDTH
    words = [word for row in cells(text) for word in row]
    for name, value in rows[0].items():
        told = f"{value:.4g}" if isinstance(value, float) else str(value)
        assert name in words
        assert told in words
    parts = words.count("kind")
    assert parts > 1
    assert words.count("altimeter_stuck") == words.count("gyro_biased") == parts
    assert text.count("faults") == 1


def test_a_table_that_fits_is_one() -> None:
    rows = by_kind([FAULT])
    text = printed(
        lambda console: console.print(table_of("faults", rows, tuple(rows[0]))), width=300
    )
    assert [row[0] for row in cells(text)] == ["kind", "altimeter_stuck"]


def test_a_column_alone_needs_no_other() -> None:
    text = printed(lambda console: console.print(table_of("names", [{"a": "b c " * 40}], ("a",))))
    assert max(map(len, text.splitlines())) <= WIDTH
    assert " ".join(row[0] for row in cells(text)[1:]) == ("b c " * 40).strip()


def test_a_line_goes_on_below_between_two_words() -> None:
    text = "word " * 40 + "x" * 100
    lines = printed(lambda console: print_line(console, text)).splitlines()
    assert [len(line) <= WIDTH for line in lines] == [True] * (len(lines) - 1) + [False], (
        "a path is not broken"
    )
    assert all(line.startswith("  ") for line in lines[1:])
    assert " ".join(" ".join(lines).split()) == text


@pytest.mark.parametrize(
    "words", [["check", "case1"], ["check-robot", "girona_maris7"], ["list"]], ids=" ".join
)
def test_commands_read_on_80_columns(words: list[str]) -> None:
    result = CliRunner().invoke(app, words, env={"COLUMNS": str(WIDTH)})
    assert result.exit_code == 0
    assert max(map(len, result.stdout.splitlines())) <= WIDTH


def test_too_little_memory_is_told_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def greedy(words: list[str]) -> None:
        np.empty(1 << 55)

    monkeypatch.setattr(commands, "app", greedy)
    monkeypatch.setattr(commands, "expand_vectors", lambda app, words: list(words))
    monkeypatch.setattr(sys, "argv", ["uvms-ocp", "list"])
    with pytest.raises(SystemExit) as end:
        commands.main()
    assert end.value.code == 2
    assert re.fullmatch(
        r"error: out of memory \(.*\): give less at a time.*\n", capsys.readouterr().err
    )
