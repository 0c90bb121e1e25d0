"""A C program of kernels: their structures, then all functions that the first ones call."""

from __future__ import annotations

import ast
import ctypes
import inspect
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, get_type_hints

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.buffered import sizes_of
from uvms_ocp.functions.kernels.c_types import DOUBLE, INT, NOTHING, VECTOR, CType, of_ctypes
from uvms_ocp.functions.kernels.expressions import PREFIX, Scope, Signature, c_name
from uvms_ocp.functions.kernels.layout import Layout, Vector
from uvms_ocp.functions.kernels.smooth import SmoothStructure, work_sizes
from uvms_ocp.functions.kernels.statements import block

_HEAD = """#include <math.h>
#include <stdlib.h>
#include <string.h>
static inline double lesser_of(double x, double y) { return y < x ? y : x; }
static inline double greater_of(double x, double y) { return y > x ? y : x; }
static inline int lesser_of_int(int x, int y) { return y < x ? y : x; }
static inline int greater_of_int(int x, int y) { return y > x ? y : x; }
"""
_PLAIN = {float: DOUBLE, int: INT, bool: INT, Vector: VECTOR, type(None): NOTHING}


@dataclass(frozen=True, kw_only=True, slots=True)
class CProgram:
    """C99 source in two parts, which needs libm only."""

    types: str
    """What it works on."""
    code: str
    """What it does, after its types."""


def c_program(kernels: Sequence[Callable[..., Any]], structures: Iterable[type[ctypes.Structure]]) -> CProgram:
    """The `kernels`, under their names behind ``k_``, and what they call.

    structures: those that their parameters are annotated with, as `structure_of` makes them. Raises `InvalidInput` for a
    function that is no kernel, with the line.
    """
    program = _Program(structures)
    for kernel in kernels:
        program.signature_of(kernel)
    while program.waiting:
        program.translate(program.waiting.pop(0))
    heads = {k: f"{'' if k in kernels else 'static '}{_head(signature)}" for k, signature in program.signatures.items()}
    bodies = [f"{head} {{\n{program.bodies[kernel]}}}\n" for kernel, head in heads.items()]
    code = "\n".join([_HEAD, *(f"{head};" for head in heads.values()), "", *bodies])
    return CProgram(types="\n".join(program.declared), code=code)


def shape_of(kind: Any) -> Any:
    """All that a C program tells of a type of a field, or of a structure."""
    if issubclass(kind, SmoothStructure):
        return kind.__name__, *sizes_of(kind.function)
    if issubclass(kind, ctypes.Structure):
        return kind.__name__, *((name, shape_of(part)) for name, part in kind._fields_)
    return (kind._length_, shape_of(kind._type_)) if issubclass(kind, ctypes.Array) else kind


class _Program:
    """What is known of it so far."""

    def __init__(self, structures: Iterable[type[ctypes.Structure]]) -> None:
        self.declared: list[str] = []
        self.signatures: dict[Callable[..., Any], Signature] = {}
        self.bodies: dict[Callable[..., Any], str] = {}
        self.waiting: list[Callable[..., Any]] = []
        self._names: Counter[str] = Counter()
        self._structures: dict[str, type[ctypes.Structure]] = {}
        for structure in structures:
            self._declare(structure)

    def signature_of(self, kernel: Any) -> Signature:
        """Of a kernel, which is translated later."""
        name = getattr(kernel, "__name__", str(kernel))
        if not inspect.isfunction(kernel):
            raise InvalidInput(f"{name} is no function written in Python; call kernels and functions of math")
        if kernel not in self.signatures:
            self._names[name] += 1
            self.signatures[kernel] = self._read(
                name if self._names[name] == 1 else f"{name}_{self._names[name]}", kernel
            )
            self.waiting.append(kernel)
        return self.signatures[kernel]

    def _read(self, name: str, kernel: Callable[..., Any]) -> Signature:
        hints = get_type_hints(kernel)
        result = self._type(f"what {name} returns", hints.pop("return", None))
        parameters = {p: self._type(f"{name}: {p}", hints.get(p)) for p in inspect.signature(kernel).parameters}
        return Signature(name, parameters, result)

    def translate(self, kernel: Callable[..., Any]) -> None:
        """The body of a kernel."""
        signature = self.signatures[kernel]
        scope = Scope(
            names=vars(sys.modules[kernel.__module__]),
            signature_of=self.signature_of,
            result=signature.result,
            local=dict(signature.parameters),
        )
        try:
            lines = block(_syntax(kernel).body, scope)
        except InvalidInput as error:
            raise InvalidInput(f"{kernel.__module__}.{kernel.__name__} is no kernel: {error}") from None
        own = [
            f"  {_variable(name, kind, own=name in scope.own)};"
            for name, kind in scope.local.items()
            if name not in signature.parameters
        ]
        self.bodies[kernel] = "".join(f"{line}\n" for line in own + lines)

    def _type(self, what: str, hint: Any) -> CType:
        if hint is None or hint in _PLAIN:
            return _PLAIN.get(hint, NOTHING)
        if isinstance(hint, type) and issubclass(hint, Layout) and hint.__name__ in self._structures:
            return CType(hint.__name__, (), self._structures[hint.__name__])
        layouts = [name for name, kind in self._structures.items() if not issubclass(kind, SmoothStructure)]
        raise InvalidInput(f"{what} is annotated with {hint}; give float, int, bool, Vector or a layout of {layouts}")

    def _declare(self, structure: type[ctypes.Structure]) -> None:
        name = structure.__name__
        if name in self._structures:
            if self._structures[name] is not structure:
                raise InvalidInput(f"layout {name} has two sizes in one program; give it one")
            return
        if issubclass(structure, SmoothStructure):
            self._structures[name] = structure
            self.declared.append(_smooth(structure))
            return
        kinds = {field: of_ctypes(kind) for field, kind in structure._fields_}  # type: ignore[misc]
        for kind in kinds.values():
            if kind.structure is not None:
                self._declare(kind.structure)
        self._structures[name] = structure
        fields = "".join(f"  {_field(field, kind)};\n" for field, kind in kinds.items())
        self.declared.append(f"typedef struct {{\n{fields}}} {name};\n")


def _head(signature: Signature) -> str:
    given = ", ".join(kind.declared(c_name(p)) for p, kind in signature.parameters.items()) or "void"
    return f"{signature.result.name} {PREFIX}{signature.name}({given})"


def _smooth(structure: type[SmoothStructure]) -> str:
    n_arg, n_res, n_iw, n_w = work_sizes(structure.function)
    call = "int (*call)(const double **, double **, long long int *, double *, int);"
    memory = f"const double *arg[{n_arg}];\n  double *res[{n_res}];\n  long long int iw[{n_iw}];\n  double w[{n_w}];"
    return f"typedef struct {{\n  {call}\n  {memory}\n}} {structure.__name__};\n"


def _field(name: str, kind: CType) -> str:
    return f"{kind.name} {c_name(name)}{''.join(f'[{size}]' for size in kind.sizes)}"


def _variable(name: str, kind: CType, *, own: bool) -> str:
    """A declaration: an array of one's own, a pointer to somebody else's, or a number, which is set before it is read."""
    if own:
        return kind.declared(c_name(name))
    if kind.sizes or kind.structure is not None:
        return f"{kind.name} *{c_name(name)} = 0"
    return f"{kind.name} {c_name(name)} = 0"


@lru_cache(maxsize=1024)
def _syntax(kernel: Callable[..., Any]) -> ast.FunctionDef:
    found = ast.parse(textwrap.dedent(inspect.getsource(kernel))).body[0]
    if not isinstance(found, ast.FunctionDef) or found.decorator_list:
        raise InvalidInput(f"{kernel.__name__} is no plain function; kernels have no decorators")
    ast.increment_lineno(found, kernel.__code__.co_firstlineno - 1)
    return found
