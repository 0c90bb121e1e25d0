"""Thrust of least electrical power among all that give the same wrench.

Power is ``sum factor |T|^exponent``. Reweighted least squares: replacing ``|T|^p`` by a parabola that touches it
and lies above it (p <= 2) gives a linear step in the null space of the thruster matrix, which lowers the power; the
step is stretched to nearly Newton's, so that a few suffice.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg

from uvms_ocp.control.force.limited_thrust import SMALL
from uvms_ocp.model.symbolic.joint_types import sparse

_STEPS = 6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PowerLaw:
    """Electrical power ``factor |T|^exponent`` of n thrusters."""

    factor: np.ndarray
    """(n,) [W/N^exponent], more than 0."""
    exponent: np.ndarray
    """(n,) [-], 1 to 3."""
    largest: np.ndarray
    """(n,) [N] largest thrust."""

    def quadratic(self) -> np.ndarray:
        """Weights (n,) [W/N^2] of the parabolas that meet the power at the largest thrust."""
        return self.factor * self.largest ** (self.exponent - 2.0)


def least_power(wrench: ca.SX, matrix: np.ndarray, inverse: np.ndarray, power: PowerLaw) -> ca.SX:
    """Thrust (n,) [N] for a wrench (6,) [N, N m].

    It is that of `inverse` (n, 6) [N/N, N/(N m)], moved in the null space of `matrix` (6, n) [N/N, N m/N].
    """
    thrust = ca.mtimes(sparse(inverse), wrench)
    N = null_space(matrix)
    stretch = min(1.8, 0.9 / max(float(power.exponent.max(initial=1.0)) - 1.0, 1e-9))
    for _ in range(_STEPS if N.size else 0):
        thrust -= stretch * _newton_like(sparse(N), _touching(power, thrust), thrust)
    return thrust


def _newton_like(N: ca.DM, weight: ca.SX, thrust: ca.SX) -> ca.SX:
    curvature = ca.mtimes(N.T, ca.repmat(weight, 1, N.shape[1]) * N)
    return ca.mtimes(N, ca.solve(curvature, ca.mtimes(N.T, weight * thrust)))


def _touching(power: PowerLaw, thrust: ca.SX) -> ca.SX:
    size = thrust**2 + (SMALL * power.largest) ** 2
    factor = ca.DM(0.5 * power.factor * power.exponent)
    if np.all(power.exponent == 1.5):  # two roots cost less than a power
        return factor / ca.sqrt(ca.sqrt(size))
    return factor * size ** ca.DM(0.5 * power.exponent - 1.0)


def null_space(matrix: np.ndarray) -> np.ndarray:
    """Basis (n, n - rank) [-] of what `matrix` (6, n) [N/N, N m/N] takes to 0, with an identity in some rows.

    That needs fewer products than an orthonormal one.
    """
    basis = scipy.linalg.null_space(matrix, rcond=1e-9)
    if not basis.shape[1]:
        return basis
    _, _, pivots = scipy.linalg.qr(basis.T, mode="economic", pivoting=True)
    simple = basis @ np.linalg.inv(basis[pivots[: basis.shape[1]]])
    return np.where(np.abs(simple) < 1e-12, 0.0, simple)
