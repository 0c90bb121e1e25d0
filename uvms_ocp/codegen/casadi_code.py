"""C code that CasADi writes, as compilers take it best: numbers apart from it, and long functions
in parts.

Numbers are data, so that another gain, weight or goal is no new code. Functions of thousands of
statements call parts of theirs: compilers share registers out among all variables of a function,
which takes longer than all else where these are many, and is no better for it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence, Set
from itertools import count
from typing import NamedTuple

import casadi as ca
import numpy as np

TWO_CALLS = "two_calls"
"""Name in C of the function that makes two calls at once."""
_PART_LENGTH = 400
"""Statements of a part: compiled in the shortest time, and the code is no slower."""
_ARITHMETIC_SHARE = 0.9
"""Share of arithmetic in a function from which one call takes as long as two at once, each in its
half of a register.
"""
_STRAIGHT_FUNCTION = re.compile(
    r"(static int casadi_f\d+\(.*\) \{\n)(?:  casadi_real a.*;\n)+((?:  (?:a\d+=|if"
    r" \(res\[\d+\]!=0\) ).*;\n)+)  return 0;\n"
)
"""A function without branches: its head, and its statements."""
_STATEMENT = re.compile(r"  (?:(a\d+)=)?(.*\n)")
"""A statement: the variable that it sets, if it does, and what it is set to."""
_VARIABLE = re.compile(r"\ba\d+\b")
_IF_WANTED = re.compile(r"if \(res\[\d+\]!=0\) ")
"""Condition that a result is wanted."""
_IF_GIVEN = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
"""An entry of an argument, or 0 where that is not given."""
_VECTOR = re.compile(r"\b(?:arg|res)\[")
_ARITHMETIC = re.compile(r"  a\d+=\((?:-|(?:a\d+|numbers\[\d+\])[-+*/])a\d+\);\n")
"""A sum, difference, product or quotient of variables and numbers."""
_NUMBER = re.compile(r"(?<![\w.])\d+\.(?:\d+e[+-]\d+)?(?![\w.])")
_ARRAY = re.compile(r"static const casadi_real (casadi_c\d+)\[\d+\] =\s*\{([^}]*)\};")
"""Declaration of an array of constants: its name, and its numbers."""
_NUMBERS_OF_FORM = frozenset(("0.", "1."))
"""Numbers that stay in the code."""


def without_numbers(code: str) -> tuple[str, np.ndarray]:
    """Return C code as CasADi writes it with its numbers (n,) taken out, which its library has to
    be given, and these.
    """
    numbers: list[str] = []

    def replace_array(match: re.Match[str]) -> str:
        name = match[1]
        first = len(numbers)
        numbers.extend(match[2].replace("casadi_", "").split(","))  # casadi_inf, casadi_nan
        return f"#undef {name}\n#define {name} (numbers + {first})"

    def replace_number(match: re.Match[str]) -> str:
        if match[0] in _NUMBERS_OF_FORM:
            return match[0]
        numbers.append(match[0])
        return f"numbers[{len(numbers) - 1}]"

    code = _ARRAY.sub(replace_array, code)
    form = _NUMBER.sub(replace_number, code)
    return form, np.array(numbers, dtype=float)


def with_numbers(function: ca.Function, numbers: Sequence[float]) -> ca.Function:
    """Return ``function`` at these numbers [any], its last input: whatever they are, CasADi writes
    the same code but for an array.
    """
    names = function.name_in()[:-1]
    symbols = [ca.MX.sym(name, function.sparsity_in(name)) for name in names]
    # Equal numbers alone would be no array.
    values = ca.MX(ca.DM([*numbers, 0.0, 1.0]))[:-2]
    results = function.call([*symbols, values])
    return ca.Function(function.name(), symbols, results, names, function.name_out())


def with_variable(code: str, name: str, values: Sequence[float]) -> str:
    """Replace in C code as CasADi writes it the constant array of these `values` [any] by the
    variable `name` of a file beside it.
    """
    declarations = _ARRAY.finditer(code)
    declaration = next(match for match in declarations if np.array_equal(_numbers(match), values))
    array = declaration[1]
    variable = f"extern double {name}[];\n#undef {array}\n#define {array} {name}"
    return code.replace(declaration[0], variable)


def _numbers(declaration: re.Match[str]) -> np.ndarray:
    """Return the numbers (n,) of an array that CasADi declares."""
    return np.fromstring(declaration[2].replace("casadi_", ""), sep=",")


class _Statement(NamedTuple):
    """A statement of C."""

    line: str
    """The whole of it, with the end of its line."""
    target: str | None
    """The variable that it sets, `None` for a result."""
    read: list[str]
    """Variables that it reads, once each."""


def in_parts(code: str) -> str:
    """Split long functions without branches, in C code as CasADi writes it, into functions that
    they call; the results are the same to the bit.
    """
    function_numbers = count()

    def parted(function: re.Match[str]) -> str:
        return _parted(function, next(function_numbers))

    return _STRAIGHT_FUNCTION.sub(parted, code)


def _parted(function: re.Match[str], number: int) -> str:
    """Return one function in parts, for two calls at once where nearly all of it is arithmetic.
    number: of the function in its file, for the names of its parts.
    """
    head = function[1]
    body = _IF_WANTED.sub("", function[2])
    body = _IF_GIVEN.sub(r"arg[\1][\2]", body)
    statements = list[_Statement]()
    for statement in _STATEMENT.finditer(body):
        variables = list(dict.fromkeys(_VARIABLE.findall(statement[2])))
        statements.append(_Statement(statement[0], statement[1], variables))
    if len(statements) < 2 * _PART_LENGTH:
        return function[0]
    calls = ""
    for first in range(0, len(statements), _PART_LENGTH):
        calls += f"  part{number}_{first}(given, wanted, kept);\n"
    targets = [statement.target for statement in statements if statement.target]
    n_variables = 1 + max(map(_place, targets))
    n_arguments, largest_argument = _sizes("arg", body)
    n_results, largest_result = _sizes("res", body)
    sizes = f"{n_variables}, {n_arguments}, {largest_argument}, {n_results}, {largest_result}"
    n_arithmetic = sum(map(_is_arithmetic, statements))
    if "casadi_f0(" not in head or n_arithmetic < _ARITHMETIC_SHARE * len(targets):
        parts = _parts(number, statements, "double")
        return f"{parts}{head}  MEMORY_OF_PARTS({sizes})\n{calls}  return 0;\n"
    n_vectors = max(n_arguments, n_results)
    paired_statements = [_paired(statement, n_vectors) for statement in statements]
    parts = _parts(number, paired_statements, "pair")
    two_calls = f"TWO_CALLS {{\n  MEMORY_OF_PAIRS({sizes}, {n_vectors})\n{calls}}}\n"
    return f"{parts}{two_calls}{head}  ONE_CALL({n_results})\n  return 0;\n"


def _is_arithmetic(statement: _Statement) -> bool:
    return _ARITHMETIC.fullmatch(statement.line) is not None


def _parts(number: int, statements: Sequence[_Statement], kind: str) -> str:
    """Return C functions of `_PART_LENGTH` statements each, whose variables are of this kind."""
    later = set[str | None]()
    texts = list[str]()
    for first in reversed(range(0, len(statements), _PART_LENGTH)):
        part = statements[first : first + _PART_LENGTH]
        parameters = f"const double** arg, double** res, {kind}* kept"
        head = f"static __attribute__((noinline)) void part{number}_{first}({parameters})"
        texts.append(f"{head} {{\n{_part(part, later, kind)}}}\n")
        for statement in reversed(part):
            later.discard(statement.target)
            later.update(statement.read)
    return "".join(texts)


def _paired(statement: _Statement, n_vectors: int) -> _Statement:
    """Return a statement for two calls: arithmetic as it is, any other as two, one for each call;
    the vectors of the second call stand `n_vectors` places later.
    """
    if _is_arithmetic(statement):
        return statement
    line = statement.line.strip()
    line_of_second = _VECTOR.sub(rf"\g<0>{n_vectors} + ", line)
    first = _VARIABLE.sub(r"FIRST(\g<0>)", line)
    second = _VARIABLE.sub(r"OTHER(\g<0>)", line_of_second)
    return statement._replace(line=f"  {first} AND_OTHER({second})\n")


def _sizes(kind: str, body: str) -> tuple[int, int]:
    """Return how many vectors of a kind (arg or res) are used at most, and how many numbers of
    one.
    """
    last_vector = 0
    last_entry = 0
    for vector, entry in re.findall(rf"{kind}\[(\d+)\]\[(\d+)\]", body):
        last_vector = max(last_vector, int(vector))
        last_entry = max(last_entry, int(entry))
    return 1 + last_vector, 1 + last_entry


def _part(statements: Sequence[_Statement], later: Set[str | None], kind: str) -> str:
    """Return statements as C that reads what earlier parts have left in memory, and leaves there
    what is read `later`.
    """
    last = {statement.target: k for k, statement in enumerate(statements)}
    declared = dict[str, None]()
    text = list[str]()
    for k, (line, target, read) in enumerate(statements):
        for name in read:
            if name not in declared:
                text.append(f"  {name}=kept[{_place(name)}];\n")
                declared[name] = None
        text.append(line)
        if target:
            declared[target] = None
            if target in later and last[target] == k:
                text.append(f"  kept[{_place(target)}]={target};\n")
    return f"  {kind} {', '.join(declared)};\n{''.join(text)}"


def _place(name: str) -> int:
    """Return the place in memory of a variable: that of ``a7`` is 7."""
    return int(name[1:])
