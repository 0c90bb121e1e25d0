"""Long functions are compiled in parts, which compilers take in a time that grows with their length alone."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp.codegen.casadi_code import in_parts
from uvms_ocp.codegen.compile import compile_function, compile_library, compiled_symbol

LONG = 1500
KINDS = (
    lambda one, other: one * other / (1.0 + other**2),
    lambda one, other: 0.7 * one - 0.3 * other,
    lambda one, other: ca.fmin(one, other),
    lambda one, other: ca.sin(one),
)


def long_function(seed: int, n: int = LONG) -> ca.Function:
    """Statements that read what others wrote long before, with two results and an input that may be missing."""
    rng, x, y = np.random.default_rng(seed), ca.SX.sym("x", 5), ca.SX.sym("y", 2)
    made = [*ca.vertsplit(x), *ca.vertsplit(y)]
    for _ in range(n):
        one, other = (made[int(len(made) * (1.0 - share**2))] for share in rng.uniform(0.01, 1.0, 2))
        made.append(KINDS[rng.integers(4)](one, other))
    return ca.Function("many", [x, y], [ca.vertcat(*made[-40:]), ca.vertcat(*made[7::9])])


def code_of(function: ca.Function) -> str:
    generator = ca.CodeGenerator("many.c", {"verbose": False})
    generator.add(function)
    return str(generator.dump())


@needs_compiler
@pytest.mark.parametrize("seed", range(2))
def test_parts_give_what_the_whole_gives(seed: int) -> None:
    function, X = long_function(seed), np.random.default_rng(9).normal(size=7)
    compiled = compile_function(function)
    assert compiled is not function
    for found, known in zip(compiled(X[:5], X[5:]), function(X[:5], X[5:]), strict=True):
        np.testing.assert_allclose(np.array(found), np.array(known), rtol=1e-11, atol=1e-13)


@needs_compiler
def test_parts_take_nothing_for_zeros_and_write_what_is_wanted() -> None:
    function = long_function(1)
    address = compiled_symbol(function)
    assert address is not None
    call = ctypes.CFUNCTYPE(ctypes.c_int, *(ctypes.c_void_p,) * 4, ctypes.c_int)(address)
    X, found, known = np.full(5, 0.4), np.zeros(40), np.array(function(np.full(5, 0.4), np.zeros(2))[0]).ravel()
    arguments, results = (ctypes.c_void_p * 8)(X.ctypes.data, None), (ctypes.c_void_p * 8)(found.ctypes.data, None)
    assert call(arguments, results, None, None, 0) == 0
    np.testing.assert_allclose(found, known, rtol=1e-11, atol=1e-13)


@needs_compiler
def test_code_is_taken_apart_only_where_it_is_not_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("UVMS_OCP_CACHE", str(tmp_path))
    calls: list[str] = []

    def prepare(code: str) -> str:
        calls.append(code)
        return f"{code} int other(void) {{ return 2; }}"

    one, again = (compile_library("int one(void) { return 1; }", prepare=prepare) for _ in range(2))
    assert one == again
    assert one is not None
    assert ctypes.CDLL(str(one)).other() == 2
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
    code = code_of(ca.Function("many", [x], [ca.vertcat(*(ca.if_else(x[i] > 0, x @ x[i], x, True) for i in range(30)))]))
    assert in_parts(code) == code
