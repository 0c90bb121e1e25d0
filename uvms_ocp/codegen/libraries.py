"""Compile C source into shared libraries, once, in a cache of the user's own.

A library is found by the hash of its source, flags and compiler; its own hash is stored beside it
and checked before every use, so that an interrupted compilation, a damaged file or garbage in the
cache leads to a new compilation. Every process compiles to a file of its own and moves it into
place, which the operating system does atomically.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path

from uvms_ocp.checks import checked
from uvms_ocp.codegen import c_compiler
from uvms_ocp.codegen.cache import HALF_MADE, cache_folder, digest, shrink_cache, turn_to_make
from uvms_ocp.codegen.compiler_log import announce, announce_first_compilation, warn_once
from uvms_ocp.codegen.loading import load_error

MOST_CACHED = 1e9
"""[bytes] beyond which libraries that were used longest ago are removed."""
BEHIND_OTHERS = threading.Event()
"""Set in a process that compiles behind all other work of the machine."""
_FLAGS = ("-O3", "-shared", "-fPIC", "-ffp-contract=off")
"""Flags of all compilations, before those of the caller and of the user."""
_EXACT = ("-fno-fast-math", "-ffp-contract=off", "-fno-tree-slp-vectorize")
"""Flags behind those of the user, so that numbers are the same with them: see exact.c."""


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
    compiler = c_compiler.find_compiler()
    if compiler is None or compiler in c_compiler.HUNG:
        return None
    folder, reason = cache_folder()
    if folder is None:
        warn_once(reason)
        return None
    flags = (*_FLAGS, *flags)
    user_flags = os.environ.get("UVMS_OCP_CFLAGS", "").split()
    if user_flags:
        flags = (*flags, *user_flags, *_EXACT)
    try:
        key = c_compiler.compilation_key((source, *others), flags, compiler)
        library = folder / f"{key}.so"
        if is_usable(library):
            with suppress(OSError):
                os.utime(library)  # used now
            return library
        if not _build(compiler, (prepare(source), *others), flags, library, name):
            return None
        shrink_cache(folder, MOST_CACHED)
        return library
    except subprocess.TimeoutExpired as error:
        c_compiler.HUNG.add(compiler)
        warn_once(f"{compiler} was stopped after {error.timeout:g} s")
        return None


def is_usable(library: Path) -> bool:
    """Check that a library is what was compiled, and can be loaded."""
    with suppress(OSError, UnicodeDecodeError):
        expected = _digest_file(library).read_text(encoding="ascii")
        is_intact = expected == digest(library.read_bytes())
        return is_intact and not load_error(library)
    return False


def _digest_file(library: Path) -> Path:
    """Return the file beside a library that has its hash."""
    return library.with_suffix(".sha256")


def _build(
    compiler: str, sources: Sequence[str], flags: Sequence[str], library: Path, name: str
) -> bool:
    """Compile a library unless another process has made it meanwhile; tell whether it is there."""
    announce_first_compilation(library.parent)
    announce(name, sum(map(len, sources)))
    try:
        # Who works behind all others takes no turn, or they would wait for that.
        turn: AbstractContextManager[None]
        if BEHIND_OTHERS.is_set():
            turn = nullcontext()
        else:
            turn = turn_to_make(library, c_compiler.compile_timeout())
        with turn, tempfile.TemporaryDirectory(prefix=HALF_MADE, dir=library.parent) as folder:
            return is_usable(library) or _build_in(Path(folder), compiler, sources, flags, library)
    except OSError as error:
        warn_once("compilation failed", error.strerror or str(error))
        return False


def _build_in(
    folder: Path, compiler: str, sources: Sequence[str], flags: Sequence[str], library: Path
) -> bool:
    """Compile a library in a folder, and move it to its place in the cache."""
    built = folder / "library.so"
    paths = list[str]()
    for k, source in enumerate(sources):
        path = folder / f"source{k}.c"
        path.write_text(source, encoding="utf-8")
        paths.append(str(path))
    command = [compiler, *flags, "-o", str(built), *paths, "-lm"]
    failed, output = c_compiler.run_compiler(command, c_compiler.compile_timeout())
    if failed:
        warn_once(f"{compiler} failed", ascii(" ".join(output.split())[-200:]))
        return False
    problem = load_error(built)
    if problem:
        warn_once(f"what {compiler} made cannot be loaded", problem)
        return False
    built_digest = _digest_file(built)
    built_digest.write_text(digest(built.read_bytes()), encoding="ascii")
    # Between the two moves the pair does not match, which only costs another process a compilation.
    os.replace(built, library)
    os.replace(built_digest, _digest_file(library))
    return True
