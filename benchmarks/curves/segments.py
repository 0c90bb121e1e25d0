"""Distances of segments in closed form: those of capsules but for their radii."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.types import Array


class Witness(NamedTuple):
    """Closest points of segments, row by row."""

    distance: Array
    """(n,) [m] between the segments, not negative."""
    normal: Array
    """(n, 3) unit vector from the first to the second."""
    first: Array
    """(n, 3) [m] closest point of the first segment."""


def segment_distance(a0: Array, a1: Array, b0: Array, b1: Array) -> Witness:
    """Closest points of segments with the end points a0, a1, b0 and b1 (n, 3) [m] each
    ([Ericson2005] 5.1.9).
    """
    u = a1 - a0
    v = b1 - b0
    w = a0 - b0
    uu = _dot(u, u)
    vv = _dot(v, v)
    uv = _dot(u, v)
    uw = _dot(u, w)
    vw = _dot(v, w)
    s = _clipped(uv * vw - vv * uw, uu * vv - uv * uv)
    t = _clipped(uv * s + vw, vv)
    s = _clipped(uv * t - uw, uu)
    first = a0 + s[:, None] * u
    gap = b0 + t[:, None] * v - first
    distance = np.sqrt(_dot(gap, gap))
    touching = distance < _TOUCH
    crossing = _crossing_normal(u[touching], v[touching])
    normal = gap / np.where(touching, 1.0, distance)[:, None]
    normal[touching] = crossing
    return Witness(distance=distance, normal=normal, first=first)


def symbolic_segment_distance(a0: ca.SX, a1: ca.SX, b0: ca.SX, b1: ca.SX) -> ca.SX:
    """Return the distance [m] of two segments as an expression; its derivatives are exact except
    where the closest feature changes.
    """
    u = a1 - a0
    v = b1 - b0
    w = a0 - b0
    uu = ca.dot(u, u)
    vv = ca.dot(v, v)
    uv = ca.dot(u, v)
    uw = ca.dot(u, w)
    vw = ca.dot(v, w)
    s = _symbolic_clipped(uv * vw - vv * uw, uu * vv - uv * uv)
    t = _symbolic_clipped(uv * s + vw, vv)
    s = _symbolic_clipped(uv * t - uw, uu)
    gap = b0 + t * v - a0 - s * u
    return ca.sqrt(ca.dot(gap, gap) + _TOUCH**2)


_TOUCH = 1e-12
_PARALLEL = 1e-14


def _clipped(numerator: Array, denominator: Array) -> Array:
    safe = np.where(denominator > _PARALLEL, denominator, 1.0)
    return np.where(denominator > _PARALLEL, np.clip(numerator / safe, 0.0, 1.0), 0.0)


def _symbolic_clipped(numerator: ca.SX, denominator: ca.SX) -> ca.SX:
    safe = ca.fmax(denominator, _PARALLEL)
    return ca.if_else(denominator > _PARALLEL, ca.fmin(ca.fmax(numerator / safe, 0.0), 1.0), 0.0)


def _crossing_normal(u: Array, v: Array) -> Array:
    """A normal to both segments where they cross, and the distance has no gradient."""
    n = np.cross(u, v)
    n[np.linalg.norm(n, axis=1) < _TOUCH] = [0.0, 0.0, 1.0]
    unit: Array = n / np.linalg.norm(n, axis=1, keepdims=True)
    return unit


def _dot(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
