"""The signed distance of two solids: apart, or overlapping."""

from __future__ import annotations

from uvms_ocp.functions.kernels.layout import zeros
from uvms_ocp.model.shapes.distance_kernels.axes import try_axes, try_axis
from uvms_ocp.model.shapes.distance_kernels.hull import Hull, grow_hull
from uvms_ocp.model.shapes.distance_kernels.meeting import Meeting, bring_together, search_apart
from uvms_ocp.model.shapes.distance_kernels.solids import Solid

_SHIFT = 1e-3  # [m] that overlapping solids are taken apart by, for their nearest points
_POLISH = 3  # [-] of the direction that a polytope gives to 1e-7 m


def measure_solids(m: Meeting, hull: Hull, a: Solid, b: Solid) -> None:
    """Distance, normal and nearest point of A, balls included, in the frame of A. A kernel."""
    bring_together(m, a, b)
    if not search_apart(m, a, b):
        overlap_solids(m, hull, a, b)
    m.distance -= a.ball + b.ball
    for i in range(3):
        m.at[i] += a.ball * m.normal[i]


def overlap_solids(m: Meeting, hull: Hull, a: Solid, b: Solid) -> None:
    """The shallowest direction, and the points that part last along it. A kernel."""
    try_axes(m, a, b)
    if is_curved(a, b):
        grow_hull(hull, m, a, b)
    for _ in range(_POLISH if is_curved(a, b) else 1):
        part_solids(m, a, b)


def is_curved(a: Solid, b: Solid) -> bool:
    """Whether the difference has faces that `axes` does not know. A kernel."""
    return (a.disk > 0.0 and not is_ball(b)) or (b.disk > 0.0 and not is_ball(a))


def is_ball(s: Solid) -> bool:
    """A kernel."""
    return s.disk == 0.0 and s.half[0] == 0.0 and s.half[1] == 0.0 and s.half[2] == 0.0


def part_solids(m: Meeting, a: Solid, b: Solid) -> None:
    """Take B away from A along the normal; what is nearest then parts last, and tells the direction again. A kernel."""
    p, n, distance = zeros(3), zeros(3), m.distance
    for i in range(3):
        p[i] = m.p[i]
        n[i] = m.normal[i]
        m.p[i] += (_SHIFT - distance) * n[i]
    search_apart(m, a, b)
    for i in range(3):
        m.p[i] = p[i]
        p[i] = m.normal[i]
        m.normal[i] = n[i]
    m.distance = distance
    try_axis(m, a, b, p)
