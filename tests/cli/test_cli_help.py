"""What the command line says of itself: examples that hold, lines of 80 columns, words that a shell
may complete.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from command_line import called

from uvms_ocp.cli import commands as cli


def test_help_has_examples_and_fits_80_columns(tmp_path: Path) -> None:
    told = called("--help", cwd=tmp_path).stdout.splitlines()
    assert sum(line.startswith("    uvms-ocp ") for line in told) >= 5
    assert max(map(len, told)) <= 80


@pytest.mark.parametrize("line", re.findall(r"^  uvms-ocp (.*)$", cli._EXAMPLES, re.MULTILINE))
def test_every_example_is_of_commands_and_options_that_there_are(line: str) -> None:
    command = typer.main.get_command(cli.app)
    words = line.split("   ")[0].split()
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    known_options = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known_options


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("run ca", ["case1", "case1_unreachable", "case2"]),
        ("run --solver lex", ["lexqp"]),
        ("run --solver a", ["active_set"]),
        ("run --plant k", ["kinematic"]),
    ],
)
def test_a_shell_completes_names(words: str, expected: list[str]) -> None:
    line = f"uvms-ocp {words}"
    completion_environment = {
        "_UVMS_OCP_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split()) - 1),
    }
    assert called(cwd=Path(), **completion_environment).stdout.split() == expected


def _all(commands: cli.Commands) -> Iterator[tuple[Any, str]]:
    for name, summary in commands.summaries():
        yield commands[name], summary
        yield from _all(getattr(commands[name], "commands", cli.Commands({})))


def test_help_lists_every_command_with_the_first_words_of_its_own_help() -> None:
    commands_and_texts = list(_all(typer.main.get_command(cli.app).commands))
    assert len(commands_and_texts) > 16
    for command, summary in commands_and_texts:
        assert " ".join(command.help.partition("\n\n")[0].split()) == summary != ""


@pytest.mark.sampled
@pytest.mark.parametrize("words", ["--help", "--version", "plan --help", "flies"])
def test_what_names_no_command_imports_none(words: str) -> None:
    code = f"import sys; from uvms_ocp.cli.commands import main; sys.argv[1:] = {words.split()}"
    code += "\ntry:\n    main()\nfinally:\n    print(*sys.modules)"
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    loaded = told.stdout.split()
    assert "uvms_ocp.cli.commands" in loaded
    assert not {"numpy", "casadi", "pinocchio", "uvms_ocp.robot", "uvms_ocp.cli.run"} & set(loaded)
