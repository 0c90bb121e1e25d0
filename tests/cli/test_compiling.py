"""While something is compiled whoever shows what happens is told, and no warning comes before an
error.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import pytest
from compiler import needs_compiler

from uvms_ocp.cli.compilation import cache, show_compilation, warned_behind_errors
from uvms_ocp.codegen.compiler_log import PROGRESS
from uvms_ocp.codegen.libraries import compile_library

LOGGER = logging.getLogger("uvms_ocp.codegen.compile")


@needs_compiler
def test_it_tells_what_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path / "cache"))
    told = list[str]()
    with show_compilation(told.append):
        compile_library("int answer(void) { return 42; }", name="answer")
        compile_library("int answer(void) { return 42; }", name="answer")
        LOGGER.warning("no compiler")
    compile_library("int other(void) { return 43; }", name="other")
    assert told == ["compiling answer"]
    assert not LOGGER.handlers


@needs_compiler
def test_the_cache_is_shown_and_cleared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    cache()
    assert capsys.readouterr().out == f"{tmp_path}: libraries: 0, 0.0 MB\n"
    compile_library("int answer(void) { return 42; }", name="answer")
    cache()
    assert (
        capsys.readouterr().out
        == f"{tmp_path}: libraries: 1, 0.0 MB, the oldest used 0.0 days ago\n"
    )
    cache(clear=True)
    assert capsys.readouterr().out.startswith(f"{tmp_path}: removed libraries: 1")
    assert not list(tmp_path.iterdir())


def _warn() -> None:
    LOGGER.warning("no compiler")
    LOGGER.warning("compiling", extra={PROGRESS: True})


@pytest.mark.parametrize("code", [0, 3])
def test_a_warning_is_said_once_all_is_done(code: int, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit), warned_behind_errors():
        _warn()
        assert capsys.readouterr().err == ""
        sys.exit(code)
    assert capsys.readouterr().err == "no compiler\n"
    assert not LOGGER.handlers


@pytest.mark.parametrize("error", [SystemExit(2), OSError("full")], ids=repr)
def test_no_warning_is_said_beside_an_error(
    error: BaseException, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(type(error)), warned_behind_errors():
        _warn()
        raise error
    assert capsys.readouterr().err == ""


def test_on_a_terminal_all_of_it_is_said_at_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with pytest.raises(OSError, match="full"), warned_behind_errors():
        _warn()
        assert capsys.readouterr().err == "no compiler\ncompiling\n"
        raise OSError("full")
    assert capsys.readouterr().err == ""
