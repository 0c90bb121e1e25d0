"""Nearest points of two convex solids that are apart (Gilbert-Johnson-Keerthi), as kernels.

A solid is a box, a disk across the z axis and a ball, added up (Minkowski sum).

The search is that of [Gilbert1988] (GJK), on boxes and disks; balls are added to what it finds. It
remembers nothing, so that the same configuration always gives the same distances.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros

FAR = 1e300
"""[m2] `Simplex.squared` of points that are no numbers."""

ROUNDS = 128
"""Largest number of steps of a search, whose last result counts."""
_TURNS = 3  # of nearest points, after which most pairs are almost done
# of the distance, by which none can be smaller: its square root is what the normal is wrong by
_EXACT = 1e-12
_STALLS = 4  # rounds without a gain, after which rounding is all that is left
TOUCHING = 1e-9
"""[m] distance below which solids count as overlapping, as rounding is all that is left of a
direction.
"""


# Solids that have a form in C: a box, a disk across the z axis and a ball, added up (Minkowski).


class Solid(Layout):
    """A convex solid as a sum: a sphere is a ball, a capsule a segment and a ball, a cylinder a
    segment and a disk, a box itself.

    Each looks the same from either side of its middle, and none has both a disk and a box that is
    wider than a segment.
    """

    half: Annotated[Vector, Sized(3)]
    """(3,) [m] half sides of the box; along z alone it is a segment."""
    disk: float
    """[m] radius of the disk."""
    ball: float
    """[m] radius of the ball."""
    size: float
    """[m] radius of the ball around the middle that holds all of it."""
    joint: int
    """Number of the joint whose body carries the shape, from 0; -1 where it stands still in W."""
    R_JS: Annotated[Vector, Sized(9)]
    """(9,) rotation of the solid on that body, row after row."""
    p_JS: Annotated[Vector, Sized(3)]
    """(3,) [m] position of the solid on that body."""
    R: Annotated[Vector, Sized(9)]
    """(9,) R_WS, row after row."""
    p: Annotated[Vector, Sized(3)]
    """(3,) [m] p_WS."""


def farthest(s: Solid, d: Vector, point: Vector) -> None:
    """Write the point (3,) [m] of box and disk that is farthest along d (3,), in the solid's frame.
    A kernel.
    """
    across = math.sqrt(d[0] * d[0] + d[1] * d[1])
    share = s.disk / across if across > 0.0 else 0.0
    point[0] = math.copysign(s.half[0], d[0]) + share * d[0]
    point[1] = math.copysign(s.half[1], d[1]) + share * d[1]
    point[2] = math.copysign(s.half[2], d[2])


def nearest_point(s: Solid, x: Vector, point: Vector) -> None:
    """Write the point (3,) [m] of box and disk that is nearest to x (3,) [m], in the solid's frame.
    A kernel.
    """
    for i in range(3):
        point[i] = min(s.half[i], max(-s.half[i], x[i]))
    across = math.sqrt(x[0] * x[0] + x[1] * x[1])
    if s.disk > 0.0:
        if across > 0.0:
            share = min(1.0, s.disk / across)
        else:
            share = 1.0
        point[0] = share * x[0]
        point[1] = share * x[1]


def height(s: Solid, d: Vector) -> float:
    """Return the extent of a solid along d [m times the length of d]. A kernel."""
    box = s.half[0] * abs(d[0]) + s.half[1] * abs(d[1]) + s.half[2] * abs(d[2])
    return box + s.disk * math.sqrt(d[0] * d[0] + d[1] * d[1])


def rotated(R: Vector, x: Vector, y: Vector) -> None:
    """Compute y = R x; R (9,) row after row, x and y (3,) not the same array. A kernel."""
    for i in range(3):
        y[i] = R[3 * i] * x[0] + R[3 * i + 1] * x[1] + R[3 * i + 2] * x[2]


def turned_back(R: Vector, x: Vector, y: Vector) -> None:
    """Compute y = R.T x; R (9,) row after row, x and y (3,) not the same array. A kernel."""
    for i in range(3):
        y[i] = R[i] * x[0] + R[3 + i] * x[1] + R[6 + i] * x[2]


def between(R: Vector, S: Vector, T: Vector) -> None:
    """Compute T = R.T S, all (9,) row after row. A kernel."""
    for i in range(3):
        for j in range(3):
            T[3 * i + j] = R[i] * S[j] + R[3 + i] * S[3 + j] + R[6 + i] * S[6 + j]


def dot(x: Vector, y: Vector) -> float:
    """Return x.T y of two vectors (3,). A kernel."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def subtract(x: Vector, y: Vector, z: Vector) -> None:
    """Compute z = x - y, all (3,). A kernel."""
    for i in range(3):
        z[i] = x[i] - y[i]


def cross(x: Vector, y: Vector, z: Vector) -> None:
    """Compute z = x cross y, all (3,), z neither of both. A kernel."""
    z[0] = x[1] * y[2] - x[2] * y[1]
    z[1] = x[2] * y[0] - x[0] * y[2]
    z[2] = x[0] * y[1] - x[1] * y[0]


# Up to four points of the difference of two solids, and the point of their hull nearest to the
# origin.


class Simplex(Layout):
    """Up to four points of the difference A - B of two solids, in the frame of the first solid, A."""

    n: int
    """Number of points."""
    a: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] points of A."""
    b: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] points of B, in the frame of B."""
    w: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] their differences a - b."""
    v: Annotated[Vector, Sized(3)]
    """(3,) [m] point of their hull that is nearest to the origin."""
    squared: float
    """[m2] squared distance from the origin to it."""
    inside: bool
    """True where the origin is inside of four points."""
    pick: Annotated[list[int], Sized(3)]
    """Points that it lies between."""
    lot: Annotated[Vector, Sized(3)]
    """(3,) shares of these points."""


def find_nearest(simplex: Simplex) -> None:
    """Find the point of the hull of all points that is nearest to the origin, or that this is
    inside. A kernel.
    """
    simplex.squared = FAR
    simplex.inside = simplex.n == 4 and holds_origin(simplex)
    if simplex.n == 1:
        offer_point(simplex, 0, 0, 0, 0.0, 0.0)
    elif simplex.n == 2:
        try_edge(simplex, 0, 1)
    elif simplex.n == 3:
        try_face(simplex, 0, 1, 2)
    elif not simplex.inside:
        try_faces(simplex)


def try_faces(simplex: Simplex) -> None:
    """Look for the nearest point on the four faces. A kernel."""
    try_face(simplex, 0, 1, 2)
    try_face(simplex, 0, 1, 3)
    try_face(simplex, 0, 2, 3)
    try_face(simplex, 1, 2, 3)


def try_edge(simplex: Simplex, i: int, j: int) -> None:
    """Look for the nearest point between two points. A kernel."""
    e = zeros(3)
    wi = simplex.w[i]
    wj = simplex.w[j]
    subtract(wj, wi, e)
    length = dot(e, e)
    if length > 0.0:
        offer_point(simplex, i, j, j, min(1.0, max(0.0, -dot(wi, e) / length)), 0.0)
    else:
        offer_point(simplex, i, i, i, 0.0, 0.0)


def try_face(simplex: Simplex, i: int, j: int, k: int) -> None:
    """Look for the nearest point between three points. A kernel."""
    e = zeros(3)
    f = zeros(3)
    normal = zeros(3)
    turned = zeros(3)
    wi = simplex.w[i]
    wj = simplex.w[j]
    wk = simplex.w[k]
    subtract(wj, wi, e)
    subtract(wk, wi, f)
    cross(e, f, normal)
    area = dot(normal, normal)
    x = -1.0
    y = -1.0
    if area > 0.0:
        cross(f, wi, turned)
        x = dot(normal, turned) / area
        cross(wi, e, turned)
        y = dot(normal, turned) / area
    if x >= 0.0 and y >= 0.0 and x + y <= 1.0:
        offer_point(simplex, i, j, k, x, y)
    else:
        try_edge(simplex, i, j)
        try_edge(simplex, i, k)
        try_edge(simplex, j, k)


def offer_point(simplex: Simplex, i: int, j: int, k: int, x: float, y: float) -> None:
    """Take the point w_i + x (w_j - w_i) + y (w_k - w_i), x and y, if it is the nearest so far. A
    kernel.
    """
    v = zeros(3)
    wi = simplex.w[i]
    wj = simplex.w[j]
    wk = simplex.w[k]
    for c in range(3):
        v[c] = wi[c] + x * (wj[c] - wi[c]) + y * (wk[c] - wi[c])
    squared = dot(v, v)
    if squared < simplex.squared:
        simplex.squared = squared
        simplex.pick[0] = i
        simplex.pick[1] = j
        simplex.pick[2] = k
        simplex.lot[0] = 1.0 - x - y
        simplex.lot[1] = x
        simplex.lot[2] = y
        simplex.v[:3] = v[:3]


def holds_origin(simplex: Simplex) -> bool:
    """Check that the origin is inside of the four points, which is not so where they lie in a
    plane. A kernel.
    """
    e = zeros(3)
    f = zeros(3)
    g = zeros(3)
    turned = zeros(3)
    subtract(simplex.w[1], simplex.w[0], e)
    subtract(simplex.w[2], simplex.w[0], f)
    subtract(simplex.w[3], simplex.w[0], g)
    cross(f, g, turned)
    volume = dot(e, turned)
    side = 1.0 if volume > 0.0 else -1.0
    x = -side * dot(simplex.w[0], turned)
    cross(g, e, turned)
    y = -side * dot(simplex.w[0], turned)
    cross(e, f, turned)
    z = -side * dot(simplex.w[0], turned)
    return volume != 0.0 and x >= 0.0 and y >= 0.0 and z >= 0.0 and x + y + z <= abs(volume)


def keep_nearest(simplex: Simplex) -> None:
    """Drop the points that the nearest one does not lie between; `lot` are the shares of those that
    stay. A kernel.
    """
    n = 0
    for m in range(3):
        if simplex.lot[m] > 0.0:
            i = simplex.pick[m]  # never before n, as the picks are in their order
            simplex.a[n][:] = simplex.a[i]
            simplex.b[n][:] = simplex.b[i]
            simplex.w[n][:] = simplex.w[i]
            simplex.lot[n] = simplex.lot[m]
            n += 1
    simplex.n = n


def keep_last(simplex: Simplex, others: bool) -> None:
    """Count the point behind the last one; without the others, which first ones that are no corners
    give way to. A kernel.
    """
    if not others:
        simplex.a[0][:] = simplex.a[simplex.n]
        simplex.b[0][:] = simplex.b[simplex.n]
        simplex.w[0][:] = simplex.w[simplex.n]
        simplex.n = 0
    simplex.n += 1


# Two solids that meet: where one is as the other sees it, and the nearest points of both while they
# are apart.
#
# The search is that of [Gilbert1988] (GJK), on boxes and disks; balls are added to what it finds.
# It remembers nothing, so that the same configuration always gives the same distances.


class RelativePlacement(Layout):
    """Relative pose of solids A and B, and how near they are, in the frame of A; balls left out."""

    R: Annotated[Vector, Sized(9)]
    """(9,) R_AB, row after row."""
    p: Annotated[Vector, Sized(3)]
    """(3,) [m] p_AB."""
    simplex: Simplex
    """Simplex whose points enclose the nearest ones."""
    normal: Annotated[Vector, Sized(3)]
    """(3,) unit normal from A to B."""
    distance: float
    """[m] distance, negative where they overlap."""
    at: Annotated[Vector, Sized(3)]
    """(3,) [m] nearest point of A."""


def place_relative(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Write the pose of solid B in the frame of solid A. A kernel."""
    way = zeros(3)
    subtract(b.p, a.p, way)
    turned_back(a.R, way, placement.p)
    between(a.R, b.R, placement.R)


def begin_search(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Begin with one point of each solid, which lie near each other: nearest to the other's, in
    turn. A kernel.
    """
    x = zeros(3)
    y = zeros(3)
    simplex = placement.simplex
    x[:3] = placement.p[:3]
    for _ in range(_TURNS):
        nearest_point(a, x, simplex.a[0])
        subtract(simplex.a[0], placement.p, x)
        turned_back(placement.R, x, y)
        nearest_point(b, y, simplex.b[0])
        rotated(placement.R, simplex.b[0], x)
        for i in range(3):
            x[i] += placement.p[i]
    place_difference(placement, 0)
    simplex.n = 1


def place_difference(placement: RelativePlacement, k: int) -> None:
    """Compute the difference of the k-th points. A kernel."""
    there = zeros(3)
    simplex = placement.simplex
    rotated(placement.R, simplex.b[k], there)
    for i in range(3):
        simplex.w[k][i] = simplex.a[k][i] - placement.p[i] - there[i]


def add_support(placement: RelativePlacement, a: Solid, b: Solid, d: Vector) -> None:
    """Add the points of A and B whose difference is farthest along d (3,). A kernel."""
    simplex = placement.simplex
    back = zeros(3)
    farthest(a, d, simplex.a[simplex.n])
    turned_back(placement.R, d, back)
    for i in range(3):
        back[i] = -back[i]
    farthest(b, back, simplex.b[simplex.n])
    place_difference(placement, simplex.n)
    simplex.n += 1


def search_apart(placement: RelativePlacement, a: Solid, b: Solid) -> bool:
    """Check that A and B are apart; if so, write their distance, normal and nearest points. A
    kernel.
    """
    simplex = placement.simplex
    before = math.inf
    stalled = 0
    begin_search(placement, a, b)
    for k in range(ROUNDS):
        find_nearest(simplex)
        if simplex.inside or simplex.squared <= TOUCHING * TOUCHING:
            return False
        keep_nearest(simplex)
        write_support(placement, a, b)
        stalled += 1 if simplex.squared >= before else 0
        if (
            simplex.squared - dot(simplex.v, simplex.w[simplex.n]) <= _EXACT * simplex.squared
            or stalled > _STALLS
        ):
            break
        before = simplex.squared if k > 0 else math.inf
        keep_last(simplex, k > 0)
    write_separation(placement)
    return True


def write_support(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Write the points that are farthest towards the origin behind those of the simplex, without
    counting them. A kernel.
    """
    simplex = placement.simplex
    away = zeros(3)
    for i in range(3):
        away[i] = -simplex.v[i]
    add_support(placement, a, b, away)
    simplex.n -= 1


def write_separation(placement: RelativePlacement) -> None:
    """Write distance, normal and nearest point from what the search ended with. A kernel."""
    simplex = placement.simplex
    placement.distance = math.sqrt(simplex.squared)
    if not simplex.squared < FAR:
        placement.distance = math.nan
    for i in range(3):
        placement.normal[i] = -simplex.v[i] / placement.distance
        placement.at[i] = 0.0
        for k in range(simplex.n):
            placement.at[i] += simplex.lot[k] * simplex.a[k][i]
