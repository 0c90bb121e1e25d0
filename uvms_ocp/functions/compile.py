"""C source to shared library, compiled once and cached; where that cannot be done callers fall back to slower code.

Either is said once per process as a warning of the logger ``uvms_ocp.functions.compile``: no compiler, one that fails, hangs
or writes garbage, a full disk, a cache that cannot be written or whose libraries cannot be loaded.

A library is found by the hash of its source, flags and compiler; its own hash is stored beside it and checked before
every use, so that an interrupted compilation, a damaged file or garbage in the cache leads to a new compilation.
Every process compiles to a file of its own and moves it into place, which the operating system does atomically.
"""

from __future__ import annotations

import _ctypes
import ctypes
import hashlib
import logging
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache, lru_cache
from pathlib import Path

import casadi as ca

from uvms_ocp.arguments import checked
from uvms_ocp.functions.compiler import call, compile_timeout
from uvms_ocp.functions.library_cache import cache_folder

_FLAGS = ("-O3", "-shared", "-fPIC", "-ffp-contract=off")
# Code without loops gains nothing from more optimisation but the time that takes.
_STRAIGHT = ("-O1", "-fstrict-aliasing", "-finline-small-functions", "-fno-semantic-interposition")
# fmax and fmin are calls into libm, hundreds in a tick; like them these return what is a number where one of both is.
MATH = """#include <math.h>
static inline double larger(double x, double y) { return x >= y || y != y ? x : y; }
static inline double smaller(double x, double y) { return x <= y || y != y ? x : y; }
#define fmax larger
#define fmin smaller
"""
"""Before the code of CasADi functions."""
PROGRESS = "progress"
"""Attribute of what is logged as a warning to be seen, and warns of nothing."""
_VERSION_TIMEOUT = 30.0  # [s]
_HUNG: set[str] = set()  # compilers, which are not called again
_SAID: set[str] = set()
_HOMES: dict[ca.Function, Path] = {}  # of compiled functions
_SLOWER = "everything works, only slower"
_log = logging.getLogger(__name__)


@checked
def compile_library(
    source: str, flags: Sequence[str] = (), name: str = "C code", others: Sequence[str] = ()
) -> Path | None:
    """Path of the library of ``source`` (C, linked with libm), which can be loaded; None where there is none (logged once).

    name: what it is called where the log tells, at level INFO, that it is being compiled. others: more sources of the same
    library, each compiled by itself.

    The path is inside the user's cache, or inside ``UVMS_OCP_CACHE`` if that is set. A compiler is stopped after
    ``UVMS_OCP_COMPILE_TIMEOUT`` seconds, 300 by default. Raises `InvalidInput` where that is no time.
    """
    compiler = _compiler()
    if compiler is None or compiler in _HUNG:
        return None
    directory, reason = cache_folder()
    if directory is None:
        _warn_once(reason)
        return None
    flags = (*_FLAGS, *flags)
    try:
        sources = (source, *others)
        library = directory / f"{_key(sources, flags, compiler)}.so"
        if _is_intact(library) and not _load_error(library):
            return library
        return library if _build(compiler, sources, flags, library, name) else None
    except subprocess.TimeoutExpired as error:
        _HUNG.add(compiler)
        _warn_once(f"{compiler} was stopped after {error.timeout:g} s")
        return None


@checked
def compile_function(function: ca.Function) -> ca.Function:
    """``function`` in machine code with the same names and sparsities; itself where it cannot be compiled."""
    generator = ca.CodeGenerator("function.c")
    generator.add(function)
    compiled = external_function(function.name(), MATH + generator.dump(), _STRAIGHT)
    return function if compiled is None else compiled


@checked
def external_function(name: str, source: str, flags: Sequence[str] = ()) -> ca.Function | None:
    """The CasADi function ``name`` that ``source`` defines, compiled; None where that cannot be (logged once)."""
    path = compile_library(source, flags, name)
    if path is None:
        return None
    try:
        function = ca.external(name, str(path))
        _HOMES[function] = path
        return function
    except RuntimeError:  # the library is one, but not of this source
        _warn_once(f"{path} does not define {name}")
        return None


def compiled_symbol(function: ca.Function) -> int | None:
    """Address of the machine code of ``function``, for other machine code to call; None where it cannot be compiled."""
    path = _HOMES.get(function) or _HOMES.get(compile_function(function))
    return None if path is None else ctypes.cast(loaded_library(path)[function.name()], ctypes.c_void_p).value


@cache
def loaded_library(path: Path) -> ctypes.CDLL:
    """The library at `path`, as `compile_library` gives it; loaded once."""
    return ctypes.CDLL(str(path))


def _key(sources: Sequence[str], flags: Sequence[str], compiler: str) -> str:
    identity = (*sources, *flags, compiler, _version(compiler), platform.machine(), sys.platform)
    return hashlib.sha256("\0".join(identity).encode()).hexdigest()


def warn_if_slower() -> None:
    """Log now, once, that there is no compiler or no cache: for who starts processes that say nothing."""
    if _compiler() is not None:
        directory, reason = cache_folder()
        if directory is None:
            _warn_once(reason)


def has_compiler() -> bool:
    """Whether there is one, and it has not been found to hang."""
    return _compiler() not in {None, *_HUNG}


@lru_cache(maxsize=1)
def _compiler() -> str | None:
    names = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    found = next((path for name in names if name and (path := shutil.which(name))), None)
    if found is None:
        _log.warning("no C compiler found (CC, cc, gcc, clang): %s", _SLOWER)
    return found


@lru_cache(maxsize=4)
def _version(compiler: str) -> str:
    try:
        return call([compiler, "--version"], min(_VERSION_TIMEOUT, compile_timeout()))[1]
    except OSError:
        return ""


def _warn_once(what: str, detail: str = "") -> None:
    if what not in _SAID:
        _SAID.add(what)
        _log.warning("%s: %s", f"{what} ({detail})" if detail else what, _SLOWER)


@lru_cache(maxsize=1)
def _announce(directory: Path) -> None:
    # A warning, as Python shows it by default: a silent half minute looks like a hang.
    text = "compiling C code for the first time, which takes a while; kept in %s"
    _log.warning(text, directory, extra={PROGRESS: True})


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _is_intact(library: Path) -> bool:
    try:
        return library.with_suffix(".sha256").read_text(encoding="ascii") == _digest(library.read_bytes())
    except (OSError, UnicodeDecodeError):
        return False


def _load_error(library: Path) -> str:
    """Why it cannot be loaded, empty where it can; it is let go again, as the file may be replaced before it is used."""
    try:
        handle = ctypes.CDLL(str(library))._handle
    except OSError as error:
        return " ".join(str(error).split())
    if sys.platform == "win32":
        _ctypes.FreeLibrary(handle)
    else:
        _ctypes.dlclose(handle)
    return ""


def _build(compiler: str, sources: Sequence[str], flags: Sequence[str], library: Path, name: str) -> bool:
    _announce(library.parent)
    _log.info("compiling %s", name)
    try:
        with tempfile.TemporaryDirectory(prefix="build-", dir=library.parent) as folder:
            return _build_in(Path(folder), compiler, sources, flags, library)
    except OSError as error:
        _warn_once("compilation failed", error.strerror or str(error))
        return False


def _build_in(folder: Path, compiler: str, sources: Sequence[str], flags: Sequence[str], library: Path) -> bool:
    built, codes = folder / "library.so", [folder / f"source{k}.c" for k in range(len(sources))]
    for code, source in zip(codes, sources, strict=True):
        code.write_text(source, encoding="utf-8")
    failed, said = call([compiler, *flags, "-o", str(built), *map(str, codes), "-lm"], compile_timeout())
    if failed:
        _warn_once(f"{compiler} failed", ascii(" ".join(said.split())[-200:]))
        return False
    if problem := _load_error(built):
        _warn_once(f"what {compiler} made cannot be loaded", problem)
        return False
    _move(built, library)
    return True


def _move(built: Path, library: Path) -> None:
    """Into the cache, with the hash of what it is."""
    digest = built.with_name("digest")
    digest.write_text(_digest(built.read_bytes()), encoding="ascii")
    # Between the two moves the pair does not match, which only costs another process a compilation.
    os.replace(built, library)
    os.replace(digest, library.with_suffix(".sha256"))
