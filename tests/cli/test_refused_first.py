"""What is refused is refused before anything is compiled, and its line is the last one, where
stderr is no terminal the only one.

The cache is empty, as on a machine that has never run the project.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from compiler import needs_compiler
from refusals import REFUSED, furnish

COMMAND = (sys.executable, "-m", "uvms_ocp")
SHORT = ("run", "reach", "--plant", "kinematic", "--duration", "0.1")
"""Something that is compiled for, and does not complete."""
FAILS = ("run", "mission.py:broken", "--force", "--out", "out")
"""Something that is compiled for, and then turns out to be wrong."""


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache in which there is nothing."""
    cache = tmp_path / "cache"
    monkeypatch.setenv("UVMS_OCP_CACHE", str(cache))
    return cache


@pytest.fixture
def place(tmp_path: Path) -> Path:
    folder = tmp_path / "place"
    folder.mkdir()
    return folder


def called(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    env = os.environ | environment
    return subprocess.run(
        [*COMMAND, *words], cwd=cwd, env=env, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_what_is_refused_is_refused_in_one_line_and_nothing_is_compiled_for_it(
    empty: Path, place: Path
) -> None:
    script = Path(__file__).with_name("refusals.py")
    expected = dict(REFUSED)
    command = [sys.executable, str(script), *expected]
    process = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    report = json.loads(process.stdout)
    wrong = {words: row for words, row in report.items() if not _is_one_line(row, expected[words])}
    assert wrong == {}
    assert report.keys() == expected.keys()
    assert not empty.exists()


def _is_one_line(row: dict[str, object], text: str) -> bool:
    err = str(row["err"])
    is_one_line = len(err.splitlines()) == 1 and err.startswith("error: ") and err.endswith("\n")
    quiet = not row["out"] or text.startswith("pre-flight refuses")  # whose findings are printed
    return (
        is_one_line
        and quiet
        and text in err
        and (row["code"], row["reached"], row["new"]) == (2, "", [])
    )


@pytest.mark.sampled
@pytest.mark.parametrize(
    "words",
    [
        "plan mission transit",
        "compare case1 none",
        "run mission.py:swept --json",
        "export controller case1 foreign",
        "campaign case1 --vary vary.py --workers 0",
    ],
)
def test_a_refusal_is_the_only_line_of_a_new_process(words: str, empty: Path, place: Path) -> None:
    furnish(place)
    process = called(*words.split(), cwd=place)
    assert process.returncode == 2, process.stderr
    (line,) = process.stderr.splitlines()
    assert line.startswith("error: ")
    assert not empty.exists()


@pytest.mark.slow
@needs_compiler
def test_an_error_that_comes_while_it_runs_is_the_only_line_too(empty: Path, place: Path) -> None:
    furnish(place)
    process = called(*FAILS, "--json", cwd=place)
    assert process.returncode == 2, process.stderr
    (line,) = process.stderr.splitlines()
    assert line.startswith("error: state of plant")
    assert list(empty.glob("*.so"))
    assert not (place / "out").exists()


@pytest.mark.slow
def test_without_a_compiler_an_error_is_the_only_line_too(empty: Path, place: Path) -> None:
    furnish(place)
    process = called(*FAILS, cwd=place, PATH=str(place), CC="")
    assert process.returncode == 2, process.stderr
    (line,) = process.stderr.splitlines()
    assert line.startswith("error: state of plant")


@pytest.mark.slow
@needs_compiler
def test_progress_is_not_said_where_stderr_is_no_terminal(empty: Path, place: Path) -> None:
    process = called(*SHORT, cwd=place)
    assert process.returncode == 3
    assert process.stderr == ""
    assert not {"\r", "\x1b"} & set(process.stdout)  # of bars
    assert "compiling" not in process.stdout
    assert list(empty.glob("*.so"))


@pytest.mark.slow
@pytest.mark.parametrize("reason", ["no compiler", "no cache"])
def test_what_makes_it_slower_is_said_once_in_one_line(
    reason: str, empty: Path, place: Path
) -> None:
    environment = {"PATH": str(place), "CC": ""} if reason == "no compiler" else {}
    if reason == "no cache":
        empty.write_text("a file")
    process = called(*SHORT, cwd=place, **environment)
    assert process.returncode == 3
    (line,) = process.stderr.splitlines()
    assert line.endswith(": everything works, only slower")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals there")
@pytest.mark.parametrize(
    "words",
    [
        pytest.param(FAILS, marks=needs_compiler),
        ("run", "mission.py:swept"),
        ("plan", "mission", "transit"),
    ],
    ids=" ".join,
)
def test_on_a_terminal_an_error_is_the_last_line(
    words: tuple[str, ...], empty: Path, place: Path
) -> None:
    furnish(place)
    lines = _on_a_terminal(*words, cwd=place)
    assert lines[-1].startswith("error: ")
    assert [line for line in lines if line.startswith("error: ")][-1:] == lines[-1:]
    says_compiling = any("compiling C code for the first time" in line for line in lines)
    assert says_compiling == (words == FAILS)


def _on_a_terminal(*words: str, cwd: Path) -> list[str]:
    """What stays on a terminal that all streams of a command are, without colours and what is drawn
    over.
    """
    import pty

    ours, theirs = pty.openpty()
    env = os.environ | {"TERM": "xterm", "COLUMNS": "300", "LINES": "50"}
    with subprocess.Popen(
        [*COMMAND, *words], cwd=cwd, env=env, stdin=theirs, stdout=theirs, stderr=theirs
    ) as process:
        os.close(theirs)
        told = b""
        while piece := _read(ours):
            told += piece
        os.close(ours)
    assert process.returncode == 2, told
    return [line for line in map(_as_seen, told.decode().split("\n")) if line]


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 65536)
    except OSError:  # as Linux tells that nobody is there any more
        return b""


def _as_seen(line: str) -> str:
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line)
    return plain.rstrip("\r").rpartition("\r")[2].strip()
