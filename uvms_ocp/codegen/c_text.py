"""C code that is put before generated code, and constants of Python written as macros of C."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from types import ModuleType


def _c_text(name: str) -> str:
    """Read a file of C beside this one."""
    return (files("uvms_ocp.codegen") / f"{name}.c").read_text("utf-8")


MATH = _c_text("math")
"""Put before the code of CasADi functions: fmax and fmin in line, in place of hundreds of calls into
libm in a tick. Like those of libm, they return the other argument where one is NaN.
"""
PARTS = _c_text("parts")
"""Put before the code of CasADi functions that are split into parts."""
WIDE_MACROS = _c_text("wide")
"""Put before code with the macros WIDE and INLINE: defines them."""
EXACT = _c_text("exact")
"""Put before code that users compile, so that the flags of their compiler change no number."""


def constants_of(module: ModuleType) -> dict[str, float]:
    """Return the numeric constants of a module: its names in capitals."""
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
