"""Distances to an interval are the same for numbers and expressions."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.codegen.elementwise import interval_distance, interval_excess

Y = np.array([-3.0, -1.0, 0.0, 0.5, 2.0, 7.0, np.nan, 1e300])
LOWER = np.array([-1.0, -1.0, -np.inf, 0.5, -np.inf, 1.0, 0.0, -1.0])
UPPER = np.array([1.0, 1.0, np.inf, 0.5, 1.5, np.inf, 1.0, 1.0])
SIGNED = np.array([-2.0, 0.0, 0.0, 0.0, 0.5, 0.0, np.nan, 1e300])


def test_the_distance_is_negative_below_zero_inside_and_positive_above() -> None:
    np.testing.assert_array_equal(interval_distance(Y, LOWER, UPPER), SIGNED)
    np.testing.assert_array_equal(interval_excess(Y, LOWER, UPPER), np.abs(SIGNED))


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_expressions_and_numbers_agree(kind: type) -> None:
    y, lower, upper = (kind.sym(name, len(Y)) for name in ("y", "lower", "upper"))
    function = ca.Function(
        "f",
        [y, lower, upper],
        [interval_distance(y, lower, upper), interval_excess(y, lower, upper)],
    )
    signed, size = (np.array(value).ravel() for value in function(Y, LOWER, UPPER))
    np.testing.assert_array_equal(signed, SIGNED)
    np.testing.assert_array_equal(size, np.abs(SIGNED))
