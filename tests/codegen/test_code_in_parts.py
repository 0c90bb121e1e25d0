"""Long functions are compiled in parts, which compilers take in a time that grows with their length
alone.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp.codegen import bound_calls, c_text
from uvms_ocp.codegen.bound_calls import BoundCalls
from uvms_ocp.codegen.casadi_code import in_parts
from uvms_ocp.codegen.compile import compile_function, compiled_symbol, two_calls
from uvms_ocp.codegen.libraries import compile_library

LONG = 1500
KINDS = (
    lambda a, b: a * b / (1.0 + b**2),
    lambda a, b: 0.7 * a - 0.3 * b,
    lambda a, b: ca.fmin(a, b),
    lambda a, b: ca.sin(a),
)


ARITHMETIC = (
    lambda a, b: a - a * b,
    lambda a, b: a * b - b,
    lambda a, b: a / (a - b),
)


def long_function(
    seed: int, n: int = LONG, kinds: Sequence[Callable[[ca.SX, ca.SX], ca.SX]] = KINDS
) -> ca.Function:
    """Statements that read what others wrote long before, with two results and an input that may be
    missing.
    """
    rng = np.random.default_rng(seed)
    x = ca.SX.sym("x", 5)
    y = ca.SX.sym("y", 2)
    values = [*ca.vertsplit(x), *ca.vertsplit(y)]
    for _ in range(n):
        first, second = (
            values[int(len(values) * (1.0 - share**2))] for share in rng.uniform(0.01, 1.0, 2)
        )
        values.append(kinds[rng.integers(len(kinds))](first, second))
    return ca.Function("many", [x, y], [ca.vertcat(*values[-40:]), ca.vertcat(*values[7::9])])


def code_of(function: ca.Function) -> str:
    generator = ca.CodeGenerator("many.c", {"verbose": False})
    generator.add(function)
    return str(generator.dump())


@needs_compiler
@pytest.mark.parametrize("seed", range(2))
def test_parts_give_what_the_whole_gives(seed: int) -> None:
    function = long_function(seed)
    X = np.random.default_rng(9).normal(size=7)
    compiled = compile_function(function)
    assert compiled is not function
    for value, expected in zip(compiled(X[:5], X[5:]), function(X[:5], X[5:]), strict=True):
        np.testing.assert_allclose(np.array(value), np.array(expected), rtol=1e-11, atol=1e-13)


@needs_compiler
def test_parts_take_nothing_for_zeros_and_write_what_is_wanted() -> None:
    function = long_function(1)
    address = compiled_symbol(function)
    assert address is not None
    call = ctypes.CFUNCTYPE(ctypes.c_int, *(ctypes.c_void_p,) * 4, ctypes.c_int)(address)
    X = np.full(5, 0.4)
    result = np.zeros(40)
    expected = np.array(function(np.full(5, 0.4), np.zeros(2))[0]).ravel()
    arguments = (ctypes.c_void_p * 8)(X.ctypes.data, None)
    results = (ctypes.c_void_p * 8)(result.ctypes.data, None)
    assert call(arguments, results, None, None, 0) == 0
    np.testing.assert_allclose(result, expected, rtol=1e-11, atol=1e-13)


@needs_compiler
def test_code_is_taken_apart_only_where_it_is_not_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    calls: list[str] = []

    def prepare(code: str) -> str:
        calls.append(code)
        return f"{code} int other(void) {{ return 2; }}"

    library, again = (
        compile_library("int one(void) { return 1; }", prepare=prepare) for _ in range(2)
    )
    assert library == again
    assert library is not None
    assert ctypes.CDLL(str(library)).other() == 2
    assert len(calls) == 1


def test_no_part_has_many_variables_and_short_functions_have_none() -> None:
    parts = in_parts(code_of(long_function(0))).split("noinline")[1:]
    statements = [part.count(";\n") - 2 * part.count("kept[") for part in parts]
    assert len(parts) > LONG / 400
    assert max(len(set(re.findall(r"\ba\d+\b", part))) for part in parts) < 900
    assert max(statements) < 410
    short = code_of(long_function(0, 30))
    assert in_parts(short) == short


def test_code_with_branches_stays_as_it_is() -> None:
    x = ca.MX.sym("x", 30)
    code = code_of(
        ca.Function(
            "many", [x], [ca.vertcat(*(ca.if_else(x[i] > 0, x @ x[i], x, True) for i in range(30)))]
        )
    )
    assert in_parts(code) == code


def arithmetic() -> ca.Function:
    """A long function of nearly nothing but arithmetic, compiled."""
    function = long_function(3, kinds=ARITHMETIC)
    x = ca.SX.sym("x", 5)
    y = ca.SX.sym("y", 2)
    rows, columns = function(x, y)
    return compile_function(
        ca.Function("plain", [x, y], [ca.vertcat(rows, ca.sin(x), ca.fmax(y, 0.0)), columns])
    )


def results_of(
    function: ca.Function, X: np.ndarray, *, with_results: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Of calls one after the other, which may be made two at a time; the second result of the first
    call only where `wanted`.
    """
    first, second = (np.zeros((len(X), function.numel_out(i))) for i in range(2))
    calls = BoundCalls()
    for k, x in enumerate(X):
        calls.add(function, [x[:5], x[5:]], [first[k], second[k] if k or with_results else None])
    calls()
    return first, second


def has_pairs() -> bool:
    """Check whether the compiler here knows vectors of numbers."""
    path = compile_library(
        f"{c_text.PARTS}\nint size(void) {{ return sizeof(pair) / sizeof(double); }}\n"
    )
    return path is not None and ctypes.CDLL(str(path)).size() == 2


@needs_compiler
@pytest.mark.parametrize("n", [1, 2, 5])
def test_two_calls_at_once_give_the_bits_of_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, n: int
) -> None:
    function = arithmetic()
    X = np.random.default_rng(4).normal(size=(n, 7))
    assert (two_calls(function) is not None) == has_pairs()
    together = results_of(function, X)
    monkeypatch.setattr(bound_calls, "two_calls", lambda function: None)
    for paired, single in zip(together, results_of(function, X), strict=True):
        np.testing.assert_array_equal(paired, single)
    expected = np.array(function(X[0, :5], X[0, 5:])[0]).ravel()
    np.testing.assert_array_equal(together[0][0], expected)


@needs_compiler
def test_what_is_no_number_in_one_of_two_calls_is_none_in_the_other() -> None:
    function = arithmetic()
    X = np.random.default_rng(5).normal(size=(2, 7))
    X[0] = np.nan
    first, second = results_of(function, X, with_results=False)
    assert np.isnan(first[0, :5]).any()
    assert not second[0].any()
    expected = [np.array(result).ravel() for result in function(X[1, :5], X[1, 5:])]
    np.testing.assert_array_equal(first[1], expected[0])
    np.testing.assert_array_equal(second[1], expected[1])


@needs_compiler
def test_a_call_that_builds_on_the_one_before_is_made_after_it() -> None:
    function = arithmetic()
    x = np.linspace(0.1, 0.5, 5)
    y = np.array([0.3, -0.2])
    first = np.zeros(function.numel_out(0))
    second = np.zeros(function.numel_out(0))
    calls = BoundCalls()
    calls.add(function, [x, y], [first, None])
    calls.add(function, [first[:5], y], [second, None])
    calls()
    np.testing.assert_array_equal(second, np.array(function(first[:5], y)[0]).ravel())


def test_functions_of_little_arithmetic_are_made_one_call_at_a_time() -> None:
    assert "TWO_CALLS" in in_parts(code_of(long_function(0, kinds=ARITHMETIC)))
    assert "TWO_CALLS" not in in_parts(code_of(long_function(0)))
