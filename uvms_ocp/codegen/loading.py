"""Load shared libraries and the CasADi functions in them, and find the addresses of their code.

Functions that differ in their numbers alone share machine code: each gets a copy of the library
with numbers of its own, which is let go with the function.
"""

from __future__ import annotations

import _ctypes
import ctypes
import shutil
import sys
import tempfile
from functools import cache, lru_cache
from pathlib import Path
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from uvms_ocp.codegen import casadi_code
from uvms_ocp.codegen.cache import HALF_MADE
from uvms_ocp.codegen.compiler_log import warn_once

NO_NUMBERS = np.zeros(0)
"""Numbers of a library that has all of them in its code."""
ADDRESSES = WeakKeyDictionary[ca.Function, dict[str, int | None]]()
"""Addresses of compiled functions, by symbol."""
_KEPT_FUNCTIONS = 48
"""Loaded functions that all callers share."""


def load_function(
    path: Path | None, name: str, numbers: np.ndarray = NO_NUMBERS
) -> ca.Function | None:
    """Return the function `name` of a library, with its numbers; None where there is no library,
    or none that has it (logged once).
    """
    try:
        if path is None:
            return None
        return _external(name, path, numbers.tobytes())
    except RuntimeError:  # the library is one, but not of this source
        warn_once(f"{path} does not define {name}")
    except OSError as error:
        warn_once(f"{path} cannot be copied", error.strerror or str(error))
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
        ADDRESSES[function] = addresses
        _close(library)  # the function holds it
    return function


@cache
def loaded_library(path: Path) -> ctypes.CDLL:
    """Load the library at `path`, as `compile_library` gives it; once."""
    return ctypes.CDLL(str(path))


def load_error(library: Path) -> str:
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
