"""C source to shared library, compiled once and cached; without a C compiler callers fall back to slower code.

Either is said once per process as a warning of the logger ``uvms_ocp.functions.compile``.

A library is found by the hash of its source, flags and compiler; its own hash is stored beside it and checked before
every use, so that an interrupted compilation, a damaged file or garbage in the cache leads to a new compilation.
Every process compiles to a file of its own and moves it into place, which the operating system does atomically.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import casadi as ca

from uvms_ocp.arguments import checked

_FLAGS = ("-O3", "-shared", "-fPIC", "-ffp-contract=off")
_TIMEOUT = 300.0  # [s]
_SLOWER = "everything works, only slower"
_log = logging.getLogger(__name__)


@checked
def compile_library(source: str, flags: Sequence[str] = ()) -> Path | None:
    """Path of the library of ``source`` (C, linked with libm), None where it cannot be compiled (logged once).

    The path is inside the user's cache, or inside ``UVMS_OCP_CACHE`` if that is set.
    """
    compiler = _compiler()
    directory = _cache_directory()
    if compiler is None or directory is None:
        return None
    flags = (*_FLAGS, *flags)
    library = directory / f"{_key(source, flags, compiler)}.so"
    if not _is_intact(library) and not _build(compiler, source, flags, library):
        return None
    return library


@checked
def compile_function(function: ca.Function) -> ca.Function:
    """``function`` in machine code with the same names and sparsities; itself where it cannot be compiled."""
    generator = ca.CodeGenerator("function.c")
    generator.add(function)
    # Code without loops gains nothing from more optimisation but the time that takes.
    path = compile_library(generator.dump(), ["-O1"])
    return function if path is None else ca.external(function.name(), str(path))


def _key(source: str, flags: Sequence[str], compiler: str) -> str:
    identity = (source, *flags, compiler, _version(compiler), platform.machine(), sys.platform)
    return hashlib.sha256("\0".join(identity).encode()).hexdigest()


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
        done = subprocess.run([compiler, "--version"], capture_output=True, text=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout


@lru_cache(maxsize=8)
def _warn_once(message: str) -> None:
    _log.warning("%s: %s", message, _SLOWER)


@lru_cache(maxsize=1)
def _announce(directory: Path) -> None:
    # A warning, as Python shows it by default: a silent half minute looks like a hang.
    _log.warning("compiling C code for the first time, about half a minute; kept in %s", directory)


def _cache_directory() -> Path | None:
    """Writable by this user only: a library that others can replace must not be loaded."""
    given = os.environ.get("UVMS_OCP_CACHE")
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    directory = Path(given) if given else base / "uvms_ocp"
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = directory.stat()
    except OSError as error:
        _warn_once(f"cache {directory} cannot be used ({error.strerror})")
        return None
    foreign = sys.platform != "win32" and status.st_uid != os.getuid()
    if foreign or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        _warn_once(f"cache {directory} can be written by others")
        return None
    return directory


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _is_intact(library: Path) -> bool:
    try:
        return library.with_suffix(".sha256").read_text(encoding="ascii") == _digest(library.read_bytes())
    except (OSError, UnicodeDecodeError):
        return False


def _build(compiler: str, source: str, flags: Sequence[str], library: Path) -> bool:
    try:
        with tempfile.TemporaryDirectory(prefix="build-", dir=library.parent) as folder:
            return _build_in(Path(folder), compiler, source, flags, library)
    except (OSError, subprocess.TimeoutExpired) as error:
        _warn_once(f"compilation failed ({error})")
        return False


def _build_in(folder: Path, compiler: str, source: str, flags: Sequence[str], library: Path) -> bool:
    code, built, digest = folder / "source.c", folder / "library.so", folder / "digest"
    _announce(library.parent)
    code.write_text(source, encoding="utf-8")
    command = [compiler, *flags, "-o", str(built), str(code), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT, check=False)
    if done.returncode != 0:
        _warn_once(f"{compiler} failed: {done.stderr.strip().splitlines()[-1:]}")
        return False
    digest.write_text(_digest(built.read_bytes()), encoding="ascii")
    # Between the two moves the pair does not match, which only costs another process a compilation.
    os.replace(built, library)
    os.replace(digest, library.with_suffix(".sha256"))
    return True
