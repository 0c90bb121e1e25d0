"""Translate statements of kernels from Python to C."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

from uvms_ocp.codegen import buffered, kernel_expressions as c_code
from uvms_ocp.codegen.kernel_layout import FunctionStructure, zeros

_PURE_BUILTINS = ("abs", "bool", "float", "int", "len", "max", "min")
_PURE = (*_PURE_BUILTINS, *(f"math.{name}" for name in vars(math)))
"""Functions, as kernels call them, that change nothing and depend on their arguments alone."""


def block(nodes: Sequence[ast.stmt], scope: c_code.Scope) -> list[str]:
    """Return lines of C, indented by two blanks. Raises `InvalidInput` for what kernels cannot
    do.
    """
    lines = list[str]()
    for node in nodes:
        translate = _TRANSLATED.get(type(node), c_code.refused)
        lines += [f"  {line}" for line in translate(node, scope)]
    return lines


def _assign(node: ast.Assign | ast.AnnAssign, scope: c_code.Scope) -> list[str]:
    """Assign to several targets one after the other, which is the same as at once where no value
    depends on what the others change.
    """
    if node.value is None:
        raise c_code.kernel_error(node, "has to give a value")
    targets: list[ast.expr]
    if isinstance(node, ast.AnnAssign):
        targets = [node.target]
    else:
        targets = node.targets
    values: list[ast.expr] = []
    if isinstance(node.value, ast.Tuple):
        values = node.value.elts
    pairs: list[tuple[ast.expr, ast.expr]] = []
    for target in targets:
        if isinstance(target, ast.Tuple):
            c_code.require(len(values) == len(target.elts), node, "has to give as many values")
            pairs += zip(target.elts, values, strict=True)
        else:
            pairs.append((target, node.value))
    c_code.require(
        _are_independent(pairs), node, "has to give values that depend on nothing that it changes"
    )
    lines = list[str]()
    for target, value in pairs:
        lines += _to_place(target, value, scope)
    return lines


def _are_independent(pairs: Sequence[tuple[ast.expr, ast.expr]]) -> bool:
    """Check that no value depends on one of several targets."""
    if len(pairs) < 2:
        return True
    targets = [target for target, _ in pairs]
    values = [value for _, value in pairs]
    return not any(_reads(value, target) for value, target in product(values, targets))


def _reads(value: ast.expr, target: ast.expr) -> bool:
    """Check whether a value may depend on a target, which may have other names too."""
    parts = list(ast.walk(value))
    if isinstance(target, ast.Name):
        return target.id in [part.id for part in parts if isinstance(part, ast.Name)]
    is_element = isinstance(target, ast.Subscript)
    while isinstance(target, ast.Subscript):
        target = target.value
    field = target.attr if isinstance(target, ast.Attribute) else ""
    for part in parts:
        if isinstance(part, ast.Call) and ast.unparse(part.func) not in _PURE:
            return True
        if isinstance(part, ast.Attribute) and part.attr == field:
            return True
        if is_element and isinstance(part, ast.Subscript):
            is_another_field = field and isinstance(part.value, ast.Attribute)
            if not is_another_field:
                return True
    return False


def _to_place(target: ast.expr, value: ast.expr, scope: c_code.Scope) -> list[str]:
    if isinstance(target, ast.Name):
        return _to_variable(target, value, scope)
    if isinstance(target, ast.Subscript) and isinstance(target.slice, ast.Slice):
        return _copy(target, target.slice, value, scope)
    place = c_code.number(target, scope)
    source = c_code.number(value, scope)
    return [f"{place.text} = {_fitting(target, place.type, source)};"]


def _to_variable(target: Any, value: ast.expr, scope: c_code.Scope) -> list[str]:
    name = c_code.c_name(target.id)
    if isinstance(value, ast.Call) and c_code.constant(value.func, scope) is zeros:
        _declare(target, c_code.CType("double", (_size(value, scope),)), scope)
        scope.owned_arrays.add(target.id)
        return [f"memset({name}, 0, sizeof {name});"]
    source = c_code.expression(value, scope)
    n_dimensions = len(source.type.sizes)
    c_code.require(
        n_dimensions < 2 and source.type != c_code.NOTHING,
        target,
        f"would be {source.type.name} of {n_dimensions} dimensions",
    )
    c_code.require(
        target.id not in scope.owned_arrays,
        target,
        "is an array of its own, and cannot become another one",
    )
    _declare(target, source.type, scope)
    return [f"{name} = {_fitting(target, scope.local[target.id], source)};"]


def _size(call: ast.Call, scope: c_code.Scope) -> int:
    """Return the size of an array that ``zeros`` makes. Raises `InvalidInput` where it is
    unknown.
    """
    (size,) = call.args
    if isinstance(size, ast.Call):
        is_builtin = c_code.constant(size.func, scope) is None
        if is_builtin and ast.unparse(size.func) == "len":
            return c_code.length(size, size.args[0], scope)
    if isinstance(size, ast.Constant):
        value = size.value
    else:
        value = c_code.constant(size, scope)
    if not isinstance(value, int) or value < 1:
        raise c_code.kernel_error(
            call, "needs a size that is known: a number > 0 or the len of an array in a layout"
        )
    return int(value)


def _declare(target: ast.Name, kind: c_code.CType, scope: c_code.Scope) -> None:
    declared = scope.local.setdefault(target.id, kind)
    is_widened = declared == c_code.DOUBLE and kind == c_code.INT
    c_code.require(
        declared.name == kind.name or is_widened,
        target,
        f"is {declared.name} at first and {kind.name} here",
    )


def _fitting(node: ast.AST, expected: c_code.CType, value: c_code.CExpression) -> str:
    c_code.require(
        expected != c_code.INT or value.type != c_code.DOUBLE,
        node,
        "is a whole number; make the value one by int()",
    )
    return value.text


def _copy(
    target: ast.Subscript, part: ast.Slice, value: ast.expr, scope: c_code.Scope
) -> list[str]:
    """Copy the first n numbers, ``to[:n] = x[:n]``, or all numbers of an array in a layout,
    ``m.to[:] = x``, as many.
    """
    n = part.upper
    origin = value
    is_whole = n is None
    if n is not None and isinstance(value, ast.Subscript):
        is_whole = ast.unparse(value.slice) == f":{ast.unparse(n)}"
        if is_whole:
            origin = value.value
    to = c_code.expression(target.value, scope)
    source = c_code.expression(origin, scope)
    begins_at_first = part.lower is None and part.step is None
    are_vectors = len(to.type.sizes) == len(source.type.sizes) == 1
    known_sizes = {to.type.sizes, source.type.sizes} - {(0,)}
    has_equal_length = n is not None or len(known_sizes) < 2
    c_code.require(
        begins_at_first
        and is_whole
        and are_vectors
        and to.type.name == source.type.name
        and has_equal_length,
        target,
        "has to become the first numbers of another array, as many",
    )
    end: int | str
    if n is None:
        end = c_code.length(target, target.value, scope)
    else:
        end = c_code.number(n, scope).text
    k = f"at_{target.lineno}"
    last = f"end_{target.lineno}"
    loop = f"for (int {k} = 0, {last} = {end}; {k} < {last}; ++{k})"
    return [f"{loop} {to.text}[{k}] = {source.text}[{k}];"]


def _augmented(node: ast.AugAssign, scope: c_code.Scope) -> list[str]:
    target = _as_read(node.target)
    value = ast.BinOp(left=target, op=node.op, right=node.value)
    ast.copy_location(value, node)
    place = c_code.number(target, scope)
    source = c_code.number(value, scope)
    return [f"{place.text} = {_fitting(node, place.type, source)};"]


def _as_read(target: ast.expr) -> ast.expr:
    return ast.copy_location(ast.parse(ast.unparse(target), mode="eval").body, target)


def _if(node: ast.If, scope: c_code.Scope) -> list[str]:
    condition = c_code.number(node.test, scope).text
    lines = [f"if ({condition}) {{", *block(node.body, scope)]
    if node.orelse:
        lines += ["} else {", *block(node.orelse, scope)]
    return [*lines, "}"]


def _for(node: ast.For, scope: c_code.Scope) -> list[str]:
    """Count over a range, whose bounds are evaluated once, as Python does."""
    iterated = node.iter
    is_range = isinstance(iterated, ast.Call) and ast.unparse(iterated.func) == "range"
    if not isinstance(iterated, ast.Call) or not is_range or not isinstance(node.target, ast.Name):
        raise c_code.kernel_error(node, "has to go over a range")
    bounds = [c_code.number(bound, scope) for bound in iterated.args]
    are_integers = all(bound.type == c_code.INT for bound in bounds)
    c_code.require(
        not node.orelse and len(bounds) < 3 and are_integers,
        node,
        "has to go over a range of one or two whole numbers, without else",
    )
    start = "0"
    if len(bounds) == 2:
        start = bounds[0].text
    end = bounds[-1].text
    k = f"at_{node.lineno}"
    last = f"end_{node.lineno}"
    head = f"for (int {k} = {start}, {last} = {end}; {k} < {last}; ++{k}) {{"
    return [head, *_counter(node.target, k, scope), *block(node.body, scope), "}"]


def _counter(target: ast.Name, k: str, scope: c_code.Scope) -> list[str]:
    """Set a variable of the kernel, which keeps its value after the loop; none where it is called
    ``_``.
    """
    if target.id == "_":
        return []
    _declare(target, c_code.INT, scope)
    return [f"  {c_code.c_name(target.id)} = {k};"]


def _while(node: ast.While, scope: c_code.Scope) -> list[str]:
    c_code.require(not node.orelse, node, "has an else")
    condition = c_code.number(node.test, scope).text
    return [f"while ({condition}) {{", *block(node.body, scope), "}"]


def _return(node: ast.Return, scope: c_code.Scope) -> list[str]:
    fits = (node.value is None) == (scope.result == c_code.NOTHING)
    c_code.require(fits, node, "does not return what the kernel is annotated with")
    if node.value is None:
        return ["return;"]
    value = c_code.number(node.value, scope)
    return [f"return {_fitting(node, scope.result, value)};"]


def _expression_statement(node: ast.Expr, scope: c_code.Scope) -> list[str]:
    """Translate a call; a docstring is left out."""
    if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
        return []
    if not isinstance(node.value, ast.Call):
        raise c_code.kernel_error(node, "does nothing")
    function = _called_function(node.value, scope)
    if function is None:
        return [f"{c_code.expression(node.value, scope).text};"]
    return _smooth_call(node.value, function, scope)


def _called_function(call: ast.Call, scope: c_code.Scope) -> c_code.CExpression | None:
    """Return the field of a memory that is called, None where it is no field."""
    owner = call.func
    while isinstance(owner, ast.Attribute):
        owner = owner.value
    if isinstance(owner, ast.Name) and owner.id in scope.local:
        return c_code.expression(call.func, scope)
    return None


def _smooth_call(call: ast.Call, target: c_code.CExpression, scope: c_code.Scope) -> list[str]:
    """Call a CasADi function with vectors to read and vectors to fill."""
    structure = target.type.structure
    c_code.require(
        isinstance(structure, type) and issubclass(structure, FunctionStructure),
        call,
        "calls what is no function",
    )
    function = structure.function
    n_in = function.n_in()
    sizes = buffered.argument_sizes(function)
    c_code.require(
        len(call.args) == len(sizes),
        call,
        f"has to give {n_in} vectors to read and {len(sizes) - n_in} to fill",
    )
    lines = ["{", f"  {target.type.name} *f = {target.text};"]
    for k, (argument, size) in enumerate(zip(call.args, sizes, strict=True)):
        is_input = k < n_in
        vector = _vector(argument, size, is_input, scope)
        if is_input:
            lines.append(f"  f->arg[{k}] = {vector};")
        else:
            lines.append(f"  f->res[{k - n_in}] = {vector};")
    return [*lines, "  f->call(f->arg, f->res, f->iw, f->w, 0);", "}"]


def _vector(node: ast.expr, size: int, is_input: bool, scope: c_code.Scope) -> str:
    """Return the address of `size` numbers: of a vector, a structure of numbers, or one number."""
    if isinstance(node, ast.Constant) and node.value is None:
        return "0"
    source = c_code.expression(node, scope)
    if source.type.is_number and is_input and size == 1:
        return f"(const double[]){{{source.text}}}"
    column = c_code.column_size(source.type)
    if column >= size and column:
        return f"(double *){source.text}"
    is_vector = source.type.name == "double" and len(source.type.sizes) == 1
    is_too_short = is_vector and 0 < source.type.sizes[0] < size  # 0 is unknown
    c_code.require(is_vector and not is_too_short, node, f"is no vector of {size} numbers")
    return source.text


def _word(word: str) -> Callable[[Any, c_code.Scope], list[str]]:
    """Return the translation of a statement that is one word."""
    return lambda node, scope: [word]


_TRANSLATED: dict[type, Callable[[Any, c_code.Scope], list[str]]] = {
    ast.Assign: _assign,
    ast.AnnAssign: _assign,
    ast.AugAssign: _augmented,
    ast.Return: _return,
    ast.Expr: _expression_statement,
    ast.If: _if,
    ast.For: _for,
    ast.While: _while,
    ast.Break: _word("break;"),
    ast.Continue: _word("continue;"),
    ast.Pass: _word(";"),
}
