"""Solids that have a form in C: a box, a disk across the z axis and a ball, added up (Minkowski)."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector


class Solid(Layout):
    """A sphere is a ball, a capsule a segment and a ball, a cylinder a segment and a disk, a box itself.

    Each looks the same from either side of its middle, and none has both a disk and a box that is wider than a segment.
    """

    half: Annotated[Vector, Sized(3)]
    """(3,) [m] half sides of the box; along z alone it is a segment."""
    disk: float
    """[m] radius."""
    ball: float
    """[m] radius."""
    size: float
    """[m] radius of the ball around the middle that holds all of it."""
    joint: int
    """Whose body carries it, counted from 0; -1 where it stands still in W."""
    R_JS: Annotated[Vector, Sized(9)]
    """(9,) [-] on that body, row after row."""
    p_JS: Annotated[Vector, Sized(3)]
    """(3,) [m]"""
    R: Annotated[Vector, Sized(9)]
    """(9,) [-] R_WS, row after row."""
    p: Annotated[Vector, Sized(3)]
    """(3,) [m] p_WS."""


def farthest(s: Solid, d: Vector, point: Vector) -> None:
    """The point (3,) [m] of box and disk that is farthest along d (3,), in the solid's frame. A kernel."""
    across = math.sqrt(d[0] * d[0] + d[1] * d[1])
    share = s.disk / across if across > 0.0 else 0.0
    point[0] = math.copysign(s.half[0], d[0]) + share * d[0]
    point[1] = math.copysign(s.half[1], d[1]) + share * d[1]
    point[2] = math.copysign(s.half[2], d[2])


def nearest_to(s: Solid, x: Vector, point: Vector) -> None:
    """The point (3,) [m] of box and disk that is nearest to x (3,) [m], in the solid's frame. A kernel."""
    for i in range(3):
        point[i] = min(s.half[i], max(-s.half[i], x[i]))
    across = math.sqrt(x[0] * x[0] + x[1] * x[1])
    if s.disk > 0.0:
        share = min(1.0, s.disk / across) if across > 0.0 else 1.0
        point[0] = share * x[0]
        point[1] = share * x[1]


def height(s: Solid, d: Vector) -> float:
    """How far that is along d [m times its length]. A kernel."""
    box = s.half[0] * abs(d[0]) + s.half[1] * abs(d[1]) + s.half[2] * abs(d[2])
    return box + s.disk * math.sqrt(d[0] * d[0] + d[1] * d[1])


def rotated(R: Vector, x: Vector, y: Vector) -> None:
    """y = R x; R (9,) row after row, x and y (3,) not the same. A kernel."""
    for i in range(3):
        y[i] = R[3 * i] * x[0] + R[3 * i + 1] * x[1] + R[3 * i + 2] * x[2]


def turned_back(R: Vector, x: Vector, y: Vector) -> None:
    """y = R.T x. A kernel."""
    for i in range(3):
        y[i] = R[i] * x[0] + R[3 + i] * x[1] + R[6 + i] * x[2]


def between(R: Vector, S: Vector, T: Vector) -> None:
    """T = R.T S, all (9,) row after row. A kernel."""
    for i in range(3):
        for j in range(3):
            T[3 * i + j] = R[i] * S[j] + R[3 + i] * S[3 + j] + R[6 + i] * S[6 + j]


def dot(x: Vector, y: Vector) -> float:
    """x.T y of (3,). A kernel."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def subtract(x: Vector, y: Vector, z: Vector) -> None:
    """z = x - y, all (3,). A kernel."""
    for i in range(3):
        z[i] = x[i] - y[i]


def cross(x: Vector, y: Vector, z: Vector) -> None:
    """z = x cross y, all (3,), z neither of both. A kernel."""
    z[0] = x[1] * y[2] - x[2] * y[1]
    z[1] = x[2] * y[0] - x[0] * y[2]
    z[2] = x[0] * y[1] - x[1] * y[0]
