"""A smooth one-sided penalty: zero beyond a threshold, cubic, then quadratic.

Its second derivative ``min(y, 1)`` is continuous, never negative and stays away from zero deep inside, so a
Gauss-Newton step keeps its curvature there; an exponential is zero nowhere and overflows in deep penetration.
`[value]` is the unit of what is penalised.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.arrays import Array


class Penalty(NamedTuple):
    """The penalty and its derivatives by what is penalised."""

    value: Array
    """(...) [-]"""
    slope: Array
    """(...) [1/value]"""
    curvature: Array
    """(...) [1/value^2]"""


def penalty(y: Array) -> Penalty:
    """y^3/6 for 0 < y < 1, y^2/2 - y/2 + 1/6 above, zero below; y (...) [-]."""
    inside = np.clip(y, 0.0, 1.0)
    beyond = np.maximum(y - 1.0, 0.0)
    value = inside**3 / 6.0 + beyond * (0.5 + 0.5 * beyond)
    return Penalty(value=value, slope=0.5 * inside**2 + beyond, curvature=inside)


def symbolic_penalty(y: ca.SX) -> ca.SX:
    """The same as an expression."""
    inside = ca.fmin(ca.fmax(y, 0.0), 1.0)
    beyond = ca.fmax(y - 1.0, 0.0)
    return inside**3 / 6.0 + beyond * (0.5 + 0.5 * beyond)


def two_sided(value: Array, limit: Array, margin: float) -> Penalty:
    """Penalty on |value| (...) [value] near and beyond a limit (n_axes,) [value], which may be infinite.

    It begins at ``(1 - margin) * limit``; margin [-].
    """
    finite = np.where(np.isinf(limit), 1.0, limit) * margin
    y = (np.abs(value) - np.where(np.isinf(limit), np.inf, limit - finite)) / finite
    p = penalty(y)
    return Penalty(value=p.value, slope=np.sign(value) * p.slope / finite, curvature=p.curvature / finite**2)


def outside(value: Array, lower: Array, upper: Array, margin: float) -> Penalty:
    """Penalty on a value (..., n_axes) [value] nearer than ``margin`` [value] to either end of its range.

    lower and upper (n_axes,) [value].
    """
    low, high = penalty((lower + margin - value) / margin), penalty((value - upper + margin) / margin)
    return Penalty(
        value=low.value + high.value,
        slope=(high.slope - low.slope) / margin,
        curvature=(high.curvature + low.curvature) / margin**2,
    )
