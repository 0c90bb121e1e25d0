"""Kernels and the functions that they call as files of C, which need no Python."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from uvms_ocp.functions.compile import MATH
from uvms_ocp.functions.kernels.initial_value import initial_value
from uvms_ocp.functions.kernels.program import c_program
from uvms_ocp.functions.kernels.smooth import functions_in


@dataclass(frozen=True, kw_only=True, slots=True)
class CLibrary:
    """Texts of C99: no allocation, no input or output, libm only."""

    types: str
    """Structures."""
    kernels: str
    """Kernels, under their names behind ``k_``; after the types."""
    functions: str
    """CasADi functions: a file of its own, without those that are made of other C already."""
    declarations: str
    """Of these functions."""
    initial: str
    """What initialises the memory that was given; after types and declarations."""


def c_library(
    kernels: Sequence[Callable[..., Any]], memory: ctypes.Structure, others: Sequence[type[ctypes.Structure]] = ()
) -> CLibrary:
    """The `kernels`, which work on a `memory` such as this and on `others`. Raises `InvalidInput`, as `c_program`."""
    program = c_program(kernels, (type(memory), *others))
    functions = dict.fromkeys(part.function for part in functions_in(memory))
    return CLibrary(
        types=program.types,
        kernels=program.code,
        functions=_generated(list(functions)),
        declarations="".join(f"{_head(function)};\n" for function in functions),
        initial=initial_value(memory),
    )


def _head(function: ca.Function) -> str:
    return f"int {function.name()}(const double **arg, double **res, long long int *iw, double *w, int mem)"


def _generated(functions: Sequence[ca.Function]) -> str:
    generator = ca.CodeGenerator("functions.c")
    for function in functions:
        if function.class_name() != "External":
            generator.add(function)
    return MATH + str(generator.dump())
