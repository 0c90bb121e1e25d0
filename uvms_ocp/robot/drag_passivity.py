"""Check whether drag takes energy out of every motion, or feeds some.

At nu the water gets the power ``L(nu) + C(nu)``, ``L = nu.T D_lin nu`` and ``C = sum_ij Q_ij nu_i
|nu_j| nu_j`` from the matrices of `uvms_ocp.robot.hydrodynamics.damping_matrix`. In a given
direction it is ``s^2 L + s^3 C`` at the speed s: the first part decides where s is small, the
second where it is large, so that neither may be negative anywhere.

L is not if the symmetric part of D_lin has no negative eigenvalue, and only then.

C is not if there are weights ``d_k > 0`` with, for every axis k,

sum_{j != k} |Q_kj| d_j^2  +  2 sum_{i != k} |Q_ik| d_i d_k  <=  3 Q_kk d_k^2.

Proof, with ``x_k = |nu_k| / d_k``: every coupling takes ``-|Q_ij| d_i d_j^2 x_i x_j^2`` at worst,
and ``x_i x_j^2`` is at most ``(x_i^3 + 2 x_j^3) / 3``, the geometric mean of x_i^3, x_j^3, x_j^3
and the arithmetic one. What all of them take of ``x_k^3`` is the left side times ``d_k / 3``, and
``Q_kk |nu_k|^3`` gives the right side times that.

The condition is necessary too where one choice of signs turns all couplings against the diagonal,
as with two coupled axes and ``Q_ij Q_ji >= 0``: the best weights are then a velocity that is fed.
Elsewhere it is stricter than need be: of two couplings ``Q_ij = -Q_ji`` it allows a quarter of what
is harmless.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

_STEPS = 200  # of the search for weights, which gains a digit in 5 to 20 steps
_ROUNDING = 1e-9
_LEAST_DRAG = 1e-27
"""Least drag of an axis, as a share of the largest entry; couplings may then be its third root,
1e-9.
"""
_SIGNS = np.array(list(product((1.0, -1.0), repeat=6)))
"""All signs (64, 6) of a velocity."""
_RATIOS = np.outer((1, -1), np.geomspace(1e-3, 1, 25)).reshape(-1, 1)
_PAIRS = np.concatenate([a + _RATIOS * b for a, b in permutations(np.eye(6), 2)])
"""Velocities (n, 6) along two axes each, the second the slower one."""


def least_dissipation(linear_drag: np.ndarray) -> tuple[np.ndarray, float]:
    """Return a velocity nu (6,) [m/s, rad/s] and the power [W] that linear drag takes there,
    negative if any velocity is fed.

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]. Its diagonal decides by its signs alone. The rest is
    judged in units in which the diagonal is 1, as Sylvester's law of inertia allows, so that an
    axis with little drag is not lost in the rounding of another; an axis without drag of its own
    bears no couplings at all.
    """
    S = linear_drag / 2 + linear_drag.T / 2  # halves first: their sum is finite
    diagonal = np.diag(S)
    couplings = S - np.diag(np.diag(S))
    worst = int(np.argmin(diagonal))
    if diagonal[worst] < 0.0 or not couplings.any():
        return np.eye(6)[worst], float(diagonal[worst])
    root = np.sqrt(diagonal)
    fed = np.argwhere(np.abs(couplings) > (1.0 + _ROUNDING) * np.outer(root, root))
    if len(fed):  # of these two axes alone; what is left below has couplings of at most 1
        weak, strong = sorted(fed[0], key=lambda axis: diagonal[axis])
        coupling = S[weak, strong]
        nu = np.zeros(6)
        nu[weak] = 1.0
        nu[strong] = -coupling / max(diagonal[strong], abs(coupling))
        return nu, float(nu @ S @ nu)
    units = 1.0 / np.where(diagonal > 0.0, root, 1.0)
    eigenvalues, eigenvectors = np.linalg.eigh(units[:, None] * S * units)
    direction = units * eigenvectors[:, 0]
    nu = direction / np.abs(direction).max()
    if eigenvalues[0] < -_ROUNDING:
        return nu, float(nu @ S @ nu)
    return nu, 0.0


def overload(quadratic_drag: np.ndarray) -> tuple[float, np.ndarray]:
    """Compute the factor by which couplings exceed what the diagonal bears, and d (6,) of the axes
    they overload.

    quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2], its diagonal not negative. At a factor of at
    most 1, rounding aside, drag never feeds energy. Above it the factor is the least that any
    weights d [m/s, rad/s] show.

    That is the largest eigenvalue of the tensor of the couplings, which is symmetric and not
    negative: the power method of [Ng2009] approaches it from above.
    """
    couplings = np.abs(quadratic_drag) * (1.0 - np.eye(6))
    if not couplings.any():
        return 0.0, np.zeros(6)
    root = _units(quadratic_drag, _LEAST_DRAG)
    B = couplings / np.outer(root, root**2)
    d = np.ones(6)
    for _ in range(_STEPS):
        shares = (B @ d**2 / d**2 + 2 * B.T @ d / d) / 3
        if shares.max() <= 1.0 + _ROUNDING:
            break
        d = d * np.sqrt(1.0 + shares)  # the added 1 keeps the iteration from turning in circles
        d = np.maximum(d / d.max(), 1e-60)
    return float(shares.max()), np.where(shares > 1.0 + _ROUNDING, d, 0.0) / root


def amplified_velocity(
    linear_drag: np.ndarray, quadratic_drag: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Return a velocity nu (6,) [m/s, rad/s] and the power [W] that drag feeds there, if one is
    found.

    linear_drag (6, 6) [N/(m/s), N m/(rad/s)]; quadratic_drag (6, 6) [N/(m/s)^2, N m/(rad/s)^2]; d
    (6,) [m/s, rad/s]: magnitudes of the entries to try with all signs, beside those of two axes
    each.
    """
    candidates = np.vstack([_SIGNS * d, _PAIRS / _units(quadratic_drag, _ROUNDING)])
    candidates /= np.abs(candidates).max(axis=1, keepdims=True)
    gains = -((candidates @ quadratic_drag) * np.abs(candidates) * candidates).sum(axis=1)
    best = int(np.argmax(gains))
    if gains[best] > 0.0:
        return _rounded(candidates[best], linear_drag, quadratic_drag)
    return None


def _rounded(
    nu: np.ndarray, linear: np.ndarray, quadratic: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Return nu with four digits, as it is printed, and the power [W] there: at a speed where
    quadratic drag outgrows the linear one.
    """
    slow = nu @ linear @ nu
    fast = nu @ quadratic @ (np.abs(nu) * nu)
    speed = 1.0 if slow + fast < 0.0 else 2.0 * slow / -fast
    nu = np.array([float(f"{speed * entry:.4g}") for entry in nu]) + 0.0  # without -0
    power = -float(nu @ linear @ nu + nu @ quadratic @ (np.abs(nu) * nu))
    if power > 0.0:
        return nu, power
    return None


def _units(quadratic_drag: np.ndarray, least_drag: float) -> np.ndarray:
    """Return factors (6,) that bring velocities to units in which the diagonal is 1, as far as it
    is there; least_drag: of an axis, relative to the largest entry.
    """
    lower = least_drag * np.abs(quadratic_drag).max()
    return np.asarray(np.cbrt(np.maximum(np.diag(quadratic_drag), lower)))
