"""Translate types and expressions of kernels from Python to C."""

from __future__ import annotations

import ast
import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from typing import Any, NoReturn

from uvms_ocp.codegen.kernel_layout import zeros
from uvms_ocp.errors import InvalidInput

_OPERATORS: dict[type, str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_INTEGER_OPERATORS: dict[type, str] = {ast.FloorDiv: "/", ast.Mod: "%"}
_COMPARISONS: dict[type, str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}
_FUNCTIONS = (
    math.sqrt,
    math.exp,
    math.log,
    math.erf,
    math.sin,
    math.cos,
    math.asin,
    math.acos,
    math.atan2,
)
_ROUNDINGS = (math.floor, math.ceil, math.copysign, math.fabs, math.remainder)
_MATH = {function: function.__name__ for function in (*_FUNCTIONS, *_ROUNDINGS)}
"""Functions that have one name in Python and in C."""
_TESTS = {math.isfinite: "isfinite", math.isnan: "isnan", math.isinf: "isinf"}
PREFIX = "k_"
"""Prefix of the names of kernels in C, which has names of its own."""
_C_WORDS = """
auto case char const default do double enum extern goto inline long register restrict short signed
sizeof static struct switch
typedef union unsigned void volatile abs greater_of lesser_of
"""
_RESERVED = frozenset(_C_WORDS.split())
_BUILTINS: dict[str, Any] = {f.__name__: f for f in (len, min, max, abs, int, float, bool)}


def kernel_error(node: ast.AST, why: str) -> InvalidInput:
    """Return the error for a function that cannot be a kernel, with the reason and its place."""
    return InvalidInput(f"line {getattr(node, 'lineno', 0)}: {ast.unparse(node)} {why}")


def require(condition: bool, node: ast.AST, why: str) -> None:
    """Raise `kernel_error` where the condition does not hold."""
    if not condition:
        raise kernel_error(node, why)


@dataclass(frozen=True, slots=True)
class CType:
    """A type in C: "double", "int", a structure, which is passed by pointer, or an array of one of
    them.
    """

    name: str
    sizes: tuple[int, ...] = ()
    """Sizes of an array; 0 where one is unknown, as of a parameter."""
    structure: Any = None
    """The type in ctypes, of a structure."""

    @property
    def is_number(self) -> bool:
        """True for a number, False for an array or a structure."""
        return not self.sizes and self.structure is None

    @property
    def subscripts(self) -> str:
        """Sizes of an array as a declaration has them, empty for anything else."""
        return "".join(f"[{size}]" for size in self.sizes)

    def entry(self) -> CType:
        """Return the type of an entry of an array."""
        return CType(self.name, self.sizes[1:], self.structure)

    def declared(self, name: str) -> str:
        """Declare a variable or a parameter of this type."""
        if self.sizes == (0,) or (self.structure is not None and not self.sizes):
            return f"{self.name} *{name}"
        return f"{self.name} {name}{self.subscripts}"


DOUBLE = CType("double")
INT = CType("int")
NOTHING = CType("void")
VECTOR = CType("double", (0,))


def of_ctypes(kind: Any) -> CType:
    """Return the C type of a field of a structure."""
    sizes = []
    while issubclass(kind, ctypes.Array):
        sizes.append(kind._length_)
        kind = kind._type_
    if issubclass(kind, ctypes.Structure):
        return CType(kind.__name__, tuple(sizes), kind)
    name = "double" if kind is ctypes.c_double else "int"
    return CType(name, tuple(sizes))


def field_of(owner: CType, name: str) -> CType:
    """Return the type of a field of a structure. Raises `InvalidInput` where it has none of that
    name.
    """
    fields = dict(owner.structure._fields_)
    if name not in fields:
        raise InvalidInput(f"{owner.name} has no field {name!r}; it has {', '.join(fields)}")
    return of_ctypes(fields[name])


def column_size(kind: CType) -> int:
    """Count the numbers of a structure that has nothing else, which stand one after the other; 0
    for any other type.
    """
    if kind.structure is None or kind.sizes:
        return 0
    for _, field_kind in kind.structure._fields_:
        if of_ctypes(field_kind).name != "double":
            return 0
    return ctypes.sizeof(kind.structure) // ctypes.sizeof(ctypes.c_double)


def c_name(name: str) -> str:
    """Return a name of Python in C, where some have another meaning."""
    if name in _RESERVED:
        return f"{name}_"
    return name


@dataclass(frozen=True, slots=True)
class CExpression:
    """An expression in C and its type."""

    text: str
    type: CType


@dataclass(frozen=True, slots=True)
class Signature:
    """Name, parameters and result of a kernel in C."""

    name: str
    """Name in C, behind the prefix: that in Python, with a number where another kernel of the
    program has it already.
    """
    parameters: Mapping[str, CType]
    result: CType


@dataclass(slots=True)
class Scope:
    """Scope of one kernel: its names and their meaning."""

    names: Mapping[str, Any]
    """Names of its module."""
    signature_of: Callable[[Any], Signature]
    """Function that gives the signature of another kernel, and has it translated too."""
    result: CType
    """Result type of the kernel itself."""
    local: dict[str, CType] = field(default_factory=dict)
    """Parameters and variables."""
    owned_arrays: set[str] = field(default_factory=set)
    """Variables that are arrays of the kernel's own."""


def expression(node: ast.expr, scope: Scope) -> CExpression:
    """Translate an expression to C. Raises `InvalidInput` for what kernels cannot do."""
    return _TRANSLATED.get(type(node), refused)(node, scope)


def refused(node: ast.AST, scope: Scope) -> NoReturn:
    """Raise the error for a statement or an expression without a counterpart in C."""
    raise kernel_error(node, "is nothing that a kernel can do")


def number(node: ast.expr, scope: Scope) -> CExpression:
    """Translate an expression that has to be a number."""
    value = expression(node, scope)
    require(
        value.type.is_number and value.type != NOTHING, node, f"is no number but {value.type.name}"
    )
    return value


def literal(value: Any) -> CExpression | None:
    """Return a constant of Python in C; `None` where kernels have none of its type."""
    if isinstance(value, (bool, int, IntEnum)):
        return CExpression(str(int(value)), INT)
    if not isinstance(value, float):
        return None
    if math.isnan(value):
        text = "NAN"
    elif value == math.inf:
        text = "INFINITY"
    elif value == -math.inf:
        text = "-INFINITY"
    else:
        text = repr(value)
    if text.startswith("-"):
        text = f"({text})"
    return CExpression(text, DOUBLE)


def constant(node: ast.expr, scope: Scope) -> Any:
    """Return the value in Python of a name or an attribute of the module; `None` where it is none
    of the module's.
    """
    if isinstance(node, ast.Name) and node.id not in scope.local:
        return scope.names.get(node.id)
    if isinstance(node, ast.Attribute):
        owner = constant(node.value, scope)
        if owner is None:
            return None
        return getattr(owner, node.attr, None)
    return None


def _constant(node: ast.Constant, scope: Scope) -> CExpression:
    value = literal(node.value)
    if value is None:
        raise kernel_error(node, "is no number")
    return value


def _name(node: ast.Name, scope: Scope) -> CExpression:
    if node.id in scope.local:
        return CExpression(c_name(node.id), scope.local[node.id])
    value = literal(constant(node, scope))
    if value is None:
        raise kernel_error(node, "is no variable and no number of the module")
    return value


def _attribute(node: ast.Attribute, scope: Scope) -> CExpression:
    value = literal(constant(node, scope))
    if value is not None:
        return value
    owner = expression(node.value, scope)
    require(owner.type.structure is not None and not owner.type.sizes, node.value, "has no fields")
    kind = field_of(owner.type, node.attr)
    return _part(f"{owner.text}->{c_name(node.attr)}", kind)


def _part(text: str, kind: CType) -> CExpression:
    """Return a field or an entry; a structure by its address."""
    if kind.structure is not None and not kind.sizes:
        return CExpression(f"(&{text})", kind)
    return CExpression(text, kind)


def _subscript(node: ast.Subscript, scope: Scope) -> CExpression:
    owner = expression(node.value, scope)
    index = expression(node.slice, scope)
    require(
        bool(owner.type.sizes) and index.type == INT,
        node,
        "has to be an entry of an array, by a whole number",
    )
    return _part(f"{owner.text}[{index.text}]", owner.type.entry())


def _binary(node: ast.BinOp, scope: Scope) -> CExpression:
    first = number(node.left, scope)
    second = number(node.right, scope)
    are_integers = first.type == second.type == INT
    kind = type(node.op)
    if kind in _INTEGER_OPERATORS:
        require(are_integers, node, "is only for whole numbers, which are not negative")
        return CExpression(f"({first.text} {_INTEGER_OPERATORS[kind]} {second.text})", INT)
    if kind not in _OPERATORS:
        refused(node, scope)
    if are_integers and kind is ast.Div:
        return CExpression(f"((double){first.text} / {second.text})", DOUBLE)
    result = INT if are_integers else DOUBLE
    return CExpression(f"({first.text} {_OPERATORS[kind]} {second.text})", result)


def _unary(node: ast.UnaryOp, scope: Scope) -> CExpression:
    operand = number(node.operand, scope)
    if isinstance(node.op, ast.Not):
        return CExpression(f"(!{operand.text})", INT)
    if not isinstance(node.op, ast.USub):
        refused(node, scope)
    return CExpression(f"(-{operand.text})", operand.type)


def _logic(node: ast.BoolOp, scope: Scope) -> CExpression:
    parts = [number(value, scope) for value in node.values]
    require(all(part.type == INT for part in parts), node, "is only for truth values")
    operator = " || "
    if isinstance(node.op, ast.And):
        operator = " && "
    text = operator.join(part.text for part in parts)
    return CExpression(f"({text})", INT)


def _comparison(node: ast.Compare, scope: Scope) -> CExpression:
    terms = [number(term, scope).text for term in (node.left, *node.comparators)]
    comparisons = list[str]()
    for operator, (first, second) in zip(node.ops, pairwise(terms), strict=True):
        require(type(operator) in _COMPARISONS, node, "does not compare numbers by size")
        comparisons.append(f"{first} {_COMPARISONS[type(operator)]} {second}")
    return CExpression(f"({' && '.join(comparisons)})", INT)


def _choice(node: ast.IfExp, scope: Scope) -> CExpression:
    test = number(node.test, scope)
    yes = number(node.body, scope)
    no = number(node.orelse, scope)
    kind = INT if yes.type == no.type == INT else DOUBLE
    return CExpression(f"({test.text} ? {yes.text} : {no.text})", kind)


def _call(node: ast.Call, scope: Scope) -> CExpression:
    function = constant(node.func, scope) or _BUILTINS.get(ast.unparse(node.func))
    if node.keywords or function is None:
        raise kernel_error(node, "has to call a kernel with arguments by place")
    if function is len:
        return CExpression(str(length(node, node.args[0], scope)), INT)
    if function is min:
        return _extreme(node, "lesser_of", scope)
    if function is max:
        return _extreme(node, "greater_of", scope)
    if function is abs:
        return _absolute(number(node.args[0], scope))
    if function in (int, float, bool):
        return _converted(number(node.args[0], scope), function)
    if function in _MATH:
        return CExpression(f"{_MATH[function]}({_listed(node.args, scope)})", DOUBLE)
    if function in _TESTS:
        return CExpression(f"{_TESTS[function]}({_listed(node.args, scope)})", INT)
    return _kernel_call(node, function, scope)


def _listed(arguments: Sequence[ast.expr], scope: Scope) -> str:
    """Translate the arguments of a call, which have to be numbers."""
    return ", ".join(number(argument, scope).text for argument in arguments)


def _absolute(value: CExpression) -> CExpression:
    function = "abs" if value.type == INT else "fabs"
    return CExpression(f"{function}({value.text})", value.type)


def _converted(value: CExpression, to: type) -> CExpression:
    if to is bool:
        return CExpression(f"({value.text} != 0)", INT)
    if to is int:
        return CExpression(f"((int){value.text})", INT)
    return CExpression(f"((double){value.text})", DOUBLE)


def length(node: ast.expr, array: ast.expr, scope: Scope) -> int:
    """Return the ``len`` of an array, which `node` asks for. Raises `InvalidInput` where it is
    unknown.
    """
    sizes = expression(array, scope).type.sizes
    is_known = bool(sizes and sizes[0])
    require(is_known, node, "is not known here; give the number to the kernel")
    return sizes[0]


def _extreme(node: ast.Call, name: str, scope: Scope) -> CExpression:
    terms = [number(argument, scope) for argument in node.args]
    kind = DOUBLE
    if all(term.type == INT for term in terms):
        name = f"{name}_int"
        kind = INT
    text = terms[0].text
    for term in terms[1:]:
        text = f"{name}({text}, {term.text})"
    return CExpression(text, kind)


def _kernel_call(node: ast.Call, function: Any, scope: Scope) -> CExpression:
    require(function is not zeros, node, "can only be what a variable is set to")
    signature = scope.signature_of(function)
    require(
        len(node.args) == len(signature.parameters),
        node,
        f"has to give {len(signature.parameters)} arguments",
    )
    arguments = [expression(argument, scope) for argument in node.args]
    for argument, (name, expected) in zip(arguments, signature.parameters.items(), strict=True):
        if expected.is_number:
            fits = argument.type.is_number
        else:
            fits = not argument.type.is_number and argument.type.name == expected.name
        require(fits, node, f"gives {argument.type.name} as {name}, which is {expected.name}")
        require(expected != INT or argument.type != DOUBLE, node, f"gives {name} no whole number")
    listed = ", ".join(argument.text for argument in arguments)
    return CExpression(f"{PREFIX}{signature.name}({listed})", signature.result)


_TRANSLATED: dict[type, Callable[[Any, Scope], CExpression]] = {
    ast.Constant: _constant,
    ast.Name: _name,
    ast.Attribute: _attribute,
    ast.Subscript: _subscript,
    ast.Call: _call,
    ast.BinOp: _binary,
    ast.UnaryOp: _unary,
    ast.BoolOp: _logic,
    ast.Compare: _comparison,
    ast.IfExp: _choice,
}
