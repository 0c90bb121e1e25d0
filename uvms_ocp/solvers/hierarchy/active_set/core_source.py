"""The C source of the solver: its own files, behind the sizes, tolerances and codes that Python decides."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.hierarchy.active_set.codes import STATUSES, RowState
from uvms_ocp.solvers.hierarchy.active_set.patience import patience
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES

_INCLUDES = "#include <math.h>\n#include <string.h>\n"
_SOURCES = ("equalities.c", "active_set.c", "scaling.c", "certificate.c", "fallbacks.c")


def solver_source(n: int, sizes: Sequence[int]) -> str:
    """C99 source for n velocities and levels of ``sizes`` rows: `solve_levels` of fallbacks.c, all else static; needs libm only.

    Nothing is allocated: a call works on the stack, with 60 kB for 13 velocities and 60 rows. It makes 3 L + 3 runs for L levels
    at most, which together end after `Patience.most_of_all` iterations, whatever the numbers, and L + 6 certificates, whose
    search for every level ends after twelve rounds per row. Raises `InvalidInput` for levels without a row.
    """
    filled = [size for size in sizes if size]
    if not filled:
        raise InvalidInput(f"levels of {list(sizes)} rows; give at least one row")
    parts = [
        _INCLUDES,
        _macros({"N": n, "M": sum(filled), "L": len(filled), "LEVEL_SIZES": ", ".join(map(str, filled))}),
        _macros(asdict(TOLERANCES)),
        _macros(asdict(patience(sum(filled)))),
        _codes({code.name: code.value for code in RowState}),
        _codes({status.name: code for code, status in enumerate(STATUSES)}),
        *_texts(_SOURCES),
    ]
    return "\n".join(parts)


def solver_declaration() -> str:
    """`solve_levels` as other C code declares it, with a comment that says what it takes; M and N are numbers there."""
    text = _texts(["fallbacks.c"])[0]
    return f"{text[text.index('/* The solver:') : text.index(' {', text.index('int solve_levels('))]};\n"


def core_source(n: int, sizes: Sequence[int]) -> str:
    """As `solver_source`, with the solver and its certificate as functions for CasADi too."""
    return "\n".join([solver_source(n, sizes), *_texts(["casadi.c"])])


def _texts(names: Iterable[str]) -> list[str]:
    folder = files("uvms_ocp.solvers.hierarchy.active_set")
    return [folder.joinpath(name).read_text(encoding="utf-8") for name in names]


def _macros(values: Mapping[str, object]) -> str:
    return "".join(f"#define {name.upper()} {value}\n" for name, value in values.items())


def _codes(codes: Mapping[str, int]) -> str:
    return f"enum {{ {', '.join(f'{name} = {code}' for name, code in codes.items())} }};\n"
