"""Remember in which library a function is, with which numbers, so that it is not made again.

A library is found by its source, and to make that takes longer than to load it: an entry of the
cache is found by what the source is made of.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

import casadi as ca
import numpy as np

from uvms_ocp.codegen import c_compiler
from uvms_ocp.codegen.cache import HALF_MADE, KEPT_NUMBERS, cache_folder, digest
from uvms_ocp.codegen.libraries import compile_library, is_usable
from uvms_ocp.codegen.loading import NO_NUMBERS

_HASH_LENGTH = len(digest(b""))
"""[bytes] of the hash before the content of an entry."""
_MAKERS = tuple(
    str(path) for path in sorted(Path(__file__).parent.iterdir()) if path.suffix in {".py", ".c"}
)
"""Files of this package, which make libraries of functions and kernels."""


def library_from(name: str, content: str, make: Callable[[], str], *modules: str) -> Path | None:
    """Return the library of the source that `make` makes of a content; where it was compiled before
    it is not made at all.

    content: all that the source depends on but the compiler, and the files `modules` of the code
    that `make` runs.
    """
    entry, cached = look_up(name, content, *modules)
    if cached:
        return cached[0]
    return keep(entry, NO_NUMBERS, partial(compile_library, make(), name=name))


def look_up(
    name: str, content: str, *modules: str
) -> tuple[Path | None, tuple[Path, np.ndarray] | None]:
    """Return the cache entry for what is made of a content, None without a cache, and what it
    holds: a library, and the numbers of the function in it.
    """
    compiler = c_compiler.find_compiler()
    folder = cache_folder()[0]
    if compiler is None or folder is None:
        return None, None
    identity = (
        *map(code_of, _MAKERS),
        *map(code_of, modules),
        ca.__version__,
        os.environ.get("UVMS_OCP_CFLAGS", ""),
    )
    key = c_compiler.compilation_key((name, content), identity, compiler)
    entry = folder / f"{key}{KEPT_NUMBERS}"
    return entry, _kept(entry)


def content_of(inputs: Sequence[ca.SX], outputs: Sequence[ca.SX], *more: object) -> str:
    """Hash expressions, without differentiating them, and whatever else a function is made of."""
    function = ca.Function("content", list(inputs), list(outputs))
    return digest(f"{function.serialize()} {more}".encode())


@cache
def code_of(file: str) -> str:
    """Return the hash of a file of code."""
    return digest(Path(file).read_bytes())


def keep(
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
        written.write_bytes(digest(data).encode() + data)
        os.replace(written, entry)
    return library


def _kept(entry: Path) -> tuple[Path, np.ndarray] | None:
    """Return the library and numbers of a cache entry; None where one of them is missing or
    damaged.
    """
    with suppress(OSError):
        content = entry.read_bytes()
        data = content[_HASH_LENGTH:]
        if content[:_HASH_LENGTH] != digest(data).encode():
            return None
        name, _, numbers = data.partition(b"\n")
        library = entry.with_name(name.decode())
        if is_usable(library):
            for path in (entry, library):
                os.utime(path)  # used now
            return library, np.frombuffer(numbers)
    return None
