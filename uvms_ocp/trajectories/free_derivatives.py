"""Minimum-derivative trajectories in the free derivatives of their nodes, in time linear in the
pieces.

A piece of degree 2k - 1 is fixed by its value and first k - 1 derivatives at both ends, the *end
data* ``z = [p(0), p'(0), ..., p(1), p'(1), ...]`` (2k,). Derivatives are per unit-interval time, so
an end derivative of order d in real time is multiplied by duration^d. All matrices are.

Unknowns are the derivatives 0 .. k-1 of the curve at its nodes that nobody has fixed ([Gao2022] eq.
(78)). The cost is a sum over pieces of quadratic forms of their end data, so its matrix is block
tridiagonal: a banded Cholesky factor, shared by all axes. Internally time is divided by the
geometric mean of the durations and derivatives are scaled per node, so that conditioning does not
depend on the unit of time.

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import factorial

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Array, Indices, Mask, read_only

# Hermite pieces on the unit interval: exact matrices of the piece and of its cost.

_Rational = np.ndarray
"""(n, n) of fractions."""


@lru_cache
def hermite_matrix(k: int) -> Array:
    """(2k, 2k): end data -> coefficients in ascending powers; exact before rounding."""
    return _rounded(_inverse(_end_data_matrix(k)))


@lru_cache
def hermite_cost(k: int) -> Array:
    """(2k, 2k), positive semi-definite: end data -> integral of the squared k-th derivative,
    [Gao2022] eq. (61).
    """
    to_coefficients = _inverse(_end_data_matrix(k))
    return _rounded(to_coefficients.T @ _monomial_cost(k) @ to_coefficients)


@lru_cache
def monomial_cost(k: int) -> Array:
    """(2k, 2k): the same cost in the coefficients of the piece."""
    return _rounded(_monomial_cost(k))


def monomial_row(u: float, derivative: int, n_coefficients: int) -> Array:
    """(n_coefficients,) the derivative-th derivative of ``1, u, u^2, ...`` at u."""
    return np.array(
        [_falling(i, derivative) * u ** max(i - derivative, 0) for i in range(n_coefficients)]
    )


def basis(u: Array, derivative: int, k: int) -> Array:
    """(n, 2k) derivative-th derivative at unit times u (n,) as a linear map of the end data."""
    return np.array([monomial_row(float(x), derivative, 2 * k) for x in u]) @ hermite_matrix(k)


def _falling(i: int, d: int) -> int:
    if i >= d:
        return factorial(i) // factorial(i - d)
    return 0


def _end_data_matrix(k: int) -> _Rational:
    rows_at_0 = []
    rows_at_1 = []
    for d in range(k):
        rows_at_0.append([Fraction(factorial(d) if i == d else 0) for i in range(2 * k)])
        rows_at_1.append([Fraction(_falling(i, d)) for i in range(2 * k)])
    return np.array(rows_at_0 + rows_at_1)


def _monomial_cost(k: int) -> _Rational:
    n = 2 * k
    rows = []
    for i in range(n):
        factors = [_falling(i, k) * _falling(j, k) for j in range(n)]
        rows.append([Fraction(factors[j], max(i + j - n + 1, 1)) for j in range(n)])
    return np.array(rows)


def _inverse(matrix: _Rational) -> _Rational:
    """Gauss-Jordan with exact fractions."""
    n = len(matrix)
    rows = np.hstack([matrix, np.eye(n, dtype=int)])
    for column in range(n):
        pivot = column + np.flatnonzero(rows[column:, column])[0]
        rows[[column, pivot]] = rows[[pivot, column]]
        rows[column] /= rows[column, column]
        others = np.arange(n) != column
        rows[others] -= np.outer(rows[others, column], rows[column])
    return rows[:, n:]


def _rounded(matrix: _Rational) -> Array:
    return read_only(matrix, np.float64)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pieces:
    """Durations of the pieces and everything that follows from them."""

    k: int
    """Derivative whose square is integrated; pieces have degree 2k - 1."""
    unit: float
    """[s] geometric mean of the durations."""
    durations: Array
    """(n,) durations in units of ``unit``."""
    node_times: Array
    """(n + 1,) scale of time at each node, in units of ``unit``."""
    scale: Array
    """(2k, n, 1) scaled node derivatives -> end data of the piece."""
    weight: Array
    """(n, 1) factor of the unit-interval cost of each piece."""


def pieces_of(durations: Array, k: int) -> Pieces:
    """Pieces of the given durations (n,) [s]."""
    unit = float(np.exp(np.mean(np.log(durations))))
    tau = durations / unit
    node = np.empty(tau.size + 1)
    node[0] = tau[0]
    node[-1] = tau[-1]
    np.sqrt(tau[1:] * tau[:-1], out=node[1:-1])
    scale = np.concatenate([_powers(tau / node[:-1], k), _powers(tau / node[1:], k)])[..., None]
    return Pieces(
        k=k,
        unit=unit,
        durations=tau,
        node_times=node,
        scale=scale,
        weight=tau[:, None] ** (1 - 2 * k),
    )


def solve_free(pieces: Pieces, values: Array, fixed: Mask) -> Array:
    """Fill the free derivatives with their optimal values.

    values (k, n + 1, n_axes) [axis/s^d]: derivatives at the nodes, of which those not fixed are a
    starting guess. fixed (k, n + 1): True where the derivative keeps its value. Raises
    `InvalidInput` where the fixed derivatives do not determine the curve.
    """
    free_rows = np.flatnonzero(~fixed.all(axis=1))
    if free_rows.size == 0:
        return values
    node_scale = _powers(pieces.node_times * pieces.unit, pieces.k)[..., None]
    scaled = values * node_scale
    factor = _factorised(_band(pieces, free_rows, ~fixed[free_rows]), 2 * free_rows.size - 1)
    scaled[free_rows] -= _back_substituted(
        factor, _gradient(pieces, scaled)[free_rows] * ~fixed[free_rows, :, None]
    )
    return np.where(fixed[..., None], values, scaled / node_scale)


def end_data(pieces: Pieces, values: Array) -> Array:
    """(2k, n, n_axes) [axis] end data of every piece from node derivatives: values (k, n + 1,
    n_axes) [axis/s^d].

    Positions are relative to the start of the piece: the cost does not see where it is, rounding
    does.
    """
    tau = _powers(pieces.durations * pieces.unit, pieces.k)[..., None]
    return _relative(values, tau, tau)


def coefficients(pieces: Pieces, data: Array, values: Array) -> Array:
    """(2k, n, n_axes) [axis] unit-interval coefficients of every piece, read-only.

    data (2k, n, n_axes) [axis]: as of `end_data`; values (k, n + 1, n_axes) [axis/s^d]: of the
    nodes.
    """
    result = np.empty(data.shape)
    np.matmul(
        hermite_matrix(pieces.k), data.reshape(len(data), -1), out=result.reshape(len(data), -1)
    )
    result[0] += values[0, :-1]
    result.flags.writeable = False
    return result


def piece_costs(pieces: Pieces, data: Array) -> Array:
    """(n, n_axes) [axis^2/s^(2k - 1)] integral of the squared k-th derivative over each piece.

    data (2k, n, n_axes) [axis]: as of `end_data`.
    """
    unit_cost = np.einsum("ijk,ijk->jk", data, _times(hermite_cost(pieces.k), data))
    return unit_cost * (pieces.durations * pieces.unit)[:, None] ** (1 - 2 * pieces.k)


def cost_slopes(pieces: Pieces, values: Array) -> tuple[Array, Array]:
    """Partial derivatives of the cost: by duration (n,) [axis^2/s^2k], and by node derivative (k, n
    + 1, n_axes) [axis/s^(2k - 1 - d)], at node derivatives: values (k, n + 1, n_axes) [axis/s^d].

    At the optimum the slope by every free derivative is zero, so these are also the total
    derivatives of the optimal cost by the durations and by the fixed derivatives (envelope
    theorem).
    """
    k = pieces.k
    h = (pieces.durations * pieces.unit)[:, None]
    data = end_data(pieces, values)
    slope = 2.0 * h ** (1 - 2 * k) * _times(hermite_cost(k), data)
    order = np.tile(np.arange(k), 2)[:, None, None]
    by_duration = np.sum((order * data - (k - 0.5) * data) * slope, axis=(0, 2)) / h[:, 0]
    return by_duration, onto_nodes(slope * np.tile(_powers(h[:, 0], k), (2, 1))[..., None], k)


def cost_curvature(pieces: Pieces) -> Array:
    """(k, n + 1, 1) [1/s^(2k - 1 - 2d)] second derivative of the cost by each node derivative of
    one axis alone.
    """
    k = pieces.k
    h = pieces.durations * pieces.unit
    piece_curvature = np.diag(hermite_cost(k))[:, None] * np.tile(_powers(h, k) ** 2, (2, 1))
    return onto_nodes((2.0 * h ** (1 - 2 * k) * piece_curvature)[:, :, None], k)


def _powers(x: Array, k: int) -> Array:
    """(k, n): x^0, ..., x^(k-1)."""
    rows = np.ones((k, x.size))
    for d in range(1, k):
        np.multiply(rows[d - 1], x, out=rows[d])
    return rows


def _relative(values: Array, start_scale: Array, end_scale: Array) -> Array:
    """(2k, n, n_axes) values at both ends of each piece, scaled by start_scale and end_scale (k,
    n, 1), from its start.
    """
    k, n_nodes, n_axes = values.shape
    data = np.empty((2 * k, n_nodes - 1, n_axes))
    np.multiply(values[1:, :-1], start_scale[1:], out=data[1:k])
    np.multiply(values[1:, 1:], end_scale[1:], out=data[k + 1 :])
    np.subtract(values[0, 1:], values[0, :-1], out=data[k])
    data[0] = 0.0
    return data


def _times(matrix: Array, data: Array) -> Array:
    return (matrix @ data.reshape(data.shape[0], -1)).reshape(-1, *data.shape[1:])


def onto_nodes(by_end: Array, k: int) -> Array:
    """(k, n + 1, n_axes) sums at the nodes of what is by the ends of the pieces (2k, n, n_axes)."""
    result = np.zeros((k, by_end.shape[1] + 1, by_end.shape[2]))
    result[:, :-1] += by_end[:k]
    result[:, 1:] += by_end[k:]
    return result


def _gradient(pieces: Pieces, scaled: Array) -> Array:
    """(k, n + 1, n_axes) half the gradient of the cost by the scaled node derivatives."""
    slope = _times(
        hermite_cost(pieces.k),
        _relative(scaled, pieces.scale[: pieces.k], pieces.scale[pieces.k :]),
    )
    slope *= pieces.scale
    slope *= pieces.weight
    return onto_nodes(slope, pieces.k)


def _band(pieces: Pieces, rows: Indices, free: Mask) -> Array:
    """(n + 1, b, 2b) lower band of half the Hessian: entry [i, c, r] is A[ib + c + r, ib + c]; b =
    rows.size.
    """
    k = pieces.k
    b = rows.size
    cost = hermite_cost(pieces.k)
    start_scale = pieces.scale[rows, :, 0] * free[:, :-1]
    end_scale = pieces.scale[rows + k, :, 0] * free[:, 1:]
    weighted_left = start_scale * pieces.weight[:, 0]
    weighted_right = end_scale * pieces.weight[:, 0]
    band = np.zeros((free.shape[1], b, 2 * b))
    for c in range(b):
        for a in range(c, b):
            band[:-1, c, a - c] += cost[rows[a], rows[c]] * weighted_left[a] * start_scale[c]
            band[1:, c, a - c] += cost[k + rows[a], k + rows[c]] * weighted_right[a] * end_scale[c]
        for a in range(b):
            band[:-1, c, b + a - c] = (
                cost[k + rows[a], rows[c]] * weighted_right[a] * start_scale[c]
            )
    band[:, :, 0] += ~free.T
    return band


def _factorised(band: Array, width: int) -> Array:
    stacked = band.reshape(-1, width + 1).T
    from scipy.linalg import lapack  # a tenth of a second, which only those pay who plan

    factor, info = lapack.dpbtrf(stacked, lower=1, overwrite_ab=1)
    if info:
        node = (info - 1) // band.shape[1]
        raise InvalidInput(
            f"the curve is not determined at way point {node}; fix more derivatives at its ends or"
            " way points."
        )
    return factor


def _back_substituted(factor: Array, slope: Array) -> Array:
    b, n_nodes, n_axes = slope.shape
    stacked = np.asfortranarray(slope.transpose(1, 0, 2).reshape(-1, n_axes))
    from scipy.linalg import lapack

    solution, _ = lapack.dpbtrs(factor, stacked, lower=1, overwrite_b=1)
    return solution.reshape(n_nodes, b, n_axes).transpose(1, 0, 2)
