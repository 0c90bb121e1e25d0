"""Elementwise operations on NumPy arrays and CasADi expressions alike; every function returns the
kind that it is given.

Arguments are of any one shape, (...), and of any one unit, [any], where nothing else is said.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

Array = Any
"""``numpy.ndarray``, ``casadi.SX`` or ``casadi.MX``; scalars of these."""


def is_symbolic(*values: Array) -> bool:
    """Tell whether any of the values is a CasADi expression."""
    return any(isinstance(value, (ca.SX, ca.MX)) for value in values)


def clipped(y: Array, lower: Array, upper: Array) -> Array:
    """Return the nearest to y (...) [any] between `lower` and `upper`, (...) [any]; the bounds must
    not be NaN.
    """
    if is_symbolic(y, lower, upper):
        return ca.fmin(ca.fmax(y, lower), upper)
    return np.minimum(np.maximum(y, lower), upper)


def where(condition: Array, if_true: Array, if_false: Array) -> Array:
    """Choose `if_true` or `if_false`, (...) [any], entry by entry, by the condition (...).

    A scalar stands for all entries, infinity included. What is not selected may be NaN.
    """
    if is_symbolic(condition):
        return ca.if_else(condition, _spread(if_true, condition), _spread(if_false, condition))
    return np.where(condition, if_true, if_false)


def logical_and(a: Array, b: Array) -> Array:
    """Return true where both a (...) and b (...) are true."""
    if is_symbolic(a, b):
        return ca.logic_and(a, b)
    return a & b


def logical_or(a: Array, b: Array) -> Array:
    """Return true where a (...) or b (...) is true."""
    if is_symbolic(a, b):
        return ca.logic_or(a, b)
    return a | b


def all_entries(condition: Array) -> Array:
    """Return true if the condition (...) holds for all entries, or there are none."""
    if is_symbolic(condition):
        return ca.sum1(ca.vec(condition)) >= condition.numel()
    return condition.all()


def row_sums(matrix: Array) -> Array:
    """Return the sums (m,) of the rows of a matrix (m, n) [any]."""
    if is_symbolic(matrix):
        return ca.sum2(matrix)
    return matrix.sum(axis=1)


def _spread(value: Array, condition: Array) -> Array:
    """Return a number as an expression of the shape of the condition."""
    if is_symbolic(value):
        return value
    return value * ca.DM.ones(condition.shape)


def interval_distance(y: Array, lower: Array, upper: Array) -> Array:
    """Compute the signed distance of y to [lower, upper], entry by entry: negative below, 0 inside,
    NaN where y is.

    y, lower and upper (...) [unit of y].
    """
    return y - clipped(y, lower, upper)


def interval_excess(y: Array, lower: Array, upper: Array) -> Array:
    """Compute the distance of y to [lower, upper], entry by entry: 0 inside, NaN where y is.

    y, lower and upper (...) [unit of y].
    """
    return abs(interval_distance(y, lower, upper))
