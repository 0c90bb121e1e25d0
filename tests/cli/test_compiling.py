"""While something is compiled, whoever shows what happens is told."""

from __future__ import annotations

import logging
from io import StringIO
from pathlib import Path

import pytest
from compiler import needs_compiler
from rich.console import Console

from uvms_ocp.cli.compiling import told_of_compiling
from uvms_ocp.functions.compile import compile_library

LOGGER = logging.getLogger("uvms_ocp.functions.compile")


@needs_compiler
def test_it_tells_what_is_compiled_and_prints_warnings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path / "cache"))
    told, printed = list[str](), StringIO()
    with told_of_compiling(told.append, Console(file=printed, width=12)):
        compile_library("int answer(void) { return 42; }", name="answer")
        compile_library("int answer(void) { return 42; }", name="answer")
        LOGGER.warning("no compiler in [red]")
    compile_library("int other(void) { return 43; }", name="other")
    assert told == ["compiling answer"]
    assert printed.getvalue().splitlines()[-1] == "no compiler in [red]"
    assert not LOGGER.handlers
