"""Laws of calls on memory that stays: the same numbers however they are made, and nothing written that nobody wants."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions import compile_function
from uvms_ocp.ocp.stagewise import bound_calls
from uvms_ocp.ocp.stagewise.bound_calls import BoundCalls


def _function() -> ca.Function:
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y")
    return ca.Function("wave", [x, y], [ca.sin(x) * y, ca.densify(ca.jacobian(ca.sin(x) * y, x))])


def _chained(function: ca.Function) -> tuple[np.ndarray, np.ndarray]:
    """What a first call gives, and the Jacobian there that a second one gives, which has no use for its own values."""
    first, second, jacobian, y = np.array([0.1, 0.2, 0.3]), np.zeros(3), np.zeros((3, 3)), np.array([2.0])
    calls = BoundCalls()
    calls.add(function, [first, y], [second, None])
    calls.add(function, [second, y], [None, jacobian])
    calls()
    first *= 2.0
    calls()
    return second, jacobian


def test_machine_code_and_the_virtual_machine_give_the_same_numbers_one_call_after_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    function = _function()
    compiled = _chained(compile_function(function))
    monkeypatch.setattr(bound_calls, "has_compiler", lambda: False)
    for found in (compiled, _chained(function)):
        second = 2.0 * np.sin([0.2, 0.4, 0.6])
        np.testing.assert_allclose(found[0], second, rtol=1e-15)
        np.testing.assert_allclose(found[1], np.diag(2.0 * np.cos(second)), rtol=1e-14)


def test_no_calls_do_nothing() -> None:
    BoundCalls()()


@pytest.mark.parametrize("memory", [np.zeros(2), np.zeros(3, dtype=np.float32), np.zeros(6)[::2]])
def test_memory_of_another_size_kind_or_order_is_refused_where_it_is_given(memory: np.ndarray) -> None:
    with pytest.raises(InvalidInput, match=r"wave: memory of shape .*; give 3 numbers side by side"):
        BoundCalls().add(_function(), [memory, np.zeros(1)], [None, None])
