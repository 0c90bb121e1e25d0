"""Functions that differ in numbers alone share machine code, each with numbers of its own."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp import scenarios
from uvms_ocp.campaign import vary
from uvms_ocp.campaign.variations import available_parameters
from uvms_ocp.codegen import libraries, loading
from uvms_ocp.codegen.casadi_code import without_numbers
from uvms_ocp.codegen.compile import compile_function, compiled_symbol
from uvms_ocp.errors import InvalidInput
from uvms_ocp.scenario import Scenario

X = np.random.default_rng(4).normal(size=3)


def function_of(a: float, b: float) -> ca.Function:
    x = ca.SX.sym("x", 3)
    y = ca.SX.sym("y")
    first = ca.vertcat(
        a * ca.sin(x[0]) + b, ca.fmin(x[1], b) / (y + a), ca.if_else(x[2] > a, x[2], 0.0)
    )
    return ca.Function("f", [x, y], [first, ca.sumsqr(x) * b], ["x", "y"], ["first", "second"])


def of_matrices(a: float, b: float) -> ca.Function:
    x = ca.MX.sym("x", 3)
    y = ca.MX.sym("y")
    matrix = ca.MX(ca.DM([[a, 0.5, 0.0], [1.0, -b, 3.0], [np.inf, 2.0, b]]))
    return ca.Function(
        "f",
        [x, y],
        [ca.fmin(matrix, y) @ x - a, ca.if_else(x[0] > b, x * a, -b) + ca.DM([a, b, 1.0]), matrix],
    )


def source_of(function: ca.Function) -> str:
    generator = ca.CodeGenerator("f.c", {"verbose": False})
    generator.add(function)
    return str(generator.dump())


@needs_compiler
@pytest.mark.parametrize("function_with", [function_of, of_matrices])
@pytest.mark.parametrize(("a", "b"), [(0.3, 1.7), (-2.2, 1e-9), (1e6, np.pi), (0.0, 1.0)])
def test_compiled_functions_have_numbers_of_their_own(
    function_with: type[ca.Function], a: float, b: float
) -> None:
    functions = [function_with(a, b), function_with(0.31, 5.5), function_with(a, b)]
    compiled = [compile_function(function) for function in functions]
    for function, compiled_function in zip(functions, compiled, strict=True):
        assert compiled_function is not function
        for value, expected in zip(compiled_function(X, 0.7), function(X, 0.7), strict=True):
            np.testing.assert_allclose(np.array(value), np.array(expected), rtol=1e-13)


@pytest.mark.parametrize("function_with", [function_of, of_matrices])
def test_code_without_its_numbers_is_the_same_for_all_of_them(
    function_with: type[ca.Function],
) -> None:
    (code, numbers), (other_code, other_numbers) = (
        without_numbers(source_of(function_with(*pair))) for pair in ((0.3, 1.7), (0.31, 5.5))
    )
    assert code == other_code
    assert len(numbers) == len(other_numbers)
    assert (numbers != other_numbers).any()


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("make_scenario", [scenarios.case1, scenarios.obstacle_field])
def test_numbers_of_tasks_and_gains_compile_nothing_whatever_they_are(
    make_scenario: Callable[..., Scenario], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, one that was equal to another, or to 0 or 1, or no longer so, made code of its
    own.
    """
    run = make_scenario(duration=0.02)
    run.run()
    begun = list[str]()
    build = libraries._build
    tried = 0
    monkeypatch.setattr(
        libraries, "_build", lambda *arguments: begun.append(arguments[-1]) or build(*arguments)
    )
    for name in available_parameters(run):
        # The lead is that of another law, and an observer without bandwidth is none.
        if name.startswith(("tasks.", "gains.")) and name not in (
            "gains.lead",
            "gains.observer_vehicle",
        ):
            for value in (0.0, 0.5, 1.0):
                with suppress(
                    InvalidInput
                ):  # a margin of half the range, a gain that has to be > 0
                    vary(run, {name: value}).run()
                    tried += 1
                assert begun == [], (name, value)
    assert tried > 40


@pytest.mark.slow
@needs_compiler
def test_machine_code_is_there_as_long_as_its_function_and_no_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(loading, "_external", lru_cache(maxsize=2)(loading._external.__wrapped__))

    def loaded() -> int:
        gc.collect()
        return (
            Path("/proc/self/maps").read_text(encoding="utf-8").count("r-xp")
            if sys.platform == "linux"
            else 0
        )

    functions = [function_of(0.3, 1.0 + k) for k in range(3)]
    addresses = [compiled_symbol(function) for function in functions]
    before = loaded()
    for k in range(20):
        assert compiled_symbol(function_of(0.3, 10.0 + k)) is not None
    assert loaded() <= before + 2
    assert len(set(addresses)) == len(functions)
    for function, address in zip(functions, addresses, strict=True):
        assert compiled_symbol(function) == address
        for value, expected in zip(function.machine_code(X, 0.7), function(X, 0.7), strict=True):
            np.testing.assert_allclose(np.array(value), np.array(expected), rtol=1e-13)
