"""A compiled library is found again, and whatever happened to the cache, the next call works."""

from __future__ import annotations

import ctypes
import gc
import itertools
import logging
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.pool import ThreadPool
from pathlib import Path
from time import perf_counter

import casadi as ca
import numpy as np
import pytest
from compiler import COMPILER, needs_compiler
from pressed import PYTHON_MAY_LOSE_IT, pressed_after

from uvms_ocp.codegen import background, c_compiler, compile as building, compiler_log, libraries
from uvms_ocp.codegen.bound_calls import BoundCalls
from uvms_ocp.codegen.c_compiler import compile_timeout
from uvms_ocp.codegen.cache import (
    HALF_MADE,
    cache_folder,
    cached_libraries,
    digest,
    shrink_cache,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.interrupts import raised_outside_casadi

SOURCE = "double answer(double x) { return 2 * x; }\n"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path / "cache"))


def _answer(path: Path | None) -> float:
    assert path is not None
    function = ctypes.CDLL(str(path)).answer
    function.restype = ctypes.c_double
    function.argtypes = [ctypes.c_double]
    return float(function(21.0))


def _compile_visible(source: str = SOURCE) -> Path | None:
    return libraries.compile_library(source)


def _worker(source: str, results: multiprocessing.Queue) -> None:
    results.put(_answer(_compile_visible(source)))


@needs_compiler
def test_a_library_is_compiled_once(tmp_path: Path) -> None:
    first = _compile_visible()
    assert _answer(first) == 42.0
    assert first is not None
    before = first.stat().st_ino
    assert _compile_visible() == first
    assert first.stat().st_ino == before
    assert _compile_visible(SOURCE + "/* other */") != first
    assert not list((tmp_path / "cache").glob(f"{HALF_MADE}*"))


@needs_compiler
def test_the_cache_keeps_what_was_used_last(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    used, unused = (_compile_visible(SOURCE + f"/* {k} */") for k in range(2))
    assert used is not None
    assert unused is not None
    for path in (used, unused):
        os.utime(path, (1.0, 1.0))
    assert _compile_visible(SOURCE + "/* 0 */") == used
    monkeypatch.setattr(libraries, "MOST_CACHED", 2.5 * used.stat().st_size)
    foreign = tmp_path / "cache" / "my_driver.so"
    foreign.touch()
    last = _compile_visible(SOURCE + "/* 2 */")
    assert foreign.exists()
    assert list(cached_libraries(tmp_path / "cache")) == [last, used]
    assert not unused.with_suffix(".sha256").exists()
    assert _answer(_compile_visible(SOURCE + "/* 1 */")) == 42.0


@needs_compiler
def test_compiled_minima_and_maxima_leave_out_what_is_no_number() -> None:
    x = ca.SX.sym("x")
    y = ca.SX.sym("y")
    function = ca.Function("extremes", [x, y], [ca.fmax(x, y), ca.fmin(x, y)])
    compiled = building.compile_function(function)
    assert compiled is not function
    values = [np.nan, -np.inf, -1.0, 0.0, 2.0, np.inf]
    for pair in itertools.product(values, values):
        expected = [np.fmax(*pair), np.fmin(*pair)]
        np.testing.assert_array_equal([float(value) for value in compiled(*pair)], expected)


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("garbage", [b"", b"garbage", b"\x7fELF" + bytes(4096)])
def test_garbage_in_the_cache_is_compiled_anew(garbage: bytes) -> None:
    path = _compile_visible()
    assert path is not None
    path.write_bytes(garbage)
    assert _answer(_compile_visible()) == 42.0
    path.with_suffix(".sha256").write_bytes(b"\xff\xfe" + garbage)
    assert _answer(_compile_visible()) == 42.0


@pytest.mark.slow
@needs_compiler
def test_processes_that_want_the_same_compile_it_once(
    pretend: Callable[[str], Path], tmp_path: Path
) -> None:
    pretend(f"echo call >> '{tmp_path}/calls'; sleep 1; exec '{COMPILER}' \"$@\"")
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    workers = [context.Process(target=_worker, args=(SOURCE, results)) for _ in range(4)]
    for worker in workers:
        worker.start()
    answers = [results.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join(timeout=60)
    assert answers == [42.0] * 4
    libraries = list((tmp_path / "cache").glob("*.so"))
    assert (tmp_path / "calls").read_text() == "call\n" * len(libraries)
    assert {path.suffix for path in (tmp_path / "cache").iterdir()} == {".so", ".sha256"}


@needs_compiler
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


@needs_compiler
def test_a_cache_that_others_can_write_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    compiler_log._SAID.clear()
    with caplog.at_level(logging.WARNING):
        assert _compile_visible() is None
    assert "can be written by others" in caplog.text


def test_without_a_compiler_it_says_so_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    c_compiler.find_compiler.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert _compile_visible() is None
        assert _compile_visible() is None
    c_compiler.find_compiler.cache_clear()
    assert caplog.text.count("no C compiler found") == 1


def _stderr_of(program: str, **environment: str) -> list[str]:
    """Lines that a new process writes to stderr, without any logging set up."""
    without_cc = {name: value for name, value in os.environ.items() if name != "CC"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=without_cc | environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return done.stderr.splitlines()


TWO_LIBRARIES = """
from uvms_ocp.codegen.libraries import compile_library
for number in (1, 2, 2):
    compile_library(f"int f(void) {{ return {number}; }}")
"""


@needs_compiler
def test_the_first_compilation_is_announced_on_stderr_once_and_the_next_process_is_silent(
    tmp_path: Path,
) -> None:
    cache = str(tmp_path / "fresh")
    (line,) = _stderr_of(TWO_LIBRARIES, UVMS_OCP_CACHE=cache)
    assert line == f"compiling C code for the first time, which takes a while; kept in {cache}"
    assert _stderr_of(TWO_LIBRARIES, UVMS_OCP_CACHE=cache) == []


def test_the_missing_compiler_is_announced_on_stderr_once(tmp_path: Path) -> None:
    (line,) = _stderr_of(TWO_LIBRARIES, PATH=str(tmp_path))
    assert line == "no C compiler found (CC, cc, gcc, clang): everything works, only slower"


@pytest.fixture
def pretend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Path]]:
    """Makes a shell script the compiler."""

    def write(script: str) -> Path:
        compiler = tmp_path / "cc"
        compiler.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo 1 && exit 0\n{script}\n')
        compiler.chmod(0o755)
        monkeypatch.setenv("CC", str(compiler))
        c_compiler.find_compiler.cache_clear()
        compiler_log._SAID.clear()
        return compiler

    yield write
    c_compiler.HUNG.clear()
    c_compiler.find_compiler.cache_clear()


BAD_COMPILERS = {
    "writes nothing": ("exit 0", "cannot be loaded"),
    "writes garbage": (
        'while [ "$1" != -o ]; do shift; done; echo garbage > "$2"',
        "cannot be loaded",
    ),
    "says garbage": ("head -c 1000000 /dev/urandom >&2; exit 1", "failed"),
    "meets a full disk": ("echo 'No space left on device' >&2; echo x > /dev/full", "failed"),
    "crashes": ("kill -SEGV $$", "failed"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="shell scripts")
@pytest.mark.parametrize("kind", BAD_COMPILERS)
def test_a_bad_compiler_is_said_in_one_line_and_leaves_no_library(
    kind: str, pretend: Callable[[str], Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    script, message = BAD_COMPILERS[kind]
    pretend(script)
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [x])
    with caplog.at_level(logging.WARNING):
        assert building.compile_function(function) is function
        assert building.compile_function(function) is function
    messages = [record.getMessage() for record in caplog.records if "slower" in record.getMessage()]
    assert len(messages) == 1
    assert message in messages[0]
    assert "\n" not in messages[0]
    assert not list((tmp_path / "cache").iterdir())


def _runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().split()[2] not in "ZX"
    except OSError:
        return False


def _await_end(process: int, seconds: float = 10.0) -> None:
    # A signal is on its way when the call returns: on a busy machine the process may take a moment
    # to end.
    until = time.monotonic() + seconds
    while _runs(process):
        assert time.monotonic() < until, f"process {process} still runs"
        time.sleep(0.01)


@pytest.mark.skipif(sys.platform == "win32", reason="shell scripts")
def test_a_compiler_that_hangs_is_stopped_with_its_children_and_not_called_again(
    pretend: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("UVMS_OCP_COMPILE_TIMEOUT", "0.3")
    pretend(f"echo call >> '{tmp_path}/calls'; sleep 300 & echo $! > '{tmp_path}/child'; wait")
    with caplog.at_level(logging.WARNING):
        assert _compile_visible() is None
        assert _compile_visible(SOURCE + "/* other */") is None
    assert caplog.text.count("was stopped after 0.3 s") == 1
    assert (tmp_path / "calls").read_text() == "call\n"
    _await_end(int((tmp_path / "child").read_text()))
    assert not list((tmp_path / "cache").iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="shell scripts")
def test_functions_that_are_begun_are_compiled_side_by_side(
    pretend: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background, "_workers", lambda process: workers)
    calls = f"'{tmp_path}/calls'"
    # Each ends when it has seen the other, or after ten seconds without.
    wait = (
        f"for i in $(seq 200); do [ \"$(wc -l < {calls})\" -ge 2 ] && echo met >> '{tmp_path}/met'"
        " && break; sleep 0.05; done"
    )
    pretend(f"echo call >> {calls}; {wait}; exit 1")
    x = ca.SX.sym("x")
    with ThreadPool(2) as workers:
        functions = [
            building.start_compiling(ca.Function(name, [x], [x])) for name in ("one", "two")
        ]
        assert [building.compile_function(function) for function in functions] == functions
    assert (tmp_path / "met").read_text() == "met\n" * 2


@needs_compiler
def test_what_is_begun_is_compiled_once_and_found_by_its_machine_code() -> None:
    x = ca.SX.sym("x")
    function = building.start_compiling(ca.Function("f", [x], [ca.sin(x)]))
    building.finish_compiling()
    assert not building._BESIDE
    address = building.compiled_symbol(function)
    assert address is not None
    assert building.compiled_symbol(function) == address


def _made(calls: list[float], number: float, content: str) -> float:
    """Value at 2 of a function with a number, by its machine code."""

    def make() -> ca.Function:
        calls.append(number)
        x = ca.SX.sym("x")
        return ca.Function("f", [x], [number * x])

    function = building.compiled_from("f", content, make, __file__)
    building.finish_compiling()
    result = np.zeros(1)
    calls_of_it = BoundCalls()
    calls_of_it.add(function, [np.array([2.0])], [result])
    calls_of_it()
    return float(result[0])


@needs_compiler
def test_what_was_compiled_before_is_not_made_again_whatever_happened_to_the_cache(
    tmp_path: Path,
) -> None:
    calls = list[float]()
    assert [_made(calls, number, f"of {number}") for number in (3.5, 0.25, 3.5, 0.25)] == [
        7.0,
        0.5,
        7.0,
        0.5,
    ]
    assert calls == [3.5, 0.25]
    cache = tmp_path / "cache"
    entries = [path for path in cache.iterdir() if path.suffix == ".numbers"]
    assert len(entries) == 2
    whole = entries[0].read_bytes()
    for damaged in (b"", whole[:70], whole[:-8] + bytes(8)):
        calls.clear()
        entries[0].write_bytes(damaged)
        assert [_made(calls, number, f"of {number}") for number in (3.5, 0.25)] == [7.0, 0.5]
        assert len(calls) == 1
    for path in cached_libraries(cache):
        if path.suffix == ".so":
            path.unlink()
    assert _made(calls, 3.5, "of 3.5") == 7.0
    assert len(calls) == 2
    shrink_cache(cache, 0.0)
    assert not [path for path in cache.iterdir() if path.suffix in {".so", ".numbers"}]


BEGIN = """
import os, sys
import casadi as ca
from uvms_ocp.codegen.compile import start_compiling
x = ca.SX.sym("x")
start_compiling(ca.Function("f", [x], [2 * x]))
while not os.path.exists(sys.argv[1]):
    pass
"""


@pytest.mark.slow
@needs_compiler
def test_what_a_process_leaves_at_its_end_another_one_compiles_for_the_next(
    pretend: Callable[[str], Path], tmp_path: Path
) -> None:
    child = tmp_path / "child"
    calls = tmp_path / "calls"
    first = f"echo $$ > '{tmp_path}/part'; mv '{tmp_path}/part' '{child}'; sleep 300"
    compiler = pretend(
        f"[ -e '{child}' ] || {{ {first}; }}; echo call >> '{calls}'; exec '{COMPILER}' \"$@\""
    )
    done = subprocess.run(
        [sys.executable, "-c", BEGIN, str(child)],
        env=os.environ | {"CC": str(compiler)},
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 0
    _await_end(int(child.read_text()))
    until = time.monotonic() + 120.0
    while not list((tmp_path / "cache").glob("*.sha256")):
        assert time.monotonic() < until, "nobody compiles it"
        time.sleep(0.05)
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [2 * x])
    assert building.compile_function(function) is not function
    assert calls.read_text() == "call\n"


@pytest.mark.slow
@needs_compiler
def test_the_process_that_goes_on_imports_what_this_one_has_and_nothing_from_where_it_was_started(
    pretend: Callable[[str], Path], tmp_path: Path
) -> None:
    child = tmp_path / "child"
    script = tmp_path / "program.py"
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "casadi.py").write_text("raise SystemExit")
    script.write_text(BEGIN)
    compiler = pretend(
        f"[ -e '{child}' ] || {{ touch '{child}'; sleep 300; }}; exec '{COMPILER}' \"$@\""
    )
    whole = os.pathsep.join(path for path in sys.path if path)
    environment = os.environ | {"CC": str(compiler), "PYTHONPATH": whole}
    done = subprocess.run(
        [sys.executable, str(script), str(child)],
        cwd=folder,
        env=environment,
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    until = time.monotonic() + 30.0
    while not list((tmp_path / "cache").glob("*.sha256")):
        assert time.monotonic() < until, "nobody compiles it"
        time.sleep(0.05)


@pytest.mark.parametrize("executable", ["/opt/robot/console", "", None])
def test_a_program_that_python_is_part_of_is_not_started_again(
    executable: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[object] = []
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setattr(subprocess, "Popen", lambda *words, **named: begun.append(words))
    background._hand_over([])
    assert not begun


def test_what_no_other_process_finds_by_its_name_is_left_without_a_word(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As functions of a module that a notebook has loaded anew: at the end of a process nobody can
    do anything about it.
    """
    begun: list[object] = []
    monkeypatch.setattr(subprocess, "Popen", lambda *words, **named: begun.append(words))
    background._hand_over([lambda: None])
    work = partial(libraries.compile_library, SOURCE)
    monkeypatch.setattr(libraries, "compile_library", None)
    background._hand_over([work])
    assert not begun


FORK = """
import os, signal, sys, time
import casadi as ca
from uvms_ocp.codegen import compile as building
x = ca.SX.sym("x")
function = ca.Function("f", [x], [2 * x])
building.start_compiling(function)
while not os.path.exists(sys.argv[1]):
    pass
child = os.fork()
if not child:
    signal.alarm(30)
    os._exit(building.compile_function(function) is function)
open(sys.argv[2], "w").close()
assert building.compile_function(function) is not function
assert os.waitpid(child, 0)[1] == 0, "it waits for itself"
"""


@needs_compiler
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_fork_begun_while_a_library_is_made_finds_it_too(
    pretend: Callable[[str], Path], tmp_path: Path
) -> None:
    begun = tmp_path / "begun"
    forked = tmp_path / "forked"
    wait = f"touch '{begun}'; while [ ! -e '{forked}' ]; do sleep 0.05; done; sleep 0.5"
    compiler = pretend(f"{wait}; exec '{COMPILER}' \"$@\"")
    words = [sys.executable, "-c", FORK, str(begun), str(forked)]
    done = subprocess.run(
        words, env=os.environ | {"CC": str(compiler)}, capture_output=True, text=True, timeout=90
    )
    assert done.returncode == 0, done.stderr


FORK_OF_A_START = """
import os, subprocess, sys, threading, time
from uvms_ocp.codegen import c_compiler
begins, ends = os.pipe()
begun, start = threading.Event(), subprocess.Popen
def slowly(*words, **named):
    begun.set()
    time.sleep(0.5)
    os.close(ends)
    return start(*words, **named)
subprocess.Popen = slowly
starting = threading.Thread(target=c_compiler.run_compiler, args=([sys.executable, "-c", ""], 60.0))
starting.start()
begun.wait()
child = os.fork()
if not child:
    try:
        os.fstat(ends)
    except OSError:
        os._exit(0)
    os._exit(1)
assert os.waitpid(child, 0)[1] == 0, "what the start of a compiler holds open is held by the fork, too"
starting.join()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_no_fork_begins_in_the_middle_of_a_start_of_a_compiler() -> None:
    """A thread that starts a process waits for the end of a pipe, and a fork that waits for that
    thread held it open.
    """
    done = subprocess.run(
        [sys.executable, "-c", FORK_OF_A_START], capture_output=True, text=True, timeout=90
    )
    assert done.returncode == 0, done.stderr


HOLD = """
import sys, time
from pathlib import Path
from uvms_ocp.codegen.cache import turn_to_make
with turn_to_make(Path(sys.argv[1]), 1.0):
    print("mine", flush=True)
    time.sleep(300)
"""


@pytest.mark.sampled
@needs_compiler
@pytest.mark.skipif(sys.platform == "win32", reason="locks of files")
@pytest.mark.parametrize("behind", [False, True])
def test_nobody_waits_for_longer_than_a_compiler_may_take_and_who_works_behind_all_others_holds_nobody_up(
    behind: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = _compile_visible()
    assert library is not None
    library.unlink()
    if behind:
        monkeypatch.setattr(libraries.BEHIND_OTHERS, "is_set", lambda: True)
    monkeypatch.setenv("UVMS_OCP_COMPILE_TIMEOUT", "30" if behind else "3")
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(library)], stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"mine\n"
        begin = time.monotonic()
        assert _answer(_compile_visible()) == 42.0
        spent = time.monotonic() - begin
        holder.kill()
    assert spent < 20.0 if behind else 3.0 < spent < 20.0


@needs_compiler
def test_what_was_left_half_made_a_day_ago_is_removed(tmp_path: Path) -> None:
    library = _compile_visible()
    assert library is not None
    old, new, foreign = (
        library.parent / name for name in (f"{HALF_MADE}old", f"{HALF_MADE}new", "build-release")
    )
    lock = library.with_suffix(".lock")
    package = library.with_name("package.lock")
    for folder in (old, new, foreign):
        folder.mkdir()
    lock.touch()
    package.touch()
    for path in (old, lock, foreign, package):
        os.utime(path, (time.time() - 1e5,) * 2)
    _compile_visible(SOURCE + "/* another */")
    assert (old.exists(), lock.exists()) == (False, False)
    assert new.exists()
    assert foreign.exists(), "of others, who keep more in that folder"
    assert package.exists()


@needs_compiler
def test_who_lets_a_function_go_before_it_is_compiled_is_not_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Never:
        def ready(self) -> bool:
            return False

        def get(self) -> None:
            raise AssertionError("waited for")

    monkeypatch.setattr(building, "start_beside", lambda work: Never())
    function = building.start_compiling(ca.Function("f", [ca.SX.sym("x")], [1.0]))
    assert building.is_being_compiled(function)
    before = len(building._BESIDE)
    del function
    gc.collect()
    assert len(building._BESIDE) == before - 1
    building.finish_compiling()


def test_ctrl_c_ends_what_is_waited_for_and_nobody_goes_on_with_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Never:
        def ready(self) -> bool:
            return False

        def get(self) -> None:
            raise KeyboardInterrupt

    function = ca.Function("f", [], [])
    begun = Never(), lambda: None
    monkeypatch.setattr(background, "_BEGUN", [begun])
    monkeypatch.setitem(building._BESIDE, function, (begun[0], np.zeros(0)))
    with pytest.raises(KeyboardInterrupt):
        building.compile_function(function)
    assert not background._BEGUN


@pytest.mark.slow
@needs_compiler
@pytest.mark.skipif(sys.platform == "win32", reason="timers by signals")
@PYTHON_MAY_LOSE_IT
def test_whenever_it_is_pressed_nothing_half_made_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    x = ca.SX.sym("x", 200)
    draw = random.Random(44)
    y = x
    for _ in range(20):
        y = ca.sin(y) + ca.vertcat(y[1:], y[0])

    def function(k: int) -> ca.Function:
        return ca.Function(f"f{k}", [x], [y])

    begin = perf_counter()
    assert building.compile_function(whole := function(0)) is not whole
    lasts = perf_counter() - begin
    for k in range(1, 51):
        with pressed_after(draw.uniform(0.001, 0.9 * lasts)) as pressed:
            begin = perf_counter()
            try:
                with raised_outside_casadi():
                    building.compile_function(function(k))
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                assert not pressed
            except KeyboardInterrupt:
                assert perf_counter() - begin < lasts + 1.0
        for library in cached_libraries(tmp_path):
            assert libraries.is_usable(library)
        assert not list(tmp_path.glob(f"{HALF_MADE}*"))
    assert building.compile_function(again := function(51)) is not again


@needs_compiler
def test_it_is_said_of_long_code_how_long_it_takes(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler_log, "_PACE", 3.0 / len(SOURCE))
    for _ in range(2):
        libraries.compile_library(SOURCE, name="the answer")
    (record,) = (record for record in caplog.records if "about" in record.getMessage())
    assert record.getMessage() == "compiling the answer, which takes about 3 s"
    assert getattr(record, compiler_log.PROGRESS)


def test_a_time_limit_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for words in ("soon", "0", "-1", "nan", "inf"):
        monkeypatch.setenv("UVMS_OCP_COMPILE_TIMEOUT", words)
        with pytest.raises(
            InvalidInput, match=f"UVMS_OCP_COMPILE_TIMEOUT = '{words}'; give seconds"
        ):
            compile_timeout()


@needs_compiler
def test_an_intact_library_that_cannot_be_loaded_is_compiled_anew() -> None:
    path = _compile_visible()
    assert path is not None
    path.write_bytes(b"of another machine")
    path.with_suffix(".sha256").write_text(digest(path.read_bytes()), encoding="ascii")
    assert _answer(_compile_visible()) == 42.0


@needs_compiler
def test_a_library_without_the_function_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    compiler_log._SAID.clear()
    with caplog.at_level(logging.WARNING):
        assert building.external_function("missing", SOURCE) is None
        assert building.external_function("missing", SOURCE) is None
    assert caplog.text.count("does not define missing") == 1


@needs_compiler
def test_without_a_home_or_with_one_that_is_read_only_the_cache_is_among_the_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in ("UVMS_OCP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "file").write_text("")
    for home in ("", "relative", str(tmp_path / "file")):
        monkeypatch.setenv("HOME", home)
        folder, _ = cache_folder()
        assert folder is not None
        assert folder.parent == tmp_path
        assert _answer(_compile_visible()) == 42.0
    assert not Path("relative").exists()


@needs_compiler
def test_a_cache_on_a_disk_that_runs_no_programs_is_said_and_not_compiled_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    compiler_log._SAID.clear()
    flags = types.SimpleNamespace(f_flag=getattr(os, "ST_NOEXEC", 8))
    monkeypatch.setattr(os, "statvfs", lambda path: flags)
    with caplog.at_level(logging.WARNING):
        assert _compile_visible() is None
    assert "mounted noexec" in caplog.text
    assert not list((tmp_path / "cache").iterdir())


@needs_compiler
def test_source_that_does_not_compile_gives_nothing_but_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    compiler_log._SAID.clear()
    with caplog.at_level(logging.WARNING):
        assert libraries.compile_library("this is not C") is None
    assert "failed" in caplog.text


@needs_compiler
def test_a_compiled_function_keeps_names_sparsity_and_values() -> None:
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [ca.sin(x), ca.diag(x)], ["angle"], ["sine", "spread"])
    compiled = building.compile_function(function)
    assert compiled.class_name() == "External"
    assert compiled.name_in() == function.name_in()
    assert compiled.name_out() == function.name_out()
    assert compiled.sparsity_out(1) == function.sparsity_out(1)
    np.testing.assert_allclose(
        np.asarray(compiled([1, 2, 3])[0]), np.sin([[1.0], [2.0], [3.0]]), rtol=1e-15
    )


def test_without_a_compiler_a_function_is_returned_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [x])
    monkeypatch.setattr(c_compiler, "find_compiler", lambda: None)
    assert building.compile_function(function) is function
