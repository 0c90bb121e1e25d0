"""Functions that differ in numbers alone have one form, and give the same to the last bit as compiled by themselves."""

from __future__ import annotations

from dataclasses import fields, replace

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp import scenarios
from uvms_ocp.codegen import compile as compiling
from uvms_ocp.codegen.compile import compile_function, compile_lifted, lift_constants, without_numbers
from uvms_ocp.tasks import Hierarchy

X = np.random.default_rng(4).normal(size=3)


def function_of(a: float, b: float) -> ca.Function:
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y")
    first = ca.vertcat(a * ca.sin(x[0]) + b, ca.fmin(x[1], b) / (y + a), ca.if_else(x[2] > a, x[2], 0.0))
    return ca.Function("f", [x, y], [first, ca.sumsqr(x) * b], ["x", "y"], ["first", "second"])


def of_matrices(a: float, b: float) -> ca.Function:
    x, y = ca.MX.sym("x", 3), ca.MX.sym("y")
    known = ca.MX(ca.DM([[a, 0.5, 0.0], [1.0, -b, 3.0], [np.inf, 2.0, b]]))
    return ca.Function("f", [x, y], [ca.fmin(known, y) @ x - a, ca.if_else(x[0] > b, x * a, -b) + ca.DM([a, b, 1.0]), known])


def source_of(function: ca.Function) -> str:
    generator = ca.CodeGenerator("f.c", {"verbose": False})
    generator.add(function)
    return str(generator.dump())


@pytest.mark.parametrize(("a", "b"), [(0.3, 1.7), (-2.2, 1e-9), (1e6, np.pi)])
def test_the_form_with_its_numbers_is_the_function(a: float, b: float) -> None:
    function = function_of(a, b)
    form, numbers = lift_constants(function)
    for one, other in zip(function(X, 0.7), form(X, 0.7, numbers), strict=True):
        assert (np.array(one) == np.array(other)).all()
    assert form.name_in() == ["x", "y", "numbers"]


def test_other_numbers_have_the_same_form_and_another_expression_has_not() -> None:
    forms = [lift_constants(function_of(*numbers))[0] for numbers in ((0.3, 1.7), (0.31, -5.0))]
    assert source_of(forms[0]) == source_of(forms[1])
    assert source_of(lift_constants(function_of(0.0, 1.7))[0]) != source_of(forms[0])


def test_what_is_shared_gives_the_same_to_the_last_bit() -> None:
    function = function_of(0.123456789, 9.87654321)
    shared, alone = compile_lifted(function), compile_function(function)
    assert (shared.name_in(), shared.name_out()) == (function.name_in(), function.name_out())
    for one, other in zip(shared(X, 0.7), alone(X, 0.7), strict=True):
        assert (np.array(one) == np.array(other)).all()


@pytest.mark.parametrize("function_with", [function_of, of_matrices])
@pytest.mark.parametrize(("a", "b"), [(0.3, 1.7), (-2.2, 1e-9), (1e6, np.pi), (0.0, 1.0)])
def test_compiled_functions_have_numbers_of_their_own(function_with: type[ca.Function], a: float, b: float) -> None:
    functions = [function_with(a, b), function_with(0.31, 5.5), function_with(a, b)]
    compiled = [compile_function(function) for function in functions]
    for function, one in zip(functions, compiled, strict=True):
        for value, known in zip(one(X, 0.7), function(X, 0.7), strict=True):
            np.testing.assert_allclose(np.array(value), np.array(known), rtol=1e-13)


@pytest.mark.parametrize("function_with", [function_of, of_matrices])
def test_code_without_its_numbers_is_the_same_for_all_of_them(function_with: type[ca.Function]) -> None:
    (one, few), (other, others) = (without_numbers(source_of(function_with(*pair))) for pair in ((0.3, 1.7), (0.31, 5.5)))
    assert one == other
    assert len(few) == len(others)
    assert (few != others).any()


@needs_compiler
def test_a_changed_gain_compiles_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    known = scenarios.case1(plant="kinematic", duration=0.5)

    def with_gains(scale: float) -> Hierarchy:
        changes = [
            {each.name: scale * getattr(task, each.name) for each in fields(task) if each.name == "gain"}
            for task in known.mission.hierarchy.tasks
        ]
        return Hierarchy([replace(task, **change) for task, change in zip(known.mission.hierarchy.tasks, changes, strict=True)])

    begun, build = list[str](), compiling._build
    monkeypatch.setattr(compiling, "_build", lambda *given: begun.append(given[-1]) or build(*given))
    ends = []
    for scale in (1.03, 1.07):
        begun.clear()
        ends.append(replace(known, mission=replace(known.mission, hierarchy=with_gains(scale))).run()["q"][-1])
    assert begun == []
    assert (ends[0] != ends[1]).any()
