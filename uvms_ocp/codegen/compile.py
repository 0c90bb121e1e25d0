"""Compile C source and CasADi functions into shared libraries, once, in a cache of the user's own.

Where that cannot be done callers fall back to slower code. Functions that differ in their numbers
alone share machine code: each gets a copy of the library with numbers of its own, which is let go
with the function.

Either is said once per process as a warning of the logger ``uvms_ocp.codegen.compile``: no
compiler, one that fails, hangs or writes garbage, a full disk, a cache that cannot be written or
whose libraries cannot be loaded.

A library is found by the hash of its source, flags and compiler; its own hash is stored beside it
and checked before every use, so that an interrupted compilation, a damaged file or garbage in the
cache leads to a new compilation. Every process compiles to a file of its own and moves it into
place, which the operating system does atomically.
"""

from __future__ import annotations

import _ctypes
import atexit
import ctypes
import hashlib
import logging
import os
import pickle
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from functools import cache, lru_cache, partial
from importlib.resources import files
from multiprocessing.pool import AsyncResult, ThreadPool
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.codegen import casadi_code
from uvms_ocp.codegen.cache import HALF_MADE, KEPT_NUMBERS, cache_folder, shrink_cache, turn_to_make
from uvms_ocp.errors import InvalidInput
from uvms_ocp.progress import progress_bar

_FLAGS = ("-O3", "-shared", "-fPIC", "-ffp-contract=off")
"""Flags of all compilations, before those of the caller and of the user."""
_EXACT = ("-fno-fast-math", "-ffp-contract=off", "-fno-tree-slp-vectorize")
"""Flags behind those of the user, so that numbers are the same with them: see exact.c."""
_STRAIGHT = (
    "-O1",
    "-fstrict-aliasing",
    "-finline-small-functions",
    "-fno-semantic-interposition",
)
"""Flags for code without loops, which gains nothing from more optimisation but the time that takes."""
_LONG_STRAIGHT = ("-Og", "-finline-small-functions", "-fno-semantic-interposition")
"""Flags for long code without loops: half the time of `_STRAIGHT`."""
_LONG_CODE = 200_000
"""[bytes] from which code is compiled with `_LONG_STRAIGHT`."""


def _c_text(name: str) -> str:
    """Read a file of C beside this one."""
    return (files("uvms_ocp.codegen") / f"{name}.c").read_text("utf-8")


MATH = _c_text("math")
"""Text before the code of CasADi functions: fmax and fmin would be calls into libm, hundreds in a
tick; like them these return what is a number where one of both is.
"""
PARTS = _c_text("parts")
"""Text before the code of CasADi functions that are in parts."""
WIDE_MACROS = _c_text("wide")
"""Text before what is marked WIDE or INLINE."""
EXACT = _c_text("exact")
"""Text before what other programs compile, so that their flags change no number."""
# Numbers of a library: constants of it, or set when it is loaded, and then they stay.
_CONSTANT_NUMBERS = '__attribute__((visibility("hidden"))) extern const double numbers[{n} + 1];\n'
_SET_NUMBERS = """__attribute__((visibility("hidden"))) double numbers[{n} + 1];
void* numbers_address(void) {{ return numbers; }}
"""
MOST_CACHED = 1e9
"""[bytes] beyond which libraries that were used longest ago are removed."""
PROGRESS = "progress"
"""Attribute of what is logged as a warning to be seen, and warns of nothing."""
_KEPT_FUNCTIONS = 48
"""Loaded functions that all callers share."""
_MAX_COMPILERS = 4
"""Compilers of a process at once: the processes of a campaign are many."""
_TIMEOUT = 300.0
"""[s] Time after which a compiler is stopped: ten times what the longest of ours takes."""
_VERSION_TIMEOUT = 30.0
"""[s] Time after which a compiler is stopped that is asked for its version."""
_PACE = 1.2e-6
"""[s] Time that a byte of long code takes to compile."""
_LONG = 2.0
"""[s] Time of silence that looks like a hang."""
_MAX_OUTPUT = 2000
"""[bytes] of what a compiler writes that are kept."""
_SLOWER = "everything works, only slower"
"""Consequence of a missing compiler, in a warning."""
_NO_NUMBERS = np.zeros(0)
_WAITS = ContextVar("waits", default=True)
"""True where a call waits for its machine code; false inside `compiling_beside`."""
_HUNG: set[str] = set()
"""Compilers that have hung, which are not called again."""
_SAID: set[str] = set()
"""Warnings that have been logged, each once."""
_ADDRESSES = WeakKeyDictionary[ca.Function, dict[str, int | None]]()
"""Addresses of compiled functions, by symbol."""
_BESIDE = WeakKeyDictionary[ca.Function, tuple[AsyncResult[Path | None], np.ndarray]]()
"""Functions that are being compiled in the background: their library, and their numbers."""
_BEGUN: list[tuple[AsyncResult[Any], Callable[[], Any]]] = []
"""Compilations in the background, whether anybody waits for them or not."""
_STARTING = threading.RLock()
"""Held while a compiler is started, so that no fork happens in between."""
_RUNNING = set[subprocess.Popen[bytes]]()
"""Compilers that run."""
_BEHIND = threading.Event()
"""Set in a process that compiles behind all other work of the machine."""
_log = logging.getLogger(__name__)

T = TypeVar("T")


@checked
def compile_library(
    source: str,
    flags: Sequence[str] = (),
    name: str = "C code",
    others: Sequence[str] = (),
    prepare: Callable[[str], str] = str,
) -> Path | None:
    """Return the path of the library of ``source`` (C, linked with libm), which can be loaded; None
    where there is none (logged once).

    name: what it is called where the log tells, at level INFO, that it is being compiled. others:
    more sources of the same library, each compiled by itself. prepare: makes of the source what is
    compiled, where it is not kept already.

    The path is inside the user's cache, or inside ``UVMS_OCP_CACHE`` if that is set. A compiler is
    stopped after ``UVMS_OCP_COMPILE_TIMEOUT`` seconds, 300 by default. Raises `InvalidInput` where
    that is no time. Flags of ``UVMS_OCP_CFLAGS`` come after ours: with ``-O0`` compilation takes
    half the time, and what runs two to five times as long. Those that change numbers are undone.
    """
    compiler = _compiler()
    if compiler is None or compiler in _HUNG:
        return None
    directory, reason = cache_folder()
    if directory is None:
        _warn_once(reason)
        return None
    flags = (*_FLAGS, *flags)
    user_flags = os.environ.get("UVMS_OCP_CFLAGS", "").split()
    if user_flags:
        flags = (*flags, *user_flags, *_EXACT)
    try:
        sources = (source, *others)
        library = directory / f"{_key(sources, flags, compiler)}.so"
        if _is_usable(library):
            with suppress(OSError):
                os.utime(library)  # used now
            return library
        if not _build(compiler, (prepare(source), *others), flags, library, name):
            return None
        shrink_cache(directory, MOST_CACHED)
        return library
    except subprocess.TimeoutExpired as error:
        _HUNG.add(compiler)
        _warn_once(f"{compiler} was stopped after {error.timeout:g} s")
        return None


@checked
def compile_function(function: ca.Function) -> ca.Function:
    """Return ``function`` in machine code with the same names and sparsities; itself where it
    cannot be compiled.

    What is returned is of this process: give others ``function``.
    """
    if function in _ADDRESSES:
        return function
    begun = _BESIDE.pop(function, None)
    if begun is not None:
        return _function_in(_awaited(begun[0]), function.name(), begun[1]) or function
    compilation, numbers = _compilation(function)
    return _function_in(compilation(), function.name(), numbers) or function


def _awaited(result: AsyncResult[Path | None]) -> Path | None:
    try:
        return result.get()
    except KeyboardInterrupt:  # which ends what it waits for
        _BEGUN.clear()
        raise


@contextmanager
def compiling_beside(in_background: bool) -> Iterator[None]:
    """Inside, `available_function` waits for no compiler, unless ``UVMS_OCP_WAIT_FOR_COMPILER`` is
    set.
    """
    is_wait_required = os.environ.get("UVMS_OCP_WAIT_FOR_COMPILER", "0") not in {"", "0"}
    previous = _WAITS.set(not in_background or is_wait_required)
    try:
        yield
    finally:
        _WAITS.reset(previous)


def waits_for_compiler() -> bool:
    """Tell whether machine code is waited for, as it is outside of `compiling_beside`."""
    return _WAITS.get()


def is_being_compiled(function: ca.Function) -> bool:
    """Check for machine code that is not there yet, but will be."""
    begun = _BESIDE.get(function)  # once: other threads take them from there
    return begun is not None and not begun[0].ready()


def available_function(function: ca.Function) -> ca.Function:
    """Return `compile_function` of a function, or inside `compiling_beside` the function itself
    while it is being compiled.
    """
    if waits_for_compiler() or not is_being_compiled(function):
        return compile_function(function)
    _BESIDE.pop(function, None)
    return function


def start_compiling(function: ca.Function, entry: Path | None = None) -> ca.Function:
    """Start to compile a function in the background, and return it: `compile_function` and
    `compiled_symbol` wait for the end.

    entry: file of the cache that will say in which library the function is, with which numbers.
    """
    if not has_compiler():
        return function
    work, numbers = _compilation(function)
    if entry is not None:
        work = partial(_keep, entry, numbers, work)
    _BESIDE[function] = (start_beside(work), numbers)
    return function


def start_beside(work: Callable[[], T]) -> AsyncResult[T]:
    """Start a compilation in the background; where this process ends first, another one finishes
    it. work: can be pickled, by its name or as a bound method.
    """
    _BEGUN[:] = [begun for begun in _BEGUN if not begun[0].ready()]
    result = _workers(os.getpid()).apply_async(work)
    _BEGUN.append((result, work))
    return result


def compiled_from(
    name: str, content: str, make: Callable[[], ca.Function], *modules: str
) -> ca.Function:
    """Return the function of that name which `make` makes, compiled in the background as by
    `start_compiling`.

    Where it was compiled before it is not made at all: the cache keeps in which library it is, and
    with which numbers. content: all that the function depends on but CasADi, the compiler, and the
    files `modules` of the code that `make` runs.
    """
    entry, cached = _looked_up(name, content, *modules)
    if cached:
        library, numbers = cached
        function = _function_in(library, name, numbers)
        if function:
            return function
    return start_compiling(make(), entry)


def library_from(name: str, content: str, make: Callable[[], str], *modules: str) -> Path | None:
    """Return the library of the source that `make` makes of a content, kept in the cache as by
    `compiled_from`.
    """
    entry, cached = _looked_up(name, content, *modules)
    if cached:
        return cached[0]
    return _keep(entry, _NO_NUMBERS, partial(compile_library, make(), name=name))


def _looked_up(
    name: str, content: str, *modules: str
) -> tuple[Path | None, tuple[Path, np.ndarray] | None]:
    """Return the cache entry for what is made of a content, None without a cache, and what it
    holds.
    """
    compiler = _compiler()
    folder = cache_folder()[0]
    if compiler is None or folder is None:
        return None, None
    flags = (
        _code_of(__file__),
        *map(_code_of, modules),
        ca.__version__,
        os.environ.get("UVMS_OCP_CFLAGS", ""),
    )
    entry = folder / f"{_key((name, content), flags, compiler)}{KEPT_NUMBERS}"
    return entry, _kept(entry)


def content_of(inputs: Sequence[ca.SX], outputs: Sequence[ca.SX], *more: object) -> str:
    """Hash expressions, without differentiating them, and whatever else a function is made of."""
    function = ca.Function("content", list(inputs), list(outputs))
    return _digest(f"{function.serialize()} {more}".encode())


@cache
def _code_of(module: str) -> str:
    return _digest(Path(module).read_bytes())


def _keep(
    entry: Path | None, numbers: np.ndarray, compilation: Callable[[], Path | None]
) -> Path | None:
    """Compile, and write into the cache entry in which library that is, with which numbers."""
    library = compilation()
    if library is None or entry is None:
        return library
    data = f"{library.name}\n".encode() + numbers.tobytes()
    with (
        suppress(OSError),
        tempfile.TemporaryDirectory(prefix=HALF_MADE, dir=entry.parent) as folder,
    ):
        written = Path(folder) / entry.name
        written.write_bytes(_digest(data).encode() + data)
        os.replace(written, entry)
    return library


def _kept(entry: Path) -> tuple[Path, np.ndarray] | None:
    """Return the library and numbers of a cache entry; None where one of them is missing or
    damaged.
    """
    with suppress(OSError):
        content = entry.read_bytes()
        if content[:64] != _digest(content[64:]).encode():
            return None
        name, _, numbers = content[64:].partition(b"\n")
        library = entry.with_name(name.decode())
        if _is_usable(library):
            for path in (entry, library):
                os.utime(path)  # used now
            return library, np.frombuffer(numbers)
    return None


def finish_compiling() -> None:
    """Wait for all that was begun, and show how far that is."""
    with progress_bar(total=len(_BESIDE), desc="compiling", unit="function", delay=_LONG) as bar:
        for function in list(_BESIDE):
            compiled_symbol(function)
            bar.update()


def n_processors() -> int:
    """Count the processors that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _workers(process: int) -> ThreadPool:
    """Return the compiler threads of this process, as a fork has none; they end with it, whatever
    is still being compiled.
    """
    pool = ThreadPool(min(_MAX_COMPILERS, n_processors()))

    def terminate() -> None:
        if os.getpid() == process:
            pool.terminate()

    atexit.register(terminate)
    return pool


def _compilation(function: ca.Function) -> tuple[Callable[[], Path | None], np.ndarray]:
    """Return the work of compiling a function, for any thread, and its numbers; CasADi writes the
    code here.
    """
    generator = ca.CodeGenerator("function.c", {"verbose": False})
    generator.add(function)
    form, numbers = casadi_code.without_numbers(generator.dump())
    comment = f"/* {_code_of(casadi_code.__file__)} */\n"
    declaration = _CONSTANT_NUMBERS.format(n=len(numbers))
    source = comment + MATH + PARTS + declaration + form
    flags = _STRAIGHT if len(form) < _LONG_CODE else _LONG_STRAIGHT
    definition = _SET_NUMBERS.format(n=len(numbers))
    work = partial(
        compile_library, source, flags, function.name(), (definition,), casadi_code.in_parts
    )
    return work, numbers


@checked
def external_function(name: str, source: str, flags: Sequence[str] = ()) -> ca.Function | None:
    """Return the CasADi function ``name`` that ``source`` defines, compiled; None where that cannot
    be (logged once).
    """
    return _function_in(compile_library(source, flags, name), name)


def _function_in(
    path: Path | None, name: str, numbers: np.ndarray = _NO_NUMBERS
) -> ca.Function | None:
    try:
        if path is None:
            return None
        return _external(name, path, numbers.tobytes())
    except RuntimeError:  # the library is one, but not of this source
        _warn_once(f"{path} does not define {name}")
    except OSError as error:
        _warn_once(f"{path} cannot be copied", error.strerror or str(error))
    return None


@lru_cache(maxsize=_KEPT_FUNCTIONS)
def _external(name: str, path: Path, numbers: bytes) -> ca.Function:
    """Load a function of a library once for all callers, so that runs of the same robot and mission
    share its memory.
    """
    with tempfile.TemporaryDirectory(
        prefix=HALF_MADE, dir=path.parent, ignore_cleanup_errors=True
    ) as folder:
        if numbers:  # a library of its own, which needs no file once it is loaded
            path = Path(shutil.copy(path, folder))
        library = ctypes.CDLL(str(path))
        if numbers:
            library.numbers_address.restype = ctypes.c_void_p
            ctypes.memmove(library.numbers_address(), numbers, len(numbers))
        function = ca.external(name, str(path))
        addresses = dict[str, int | None]()
        for symbol in (name, casadi_code.TWO_CALLS):
            if hasattr(library, symbol):
                addresses[symbol] = ctypes.cast(library[symbol], ctypes.c_void_p).value
        _ADDRESSES[function] = addresses
        _close(library)  # the function holds it
    return function


def compiled_symbol(function: ca.Function) -> int | None:
    """Return the address of the machine code of ``function``, for other machine code to call; None
    where it cannot be compiled.

    It is valid as long as ``function``.
    """
    if function in _ADDRESSES:
        return _ADDRESSES[function][function.name()]
    if not hasattr(function, "machine_code"):
        compiled = compile_function(function)
        if compiled is function:
            return None
        function.machine_code = compiled
    return compiled_symbol(function.machine_code)


def two_calls(function: ca.Function) -> int | None:
    """Return the address of the machine code for two calls of ``function`` at once, once that is
    compiled; None where there is none.
    """
    compiled = getattr(function, "machine_code", function)
    return _ADDRESSES.get(compiled, {}).get(casadi_code.TWO_CALLS)


@cache
def loaded_library(path: Path) -> ctypes.CDLL:
    """Load the library at `path`, as `compile_library` gives it; once."""
    return ctypes.CDLL(str(path))


def constants_of(module: ModuleType) -> dict[str, float]:
    """Return the numbers that a module names in capitals."""
    constants = {}
    for name, value in vars(module).items():
        if name.isupper() and isinstance(value, int | float):
            constants[name] = value
    return constants


def c_macros(values: Mapping[str, object]) -> str:
    """Define a macro for each value, under its name in capitals."""
    macros = ""
    for name, value in values.items():
        macros += f"#define {name.upper()} {value}\n"
    return macros


def _key(sources: Sequence[str], flags: Sequence[str], compiler: str) -> str:
    identity = (*sources, *flags, compiler, _version(compiler), platform.machine(), sys.platform)
    return hashlib.sha256("\0".join(identity).encode()).hexdigest()


def warn_if_slower() -> None:
    """Log once that there is no compiler or no cache, before starting processes that log
    nothing.
    """
    if _compiler() is not None:
        directory, reason = cache_folder()
        if directory is None:
            _warn_once(reason)


def has_compiler() -> bool:
    """Check that there is a compiler that has not been found to hang, and a folder for what it
    makes.
    """
    return _compiler() not in {None, *_HUNG} and cache_folder()[0] is not None


@lru_cache(maxsize=1)
def _compiler() -> str | None:
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        compiler = shutil.which(name) if name else None
        if compiler:
            return compiler
    _log.warning("no C compiler found (CC, cc, gcc, clang): %s", _SLOWER)
    return None


@lru_cache(maxsize=4)
def _version(compiler: str) -> str:
    with suppress(OSError):
        return run_compiler([compiler, "--version"], min(_VERSION_TIMEOUT, compile_timeout()))[1]
    return ""


def _warn_once(event: str, detail: str = "") -> None:
    if not threading.main_thread().is_alive():  # its compiler was ended with it
        return
    if event in _SAID:
        return
    _SAID.add(event)
    text = f"{event} ({detail})" if detail else event
    _log.warning("%s: %s", text, _SLOWER)


@lru_cache(maxsize=1)
def _announce(directory: Path) -> None:
    # A warning, as Python shows it by default: a silent half minute looks like a hang.
    _log.warning(
        "compiling C code for the first time, which takes a while; kept in %s",
        directory,
        extra={PROGRESS: True},
    )


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _is_usable(library: Path) -> bool:
    """Check that it is what was compiled, and can be loaded."""
    with suppress(OSError, UnicodeDecodeError):
        digest = library.with_suffix(".sha256").read_text(encoding="ascii")
        is_intact = digest == _digest(library.read_bytes())
        return is_intact and not _load_error(library)
    return False


def _load_error(library: Path) -> str:
    """Return why a library cannot be loaded, empty where it can; it is closed again, as the file
    may be replaced before it is used.
    """
    try:
        _close(ctypes.CDLL(str(library)))
    except OSError as error:
        return " ".join(str(error).split())
    return ""


def _close(library: ctypes.CDLL) -> None:
    if sys.platform == "win32":
        _ctypes.FreeLibrary(library._handle)
    else:
        _ctypes.dlclose(library._handle)


def _build(
    compiler: str, sources: Sequence[str], flags: Sequence[str], library: Path, name: str
) -> bool:
    _announce(library.parent)
    _log.info("compiling %s", name)
    seconds = _PACE * sum(map(len, sources))
    if seconds > _LONG:
        _log.warning(
            "compiling %s, which takes about %.0f s", name, seconds, extra={PROGRESS: True}
        )
    try:
        # Who works behind all others takes no turn, or they would wait for that.
        turn: AbstractContextManager[None]
        if _BEHIND.is_set():
            turn = nullcontext()
        else:
            turn = turn_to_make(library, compile_timeout())
        with turn, tempfile.TemporaryDirectory(prefix=HALF_MADE, dir=library.parent) as folder:
            return _is_usable(library) or _build_in(Path(folder), compiler, sources, flags, library)
    except OSError as error:
        _warn_once("compilation failed", error.strerror or str(error))
        return False


def _build_in(
    folder: Path, compiler: str, sources: Sequence[str], flags: Sequence[str], library: Path
) -> bool:
    built = folder / "library.so"
    paths = list[str]()
    for k, source in enumerate(sources):
        path = folder / f"source{k}.c"
        path.write_text(source, encoding="utf-8")
        paths.append(str(path))
    command = [compiler, *flags, "-o", str(built), *paths, "-lm"]
    failed, output = run_compiler(command, compile_timeout())
    if failed:
        _warn_once(f"{compiler} failed", ascii(" ".join(output.split())[-200:]))
        return False
    problem = _load_error(built)
    if problem:
        _warn_once(f"what {compiler} made cannot be loaded", problem)
        return False
    # Into the cache, with the hash of what it is.
    digest = built.with_name("digest")
    digest.write_text(_digest(built.read_bytes()), encoding="ascii")
    # Between the two moves the pair does not match, which only costs another process a compilation.
    os.replace(built, library)
    os.replace(digest, library.with_suffix(".sha256"))
    return True


def compile_timeout() -> float:
    """Return the time [s] after which a compiler is stopped: ``UVMS_OCP_COMPILE_TIMEOUT``. Raises
    `InvalidInput` where that is no time.
    """
    configured = os.environ.get("UVMS_OCP_COMPILE_TIMEOUT", "")
    try:
        seconds = float(configured or _TIMEOUT)
    except ValueError:
        seconds = -1.0
    if not 0.0 < seconds < 1e9:
        raise InvalidInput(
            f"UVMS_OCP_COMPILE_TIMEOUT = {configured!r}; give seconds, such as {_TIMEOUT:g}"
        )
    return seconds


def run_compiler(command: Sequence[str], seconds: float) -> tuple[int, str]:
    """Run a compiler for at most that many `seconds` [s]; return its code and the end of what it
    wrote on both outputs.

    Raises `OSError` where it cannot be run, and `subprocess.TimeoutExpired` where it was stopped,
    with all its children.
    """
    with tempfile.TemporaryFile() as output:
        with _STARTING:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            _RUNNING.add(process)
        try:
            code = process.wait(seconds)
        except BaseException:  # Ctrl-C too, which does not reach a session of its own
            _kill(process)
            raise
        finally:
            _RUNNING.discard(process)
        size = output.seek(0, os.SEEK_END)
        output.seek(max(0, size - _MAX_OUTPUT))
        return code, output.read().decode(errors="replace")


@atexit.register
def _end_compilers() -> None:
    """Stop all compilers as the process ends, which threads that wait for them do not notice."""
    _STARTING.acquire()  # and none begins any more
    unfinished = [work for result, work in _BEGUN if not result.ready()]
    for process in _RUNNING.copy():
        _kill(process)
    if unfinished:
        _hand_over(unfinished)


def _hand_over(unfinished: Sequence[Callable[[], object]]) -> None:
    """Give unfinished compilations to a process of their own, so that the next process finds their
    libraries.
    """
    is_python = "python" in Path(sys.executable or "").name.lower()
    if not is_python:  # but a program that has Python in it, and would begin anew
        return
    imports = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import compile_what_is_left"
    with suppress(OSError, AttributeError, pickle.PicklingError), tempfile.TemporaryFile() as file:
        pickle.dump(unfinished, file)
        file.seek(0)
        subprocess.Popen(
            [sys.executable, "-c", f"{imports}; compile_what_is_left()"],
            stdin=file,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def compile_what_is_left() -> None:
    """Compile what another process has begun and left on stdin, behind all other work of the
    machine.
    """
    if sys.platform != "win32":
        os.nice(19)
    _BEHIND.set()
    jobs = pickle.load(sys.stdin.buffer)
    workers = _workers(os.getpid())
    results = [workers.apply_async(job) for job in jobs]
    for result in results:
        result.wait()


def _forget_threads() -> None:
    """Forget in a fork the threads and compilers, which are those of its parent."""
    _BESIDE.clear()
    _BEGUN.clear()
    _RUNNING.clear()
    _STARTING.release()


if sys.platform != "win32":
    # A fork in the middle of a start would hold open the pipe by which the starting thread hears
    # that its compiler runs.
    os.register_at_fork(
        before=_STARTING.acquire, after_in_parent=_STARTING.release, after_in_child=_forget_threads
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        process.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()
