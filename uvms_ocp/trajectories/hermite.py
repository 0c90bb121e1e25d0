"""Hermite pieces on the unit interval: exact matrices of the piece and of its cost.

A piece of degree 2k - 1 is fixed by its value and first k - 1 derivatives at both ends, the *end data*
``z = [p(0), p'(0), ..., p(1), p'(1), ...]`` (2k,). Derivatives are per unit-interval time, so an end derivative of
order d in real time is multiplied by duration^d. All matrices are [-].
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from math import factorial

import numpy as np

from uvms_ocp.arrays import Array

_Rational = list[list[Fraction]]


@lru_cache
def hermite_matrix(k: int) -> Array:
    """(2k, 2k): end data -> coefficients in ascending powers; exact before rounding."""
    return _rounded(_inverse(_end_data_matrix(k)))


@lru_cache
def hermite_cost(k: int) -> Array:
    """(2k, 2k), positive semi-definite: end data -> integral of the squared k-th derivative, [Gao2022] eq. (61)."""
    to_coefficients = _inverse(_end_data_matrix(k))
    return _rounded(_product(_transposed(to_coefficients), _product(_monomial_cost(k), to_coefficients)))


@lru_cache
def monomial_cost(k: int) -> Array:
    """(2k, 2k): the same cost in the coefficients of the piece."""
    return _rounded(_monomial_cost(k))


def monomial_row(u: float, derivative: int, n_coefficients: int) -> Array:
    """(n_coefficients,) the derivative-th derivative of ``1, u, u^2, ...`` at u [-]."""
    return np.array([_falling(i, derivative) * u ** max(i - derivative, 0) for i in range(n_coefficients)])


def basis(u: Array, derivative: int, k: int) -> Array:
    """(n, 2k) derivative-th derivative at unit times u (n,) [-] as a linear map of the end data."""
    rows = np.array([monomial_row(float(x), derivative, 2 * k) for x in u])
    return rows @ hermite_matrix(k)


def _falling(i: int, d: int) -> int:
    return factorial(i) // factorial(i - d) if i >= d else 0


def _end_data_matrix(k: int) -> _Rational:
    at_0 = [[Fraction(factorial(d) if i == d else 0) for i in range(2 * k)] for d in range(k)]
    at_1 = [[Fraction(_falling(i, d)) for i in range(2 * k)] for d in range(k)]
    return at_0 + at_1


def _monomial_cost(k: int) -> _Rational:
    n = 2 * k
    return [[Fraction(_falling(i, k) * _falling(j, k), max(i + j - 2 * k + 1, 1)) for j in range(n)] for i in range(n)]


def _inverse(matrix: _Rational) -> _Rational:
    """Gauss-Jordan with exact fractions."""
    n = len(matrix)
    rows = [[*row, *(Fraction(i == j) for j in range(n))] for i, row in enumerate(matrix)]
    for column in range(n):
        pivot = next(i for i in range(column, n) if rows[i][column] != 0)
        rows[column], rows[pivot] = rows[pivot], rows[column]
        rows[column] = [x / rows[column][column] for x in rows[column]]
        for i in range(n):
            if i != column:
                factor = rows[i][column]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[column], strict=True)]
    return [row[n:] for row in rows]


def _product(a: _Rational, b: _Rational) -> _Rational:
    columns = _transposed(b)
    return [[sum((x * y for x, y in zip(row, col, strict=True)), Fraction(0)) for col in columns] for row in a]


def _transposed(a: _Rational) -> _Rational:
    return [list(row) for row in zip(*a, strict=True)]


def _rounded(matrix: _Rational) -> Array:
    result = np.array([[float(x) for x in row] for row in matrix])
    result.flags.writeable = False
    return result
