"""Hermite pieces on the unit interval: exact matrices of a piece and of its cost.

A piece of degree 2k - 1 is fixed by its value and first k - 1 derivatives at both ends, the *end
data* ``z = [p(0), p'(0), ..., p(1), p'(1), ...]`` (2k,). Derivatives are per unit-interval time, so
an end derivative of order d in real time is multiplied by duration^d.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from math import factorial

import numpy as np

from uvms_ocp.types import Array, read_only

_Rational = np.ndarray
"""Matrix (n, n) of fractions."""


@lru_cache
def hermite_matrix(k: int) -> Array:
    """Return the matrix (2k, 2k) from end data to coefficients in ascending powers; exact before
    rounding.
    """
    return _rounded(_inverse(_end_data_matrix(k)))


@lru_cache
def hermite_cost(k: int) -> Array:
    """Return the matrix (2k, 2k), positive semi-definite, of the integral of the squared k-th
    derivative as a quadratic form of the end data, [Gao2022] eq. (61).
    """
    to_coefficients = _inverse(_end_data_matrix(k))
    return _rounded(to_coefficients.T @ _monomial_cost(k) @ to_coefficients)


@lru_cache
def monomial_cost(k: int) -> Array:
    """Return the matrix (2k, 2k) of the integral of the squared k-th derivative as a quadratic form
    of the coefficients.
    """
    return _rounded(_monomial_cost(k))


def monomial_row(u: float, derivative: int, n_coefficients: int) -> Array:
    """Return the derivative-th derivative (n_coefficients,) of ``1, u, u^2, ...`` at u."""
    row = []
    for power in range(n_coefficients):
        row.append(_falling(power, derivative) * u ** max(power - derivative, 0))
    return np.array(row)


def basis(u: Array, derivative: int, k: int) -> Array:
    """Return the derivative-th derivative at unit times u (n,) as a linear map (n, 2k) of the end
    data.
    """
    rows = np.array([monomial_row(float(time), derivative, 2 * k) for time in u])
    return rows @ hermite_matrix(k)


def _falling(i: int, d: int) -> int:
    """Return the falling factorial ``i (i - 1) ... (i - d + 1)``: factor of the d-th derivative of
    u^i.
    """
    if i >= d:
        return factorial(i) // factorial(i - d)
    return 0


def _end_data_matrix(k: int) -> _Rational:
    """Return the matrix (2k, 2k) that takes coefficients to values and derivatives at both ends."""
    rows_at_0 = []
    rows_at_1 = []
    for d in range(k):
        row_at_0 = [Fraction(0)] * (2 * k)
        row_at_0[d] = Fraction(factorial(d))
        rows_at_0.append(row_at_0)
        rows_at_1.append([Fraction(_falling(i, d)) for i in range(2 * k)])
    return np.array(rows_at_0 + rows_at_1)


def _monomial_cost(k: int) -> _Rational:
    """Return `monomial_cost` exactly."""
    n = 2 * k
    rows = []
    for i in range(n):
        factors = [_falling(i, k) * _falling(j, k) for j in range(n)]
        rows.append([Fraction(factors[j], max(i + j - n + 1, 1)) for j in range(n)])
    return np.array(rows)


def _inverse(matrix: _Rational) -> _Rational:
    """Invert a matrix by Gauss-Jordan elimination with exact fractions."""
    n = len(matrix)
    rows = np.hstack([matrix, np.eye(n, dtype=int)])
    for column in range(n):
        pivot = column + np.flatnonzero(rows[column:, column])[0]
        rows[[column, pivot]] = rows[[pivot, column]]
        rows[column] /= rows[column, column]
        is_elsewhere = np.arange(n) != column
        rows[is_elsewhere] -= np.outer(rows[is_elsewhere, column], rows[column])
    return rows[:, n:]


def _rounded(matrix: _Rational) -> Array:
    """Round fractions to floats."""
    return read_only(matrix, np.float64)
