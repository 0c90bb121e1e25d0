"""Bind kernels: functions of numbers, written once in Python, which run as C where there is a
compiler.

What branches, loops and remembers at every tick is written as a kernel; what is smooth is a CasADi
expression. A kernel is a function at the top level of a module. Its parameters are annotated with
``float``, ``int``, ``bool``, `Vector` or a `Layout`; its body keeps to assignments, ``if``, ``for``
over ``range``, ``while``, ``return``, arithmetic, comparisons, ``min``, ``max``, ``abs``, ``len``
of an array in a layout, copies ``m.x[:] = y`` and ``x[:n] = y[:n]``, `zeros`, functions of ``math``
and other kernels. Constants are numbers and members of integer enumerations of its module. A CasADi
function is a field of a layout (`FunctionField`), called with vectors and layouts of them, and so
is a callback to Python (`CallbackField`), for what has no other form. A local variable keeps the
type that it has first. Layouts and vectors are changed in place. `wide` marks a kernel with long
loops for the processor's wider registers.

Python and C give the same bits as long as nothing is divided by zero, taken the root of below zero
or made an integer out of range: there Python raises, and C goes on. Kernels guard against it, and
multiply where they would take a power.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from inspect import signature
from pathlib import Path
from typing import Any, get_type_hints

import casadi as ca

from uvms_ocp.codegen.c_text import MATH
from uvms_ocp.codegen.cache_entries import library_from
from uvms_ocp.codegen.casadi_code import with_variable, without_numbers
from uvms_ocp.codegen.kernel_expressions import PREFIX, c_name
from uvms_ocp.codegen.kernel_layout import (
    NUMBERS,
    FunctionStructure,
    Layout,
    Memory,
    connect,
    functions_in,
)
from uvms_ocp.codegen.kernel_program import (
    c_program,
    program_content,
    structure_signature,
)
from uvms_ocp.codegen.loading import loaded_library
from uvms_ocp.types import Keyed

Kernels = Sequence[Callable[..., Any]]
BoundKernels = tuple[Callable[..., Any], ...]
_DECLARATION = "int {}(const double **arg, double **res, long long int *iw, double *w, int mem);\n"


def initial_value(memory: Layout) -> str:
    """Return a constant expression of C99 for a memory, with its functions under their own names;
    zeros are left out.
    """
    return _text(memory) or "{0}"


def _text(value: Any) -> str:
    """Return the value of a field in C; empty for zero."""
    if isinstance(value, FunctionStructure):
        return f"{{.call = {value.function.name()}}}"
    if isinstance(value, ctypes.Structure):
        return _structure_text(value)
    if isinstance(value, ctypes.Array):
        return _array_text(value)
    return number(value)


def _structure_text(structure: Any) -> str:
    fields = list[str]()
    for name, *_ in structure._fields_:
        text = _text(getattr(structure, name))
        if text:
            fields.append(f".{c_name(name)} = {text}")
    if not fields:
        return ""
    return f"{{{', '.join(fields)}}}"


def _array_text(array: Any) -> str:
    """Return an array in C, without the zeros at its end."""
    zero = "0"
    if issubclass(array._type_, (ctypes.Array, ctypes.Structure)):
        zero = "{0}"
    entries = [_text(entry) or zero for entry in array]
    while entries and entries[-1] == zero:
        entries.pop()
    if not entries:
        return ""
    return f"{{{', '.join(entries)}}}"


def number(value: float) -> str:
    """Write a number in C, exact to the last bit; empty for 0."""
    if value == 0 and math.copysign(1.0, value) > 0.0:
        return ""
    if isinstance(value, int):
        return str(value)
    if math.isnan(value):
        return "NAN"
    if value == math.inf:
        return "INFINITY"
    if value == -math.inf:
        return "-INFINITY"
    return value.hex()


def bind_kernels(
    kernels: Kernels, structures: Iterable[type[Layout]], *, compiled: bool = True
) -> BoundKernels:
    """Return the `kernels`, in C unless `compiled` is false or there is no compiler; themselves
    otherwise.

    structures: those that they work on, as `structure_of` makes them. A vector is given as an array
    in a structure. Raises `InvalidInput` for a function that is no kernel.
    """
    if compiled:
        return _bound(tuple(kernels), tuple(structures))
    return tuple(kernels)


def make_memory(
    structure: type[Memory], kernels: Kernels, *, compiled: bool = True
) -> tuple[Memory, BoundKernels]:
    """Return a new memory whose functions are at their places, and the `kernels` that work on it,
    as `bind_kernels` gives them.

    Where one of its functions cannot be compiled the kernels stay in Python.
    """
    memory = structure()
    return memory, bind_memory(memory, kernels, compiled=compiled)


def bind_memory(memory: Layout, kernels: Kernels, *, compiled: bool = True) -> BoundKernels:
    """Return the `kernels` for a memory, as `make_memory` gives them, once its functions are at
    their places.
    """
    return bind_kernels(kernels, (type(memory),), compiled=compiled and connect(memory))


@lru_cache(maxsize=32)
def _bound(kernels: BoundKernels, structures: tuple[Any, ...]) -> BoundKernels:
    # C sees no difference between functions of one name and size.
    signatures = tuple(structure_signature(structure) for structure in structures)
    path = _compiled(kernels, Keyed(signatures, structures))
    if path is None:
        return kernels
    library = loaded_library(path)
    return tuple(_function(library, kernel) for kernel in kernels)


@lru_cache(maxsize=64)
def _compiled(kernels: BoundKernels, structures: Keyed) -> Path | None:
    name = ", ".join(kernel.__name__ for kernel in kernels)
    content = f"{program_content(kernels)} {structures.key}"

    def make() -> str:
        types, code = c_program(kernels, structures.value)
        return types + code

    return library_from(name, content, make)


def _function(library: ctypes.CDLL, kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function of a library that a kernel has become."""
    function = library[f"{PREFIX}{kernel.__name__}"]
    hints = get_type_hints(kernel)
    function.argtypes = [_argument_type(hints[name]) for name in signature(kernel).parameters]
    function.restype = NUMBERS.get(hints.get("return"))
    return function


class _ByReference:
    """Argument type of layouts; ``ctypes.POINTER`` keeps every type that it was ever asked for, and
    all that hangs on it.
    """

    from_param = ctypes.byref


def _argument_type(hint: Any) -> Any:
    """Return the type in ctypes of an annotated parameter."""
    if isinstance(hint, type) and issubclass(hint, Layout):
        return _ByReference
    return NUMBERS.get(hint, ctypes.POINTER(ctypes.c_double))


@dataclass(frozen=True, kw_only=True, slots=True)
class CLibrary:
    """Texts of C99: no allocation, no input or output, libm only."""

    types: str
    """Structures."""
    kernels: str
    """Kernels, under their names behind ``k_``; after the types."""
    functions: str
    """CasADi functions: a file of its own, without those that are made of other C already. Their
    numbers are data of another file, as in the libraries that Python calls: what a compiler knows
    it computes itself, and not to the last bit as libm does.
    """
    numbers: str
    """Definition of these numbers, ``const double numbers[]``."""
    declarations: str
    """Declarations of these functions."""
    initial: str
    """Function that initialises memory; after types and declarations."""


def c_library(
    kernels: Kernels,
    memory: Layout,
    others: Sequence[type[Layout]] = (),
    variable: tuple[str, Sequence[float]] | None = None,
) -> CLibrary:
    """Write the `kernels` in C, which work on a `memory` such as this and on `others`.

    variable: name of an array of C that a program may change, and the values of the constants of
    the CasADi functions whose place it takes. Raises `InvalidInput`, as `c_program`.
    """
    types, code = c_program(kernels, (type(memory), *others))
    functions = dict.fromkeys(part.function for part in functions_in(memory))
    generator = ca.CodeGenerator("functions.c")
    for function in functions:
        if function.class_name() != "External":
            generator.add(function)
    smooth_code = str(generator.dump())
    if variable is not None:
        smooth_code = with_variable(smooth_code, *variable)
    form, values = without_numbers(smooth_code)
    array = f"const double numbers[{max(1, len(values))}]"
    listed_numbers = ", ".join(number(value) or "0" for value in values.tolist()) or "0"
    declarations = ""
    for function in functions:
        declarations += _DECLARATION.format(function.name())
    return CLibrary(
        types=types,
        kernels=code,
        functions=f"{MATH}extern {array};\n{form}",
        numbers=f"extern {array};\n{array} = {{{listed_numbers}}};\n",
        declarations=declarations,
        initial=initial_value(memory),
    )
