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

_PART_LENGTH = 400  # statements: compiled in the least time, and the code is no slower
_STRAIGHT_FUNCTION = re.compile(
    r"(static int casadi_f\d+\(.*\) \{\n)(?:  casadi_real a.*;\n)+((?:  (?:a\d+=|if"
    r" \(res\[\d+\]!=0\) ).*;\n)+)  return 0;\n"
)
_STATEMENT = re.compile(r"  (?:(a\d+)=)?(.*\n)")
_VARIABLE = re.compile(r"\ba\d+\b")
_IF_WANTED = re.compile(r"if \(res\[\d+\]!=0\) ")
_IF_GIVEN = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
_VECTOR = re.compile(r"\b(?:arg|res)\[")
_ARITHMETIC = re.compile(r"  a\d+=\((?:-|(?:a\d+|numbers\[\d+\])[-+*/])a\d+\);\n")
# Where nearly all is arithmetic, one call takes as long as two at once, each in its half of a
# register: share of arithmetic from which it does.
_ARITHMETIC_SHARE = 0.9
TWO_CALLS = "two_calls"
"""Name in C of the function that makes two calls at once."""


_NUMBER = re.compile(r"(?<![\w.])\d+\.(?:\d+e[+-]\d+)?(?![\w.])")
_ARRAY = re.compile(r"static const casadi_real (casadi_c\d+)\[\d+\] =\s*\{([^}]*)\};")
_OF_FORM = frozenset(("0.", "1."))


def without_numbers(code: str) -> tuple[str, np.ndarray]:
    """C code as CasADi writes it with its numbers (n,) taken out, which its library has to be
    given, and these.
    """
    numbers: list[str] = []

    def array(match: re.Match[str]) -> str:
        numbers.extend(match[2].replace("casadi_", "").split(","))  # inf, nan
        return (
            f"#undef {match[1]}\n#define {match[1]} (numbers +"
            f" {len(numbers) - match[2].count(',') - 1})"
        )

    def number(match: re.Match[str]) -> str:
        if match[0] in _OF_FORM:
            return match[0]
        numbers.append(match[0])
        return f"numbers[{len(numbers) - 1}]"

    return _NUMBER.sub(number, _ARRAY.sub(array, code)), np.array(numbers, dtype=float)


def with_numbers(function: ca.Function, numbers: Sequence[float]) -> ca.Function:
    """``function`` at these numbers [any], its last input: whatever they are, CasADi writes the
    same code but for an array.
    """
    names = function.name_in()[:-1]
    symbols = [ca.MX.sym(name, function.sparsity_in(name)) for name in names]
    values = ca.MX(ca.DM([*numbers, 0.0, 1.0]))[:-2]  # equal ones alone would be no array
    return ca.Function(
        function.name(), symbols, function.call([*symbols, values]), names, function.name_out()
    )


def with_variable(code: str, name: str, values: Sequence[float]) -> str:
    """C code as CasADi writes it, whose constant array of these `values` [any] is the variable
    `name` of a file beside it.
    """
    arrays = (
        (match, np.fromstring(match[2].replace("casadi_", ""), sep=","))
        for match in _ARRAY.finditer(code)
    )
    declaration = next(match for match, numbers in arrays if np.array_equal(numbers, values))
    return code.replace(
        declaration[0],
        f"extern double {name}[];\n#undef {declaration[1]}\n#define {declaration[1]} {name}",
    )


class _Statement(NamedTuple):
    line: str
    target: str | None
    """The variable that it sets, `None` for a result."""
    read: list[str]
    """Variables that it reads, once each."""


def in_parts(code: str) -> str:
    """Split long functions without branches, in C code as CasADi writes it, into functions that
    they call; the results are the same to the bit.
    """
    numbers = count()
    return _STRAIGHT_FUNCTION.sub(lambda found: _parted(found, next(numbers)), code)


def _parted(function: re.Match[str], number: int) -> str:
    """Return one function in parts, for two calls at once where nearly all of it is arithmetic."""
    body = _IF_GIVEN.sub(r"arg[\1][\2]", _IF_WANTED.sub("", function[2]))
    statements = [
        _Statement(statement[0], statement[1], [*dict.fromkeys(_VARIABLE.findall(statement[2]))])
        for statement in _STATEMENT.finditer(body)
    ]
    if len(statements) < 2 * _PART_LENGTH:
        return function[0]
    calls = "".join(
        f"  part{number}_{first}(given, wanted, kept);\n"
        for first in range(0, len(statements), _PART_LENGTH)
    )
    targets = [statement.target for statement in statements if statement.target]
    (n_given, most_given) = _sizes("arg", body)
    (n_wanted, most_wanted) = _sizes("res", body)
    sizes = f"{1 + max(map(_place, targets))}, {n_given}, {most_given}, {n_wanted}, {most_wanted}"
    n = max(n_given, n_wanted)
    plain = sum(_ARITHMETIC.fullmatch(statement.line) is not None for statement in statements)
    if "casadi_f0(" not in function[1] or plain < _ARITHMETIC_SHARE * len(targets):
        parts = _parts(number, statements, "double")
        return f"{parts}{function[1]}  MEMORY_OF_PARTS({sizes})\n{calls}  return 0;\n"
    statements = [
        statement
        if _ARITHMETIC.fullmatch(statement.line)
        else statement._replace(line=_paired(statement.line, n))
        for statement in statements
    ]
    both = f"TWO_CALLS {{\n  MEMORY_OF_PAIRS({sizes}, {n})\n{calls}}}\n"
    parts = _parts(number, statements, "pair")
    return f"{parts}{both}{function[1]}  ONE_CALL({n_wanted})\n  return 0;\n"


def _parts(number: int, statements: Sequence[_Statement], kind: str) -> str:
    """Return C functions of `_PART_LENGTH` statements each, whose variables are of this kind."""
    later = set[str | None]()
    texts = list[str]()
    for first in reversed(range(0, len(statements), _PART_LENGTH)):
        part = statements[first : first + _PART_LENGTH]
        head = (
            f"static __attribute__((noinline)) void part{number}_{first}(const double** arg,"
            f" double** res, {kind}* kept)"
        )
        texts.append(f"{head} {{\n{_part(part, later, kind)}}}\n")
        for statement in reversed(part):
            later.discard(statement.target)
            later.update(statement.read)
    return "".join(texts)


def _paired(line: str, n: int) -> str:
    """Return a statement that is no arithmetic as two, one for each of two calls; the vectors of
    the second call stand n places later.
    """
    lanes = {"FIRST": line.strip(), "OTHER": _VECTOR.sub(rf"\g<0>{n} + ", line.strip())}
    first, second = (_VARIABLE.sub(rf"{lane}(\g<0>)", text) for lane, text in lanes.items())
    return f"  {first} AND_OTHER({second})\n"


def _sizes(kind: str, body: str) -> tuple[int, int]:
    """Return how many vectors of a kind (arg or res) are used at most, and how many numbers of
    one.
    """
    places = [(int(k), int(i)) for k, i in re.findall(rf"{kind}\[(\d+)\]\[(\d+)\]", body)]
    return 1 + max((k for k, _ in places), default=0), 1 + max((i for _, i in places), default=0)


def _part(statements: Sequence[_Statement], later: Set[str | None], kind: str) -> str:
    """Return statements as C that reads what earlier parts have left in memory, and leaves there
    what is read `later`.
    """
    last = {statement.target: k for k, statement in enumerate(statements)}
    declared = dict[str, None]()
    text = list[str]()
    for k, (line, target, read) in enumerate(statements):
        text += [f"  {name}=kept[{_place(name)}];\n" for name in read if name not in declared]
        text.append(line)
        declared |= dict.fromkeys([*read, target] if target else read)
        if target and target in later and last[target] == k:
            text.append(f"  kept[{_place(target)}]={target};\n")
    return f"  {kind} {', '.join(declared)};\n{''.join(text)}"


def _place(name: str) -> int:
    return int(name[1:])
