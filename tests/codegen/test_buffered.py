"""Calls through fixed memory give what calls through CasADi give."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp.codegen.buffered import BufferedFunction, buffer_on
from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.errors import InvalidInput


@pytest.fixture
def buffered() -> BufferedFunction:
    x = ca.SX.sym("x", 3)
    A = ca.SX.sym("A", 3, 2)
    return BufferedFunction(ca.Function("f", [x, A], [A * x[0], A.T @ x], ["x", "A"], ["B", "y"]))


X = np.array([1.0, 2.0, 3.0])
A = np.array([[0.0, 3.0], [1.0, 4.0], [2.0, 5.0]])


def test_arguments_and_results_are_shaped_as_casadi_shapes_them(buffered: BufferedFunction) -> None:
    B, y = buffered(X, A)
    np.testing.assert_array_equal(B, A)
    np.testing.assert_array_equal(y, A.T @ X)
    assert B.flags.c_contiguous


def test_the_memory_order_of_an_argument_does_not_matter(buffered: BufferedFunction) -> None:
    np.testing.assert_array_equal(buffered(X, np.asfortranarray(A))[1], A.T @ X)
    np.testing.assert_array_equal(buffered(X.tolist(), A.tolist())[1], A.T @ X)


def test_a_column_may_be_a_matrix_of_one_column(buffered: BufferedFunction) -> None:
    np.testing.assert_array_equal(buffered(X[:, None], A)[1], A.T @ X)


def test_one_column_can_stand_for_all(buffered: BufferedFunction) -> None:
    _, y = buffered(X, X)
    np.testing.assert_array_equal(y, [14.0, 14.0])


def test_results_survive_the_next_call(buffered: BufferedFunction) -> None:
    _, first = buffered(X, A)
    buffered(2 * X, A)
    np.testing.assert_array_equal(first, A.T @ X)


def test_a_copy_through_pickle_has_its_own_memory(buffered: BufferedFunction) -> None:
    _, y = pickle.loads(pickle.dumps(buffered))(X, A)
    np.testing.assert_array_equal(y, A.T @ X)


def test_a_wrong_shape_is_named(buffered: BufferedFunction) -> None:
    with pytest.raises(InvalidInput, match=r"f: A of shape \(2, 3\) given; allowed: \(3, 2\)"):
        buffered(X, A.T)


def test_a_wrong_number_of_arguments_is_told_the_names(buffered: BufferedFunction) -> None:
    with pytest.raises(InvalidInput, match=r"f: 1 arguments given; allowed: 2, x, A"):
        buffered(X)


def test_what_is_empty_stays_empty() -> None:
    x = ca.SX.sym("x", 0)
    E = ca.SX.sym("E", 3, 0)
    x_out, E_out, two = BufferedFunction(ca.Function("f", [x, E], [x, E, ca.SX(2)]))(
        np.zeros(0), np.zeros((3, 0))
    )
    assert (x_out.shape, E_out.shape) == ((0,), (3, 0))
    assert two[0] == 2.0


FAILING = """
int failing(const double **arg, double **res, long long int *iw, double *w, int mem) {
  if (arg[0][0] < 0) return 1;
  res[0][0] = arg[0][0];
  return 0;
}
"""


@needs_compiler
def test_an_evaluation_that_was_abandoned_is_told() -> None:
    function = BufferedFunction(ca.external("failing", str(compile_library(FAILING))))
    for value in (1.0, -1.0, 2.0):
        (result,) = function(value)
        assert function.failed == (value < 0.0)
        assert function.failed or result == value


def test_arguments_that_are_adopted_are_read_where_they_are(buffered: BufferedFunction) -> None:
    x = np.array([2.0, 1.0, 0.0])
    A = np.asfortranarray(np.arange(6.0).reshape(3, 2))
    buffered.adopt(x, A)
    for scale in (2.0, 3.0):
        x[0] = scale
        buffered.evaluate()
        np.testing.assert_array_equal(buffered.results[0], scale * A)
    np.testing.assert_array_equal(buffered(2.0 * x, A)[0], 6.0 * A)
    with pytest.raises(InvalidInput, match="f: A of shape"):
        buffered.adopt(x, np.ones((3, 2)))


def test_memory_with_gaps_is_refused_where_its_address_is_kept(buffered: BufferedFunction) -> None:
    """Side by side it would be a copy, which is let go while CasADi reads there."""
    x = np.zeros(6)[::2]
    A = np.zeros((3, 2), order="F")
    B = np.zeros((6, 2), order="F")[::2]
    y = np.zeros(2)
    for arguments in (((x, A), (np.zeros((3, 2), order="F"), y)), ((np.zeros(3), A), (B, y))):
        with pytest.raises(NotImplementedError):
            buffer_on(buffered.function, *arguments)
