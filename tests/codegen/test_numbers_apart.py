"""Functions that differ in numbers alone have one form, and give the same to the last bit as compiled by themselves."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.codegen.compile import compile_function, compile_lifted, lift_constants

X = np.random.default_rng(4).normal(size=3)


def function_of(a: float, b: float) -> ca.Function:
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y")
    first = ca.vertcat(a * ca.sin(x[0]) + b, ca.fmin(x[1], b) / (y + a), ca.if_else(x[2] > a, x[2], 0.0))
    return ca.Function("f", [x, y], [first, ca.sumsqr(x) * b], ["x", "y"], ["first", "second"])


def source_of(function: ca.Function) -> str:
    generator = ca.CodeGenerator("f.c")
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
