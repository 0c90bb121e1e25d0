"""A compiled library is found again, and whatever happened to the cache, the next call works."""

from __future__ import annotations

import ctypes
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.functions import compile as building

SOURCE = "double answer(double x) { return 2 * x; }\n"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path / "cache"))


def _answer(path: Path | None) -> float:
    assert path is not None
    function = ctypes.CDLL(str(path)).answer
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return float(function(21.0))


def _compile_visible(source: str = SOURCE) -> Path | None:
    return building.compile_library(source)


def _worker(source: str, results: multiprocessing.Queue) -> None:
    results.put(_answer(_compile_visible(source)))


def test_a_library_is_compiled_once(tmp_path: Path) -> None:
    first = _compile_visible()
    assert _answer(first) == 42.0
    assert first is not None
    before = first.stat().st_mtime_ns
    assert _compile_visible() == first
    assert first.stat().st_mtime_ns == before
    assert _compile_visible(SOURCE + "/* other */") != first
    assert not list((tmp_path / "cache").glob("build-*"))


@pytest.mark.parametrize("garbage", [b"", b"garbage", b"\x7fELF" + bytes(4096)])
def test_garbage_in_the_cache_is_compiled_anew(garbage: bytes) -> None:
    path = _compile_visible()
    assert path is not None
    path.write_bytes(garbage)
    assert _answer(_compile_visible()) == 42.0
    path.with_suffix(".sha256").write_bytes(b"\xff\xfe" + garbage)
    assert _answer(_compile_visible()) == 42.0


def test_processes_that_compile_at_once_all_succeed() -> None:
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    workers = [context.Process(target=_worker, args=(SOURCE, results)) for _ in range(4)]
    for worker in workers:
        worker.start()
    answers = [results.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join(timeout=60)
    assert answers == [42.0] * 4


def test_a_process_killed_while_compiling_breaks_nothing() -> None:
    slow = SOURCE + "\n".join(f"double f{i}(double x) {{ return x * {i}; }}" for i in range(20000))
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    worker = context.Process(target=_worker, args=(slow, results))
    worker.start()
    time.sleep(1.0)
    if worker.pid is not None and worker.is_alive():
        os.kill(worker.pid, signal.SIGKILL)
    worker.join(timeout=60)
    assert _answer(_compile_visible()) == 42.0


def test_a_cache_that_others_can_write_is_refused(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    building._warn_once.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert _compile_visible() is None
    assert "can be written by others" in caplog.text


def test_without_a_compiler_it_says_so_once(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    building._compiler.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert _compile_visible() is None
        assert _compile_visible() is None
    building._compiler.cache_clear()
    assert caplog.text.count("no C compiler found") == 1


def _stderr_of(program: str, **environment: str) -> list[str]:
    """Lines that a new process writes to stderr, without any logging set up."""
    kept = {name: value for name, value in os.environ.items() if name != "CC"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=kept | environment, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stderr.splitlines()


TWO_LIBRARIES = """
from uvms_ocp.functions.compile import compile_library
for number in (1, 2, 2):
    compile_library(f"int f(void) {{ return {number}; }}")
"""


def test_the_first_compilation_is_announced_on_stderr_once_and_the_next_process_is_silent(tmp_path: Path) -> None:
    cache = str(tmp_path / "fresh")
    (line,) = _stderr_of(TWO_LIBRARIES, UVMS_OCP_CACHE=cache)
    assert line == f"compiling C code for the first time, about half a minute; kept in {cache}"
    assert _stderr_of(TWO_LIBRARIES, UVMS_OCP_CACHE=cache) == []


def test_the_missing_compiler_is_announced_on_stderr_once(tmp_path: Path) -> None:
    (line,) = _stderr_of(TWO_LIBRARIES, PATH=str(tmp_path))
    assert line == "no C compiler found (CC, cc, gcc, clang): everything works, only slower"


def test_source_that_does_not_compile_gives_nothing_but_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    building._warn_once.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert building.compile_library("this is not C") is None
    assert "failed" in caplog.text


def test_a_compiled_function_keeps_names_sparsity_and_values() -> None:
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [ca.sin(x), ca.diag(x)], ["angle"], ["sine", "spread"])
    compiled = building.compile_function(function)
    assert compiled.is_a("External")
    assert compiled.name_in() == function.name_in()
    assert compiled.name_out() == function.name_out()
    assert compiled.sparsity_out(1) == function.sparsity_out(1)
    np.testing.assert_allclose(np.asarray(compiled([1, 2, 3])[0]), np.sin([[1.0], [2.0], [3.0]]), rtol=1e-15)


def test_without_a_compiler_a_function_is_returned_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [x])
    monkeypatch.setattr(building, "_compiler", lambda: None)
    assert building.compile_function(function) is function
