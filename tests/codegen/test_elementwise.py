"""The same operation on numbers and on expressions has the same result."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.codegen.elementwise import (
    all_entries,
    clipped,
    logical_and,
    logical_or,
    row_sums,
    where,
)

A = np.array([[1.0, -2.0, np.inf], [0.0, 3.0, -1.0]])  # inf - inf is NaN
OPERATIONS: dict[str, Callable] = {
    "clipped": lambda x: clipped(x, -1.5, 2.0),
    "where, of scalars that may be infinite": lambda x: where(x > 0.5, -np.inf, 2.0),
    "where, of what may be NaN where it is not selected": lambda x: where(x < 5.0, x - x, 1.0),
    "both": lambda x: logical_and(x > -1.5, x < 2.0),
    "either": lambda x: logical_or(x < -1.5, x > 2.0),
    "everywhere, true": lambda x: all_entries(x > -3.0),
    "everywhere, false": lambda x: all_entries(x > -2.0),
    "everywhere, nothing": lambda x: all_entries(x[:0, :] > 5.0),
    "row sums": lambda x: row_sums(x[:, :2]),
}


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("name", OPERATIONS)
@np.errstate(invalid="ignore")
def test_expressions_and_numbers_agree(kind: type, name: str) -> None:
    x = kind.sym("x", *A.shape)
    operation = OPERATIONS[name]
    expected = np.asarray(operation(A), dtype=float)
    value = np.array(ca.Function("f", [x], [operation(x)])(A))
    np.testing.assert_array_equal(value.reshape(expected.shape), expected)
