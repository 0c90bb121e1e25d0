"""The C source of the core: its own files, behind the sizes, tolerances and codes that Python decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from enum import IntEnum
from importlib.resources import files

from uvms_ocp.solvers.hierarchy.active_set.codes import Outcome, RowState
from uvms_ocp.solvers.hierarchy.active_set.patience import patience
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES

_INCLUDES = "#include <math.h>\n#include <string.h>\n"
_SOURCES = ("equalities.c", "active_set.c", "scaling.c", "certificate.c", "entry.c")


def core_source(n: int, sizes: Sequence[int]) -> str:
    """C source for n velocities and levels of ``sizes`` rows; needs libm only."""
    filled = [size for size in sizes if size]
    folder = files("uvms_ocp.solvers.hierarchy.active_set")
    parts = [
        _INCLUDES,
        _macros({"N": n, "M": sum(filled), "L": len(filled), "LEVEL_SIZES": ", ".join(map(str, filled))}),
        _macros(asdict(TOLERANCES)),
        _macros(asdict(patience(sum(filled)))),
        _codes(RowState),
        _codes(Outcome),
        *(folder.joinpath(name).read_text(encoding="utf-8") for name in _SOURCES),
    ]
    return "\n".join(parts)


def _macros(values: Mapping[str, object]) -> str:
    return "".join(f"#define {name.upper()} {value}\n" for name, value in values.items())


def _codes(codes: type[IntEnum]) -> str:
    return f"enum {{ {', '.join(f'{code.name} = {code.value}' for code in codes)} }};\n"
