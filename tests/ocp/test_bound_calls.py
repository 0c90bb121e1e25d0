"""Laws of calls on memory that stays: the same numbers however they are made, and nothing written
that nobody wants.
"""

from __future__ import annotations

import ctypes

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp.codegen import bound_calls, compile_function
from uvms_ocp.codegen.bound_calls import BoundCalls
from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import loaded_library
from uvms_ocp.errors import InvalidInput


def _function() -> ca.Function:
    x = ca.SX.sym("x", 3)
    y = ca.SX.sym("y")
    return ca.Function("wave", [x, y], [ca.sin(x) * y, ca.densify(ca.jacobian(ca.sin(x) * y, x))])


def _chained(function: ca.Function) -> tuple[np.ndarray, np.ndarray]:
    """What a first call gives, and the Jacobian there that a second one gives, which has no use for
    its own values.
    """
    first = np.array([0.1, 0.2, 0.3])
    second = np.zeros(3)
    jacobian = np.zeros((3, 3))
    y = np.array([2.0])
    calls = BoundCalls()
    calls.add(function, [first, y], [second, None])
    calls.add(function, [second, y], [None, jacobian])
    calls()
    first *= 2.0
    calls()
    return second, jacobian


@needs_compiler
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
def test_memory_of_another_size_kind_or_order_is_refused_where_it_is_given(
    memory: np.ndarray,
) -> None:
    with pytest.raises(
        InvalidInput, match=r"wave: memory of shape .*; give 3 numbers side by side"
    ):
        BoundCalls().add(_function(), [memory, np.zeros(1)], [None, None])


FAILING = """
int failing(const double **given, double **found, long long *iw, double *w, int mem) {
  if (given[0][0] < 0.0) return 1;
  found[0][0] = 2.0 * given[0][0];
  return 0;
}
"""


@needs_compiler  # functions of CasADi's own do not fail
@pytest.mark.parametrize("by_address", [False, True])
def test_what_a_call_that_fails_leaves_unwritten_is_not_taken_for_a_result(
    monkeypatch: pytest.MonkeyPatch, by_address: bool
) -> None:
    path = compile_library(FAILING, name="what fails")
    assert path is not None
    address = (
        ctypes.cast(loaded_library(path).failing, ctypes.c_void_p).value if by_address else None
    )
    monkeypatch.setattr(bound_calls, "compiled_symbol", lambda function: address)
    function = ca.external("failing", str(path))
    given = np.array([[1.0], [3.0], [5.0]])
    found = np.zeros((3, 1))
    calls = BoundCalls()
    for argument, result in zip(given, found, strict=True):
        calls.add(function, [argument], [result])
    calls()
    assert found.ravel().tolist() == [2.0, 6.0, 10.0]
    given[:2] = -1.0
    calls()
    assert np.isnan(found.ravel()).tolist() == [True, True, False]
    given[:] = 4.0
    calls()
    assert found.ravel().tolist() == [8.0, 8.0, 8.0]
