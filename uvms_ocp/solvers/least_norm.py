"""Small systems of linear equations, as kernels: positive definite ones, and those of any rank by least residual and norm."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector

_RANK = 1e-9  # of a row beside those before it, relative to the largest: less is none


class Rows(Layout):
    """Room for m rows and n variables."""

    K: Annotated[list[Vector], Sized("n", "n")]
    """Of a positive definite system; overwritten."""
    W: Annotated[list[Vector], Sized("m", "n")]
    """Of any other; overwritten by what is left of its rows beside the basis."""
    b: Annotated[Vector, Sized("m")]
    """Its right side; overwritten."""
    y: Annotated[Vector, Sized("n")]
    """The solution; before, the right side of a positive definite system."""
    basis: Annotated[list[Vector], Sized("m", "n")]
    """Orthonormal, of the rows."""
    L: Annotated[list[Vector], Sized("m", "m")]
    """The rows in that basis; then its columns made orthonormal."""
    R: Annotated[list[Vector], Sized("m", "m")]
    """What those columns were in the orthonormal ones."""
    z: Annotated[Vector, Sized("m")]
    """The solution in the basis."""


def solve_positive(s: Rows, n: int) -> None:
    """``K y = y`` in place, for n variables, by Cholesky's factors."""
    for j in range(n):
        for i in range(j, n):
            total = s.K[i][j]
            for k in range(j):
                total -= s.K[i][k] * s.K[j][k]
            s.K[i][j] = math.sqrt(max(total, 0.0)) if i == j else total / s.K[j][j]
    for i in range(n):
        for k in range(i):
            s.y[i] -= s.K[i][k] * s.y[k]
        s.y[i] /= s.K[i][i]
    for back in range(n):
        i = n - 1 - back
        for k in range(i + 1, n):
            s.y[i] -= s.K[k][i] * s.y[k]
        s.y[i] /= s.K[i][i]


def least_norm(s: Rows, m: int, n: int) -> None:
    """y (n,) of least norm among those of least ``|W y - b|``.

    W = L Q with an orthonormal basis Q of its rows, taken in the order of what is left of them; then L z = b by least squares
    with L = U R. Both by Gram and Schmidt, twice, which is as good as reflections.
    """
    rank = row_space(s, m, n)
    for k in range(rank):
        _orthonormal_column(s, m, k)
        s.z[k] = 0.0
        for i in range(m):
            s.z[k] += s.L[i][k] * s.b[i]
        for i in range(m):
            s.b[i] -= s.L[i][k] * s.z[k]
    for back in range(rank):
        k = rank - 1 - back
        for j in range(k + 1, rank):
            s.z[k] -= s.R[k][j] * s.z[j]
        s.z[k] /= s.R[k][k]
    for j in range(n):
        s.y[j] = 0.0
        for k in range(rank):
            s.y[j] += s.z[k] * s.basis[k][j]


def row_space(s: Rows, m: int, n: int) -> int:
    """Basis and L of the m rows (m, n) of W [any]; the rank."""
    largest = 0.0
    for k in range(min(m, n)):
        row = _longest(s, m, n)
        size = _row_length(s.W[row], n)
        largest = max(largest, size)
        if size <= _RANK * largest:
            return k
        for j in range(n):
            s.basis[k][j] = s.W[row][j] / size
        _orthogonal_to_the_others(s, k, n)
        for i in range(m):
            # Of rows that are in the basis nothing is left, and what they were before is added where it was taken.
            along = dot(s.W[i], s.basis[k], n)
            s.L[i][k] = along
            for j in range(n):
                s.W[i][j] -= along * s.basis[k][j]
    return min(m, n)


def _longest(s: Rows, m: int, n: int) -> int:
    longest = 0
    for i in range(1, m):
        if dot(s.W[i], s.W[i], n) > dot(s.W[longest], s.W[longest], n):
            longest = i
    return longest


def _orthogonal_to_the_others(s: Rows, k: int, n: int) -> None:
    """Basis vector k, once more, to the last bit."""
    for earlier in range(k):
        along = dot(s.basis[k], s.basis[earlier], n)
        for j in range(n):
            s.basis[k][j] -= along * s.basis[earlier][j]
    size = _row_length(s.basis[k], n)
    for j in range(n):
        s.basis[k][j] /= size


def _orthonormal_column(s: Rows, m: int, k: int) -> None:
    """Column k of L, beside those before it, and column k of R."""
    for earlier in range(k):
        s.R[earlier][k] = 0.0
    for _ in range(2):
        for earlier in range(k):
            along = 0.0
            for i in range(m):
                along += s.L[i][earlier] * s.L[i][k]
            s.R[earlier][k] += along
            for i in range(m):
                s.L[i][k] -= along * s.L[i][earlier]
    total = 0.0
    for i in range(m):
        total += s.L[i][k] * s.L[i][k]
    s.R[k][k] = math.sqrt(total)
    for i in range(m):
        s.L[i][k] /= s.R[k][k]


def dot(x: Vector, y: Vector, n: int) -> float:
    """Of the first n entries of x (n,) [any] and y (n,) [any]."""
    total = 0.0
    for j in range(n):
        total += x[j] * y[j]
    return total


def _row_length(x: Vector, n: int) -> float:
    return math.sqrt(dot(x, x, n))
