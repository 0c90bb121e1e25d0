"""Keep past estimates, to compare late readings with, and compute with quaternions in kernels."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros

# Quaternions xyzw for kernels.


def product(a: Vector, b: Vector, out: Vector) -> None:
    """Out (4,) becomes a times b, all other arrays than `out`."""
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


def small_rotation(by: Vector, share: float, out: Vector) -> None:
    """Out (4,) becomes the small rotation by share of the vector `by` (3,) [rad]."""
    for i in range(3):
        out[i] = 0.5 * (share * by[i])
    out[3] = 1.0 - 0.5 * (out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    normalize(out)


def rotate(q: Vector, by: Vector, out: Vector) -> None:
    """Out (3,) becomes the vector `by` (3,) turned by the quaternion at entries 3 to 6 of q; another array than `by`."""
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


# The last estimates, to ask what was estimated when a late reading was taken.


class PastEstimate(Layout):
    """Where the robot was taken to be at one tick."""

    t: float
    """[s]"""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad]"""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s]"""
    beam_at: Annotated[Vector, Sized(3)]
    """(3,) [m] the altimeter in B."""
    beam_up: Annotated[Vector, Sized(3)]
    """(3,) its z axis in B."""


class EstimateHistory(Layout):
    """Estimates in the order of time, in a ring."""

    length: float
    """[s] for which they are kept."""
    spacing: float
    """[s] between two at least, the newest aside: so many fit."""
    first: int
    count: int
    kept: Annotated[list[PastEstimate], Sized("n_estimates")]


def remember(h: EstimateHistory, now: PastEstimate) -> None:
    """Keep the estimate of a tick."""
    if h.count >= 2 and _time(h, h.count - 1) - _time(h, h.count - 2) < h.spacing:
        h.count -= 1
    if h.count == len(h.kept):
        _drop(h)
    _copy_estimate(h.kept[(h.first + h.count) % len(h.kept)], now)
    h.count += 1
    while _time(h, 0) < now.t - h.length:
        _drop(h)


def slot_at(h: EstimateHistory, t: float) -> int:
    """Where the estimate is kept that was made nearest to time t [s]; -1 before the first."""
    if h.count == 0:
        return -1
    low, high = 0, h.count - 1
    if t >= _time(h, high):
        low = high
    while high - low > 1:
        middle = (low + high) // 2
        if _time(h, middle) <= t:
            low = middle
        else:
            high = middle
    nearest = low if abs(_time(h, low) - t) <= abs(_time(h, high) - t) else high
    return (h.first + nearest) % len(h.kept)


def _time(h: EstimateHistory, k: int) -> float:
    return h.kept[(h.first + k) % len(h.kept)].t


def _drop(h: EstimateHistory) -> None:
    h.first = (h.first + 1) % len(h.kept)
    h.count -= 1


def _copy_estimate(to: PastEstimate, now: PastEstimate) -> None:
    to.t = now.t
    for i in range(len(to.q)):
        to.q[i] = now.q[i]
    for i in range(len(to.v)):
        to.v[i] = now.v[i]
    for i in range(3):
        to.beam_at[i] = now.beam_at[i]
        to.beam_up[i] = now.beam_up[i]
