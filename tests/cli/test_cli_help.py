"""What the command line says of itself: examples that hold, lines of 80 columns, words that a shell may complete."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest
import typer.main

from uvms_ocp.cli import commands as cli

RUN = (sys.executable, "-c", "import sys; sys.argv[0] = 'uvms-ocp'; from uvms_ocp.cli.commands import main; main()")
"""As the installed script does: a shell completes the command of that name."""


def _asked(*arguments: str, **environment: str) -> str:
    process = subprocess.run(
        [*RUN, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "COLUMNS": "80", **environment},
    )
    return process.stdout


def test_help_has_examples_and_fits_80_columns() -> None:
    told = _asked("--help").splitlines()
    assert sum(line.startswith("    uvms-ocp ") for line in told) >= 5
    assert max(map(len, told)) <= 80


@pytest.mark.parametrize("line", re.findall(r"^  uvms-ocp (.*)$", cli._EXAMPLES, re.MULTILINE))
def test_every_example_is_of_commands_and_options_that_there_are(line: str) -> None:
    command = typer.main.get_command(cli.app)
    words = line.split("   ")[0].split()
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    known = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known


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
    told = _asked(_UVMS_OCP_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=str(len(line.split()) - 1))
    assert told.split() == expected
