"""Translate kernels, and everything that they call, to one C program."""

from __future__ import annotations

import ast
import ctypes
import inspect
import linecache
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from importlib.resources import files
from types import FunctionType
from typing import Any, get_type_hints

from uvms_ocp.codegen import (
    buffered,
    kernel_expressions as c_code,
    kernel_statements,
)
from uvms_ocp.codegen.c_text import WIDE_MACROS
from uvms_ocp.codegen.kernel_layout import WIDE, FunctionStructure, Layout, Vector, work_sizes
from uvms_ocp.errors import InvalidInput

_HEAD = (files("uvms_ocp.codegen") / "kernels.c").read_text(encoding="utf-8")
_MAX_DOTS = 2  # dots in module.Enumeration.MEMBER
_TYPES = {
    float: c_code.DOUBLE,
    int: c_code.INT,
    bool: c_code.INT,
    Vector: c_code.VECTOR,
    type(None): c_code.NOTHING,
}
"""Type in C of each annotation but layouts."""


def c_program(
    kernels: Sequence[Callable[..., Any]], structures: Iterable[type[Any]]
) -> tuple[str, str]:
    """Return the `kernels`, under their names behind ``k_``, and what they call: C99 that needs
    libm only, types and then functions.

    structures: those that their parameters are annotated with, as `structure_of` makes them. Raises
    `InvalidInput` for a function that is no kernel, with the line.
    """
    program = _Program(structures)
    for kernel in kernels:
        program.signature_of(kernel)
    while program.waiting:
        program.translate(program.waiting.pop(0))
    declarations = []
    definitions = []
    for kernel, signature in program.signatures.items():
        head = _head(signature)
        if kernel not in kernels:
            head = f"static {head}"
        declarations.append(f"{head};")
        prefix = "WIDE " if kernel in WIDE else ""
        definitions.append(f"{prefix}{head} {{\n{program.bodies[kernel]}}}\n")
    macros = []
    if WIDE.intersection(program.signatures):
        macros.append(WIDE_MACROS)
    code = "\n".join([_HEAD, *macros, *declarations, "", *definitions])
    return "\n".join(program.structure_declarations), code


class _Program:
    """Program under construction: kernels are translated once the structures are declared."""

    def __init__(self, structures: Iterable[type[ctypes.Structure]]) -> None:
        self.structure_declarations: list[str] = []
        """Declarations of the structures, in C."""
        self.signatures: dict[Callable[..., Any], c_code.Signature] = {}
        """Signatures of all kernels that are called, in the order in which they are met."""
        self.bodies: dict[Callable[..., Any], str] = {}
        """Bodies in C of the kernels that are translated."""
        self.waiting: list[Callable[..., Any]] = []
        """Kernels that have a signature and no body yet."""
        self._names: Counter[str] = Counter()
        self._structures: dict[str, type[ctypes.Structure]] = {}
        for structure in structures:
            self._declare(structure)

    def signature_of(self, kernel: Any) -> c_code.Signature:
        """Return the signature of a kernel, which is translated later."""
        name = getattr(kernel, "__name__", str(kernel))
        if not inspect.isfunction(kernel):
            raise InvalidInput(
                f"{name} is no function written in Python; call kernels and functions of math"
            )
        if kernel not in self.signatures:
            self._names[name] += 1
            unique_name = name
            if self._names[name] > 1:
                unique_name = f"{name}_{self._names[name]}"
            self.signatures[kernel] = self._signature(unique_name, kernel)
            self.waiting.append(kernel)
        return self.signatures[kernel]

    def _signature(self, name: str, kernel: Callable[..., Any]) -> c_code.Signature:
        """Return the signature of a kernel, by a name that no other one has in the program."""
        hints = get_type_hints(kernel)
        result = self._type(f"what {name} returns", hints.pop("return", None))
        parameters = {}
        for parameter in inspect.signature(kernel).parameters:
            parameters[parameter] = self._type(f"{name}: {parameter}", hints.get(parameter))
        return c_code.Signature(name, parameters, result)

    def _type(self, what: str, hint: Any) -> c_code.CType:
        """Return the type of an annotation; what: it is of, for the error."""
        if hint is None or hint in _TYPES:
            return _TYPES.get(hint, c_code.NOTHING)
        if isinstance(hint, type) and issubclass(hint, Layout):
            structure = self._structures.get(hint.__name__)
            if structure is not None:
                return c_code.CType(hint.__name__, (), structure)
        layouts = []
        for name, structure in self._structures.items():
            if not issubclass(structure, FunctionStructure):
                layouts.append(name)
        raise InvalidInput(
            f"{what} is annotated with {hint}; give float, int, bool, Vector or a layout of"
            f" {layouts}"
        )

    def translate(self, kernel: Callable[..., Any]) -> None:
        """Write the body of a kernel in C."""
        signature = self.signatures[kernel]
        scope = c_code.Scope(
            names=vars(sys.modules[kernel.__module__]),
            signature_of=self.signature_of,
            result=signature.result,
            local=dict(signature.parameters),
        )
        try:
            lines = kernel_statements.block(_syntax(kernel).body, scope)
        except InvalidInput as error:
            raise InvalidInput(
                f"{kernel.__module__}.{kernel.__name__} is no kernel: {error}"
            ) from None
        body = ""
        for name, kind in scope.local.items():
            if name not in signature.parameters:
                variable = _variable(name, kind, is_owned=name in scope.owned_arrays)
                body += f"  {variable};\n"
        for line in lines:
            body += f"{line}\n"
        self.bodies[kernel] = body

    def _declare(self, structure: type[ctypes.Structure]) -> None:
        """Declare a structure, after those that it is made of."""
        name = structure.__name__
        if name in self._structures:
            if self._structures[name] is not structure:
                raise InvalidInput(f"layout {name} has two sizes in one program; give it one")
            return
        if issubclass(structure, FunctionStructure):
            self._structures[name] = structure
            self.structure_declarations.append(_function_declaration(structure))
            return
        fields = ""
        for field, ctypes_kind in structure._fields_:  # type: ignore[misc]
            kind = c_code.of_ctypes(ctypes_kind)
            if kind.structure is not None:
                self._declare(kind.structure)
            fields += f"  {_field(field, kind)};\n"
        self._structures[name] = structure
        self.structure_declarations.append(f"typedef struct {{\n{fields}}} {name};\n")


def _function_declaration(structure: type[FunctionStructure]) -> str:
    """Declare a CasADi function with the memory that it works in."""
    n_arg, n_res, n_iw, n_w = work_sizes(structure.function)
    fields = (
        "int (*call)(const double **, double **, long long int *, double *, int);",
        f"const double *arg[{n_arg}];",
        f"double *res[{n_res}];",
        f"long long int iw[{n_iw}];",
        f"double w[{n_w}];",
    )
    lines = "\n  ".join(fields)
    return f"typedef struct {{\n  {lines}\n}} {structure.__name__};\n"


def _head(signature: c_code.Signature) -> str:
    """Declare a function, without the semicolon."""
    parameters = []
    for name, kind in signature.parameters.items():
        parameters.append(kind.declared(c_code.c_name(name)))
    listed = ", ".join(parameters) or "void"
    return f"{signature.result.name} {c_code.PREFIX}{signature.name}({listed})"


def _field(name: str, kind: c_code.CType) -> str:
    """Declare a field of a structure, without the semicolon."""
    return f"{kind.name} {c_code.c_name(name)}{kind.subscripts}"


def _variable(name: str, kind: c_code.CType, *, is_owned: bool) -> str:
    """Declare an array that the kernel owns, a pointer to memory of another owner, or a number,
    which is set before it is read.
    """
    variable = c_code.c_name(name)
    if is_owned:
        return kind.declared(variable)
    if kind.is_number:
        return f"{kind.name} {variable} = 0"
    return f"{kind.name} *{variable} = 0"


def program_content(kernels: Iterable[Any]) -> str:
    """Return all that a C program is made of but its structures: texts of kernels and of what they
    call, and what they name.
    """
    texts = {"head": _HEAD, "wide": WIDE_MACROS}
    content = list[Any]()
    reached = [kernel for kernel in kernels if inspect.isfunction(kernel)]
    for kernel in reached:  # which grows by what each kernel calls
        code = kernel.__code__
        if code.co_filename not in texts:
            texts[code.co_filename] = _text(code.co_filename)
        values = _values_named_in(kernel)
        content.append((kernel.__module__, kernel.__name__, code.co_firstlineno, kernel in WIDE))
        for path, value in values:
            content.append((path, _named_value(value)))
            is_function = inspect.isfunction(value) and value.__name__ == value.__qualname__
            if is_function and value not in reached:
                reached.append(value)
    return f"{content} {texts}"


def _values_named_in(kernel: FunctionType) -> list[tuple[str, Any]]:
    """Return what a kernel names of its module, and attributes of these by their dotted names."""
    annotations = re.findall(r"\w+", str(kernel.__annotations__))
    words = sorted({*kernel.__code__.co_names, *annotations})
    module = kernel.__globals__
    values = [(word, module[word]) for word in words if word in module]
    for path, owner in values:  # which grows by the attributes of each value
        if isinstance(owner, float | int | FunctionType) or path.count(".") >= _MAX_DOTS:
            continue
        for word in words:
            if hasattr(owner, word):
                values.append((f"{path}.{word}", getattr(owner, word)))
    return values


def _named_value(value: Any) -> str:
    """Return a number in C, anything else by its name."""
    number = c_code.literal(value)
    if number:
        return number.text
    return getattr(value, "__qualname__", type(value).__qualname__)


def structure_signature(kind: Any) -> Any:
    """Return all that a C program tells of a type of a field, or of a structure."""
    if issubclass(kind, FunctionStructure):
        return kind.__name__, *buffered.argument_sizes(kind.function)
    if issubclass(kind, ctypes.Structure):
        return kind.__name__, *((name, structure_signature(part)) for name, part in kind._fields_)
    if issubclass(kind, ctypes.Array):
        return (kind._length_, structure_signature(kind._type_))
    return kind


def _syntax(kernel: Callable[..., Any]) -> ast.FunctionDef:
    """Return the definition of a kernel. Raises `InvalidInput` for decorators and inner
    functions.
    """
    code = kernel.__code__
    definition = _functions_in(_text(code.co_filename)).get(code.co_firstlineno)
    n_allowed_decorators = 1 if kernel in WIDE else 0
    if definition is None or len(definition.decorator_list) > n_allowed_decorators:
        raise InvalidInput(
            f"{kernel.__name__} is no plain function; kernels have no decorators but `wide`"
        )
    return definition


def _text(file: str) -> str:
    """Return the text of a file, as it is now."""
    linecache.checkcache(file)
    return "".join(linecache.getlines(file))


@lru_cache(maxsize=128)
def _functions_in(text: str) -> dict[int, ast.FunctionDef]:
    """Return functions at the top level of a file, by the line in which each begins: one parse is
    quicker than a search for each.
    """
    functions = dict[int, ast.FunctionDef]()
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef):
            first = node.decorator_list[0] if node.decorator_list else node
            functions[first.lineno] = node
    return functions
