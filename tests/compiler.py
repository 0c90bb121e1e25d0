"""Tests that need a C compiler say so where there is none, or no folder for what it makes."""

from __future__ import annotations

import os
import shutil
import sys

import pytest

from uvms_ocp.codegen.cache import cache_folder
from uvms_ocp.codegen.libraries import compile_library


def _compiler() -> str:
    """Path of the C compiler; empty where there is none."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        path = shutil.which(name)
        if path:
            return path
    return ""


COMPILER = _compiler()


def _missing() -> str:
    """What keeps C from being compiled here; empty where nothing does."""
    if not COMPILER or sys.platform == "win32":
        return "needs a C compiler: install gcc or clang"
    if cache_folder()[0] is None:
        return (
            "needs a folder for compiled libraries: set UVMS_OCP_CACHE to one that can be written"
        )
    if compile_library("int compiled(void) { return 1; }", name="a library of tests") is None:
        return f"needs a C compiler that works, which {COMPILER} does not: install gcc or clang"
    return ""


MISSING = _missing()
needs_compiler = pytest.mark.skipif(bool(MISSING), reason=MISSING or "all is there")
IN_C_AND_PYTHON = [pytest.param(True, marks=needs_compiler), False]
"""Whether something is compiled: both ways, where that can be."""
long_without_compiler = pytest.mark.skipif(
    bool(MISSING), reason=f"takes minutes in Python; {MISSING}"
)
"""Of closed loops over minutes, whose laws shorter ones hold too."""
