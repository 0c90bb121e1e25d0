"""Calls through fixed memory give what calls through CasADi give."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.buffered import BufferedFunction


@pytest.fixture
def buffered() -> BufferedFunction:
    x, A = ca.SX.sym("x", 3), ca.SX.sym("A", 3, 2)
    return BufferedFunction(ca.Function("f", [x, A], [A * x[0], A.T @ x], ["x", "A"], ["B", "y"]))


X, ROWS = np.array([1.0, 2.0, 3.0]), np.arange(6.0).reshape(2, 3)


def test_matrices_go_in_by_columns_and_come_out_as_matrices(buffered: BufferedFunction) -> None:
    B, y = buffered(X, ROWS)
    np.testing.assert_array_equal(B, ROWS.T)
    np.testing.assert_array_equal(y, ROWS @ X)


def test_one_column_can_stand_for_all(buffered: BufferedFunction) -> None:
    _, y = buffered(X, X)
    np.testing.assert_array_equal(y, [14.0, 14.0])


def test_results_survive_the_next_call(buffered: BufferedFunction) -> None:
    _, first = buffered(X, ROWS)
    buffered(2 * X, ROWS)
    np.testing.assert_array_equal(first, ROWS @ X)


def test_a_copy_through_pickle_has_its_own_memory(buffered: BufferedFunction) -> None:
    _, y = pickle.loads(pickle.dumps(buffered))(X, ROWS)
    np.testing.assert_array_equal(y, ROWS @ X)


def test_a_wrong_shape_is_named(buffered: BufferedFunction) -> None:
    with pytest.raises(InvalidInput, match=r"f: A of shape \(3, 2\) given; allowed: \(2, 3\)"):
        buffered(X, ROWS.T)
