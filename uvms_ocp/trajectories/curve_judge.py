"""Judge of minimum-derivative curves, which knows the conditions and the polynomials and nothing of
how these were found.

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from functools import lru_cache
from math import comb, factorial

import numpy as np
from numpy.polynomial.polynomial import polyder, polyroots, polytrim, polyval

from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Array, Mask

KEPT = 1e-6
"""Largest distance from a condition at a way point, relative to the size of the derivative."""
CHEAPEST = 1e-4
"""Largest share of its cost that a curve may be dearer than another that is found beside it."""
_NEIGHBOURS = 3  # way points whose derivatives share a piece with those of one, itself included


def largest_miss(curve: PiecewisePolynomial, lower: Array, upper: Array) -> float:
    """Return how far the curve is from its conditions at way points, on either side of each,
    relative to the size of the derivative; at most `KEPT` of one that keeps them.

    lower, upper (k, n + 1, n_axes) [axis/s^d]: bounds on derivatives 0 .. k - 1 at n + 1 way
    points, equal where one is fixed, infinite where it is free. Derivatives below k must not jump.
    """
    k = lower.shape[0]
    n_coefficients = curve.coefficients.shape[0]
    flat = curve.coefficients.reshape(n_coefficients, -1)
    shape = (k, *curve.coefficients.shape[1:])
    orders = np.arange(k)[:, None, None]
    rate = curve.durations[None, :, None] ** -orders
    at_end = _derivatives_at_one(k, n_coefficients)
    begins = curve.coefficients[:k] * np.diag(at_end)[:, None, None] * rate
    ends = (at_end @ flat).reshape(shape) * rate
    size = ((at_end @ np.abs(flat)).reshape(shape) * rate).max(axis=1, keepdims=True)
    return max(
        _excess(begins, lower[:, :-1], upper[:, :-1], size),
        _excess(ends, lower[:, 1:], upper[:, 1:], size),
        _excess(begins[:, 1:], ends[:, :-1], ends[:, :-1], size),
    )


def excess_over_limits(curve: PiecewisePolynomial, lower: Array, upper: Array) -> Array:
    """Return by how much (n_axes,) [axis] a curve leaves limits (n_axes,) [axis] at most, anywhere on
    it.

    Where a bound on a piece, by its Bernstein coefficients, does not say that it stays inside, its
    ends and the roots of its slope do.
    """
    excess = np.zeros(curve.n_axes)
    to_bernstein = _to_bernstein(curve.coefficients.shape[0])
    bernstein = np.tensordot(to_bernstein, curve.coefficients, axes=1)
    may_leave = (bernstein.min(axis=0) < lower) | (bernstein.max(axis=0) > upper)
    for piece, axis in np.argwhere(may_leave):
        coefficients = curve.coefficients[:, piece, axis]
        roots = polyroots(polytrim(polyder(coefficients)))
        inside = roots.real[(roots.real > 0.0) & (roots.real < 1.0)]
        extremes = polyval(np.concatenate([[0.0, 1.0], inside]), coefficients)
        beyond = max(lower[axis] - extremes.min(), extremes.max() - upper[axis])
        excess[axis] = max(excess[axis], beyond)
    return excess


@lru_cache
def _to_bernstein(n_coefficients: int) -> Array:
    """Return the matrix (n_coefficients, n_coefficients) from coefficients of powers to Bernstein
    coefficients: values on the unit interval lie between the least and the largest of these.
    """
    n = n_coefficients - 1
    rows = np.zeros((n + 1, n + 1))
    for i in range(n + 1):
        for j in range(i + 1):
            rows[i, j] = comb(i, j) / comb(n, j)
    return rows


def achievable_gain(
    slopes: Array, curvature: Array, values: Array, lower: Array, upper: Array
) -> float:
    """Return how much cheaper [axis^2/s^(2k - 1)] one step makes a curve at least, which its solver
    has not taken: down the slope of the cost, each derivative by its own curvature; 0 at an
    optimum.

    Of a positive semi-definite H with at most m entries in a row, ``s' H s <= m sum H_ii s_i^2``
    for every s: a step of ``-slope_i / (m H_ii)`` gains ``sum slope_i^2 / (2 m H_ii)`` or more.

    slopes, values (k, n + 1, n_axes): of the cost by the derivatives at way points, and these.
    curvature (k, n + 1, 1): second derivatives of the cost by each alone. lower, upper (k, n + 1,
    n_axes): as for `largest_miss`; no step is longer than they allow.
    """
    size = np.abs(values).max(axis=1, keepdims=True)
    is_held: Mask = (values <= lower + KEPT * size) & (slopes >= 0.0)
    is_held |= (values >= upper - KEPT * size) & (slopes <= 0.0)
    is_held |= lower == upper
    step = np.where(is_held, 0.0, -slopes / curvature)
    descent = -float((slopes * step).sum())
    if not descent > 0.0:
        return 0.0
    curvature_bound = _NEIGHBOURS * slopes.shape[0] * descent
    room = np.where(step > 0.0, upper - values, values - lower)
    moves = step != 0.0
    farthest = float((room[moves] / np.abs(step[moves])).min(initial=np.inf))
    length = min(descent / curvature_bound, max(farthest, 0.0))
    return length * (descent - length * curvature_bound / 2.0)


@lru_cache
def _derivatives_at_one(k: int, n_coefficients: int) -> Array:
    """Return (k, n_coefficients) derivatives 0 .. k - 1 of 1, u, u^2, ... at u = 1."""
    rows = np.zeros((k, n_coefficients))
    for order in range(k):
        for power in range(order, n_coefficients):
            rows[order, power] = factorial(power) / factorial(power - order)
    return rows


def _excess(values: Array, lower: Array, upper: Array, size: Array) -> float:
    """Return the largest distance of values from their bounds, relative to a size; all of (k, n,
    n_axes).
    """
    beyond = np.maximum(lower - values, values - upper)
    return float((beyond / np.where(size > 0.0, size, 1.0)).max(initial=0.0))
