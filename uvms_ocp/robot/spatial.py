"""Notation, and the maths of rotations and rigid motions for NumPy arrays and CasADi expressions
alike.

Notation (Drake's monogram, ASCII):

- ``W`` world, z up; ``B`` vehicle body, x forward, y left, z up; ``S`` altimeter; ``O`` operational
  target; ``E`` arm flange; ``T`` tool; ``L`` a link; ``J`` the frame of a joint's child body; ``F``
  any frame.
- ``X_WB`` pose of B in W, ``R_WB`` its rotation, ``p_WB`` position of B's origin in W [m].
  Adjacent letters match in products: ``X_WT = X_WB @ X_BT``.
- ``V_WB_B`` twist of B relative to W expressed in B, ``J_WB_B`` its Jacobian. Linear rows first
  [m/s], then angular [rad/s]. A wrench: force [N], then moment about the origin of its frame [N m].
- Quaternions are xyzw. Roll, pitch, yaw mean ``R = Rz(yaw) Ry(pitch) Rx(roll)`` [Gao2022] eq. (6).
- ``q, v, a, tau``: configuration, velocity, acceleration and generalized force of the whole system,
  in Pinocchio's order. Fossen's ``nu, M_A, C_A, D, g`` appear inside hydrodynamics only. Counts are
  ``n_...``.

Every function of one attitude takes ``numpy`` arrays or ``casadi.SX`` / ``MX`` and answers in kind;
``[any]`` is any unit. Expressions stay finite, and so do their derivatives, at zero angle (series)
and at the angle pi.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import is_symbolic

Array = Any
"""``numpy.ndarray``, ``casadi.SX`` or ``casadi.MX``; scalars of these."""

_SERIES_BELOW = (
    1e-2  # squared angle [rad^2]: five terms are exact to rounding, the closed forms keep 13 digits
)

_COS = (1.0, -1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800)
_SINC = (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880)
_COSC = (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800)
_SINCC = (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800)
_COTC = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160)
_ATANC = (1.0, -1 / 3, 1 / 5, -1 / 7, 1 / 9, -1 / 11, 1 / 13)


# --- numpy / CasADi shim --------------------------------------------------------------------------


def where(condition: Array, if_true: Array, if_false: Array) -> Array:
    """Return `if_true` or `if_false`, scalars () [any], by the condition (). Both are evaluated, so
    both must be finite.
    """
    if is_symbolic(condition):
        return ca.if_else(condition, if_true, if_false)
    if condition:
        return if_true
    return if_false


def column(*entries: Array) -> Array:
    """Stack scalars or columns into one column."""
    if is_symbolic(*entries):
        return ca.vertcat(*entries)
    return np.concatenate([np.atleast_1d(np.asarray(entry, dtype=float)) for entry in entries])


def matrix(*rows: Sequence[Array]) -> Array:
    """Build a matrix from rows of scalars; a literal integer 0 stays a structural zero of an
    expression.
    """
    if not any(is_symbolic(*row) for row in rows):
        return np.array(rows, dtype=float)
    expressions = []
    for row in rows:
        expressions.append(ca.horzcat(*[_with_structural_zero(entry) for entry in row]))
    return ca.vertcat(*expressions)


def _with_structural_zero(entry: Array) -> Array:
    if isinstance(entry, int) and entry == 0:
        return ca.DM(1, 1)
    return entry


def diagonal(entries: Array) -> Array:
    """Build a square matrix with the entries (n,) [any] on its diagonal."""
    if is_symbolic(entries):
        return ca.diag(entries)
    return np.diag(entries)


def dot(a: Array, b: Array) -> Array:
    """Compute the inner product of a (3,) [any] and b (3,) [any]."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Array, b: Array) -> Array:
    """Compute the cross product (3,) of a (3,) [any] and b (3,) [any]."""
    if is_symbolic(a, b):
        return ca.cross(a, b)  # the same expression in a tenth of the time
    return column(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def skew(a: Array) -> Array:
    """Build the matrix (3, 3) with ``skew(a) @ b == cross(a, b)``, of a (3,) [any]."""
    return matrix((0, -a[2], a[1]), (a[2], 0, -a[0]), (-a[1], a[0], 0))


def _horner(x: Array, coefficients: Sequence[float]) -> Array:
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * x + coefficient
    return value


def _by_series_near_zero(
    x: Array, coefficients: Sequence[float], closed: Callable[[Array], Array]
) -> Array:
    """Evaluate a power series of the squared angle x where it is small, a closed form of the angle
    elsewhere.

    The closed form sees 1 where the series is used: a NaN in the branch not taken would survive
    differentiation.
    """
    near_zero = x < _SERIES_BELOW
    angle = ca.sqrt(where(near_zero, 1.0, x))
    return where(near_zero, _horner(x, coefficients), closed(angle))


def cos_of_squared(x: Array) -> Array:
    """Compute ``cos(t)`` of the squared angle x () [rad2], ``x = t^2``, smooth at 0."""
    return _by_series_near_zero(x, _COS, ca.cos)


def sinc_of_squared(x: Array) -> Array:
    """Compute ``sin(t) / t`` of the squared angle x () [rad2], ``x = t^2``."""
    return _by_series_near_zero(x, _SINC, lambda t: ca.sin(t) / t)


def _cosc_of_squared(x: Array) -> Array:
    return _by_series_near_zero(x, _COSC, lambda t: 2 * (ca.sin(t / 2) / t) ** 2)


def _sincc_of_squared(x: Array) -> Array:
    return _by_series_near_zero(x, _SINCC, lambda t: (t - ca.sin(t)) / (t * t * t))


def cotc_of_squared(x: Array) -> Array:
    """Compute ``(1 - t/2 cot(t/2)) / t^2`` of the squared angle x () [rad2], ``x = t^2``, finite up
    to ``t = pi`` and beyond.
    """
    return _by_series_near_zero(
        x, _COTC, lambda t: (1 - t / 2 * ca.cos(t / 2) / ca.sin(t / 2)) / (t * t)
    )


# --- quaternions, xyzw ----------------------------------------------------------------------------


def quaternion_to_matrix(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,) xyzw, one matrix for either sign."""
    x, y, z, w = (quaternion[i] for i in range(4))
    return matrix(
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def matrix_to_quaternion(R: Array) -> Array:
    """Return the unit quaternion (4,) xyzw of a rotation matrix R (3, 3), of either sign.

    The products ``4 q_k q`` are linear in R; the largest of the four ``4 q_k^2`` is at least 1, so
    that the root and the division are safe at every rotation [Shepperd1978].
    """
    xx = 1 + R[0, 0] - R[1, 1] - R[2, 2]
    yy = 1 - R[0, 0] + R[1, 1] - R[2, 2]
    zz = 1 - R[0, 0] - R[1, 1] + R[2, 2]
    ww = 1 + R[0, 0] + R[1, 1] + R[2, 2]
    xy = R[0, 1] + R[1, 0]
    xz = R[0, 2] + R[2, 0]
    yz = R[1, 2] + R[2, 1]
    xw = R[2, 1] - R[1, 2]
    yw = R[0, 2] - R[2, 0]
    zw = R[1, 0] - R[0, 1]
    by_x = (xx, xy, xz, xw)
    by_y = (xy, yy, yz, yw)
    by_z = (xz, yz, zz, zw)
    by_w = (xw, yw, zw, ww)
    first = _larger(xx, by_x, ww, by_w)
    second = _larger(yy, by_y, zz, by_z)
    square, products = _larger(*second, *first)
    scale = 0.5 / ca.sqrt(square)
    return column(*[scale * product for product in products])


def _larger(
    a: Array, row_a: Sequence[Array], b: Array, row_b: Sequence[Array]
) -> tuple[Array, tuple[Array, ...]]:
    choose_a = a > b
    return where(choose_a, a, b), tuple(
        where(choose_a, x, y) for x, y in zip(row_a, row_b, strict=True)
    )


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Compute the product (4,) of the quaternions a (4,) and b (4,), xyzw: the rotation ``R(a) @
    R(b)``.
    """
    return column(
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2],
        a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


def quaternion_conjugate(quaternion: Array) -> Array:
    """Return the inverse (4,) of a unit quaternion (4,) xyzw."""
    return column(-quaternion[0], -quaternion[1], -quaternion[2], quaternion[3])


def continuous_quaternions(quaternions: np.ndarray) -> np.ndarray:
    """Choose for each attitude the one of its two quaternions (n, 4) that does not jump from the
    attitude before; NumPy alone.
    """
    signs = np.cumprod(np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    return np.asarray(quaternions * np.concatenate([[1.0], signs])[:, None])


def quaternion_exp(rotation_vector: Array) -> Array:
    """Return the unit quaternion (4,) xyzw of the `rotation_vector` (3,) [rad]."""
    quarter = dot(rotation_vector, rotation_vector) / 4
    scale = sinc_of_squared(quarter) / 2
    return column(*[scale * rotation_vector[i] for i in range(3)], cos_of_squared(quarter))


def quaternion_log(quaternion: Array) -> Array:
    """Return the rotation vector (3,) [rad] of norm at most pi of a unit quaternion (4,) xyzw of
    either sign.
    """
    sign = where(quaternion[3] < 0, -1.0, 1.0)
    cosine = sign * quaternion[3]
    sine2 = dot(quaternion, quaternion)
    near_zero = sine2 < _SERIES_BELOW
    sine = ca.sqrt(where(near_zero, 1.0, sine2))
    safe_cosine = where(near_zero, cosine, 1.0)
    series = _horner(sine2 / (safe_cosine * safe_cosine), _ATANC) / safe_cosine
    scale = 2 * sign * where(near_zero, series, ca.atan2(sine, cosine) / sine)
    return column(*[scale * quaternion[i] for i in range(3)])


# --- rotations and rigid motions ------------------------------------------------------------------


def exp3(rotation_vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of the `rotation_vector` (3,) [rad]."""
    return quaternion_to_matrix(quaternion_exp(rotation_vector))


def log3(R: Array) -> Array:
    """Return the rotation vector (3,) [rad] of norm at most pi of a rotation matrix R (3, 3).

    At the angle pi both signs of the axis are right; one of them is returned.
    """
    return quaternion_log(matrix_to_quaternion(R))


def exp6_translation(twist: Array) -> Array:
    """Return the translation (3,) [m] after moving for one second with a constant body twist (6,)
    [m/s, rad/s].
    """
    linear = twist[:3]
    angular = twist[3:]
    x = dot(angular, angular)
    once = cross(angular, linear)
    return linear + _cosc_of_squared(x) * once + _sincc_of_squared(x) * cross(angular, once)


def log6_translation(rotation_vector: Array, p: Array) -> Array:
    """Return the linear part (3,) [m/s] of the twist whose exponential has the `rotation_vector`
    (3,) [rad] and translation p (3,) [m].
    """
    once = cross(rotation_vector, p)
    scale = cotc_of_squared(dot(rotation_vector, rotation_vector))
    return p - once / 2 + scale * cross(rotation_vector, once)
