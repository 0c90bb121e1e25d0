"""Minimum-derivative trajectories in the free derivatives of their nodes, in time linear in the
pieces.

Unknowns are the derivatives 0 .. k-1 of the curve at its nodes that nobody has fixed ([Gao2022] eq.
(78)). The cost is a sum over pieces of quadratic forms of their end data, see
`uvms_ocp.trajectories.hermite_pieces`, so its matrix is block tridiagonal: a banded Cholesky factor,
shared by all axes. Internally time is divided by the geometric mean of the durations and derivatives
are scaled per node, so that conditioning does not depend on the unit of time.

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.trajectories.hermite_pieces import hermite_cost, hermite_matrix
from uvms_ocp.types import Array, Indices, Mask


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
    """Return the pieces of the given durations (n,) [s], for derivative k."""
    unit = float(np.exp(np.mean(np.log(durations))))
    tau = durations / unit
    node_times = np.empty(tau.size + 1)
    node_times[0] = tau[0]
    node_times[-1] = tau[-1]
    np.sqrt(tau[1:] * tau[:-1], out=node_times[1:-1])
    start_scale = _powers(tau / node_times[:-1], k)
    end_scale = _powers(tau / node_times[1:], k)
    return Pieces(
        k=k,
        unit=unit,
        durations=tau,
        node_times=node_times,
        scale=np.concatenate([start_scale, end_scale])[..., None],
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
    band = _band(pieces, free_rows, ~fixed[free_rows])
    factor = _factorised(band, 2 * free_rows.size - 1)
    slope = _gradient(pieces, scaled)[free_rows] * ~fixed[free_rows, :, None]
    scaled[free_rows] -= _back_substituted(factor, slope)
    return np.where(fixed[..., None], values, scaled / node_scale)


def end_data(pieces: Pieces, values: Array) -> Array:
    """Compute the end data (2k, n, n_axes) [axis] of every piece from node derivatives: values (k, n
    + 1, n_axes) [axis/s^d].

    Positions are relative to the start of the piece: the cost does not see where it is, rounding
    does.
    """
    tau = _powers(pieces.durations * pieces.unit, pieces.k)[..., None]
    return _relative(values, tau, tau)


def coefficients(pieces: Pieces, data: Array, values: Array) -> Array:
    """Compute the unit-interval coefficients (2k, n, n_axes) [axis] of every piece, read-only.

    data (2k, n, n_axes) [axis]: from `end_data`; values (k, n + 1, n_axes) [axis/s^d]: derivatives
    at the nodes.
    """
    result = np.empty(data.shape)
    flat_data = data.reshape(len(data), -1)
    np.matmul(hermite_matrix(pieces.k), flat_data, out=result.reshape(len(data), -1))
    result[0] += values[0, :-1]
    result.flags.writeable = False
    return result


def piece_costs(pieces: Pieces, data: Array) -> Array:
    """Compute the integral (n, n_axes) [axis^2/s^(2k - 1)] of the squared k-th derivative over each
    piece.

    data (2k, n, n_axes) [axis]: from `end_data`.
    """
    unit_cost = np.einsum("ijk,ijk->jk", data, _times(hermite_cost(pieces.k), data))
    return unit_cost * (pieces.durations * pieces.unit)[:, None] ** (1 - 2 * pieces.k)


def cost_slopes(pieces: Pieces, values: Array) -> tuple[Array, Array]:
    """Compute partial derivatives of the cost: by duration (n,) [axis^2/s^2k], and by node derivative (k, n
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
    powers = np.tile(_powers(h[:, 0], k), (2, 1))[..., None]
    return by_duration, onto_nodes(slope * powers, k)


def cost_curvature(pieces: Pieces) -> Array:
    """Compute the second derivative (k, n + 1, 1) [1/s^(2k - 1 - 2d)] of the cost by each node
    derivative of one axis alone.
    """
    k = pieces.k
    h = pieces.durations * pieces.unit
    piece_curvature = np.diag(hermite_cost(k))[:, None] * np.tile(_powers(h, k) ** 2, (2, 1))
    return onto_nodes((2.0 * h ** (1 - 2 * k) * piece_curvature)[:, :, None], k)


def _powers(x: Array, k: int) -> Array:
    """Return the powers x^0, ..., x^(k-1) (k, n)."""
    rows = np.ones((k, x.size))
    for d in range(1, k):
        np.multiply(rows[d - 1], x, out=rows[d])
    return rows


def _relative(values: Array, start_scale: Array, end_scale: Array) -> Array:
    """Return (2k, n, n_axes) values at both ends of each piece, scaled by start_scale and end_scale
    (k, n, 1), from its start.
    """
    k, n_nodes, n_axes = values.shape
    data = np.empty((2 * k, n_nodes - 1, n_axes))
    np.multiply(values[1:, :-1], start_scale[1:], out=data[1:k])
    np.multiply(values[1:, 1:], end_scale[1:], out=data[k + 1 :])
    np.subtract(values[0, 1:], values[0, :-1], out=data[k])
    data[0] = 0.0
    return data


def _times(matrix: Array, data: Array) -> Array:
    """Multiply a matrix (m, 2k) with the end data (2k, n, n_axes) of all pieces: (m, n, n_axes)."""
    flat_data = data.reshape(data.shape[0], -1)
    return (matrix @ flat_data).reshape(-1, *data.shape[1:])


def onto_nodes(by_end: Array, k: int) -> Array:
    """Sum what belongs to both ends of the pieces (2k, n, n_axes) at the nodes (k, n + 1, n_axes)."""
    result = np.zeros((k, by_end.shape[1] + 1, by_end.shape[2]))
    result[:, :-1] += by_end[:k]
    result[:, 1:] += by_end[k:]
    return result


def _gradient(pieces: Pieces, scaled: Array) -> Array:
    """Return half the gradient (k, n + 1, n_axes) of the cost by the scaled node derivatives."""
    k = pieces.k
    data = _relative(scaled, pieces.scale[:k], pieces.scale[k:])
    slope = _times(hermite_cost(k), data)
    slope *= pieces.scale
    slope *= pieces.weight
    return onto_nodes(slope, k)


def _band(pieces: Pieces, rows: Indices, free: Mask) -> Array:
    """Return (n + 1, b, 2b) lower band of half the Hessian: entry [i, c, r] is A[ib + c + r, ib +
    c]; b = rows.size.
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
    """Return the Cholesky factor of a matrix by its lower band, of this width below the diagonal.

    Raises `InvalidInput` where it is singular: the curve is not determined.
    """
    from scipy.linalg import lapack  # a tenth of a second, which only those pay who plan

    stacked = band.reshape(-1, width + 1).T
    factor, info = lapack.dpbtrf(stacked, lower=1, overwrite_ab=1)
    if info:
        node = (info - 1) // band.shape[1]
        raise InvalidInput(
            f"the curve is not determined at way point {node}; fix more derivatives at its ends or"
            " way points."
        )
    return factor


def _back_substituted(factor: Array, slope: Array) -> Array:
    """Solve for a right side (b, n + 1, n_axes), of b free derivatives at each node."""
    from scipy.linalg import lapack

    b, n_nodes, n_axes = slope.shape
    stacked = np.asfortranarray(slope.transpose(1, 0, 2).reshape(-1, n_axes))
    solution, _ = lapack.dpbtrs(factor, stacked, lower=1, overwrite_b=1)
    return solution.reshape(n_nodes, b, n_axes).transpose(1, 0, 2)
