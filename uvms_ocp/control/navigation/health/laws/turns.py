"""Quaternions xyzw for kernels."""

from __future__ import annotations

import math

from uvms_ocp.functions.kernels.layout import Vector, zeros


def product(a: Vector, b: Vector, out: Vector) -> None:
    """out (4,) becomes a times b, all other arrays than `out`."""
    out[0] = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1]
    out[1] = a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2]
    out[2] = a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0]
    out[3] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]


def conjugate(a: Vector) -> None:
    """Turn it (4,) round in place."""
    for i in range(3):
        a[i] = -a[i]


def normalize(a: Vector) -> None:
    """Give a (4,) the length 1."""
    size = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3])
    for i in range(4):
        a[i] = a[i] / size


def small_turn(by: Vector, share: float, out: Vector) -> None:
    """out (4,) becomes the small rotation by share [-] of the vector `by` (3,) [rad]."""
    for i in range(3):
        out[i] = 0.5 * (share * by[i])
    out[3] = 1.0 - 0.5 * (out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    normalize(out)


def turn(q: Vector, by: Vector, out: Vector) -> None:
    """out (3,) becomes the vector `by` (3,) turned by the quaternion at entries 3 to 6 of q; another array than `by`."""
    u = zeros(3)
    u[0] = 2.0 * (q[4] * by[2] - q[5] * by[1])
    u[1] = 2.0 * (q[5] * by[0] - q[3] * by[2])
    u[2] = 2.0 * (q[3] * by[1] - q[4] * by[0])
    out[0] = by[0] + q[6] * u[0] + (q[4] * u[2] - q[5] * u[1])
    out[1] = by[1] + q[6] * u[1] + (q[5] * u[0] - q[3] * u[2])
    out[2] = by[2] + q[6] * u[2] + (q[3] * u[1] - q[4] * u[0])


def angle_between(a: Vector, b: Vector) -> float:
    """[rad] by which the rotations a (4,) and b (4,) differ."""
    back, between = zeros(4), zeros(4)
    for i in range(4):
        back[i] = b[i]
    conjugate(back)
    product(a, back, between)
    size = math.sqrt(between[0] * between[0] + between[1] * between[1] + between[2] * between[2])
    return 2.0 * math.atan2(size, abs(between[3]))
