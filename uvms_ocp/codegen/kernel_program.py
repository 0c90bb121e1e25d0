"""Translate statements of kernels, and everything that they call, to one C program."""

from __future__ import annotations

import ast
import ctypes
import inspect
import linecache
import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from importlib.resources import files
from types import FunctionType
from typing import Any, get_type_hints

from uvms_ocp.codegen import buffered, kernel_expressions as c_code, kernel_layout
from uvms_ocp.codegen.compile import WIDE_MACROS
from uvms_ocp.codegen.kernel_layout import (
    WIDE,
    FunctionStructure,
    Layout,
    Vector,
    work_sizes,
    zeros,
)
from uvms_ocp.errors import InvalidInput

_PURE = (
    "abs",
    "bool",
    "float",
    "int",
    "len",
    "max",
    "min",
    *(f"math.{name}" for name in vars(math)),
)
TRANSLATOR = __file__, c_code.__file__, kernel_layout.__file__, buffered.__file__
"""Files of the code that makes a C program of kernels."""
_HEAD = (files("uvms_ocp.codegen") / "kernels.c").read_text(encoding="utf-8")
_MOST_DOTS = 2  # dots in module.Enumeration.MEMBER

_PLAIN = {
    float: c_code.DOUBLE,
    int: c_code.INT,
    bool: c_code.INT,
    Vector: c_code.VECTOR,
    type(None): c_code.NOTHING,
}


def block(nodes: Sequence[ast.stmt], scope: c_code.Scope) -> list[str]:
    """Lines of C, indented by two blanks. Raises `InvalidInput` for what kernels cannot do."""
    return [
        f"  {line}"
        for node in nodes
        for line in _TRANSLATED.get(type(node), c_code.refused)(node, scope)
    ]


def _assign(node: ast.Assign | ast.AnnAssign, scope: c_code.Scope) -> list[str]:
    """Assign to several targets one after the other, which is the same as at once where no value
    depends on what the others change.
    """
    if node.value is None:
        raise c_code.kernel_error(node, "has to give a value")
    pairs: list[tuple[ast.expr, ast.expr]] = []
    for target in [node.target] if isinstance(node, ast.AnnAssign) else node.targets:
        if isinstance(target, ast.Tuple):
            values = node.value.elts if isinstance(node.value, ast.Tuple) else []
            c_code.require(len(values) == len(target.elts), node, "has to give as many values")
            pairs += zip(target.elts, values, strict=True)
        else:
            pairs.append((target, node.value))
    alone = len(pairs) < 2 or not any(
        _reads(value, target) for target, _ in pairs for _, value in pairs
    )
    c_code.require(alone, node, "has to give values that depend on nothing that it changes")
    return [line for target, value in pairs for line in _to_place(target, value, scope)]


def _reads(value: ast.expr, target: ast.expr) -> bool:
    """Check whether a value may depend on a target, which other names may stand for too."""
    parts = list(ast.walk(value))
    is_element = isinstance(target, ast.Subscript)
    while isinstance(target, ast.Subscript):
        target = target.value
    if isinstance(target, ast.Name) and not is_element:
        return any(isinstance(part, ast.Name) and part.id == target.id for part in parts)
    name = target.attr if isinstance(target, ast.Attribute) else ""
    called = any(
        isinstance(part, ast.Call) and ast.unparse(part.func) not in _PURE for part in parts
    )
    if is_element:
        others = [part.value for part in parts if isinstance(part, ast.Subscript)]
    else:
        others = []
    aliases = any(not isinstance(part, ast.Attribute) or not name for part in others)
    return (
        called
        or aliases
        or any(isinstance(part, ast.Attribute) and part.attr == name for part in parts)
    )


def _to_place(target: ast.expr, value: ast.expr, scope: c_code.Scope) -> list[str]:
    if isinstance(target, ast.Name):
        return _to_variable(target, value, scope)
    if isinstance(target, ast.Subscript) and isinstance(target.slice, ast.Slice):
        return _copy(target, target.slice, value, scope)
    place = c_code.number(target, scope)
    source = c_code.number(value, scope)
    return [f"{place.text} = {_fitting(target, place.type, source)};"]


def _copy(
    target: ast.Subscript, part: ast.Slice, value: ast.expr, scope: c_code.Scope
) -> list[str]:
    """The first n numbers, ``to[:n] = x[:n]``, or all numbers of an array in a layout,
    ``m.to[:] = x``, as many.
    """
    n = part.upper
    of = value
    if (
        n is not None
        and isinstance(value, ast.Subscript)
        and ast.unparse(value.slice) == f":{ast.unparse(n)}"
    ):
        of = value.value
    to = c_code.expression(target.value, scope)
    source = c_code.expression(of, scope)
    fits = to.type.name == source.type.name and len(to.type.sizes) == len(source.type.sizes) == 1
    equal = (
        n is not None or len({to.type.sizes, source.type.sizes} - {(0,)}) < 2
    )  # as far as they are known
    first = not (part.lower or part.step) and (n is not None) == (of is not value)
    c_code.require(
        first and fits and equal,
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
    return [
        (
            f"for (int {k} = 0, {last} = {end}; {k} < {last}; ++{k}) {to.text}[{k}] ="
            f" {source.text}[{k}];"
        )
    ]


def _to_variable(target: Any, value: ast.expr, scope: c_code.Scope) -> list[str]:
    name = c_code.c_name(target.id)
    if isinstance(value, ast.Call) and c_code.constant(value.func, scope) is zeros:
        _declare(target, c_code.CType("double", (_size(value, scope),)), scope)
        scope.own.add(target.id)
        return [f"memset({name}, 0, sizeof {name});"]
    source = c_code.expression(value, scope)
    sizes = len(source.type.sizes)
    c_code.require(
        sizes < 2 and source.type != c_code.NOTHING,
        target,
        f"would be {source.type.name} of {sizes} dimensions",
    )
    c_code.require(
        target.id not in scope.own, target, "is an array of its own, and cannot become another one"
    )
    _declare(target, source.type, scope)
    return [f"{name} = {_fitting(target, scope.local[target.id], source)};"]


def _size(call: ast.Call, scope: c_code.Scope) -> int:
    (of,) = call.args
    if (
        isinstance(of, ast.Call)
        and c_code.constant(of.func, scope) is None
        and ast.unparse(of.func) == "len"
    ):
        return c_code.length(of, of.args[0], scope)
    if isinstance(of, ast.Constant):
        value = of.value
    else:
        value = c_code.constant(of, scope)
    if not isinstance(value, int) or value < 1:
        raise c_code.kernel_error(
            call, "needs a size that is known: a number > 0 or the len of an array in a layout"
        )
    return int(value)


def _declare(target: ast.Name, kind: c_code.CType, scope: c_code.Scope) -> None:
    declared = scope.local.setdefault(target.id, kind)
    alike = declared.name == kind.name or (declared == c_code.DOUBLE and kind == c_code.INT)
    c_code.require(alike, target, f"is {declared.name} at first and {kind.name} here")


def _fitting(node: ast.AST, expected: c_code.CType, value: c_code.CExpression) -> str:
    c_code.require(
        expected != c_code.INT or value.type != c_code.DOUBLE,
        node,
        "is a whole number; make the value one by int()",
    )
    return value.text


def _augmented(node: ast.AugAssign, scope: c_code.Scope) -> list[str]:
    value = ast.BinOp(left=_as_read(node.target), op=node.op, right=node.value)
    ast.copy_location(value, node)
    place = c_code.number(_as_read(node.target), scope)
    source = c_code.number(value, scope)
    return [f"{place.text} = {_fitting(node, place.type, source)};"]


def _as_read(target: ast.expr) -> ast.expr:
    return ast.copy_location(ast.parse(ast.unparse(target), mode="eval").body, target)


def _if(node: ast.If, scope: c_code.Scope) -> list[str]:
    lines = [f"if ({c_code.number(node.test, scope).text}) {{", *block(node.body, scope)]
    if node.orelse:
        lines += ["} else {", *block(node.orelse, scope)]
    return [*lines, "}"]


def _for(node: ast.For, scope: c_code.Scope) -> list[str]:
    over = node.iter
    if not (
        isinstance(over, ast.Call)
        and ast.unparse(over.func) == "range"
        and isinstance(node.target, ast.Name)
    ):
        raise c_code.kernel_error(node, "has to go over a range")
    bounds = [c_code.number(bound, scope) for bound in over.args]
    plain = (
        not node.orelse and len(bounds) < 3 and all(bound.type == c_code.INT for bound in bounds)
    )
    c_code.require(plain, node, "has to go over a range of one or two whole numbers, without else")
    start, end = ("0", bounds[0].text) if len(bounds) == 1 else (bounds[0].text, bounds[1].text)
    # as Python, which looks at the bounds once
    k = f"at_{node.lineno}"
    last = f"end_{node.lineno}"
    head = f"for (int {k} = {start}, {last} = {end}; {k} < {last}; ++{k}) {{"
    return [head, *_counter(node.target, k, scope), *block(node.body, scope), "}"]


def _counter(target: ast.Name, k: str, scope: c_code.Scope) -> list[str]:
    """A variable of the kernel's own, as it keeps its value after the loop; none where it is called
    ``_``.
    """
    if target.id == "_":
        return []
    _declare(target, c_code.INT, scope)
    return [f"  {c_code.c_name(target.id)} = {k};"]


def _while(node: ast.While, scope: c_code.Scope) -> list[str]:
    c_code.require(not node.orelse, node, "has an else")
    return [f"while ({c_code.number(node.test, scope).text}) {{", *block(node.body, scope), "}"]


def _return(node: ast.Return, scope: c_code.Scope) -> list[str]:
    fits = (node.value is None) == (scope.result == c_code.NOTHING)
    c_code.require(fits, node, "does not return what the kernel is annotated with")
    if node.value is None:
        value = ""
    else:
        value = f" {_fitting(node, scope.result, c_code.number(node.value, scope))}"
    return [f"return{value};"]


def _alone(node: ast.Expr, scope: c_code.Scope) -> list[str]:
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
    structure = target.type.structure
    c_code.require(
        isinstance(structure, type) and issubclass(structure, FunctionStructure),
        call,
        "calls what is no function",
    )
    function = structure.function
    n = function.n_in()
    sizes = buffered.argument_sizes(function)
    c_code.require(
        len(call.args) == len(sizes),
        call,
        f"has to give {n} vectors to read and {len(sizes) - n} to fill",
    )
    vectors = [
        _vector(argument, size, k < n, scope)
        for k, (argument, size) in enumerate(zip(call.args, sizes, strict=True))
    ]
    places = [f"arg[{k}]" if k < n else f"res[{k - n}]" for k in range(len(sizes))]
    filled = [f"  f->{place} = {vector};" for place, vector in zip(places, vectors, strict=True)]
    return [
        "{",
        f"  {target.type.name} *f = {target.text};",
        *filled,
        "  f->call(f->arg, f->res, f->iw, f->w, 0);",
        "}",
    ]


def _vector(node: ast.expr, size: int, read: bool, scope: c_code.Scope) -> str:
    if isinstance(node, ast.Constant) and node.value is None:
        return "0"
    source = c_code.expression(node, scope)
    if source.type.is_number and read and size == 1:
        return f"(const double[]){{{source.text}}}"
    column = c_code.column_size(source.type)
    if column >= size and column:
        return f"(double *){source.text}"
    length = source.type.sizes[0] if source.type.sizes else -1
    fits = source.type.name == "double" and len(source.type.sizes) == 1 and not 0 < length < size
    c_code.require(fits, node, f"is no vector of {size} numbers")
    return source.text


def _word(word: str) -> Callable[[Any, c_code.Scope], list[str]]:
    return lambda node, scope: [word]


_TRANSLATED = dict[type, Callable[[Any, c_code.Scope], list[str]]]()
_TRANSLATED |= {
    ast.Assign: _assign,
    ast.AnnAssign: _assign,
    ast.AugAssign: _augmented,
    ast.Return: _return,
    ast.Expr: _alone,
}
_TRANSLATED |= {ast.If: _if, ast.For: _for, ast.While: _while}
_TRANSLATED |= {ast.Break: _word("break;"), ast.Continue: _word("continue;"), ast.Pass: _word(";")}


def c_program(
    kernels: Sequence[Callable[..., Any]], structures: Iterable[type[Any]]
) -> tuple[str, str]:
    """The `kernels`, under their names behind ``k_``, and what they call: C99 that needs libm only,
    types and then functions.

    structures: those that their parameters are annotated with, as `structure_of` makes them. Raises
    `InvalidInput` for a function that is no kernel, with the line.
    """
    program = _Program(structures)
    for kernel in kernels:
        program.signature_of(kernel)
    while program.waiting:
        program.translate(program.waiting.pop(0))
    heads = {
        k: f"{'' if k in kernels else 'static '}{_head(signature)}"
        for k, signature in program.signatures.items()
    }
    wide = WIDE.intersection(heads)
    bodies = [
        f"{'WIDE ' if kernel in wide else ''}{head} {{\n{program.bodies[kernel]}}}\n"
        for kernel, head in heads.items()
    ]
    code = "\n".join(
        [
            _HEAD,
            *([WIDE_MACROS] if wide else []),
            *(f"{head};" for head in heads.values()),
            "",
            *bodies,
        ]
    )
    return "\n".join(program.declared), code


def program_content(kernels: Iterable[Any]) -> str:
    """All that a C program is made of but its structures: texts of kernels and of what they call,
    and what they name.
    """
    reached = [*filter(inspect.isfunction, kernels)]
    parts = list[Any]()
    texts = {"head": _HEAD, "wide": WIDE_MACROS}
    for kernel in reached:  # which grows
        place, names = kernel.__code__, kernel.__globals__
        texts[place.co_filename] = texts.get(place.co_filename) or _text(place.co_filename)
        words = sorted({*place.co_names, *re.findall(r"\w+", str(kernel.__annotations__))})
        values = [(word, names[word]) for word in words if word in names]
        for path, owner in values:  # as before
            if not isinstance(owner, float | int | FunctionType) and path.count(".") < _MOST_DOTS:
                values += [
                    (f"{path}.{word}", getattr(owner, word))
                    for word in words
                    if hasattr(owner, word)
                ]
        parts.append((kernel.__module__, kernel.__name__, place.co_firstlineno, kernel in WIDE))
        parts += [(path, _named_value(value)) for path, value in values]
        called = dict.fromkeys(value for _, value in values if inspect.isfunction(value))
        reached += [
            function
            for function in called
            if function.__name__ == function.__qualname__ and function not in reached
        ]
    return f"{parts} {texts}"


def _named_value(value: Any) -> str:
    number = c_code.literal(value)
    if number:
        return number.text
    return getattr(value, "__qualname__", type(value).__qualname__)


def structure_signature(kind: Any) -> Any:
    """All that a C program tells of a type of a field, or of a structure."""
    if issubclass(kind, FunctionStructure):
        return kind.__name__, *buffered.argument_sizes(kind.function)
    if issubclass(kind, ctypes.Structure):
        return kind.__name__, *((name, structure_signature(part)) for name, part in kind._fields_)
    if issubclass(kind, ctypes.Array):
        return (kind._length_, structure_signature(kind._type_))
    return kind


class _Program:
    """Program under construction."""

    def __init__(self, structures: Iterable[type[ctypes.Structure]]) -> None:
        self.declared: list[str] = []
        self.signatures: dict[Callable[..., Any], c_code.Signature] = {}
        self.bodies: dict[Callable[..., Any], str] = {}
        self.waiting: list[Callable[..., Any]] = []
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
            self.signatures[kernel] = self._read(
                name if self._names[name] == 1 else f"{name}_{self._names[name]}", kernel
            )
            self.waiting.append(kernel)
        return self.signatures[kernel]

    def _read(self, name: str, kernel: Callable[..., Any]) -> c_code.Signature:
        hints = get_type_hints(kernel)
        result = self._type(f"what {name} returns", hints.pop("return", None))
        parameters = {
            p: self._type(f"{name}: {p}", hints.get(p))
            for p in inspect.signature(kernel).parameters
        }
        return c_code.Signature(name, parameters, result)

    def translate(self, kernel: Callable[..., Any]) -> None:
        """The body of a kernel."""
        signature = self.signatures[kernel]
        scope = c_code.Scope(
            names=vars(sys.modules[kernel.__module__]),
            signature_of=self.signature_of,
            result=signature.result,
            local=dict(signature.parameters),
        )
        try:
            lines = block(_syntax(kernel).body, scope)
        except InvalidInput as error:
            raise InvalidInput(
                f"{kernel.__module__}.{kernel.__name__} is no kernel: {error}"
            ) from None
        declarations = [
            f"  {_variable(name, kind, is_owned=name in scope.own)};"
            for name, kind in scope.local.items()
            if name not in signature.parameters
        ]
        self.bodies[kernel] = "".join(f"{line}\n" for line in declarations + lines)

    def _type(self, what: str, hint: Any) -> c_code.CType:
        if hint is None or hint in _PLAIN:
            return _PLAIN.get(hint, c_code.NOTHING)
        if (
            isinstance(hint, type)
            and issubclass(hint, Layout)
            and hint.__name__ in self._structures
        ):
            return c_code.CType(hint.__name__, (), self._structures[hint.__name__])
        layouts = [
            name
            for name, kind in self._structures.items()
            if not issubclass(kind, FunctionStructure)
        ]
        raise InvalidInput(
            f"{what} is annotated with {hint}; give float, int, bool, Vector or a layout of"
            f" {layouts}"
        )

    def _declare(self, structure: type[ctypes.Structure]) -> None:
        name = structure.__name__
        if name in self._structures:
            if self._structures[name] is not structure:
                raise InvalidInput(f"layout {name} has two sizes in one program; give it one")
            return
        if issubclass(structure, FunctionStructure):
            self._structures[name] = structure
            n_arg, n_res, n_iw, n_w = work_sizes(structure.function)
            call = "int (*call)(const double **, double **, long long int *, double *, int);"
            memory = (
                f"const double *arg[{n_arg}];\n  double *res[{n_res}];\n  long long int"
                f" iw[{n_iw}];\n  double w[{n_w}];"
            )
            self.declared.append(
                f"typedef struct {{\n  {call}\n  {memory}\n}} {structure.__name__};\n"
            )
            return
        kinds = {field: c_code.of_ctypes(kind) for field, kind in structure._fields_}  # type: ignore[misc]
        for kind in kinds.values():
            if kind.structure is not None:
                self._declare(kind.structure)
        self._structures[name] = structure
        fields = "".join(f"  {_field(field, kind)};\n" for field, kind in kinds.items())
        self.declared.append(f"typedef struct {{\n{fields}}} {name};\n")


def _head(signature: c_code.Signature) -> str:
    parameters = (
        ", ".join(kind.declared(c_code.c_name(p)) for p, kind in signature.parameters.items())
        or "void"
    )
    return f"{signature.result.name} {c_code.PREFIX}{signature.name}({parameters})"


def _field(name: str, kind: c_code.CType) -> str:
    return f"{kind.name} {c_code.c_name(name)}{''.join(f'[{size}]' for size in kind.sizes)}"


def _variable(name: str, kind: c_code.CType, *, is_owned: bool) -> str:
    """Declare an array that the kernel owns, a pointer to memory of another owner, or a number,
    which is set before it is read.
    """
    if is_owned:
        return kind.declared(c_code.c_name(name))
    return f"{kind.name} {'' if kind.is_number else '*'}{c_code.c_name(name)} = 0"


def _syntax(kernel: Callable[..., Any]) -> ast.FunctionDef:
    place = kernel.__code__
    definition = _functions_in(_text(place.co_filename)).get(place.co_firstlineno)
    if definition is None or len(definition.decorator_list) > (kernel in WIDE):
        raise InvalidInput(
            f"{kernel.__name__} is no plain function; kernels have no decorators but `wide`"
        )
    return definition


def _text(file: str) -> str:
    linecache.checkcache(file)
    return "".join(linecache.getlines(file))


@lru_cache(maxsize=128)
def _functions_in(text: str) -> dict[int, ast.FunctionDef]:
    """Functions at the top level of a file, by the line in which each begins: one parse is quicker
    than a search for each.
    """
    functions = (node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef))
    return {
        node.decorator_list[0].lineno if node.decorator_list else node.lineno: node
        for node in functions
    }
