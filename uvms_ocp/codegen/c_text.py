"""Texts of C that stand before generated code, and constants of Python written as macros of C."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from types import ModuleType


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
