"""What README and the guide show runs as printed, from top to bottom, in an empty folder."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from compiler import needs_compiler
from typer.core import TyperGroup
from typer.main import get_command

from uvms_ocp.cli.commands import app
from uvms_ocp.reference import build

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
GUIDE = Path(build.__file__).with_name("guide")
PAGES = (README, *sorted(GUIDE.glob("*.md")))
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^):]+)\)")
DEEP_IMPORT = re.compile(r"(?:from|import) uvms_ocp\.\w+\.[\w.]+")
COMMAND = re.compile(r"`uvms-ocp ([a-z][^`]*)`")
CALL = """
def call(words):
    import sys
    from uvms_ocp.cli.commands import main
    sys.argv = ["uvms-ocp", *words]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
"""
PLACE = re.compile(r"`((?:notebooks|benchmarks|robots)/[\w/.]+\.\w+)`")


def program(text: str) -> Iterator[str]:
    """One program: Python as it is, commands in the same process; README's two lines of pip are for
    `.ci/run`.
    """
    yield CALL
    for language, block in BLOCK.findall(text):
        if language == "python":
            yield block
            continue
        for line in filter(None, block.splitlines()):
            command, *words = shlex.split(line, comments=True)
            assert command in ("uvms-ocp", "pip"), line
            if command == "uvms-ocp":
                yield f"call({words!r})"


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_block_runs_as_printed(page: Path, tmp_path: Path) -> None:
    # Processes that are started from it read no file again: there is none.
    words = [sys.executable, "-c", "\n".join(program(page.read_text(encoding="utf-8")))]
    told = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stdout + told.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_it_leads_to_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [link for link in LINK.findall(text) if not (page.parent / link).exists()] == []
    assert [place for place in PLACE.findall(text) if not is_there(ROOT / place)] == []


def unknown_words(command: Any, words: list[str]) -> list[str]:
    """Commands and options that there are not, of one command line."""
    while words and isinstance(command, TyperGroup):
        name, *words = words
        if name == "COMMAND":
            return []
        if name not in command.commands:
            return [name]
        command = command.commands[name]
    options = {"--help"}
    for parameter in command.params:
        options.update(parameter.opts)
    return [word for word in words if word.startswith("--") and word not in options]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_that_are_told_of_and_their_options_are_there(page: Path) -> None:
    group = get_command(app)
    lines = COMMAND.findall(page.read_text(encoding="utf-8"))
    assert [line for line in lines if unknown_words(group, shlex.split(line))] == []


def is_there(path: Path) -> bool:
    """Or can be recorded: by the benchmark of its name."""
    return path.exists() or (ROOT / "benchmarks" / f"{path.stem}.py").exists()


def test_figures_in_readme_are_those_that_are_recorded() -> None:
    claims = runpy.run_path(str(ROOT / "benchmarks" / "__main__.py"))
    assert claims["table"]() in README.read_text(encoding="utf-8"), (
        "run: python -m benchmarks --into README.md"
    )
    for script in claims["SCRIPTS"]:
        assert (ROOT / "benchmarks" / f"{script}.py").exists()


@pytest.mark.parametrize(
    "page", [*PAGES, *sorted((ROOT / "notebooks").glob("*.ipynb"))], ids=lambda page: page.stem
)
def test_what_is_shown_is_imported_from_no_deeper_than_a_subpackage(page: Path) -> None:
    assert DEEP_IMPORT.findall(page.read_text(encoding="utf-8")) == []
