"""How deep solids overlap along directions that may be the shallowest: those of their faces and edges.

Without disks these are all (separating axes, [Ericson2005] 4.4.1); with one disk and a point besides, the way outward of the
axis of the disk is left; for the rest they are where `hull` begins.
"""

from __future__ import annotations

import math

from uvms_ocp.functions.kernels.layout import Vector, zeros
from uvms_ocp.model.shapes.distance_kernels.meeting import Meeting
from uvms_ocp.model.shapes.distance_kernels.solids import Solid, cross, dot, height, turned_back

_PARALLEL = 1e-20  # [-] squared sine of edges that span no face


def try_axes(m: Meeting, a: Solid, b: Solid) -> None:
    """The shallowest of these directions, and the distance along it. A kernel."""
    m.distance = -math.inf
    for i in range(3):
        try_face_and_edges(m, a, b, i)
    try_outward(m, a, b)


def try_face_and_edges(m: Meeting, a: Solid, b: Solid, i: int) -> None:
    """Along the i-th axes of both, and across that of A and any of B. A kernel."""
    along, other, both = zeros(3), zeros(3), zeros(3)
    along[i] = 1.0
    try_axis(m, a, b, along)
    for j in range(3):
        for k in range(3):
            other[k] = m.R[3 * k + j]
        if j == i:
            try_axis(m, a, b, other)
        cross(along, other, both)
        try_axis(m, a, b, both)


def try_outward(m: Meeting, a: Solid, b: Solid) -> None:
    """From the z axis of either to the middle of the other. A kernel."""
    out, z = zeros(3), zeros(3)
    for k in range(2):
        out[k] = m.p[k]
    try_axis(m, a, b, out)
    for k in range(3):
        z[k] = m.R[3 * k + 2]
    along = dot(z, m.p)
    for k in range(3):
        out[k] = m.p[k] - along * z[k]
    try_axis(m, a, b, out)


def try_axis(m: Meeting, a: Solid, b: Solid, d: Vector) -> None:
    """Take d (3,), of any length, if the solids overlap less along it than along what was taken before. A kernel."""
    n, length = zeros(3), math.sqrt(dot(d, d))
    if not length * length > _PARALLEL:
        return
    side = 1.0 if dot(d, m.p) >= 0.0 else -1.0
    for i in range(3):
        n[i] = side * d[i] / length
    distance = distance_along(m, a, b, n)
    if distance > m.distance:
        m.distance = distance
        for i in range(3):
            m.normal[i] = n[i]


def distance_along(m: Meeting, a: Solid, b: Solid, n: Vector) -> float:
    """By how much B lies beyond A along n (3,) [-] of length 1, in the frame of A [m]. A kernel."""
    back = zeros(3)
    turned_back(m.R, n, back)
    return dot(n, m.p) - height(a, n) - height(b, back)
