"""Recorded files say how they came to be, and times are taken in one way."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from recording.head import QUIET, Beginning, Head, command_line
from recording.processors import ProcessorTimes
from recording.report import Report, Table, cell, filled
from recording.timing import built, timed


def head(others: float | None) -> Head:
    return Head(
        command="python benchmarks/x.py",
        date="today",
        versions="a 1, b 2",
        machine="here",
        others=others,
    )


def times(total: float, busy: float, ours: float) -> ProcessorTimes:
    return ProcessorTimes(total=total, busy=busy, ours=ours)


def test_what_others_use_is_what_is_busy_and_not_ours() -> None:
    before = times(1000.0, 300.0, 20.0)
    after = times(1200.0, 400.0, 90.0)
    assert before.others_until(after) == pytest.approx(15.0)
    assert before.others_until(before) == 0.0
    assert before.others_until(times(1010.0, 305.0, 25.1)) == 0.0  # clocks of the two tick apart


@pytest.mark.skipif(ProcessorTimes.now() is None, reason="the system does not tell")
def test_work_of_child_processes_is_ours() -> None:
    before = ProcessorTimes.now()
    subprocess.run([sys.executable, "-c", "sum(range(20_000_000))"], check=True)
    after = ProcessorTimes.now()
    assert before is not None
    assert after is not None
    assert after.ours - before.ours > 0.1
    assert after.busy >= before.busy
    assert after.total > before.total


def test_a_busy_machine_is_told_in_the_head() -> None:
    assert head(QUIET).load == "Other programs used 10.0 % of the processors"
    assert head(QUIET).quiet
    assert not head(QUIET + 0.1).quiet
    assert (
        head(12.34).lines()[-1]
        == "Other programs used 12.3 % of the processors, more than 10 %: times are partly theirs,"
        " record again."
    )
    assert "does not tell" in head(None).load


def test_both_files_begin_with_the_same_head(tmp_path: Path) -> None:
    rows = [{"a": 1, "b": 0.123456}, {"a": 2, "c": "x|y"}]
    report = Report(name="some", title="Some", prose="Words.", tables=[Table(rows=rows)])
    assert [path.name for path in report.write(tmp_path, head(3.0))] == ["some.md", "some.csv"]
    markdown = (tmp_path / "some.md").read_text().splitlines()
    csv = (tmp_path / "some.csv").read_text().splitlines()
    assert [line.removeprefix("# ") for line in csv[:4]] == head(3.0).lines()
    assert [line.strip() for line in markdown[2:6]] == head(3.0).lines()
    assert csv[4:] == ["a,b,c", "1,0.123456,", "2,,x|y"]
    assert markdown[-4:] == [
        "| a | b | c |",
        "|---|---|---|",
        "| 1 | 0.123 |  |",
        "| 2 |  | x\\|y |",
    ]


def test_a_head_names_the_date_the_versions_and_the_peers() -> None:
    beginning = Beginning("python benchmarks/x.py")
    run_head = beginning.head({"peer": "1.2.3"})
    assert run_head.date.startswith(f"{beginning.date:%Y-%m-%d}")
    assert run_head.versions.startswith("Python ")
    assert run_head.versions.endswith(", peer 1.2.3")
    assert f"{os.cpu_count()} processors" in run_head.machine


def test_a_command_shows_no_folder_of_the_machine() -> None:
    words = ["/a/benchmarks/x.py", "--n", "3", "--out", "/home/me/out", "--name", "two words"]
    assert command_line(words) == "python benchmarks/x.py --n 3 --out PATH --name 'two words'"


def test_everything_is_called_once_to_warm_up_and_then_as_often_as_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []
    walls = iter([0.0, 9.0, 10.0, 13.0, 20.0, 25.0, 30.0, 39.0])
    cpus = iter([0.0, 2.0, 2.0, 5.0, 5.0, 6.0, 6.0, 10.0])
    monkeypatch.setattr("recording.timing.perf_counter", lambda: next(walls))
    monkeypatch.setattr("recording.timing.process_time", lambda: next(cpus))
    timing = timed(lambda: calls.append(len(calls)) or len(calls), 4)
    assert len(calls) == 5
    assert timing.value == 5
    assert (timing.wall, timing.cpu) == (3.0, 1.0)  # the least of each, the warming up aside


def test_a_cold_build_has_an_empty_cache_of_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    cache = built(lambda: Path(os.environ["UVMS_OCP_CACHE"]), cold=True).value
    assert cache != tmp_path
    assert not cache.exists()
    assert built(lambda: os.environ["UVMS_OCP_CACHE"], cold=False).value == str(tmp_path)
    assert os.environ["UVMS_OCP_CACHE"] == str(tmp_path)
    monkeypatch.delenv("UVMS_OCP_CACHE")
    built(lambda: None, cold=True)
    assert "UVMS_OCP_CACHE" not in os.environ


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (None, ".2f", ""),
        (True, "", "yes"),
        (3, "", "3"),
        (0.00012345, "", "0.000123"),
        (12345.6, "", "12346"),
        (0.5, ".2f", "0.50"),
        ("words", ".2f", "words"),
    ],
)
def test_cells_are_short(value: object, form: str, text: str) -> None:
    assert cell(value, form) == text


def test_prose_is_filled_and_lists_stay_lists() -> None:
    text = filled("one\ntwo\n\n- " + "word " * 40 + "\n  of an item\n- last")
    first, *items = text.split("\n")
    assert first == "one two"
    assert items[0] == ""
    assert [line[:2] for line in items[1:]] == ["- ", "  ", "- "]
    assert "word of an item" in text
