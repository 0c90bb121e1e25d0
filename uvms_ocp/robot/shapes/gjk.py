"""Distance of two convex solids that are apart, by the algorithm of Gilbert, Johnson and Keerthi
(GJK, [Gilbert1988]), as kernels.

A solid is the Minkowski sum of a box, a disk across the z axis and a ball. The search is on boxes
and disks; its caller adds the balls. It keeps nothing between calls, so that the same configuration
always gives the same distances.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros

FAR = 1e300
"""[m2] `Simplex.squared_distance` before a point is found; it stays where points are not finite."""

ROUNDS = 128
"""Largest number of steps of a search, whose last result counts."""
_FIRST_ROUNDS = 3  # projections between the solids at first, after which most pairs are almost done
# largest gain of a step that ends the search, as a share of the squared distance; the normal is then
# wrong by at most its square root
_NEGLIGIBLE_GAIN = 1e-12
_MOST_STALLS = 4  # steps that brought no point nearer, after which only rounding is left
TOUCHING = 1e-9
"""[m] distance below which solids count as overlapping: the direction between them would be
rounding.
"""


def search_apart(placement: RelativePlacement, a: Solid, b: Solid) -> bool:
    """Return whether A and B are apart; if so, write their distance, normal and nearest point. A
    kernel.
    """
    simplex = placement.simplex
    previous = math.inf
    n_stalls = 0
    begin_search(placement, a, b)
    for k in range(ROUNDS):
        find_nearest(simplex)
        if simplex.encloses_origin or simplex.squared_distance <= TOUCHING * TOUCHING:
            return False
        reduce_simplex(simplex)
        write_support(placement, a, b)
        if simplex.squared_distance >= previous:
            n_stalls += 1
        largest_gain = simplex.squared_distance - dot(simplex.v, simplex.w[simplex.n])
        is_nearest = largest_gain <= _NEGLIGIBLE_GAIN * simplex.squared_distance
        if is_nearest or n_stalls > _MOST_STALLS:
            break
        if k == 0:
            restart_from_support(simplex)
        else:
            previous = simplex.squared_distance
            simplex.n += 1
    write_separation(placement)
    return True


class Solid(Layout):
    """A convex solid, the sum of a box, a disk and a ball.

    A sphere is a ball, a capsule a segment and a ball, a cylinder a segment and a disk; a segment is
    a box along z alone. All are symmetric about their centre, and none has a disk together with a
    box that is more than a segment.
    """

    half: Annotated[Vector, Sized(3)]
    """(3,) [m] half sides of the box."""
    disk: float
    """[m] radius of the disk."""
    ball: float
    """[m] radius of the ball."""
    size: float
    """[m] radius of the ball around the centre that holds all of it."""
    joint: int
    """Number of the joint whose body carries the solid, from 0; -1 where it is fixed in W."""
    R_JS: Annotated[Vector, Sized(9)]
    """(9,) rotation of the solid on that body, row after row."""
    p_JS: Annotated[Vector, Sized(3)]
    """(3,) [m] position of the solid on that body."""
    R: Annotated[Vector, Sized(9)]
    """(9,) R_WS, row after row."""
    p: Annotated[Vector, Sized(3)]
    """(3,) [m] p_WS."""


class Simplex(Layout):
    """Up to four points of the Minkowski difference A - B, in the frame of A."""

    n: int
    """Number of points."""
    a: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] points of A."""
    b: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] points of B, in the frame of B."""
    w: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] their differences a - b, in the frame of A."""
    v: Annotated[Vector, Sized(3)]
    """(3,) [m] point of the convex hull of `w` that is nearest to the origin."""
    squared_distance: float
    """[m2] squared distance of `v` from the origin."""
    encloses_origin: bool
    """True where the origin is inside the tetrahedron of four points; `v` is not written then."""
    corners: Annotated[list[int], Sized(3)]
    """(3,) indices of the points that `v` is a combination of; those of an edge or of one point are
    repeated.
    """
    weights: Annotated[Vector, Sized(3)]
    """(3,) barycentric coordinates of `v` with respect to its `corners`; after `reduce_simplex` of
    the first n points.
    """


class RelativePlacement(Layout):
    """Relative pose of solids A and B, and how near they are, in the frame of A; balls left out."""

    R: Annotated[Vector, Sized(9)]
    """(9,) R_AB, row after row."""
    p: Annotated[Vector, Sized(3)]
    """(3,) [m] p_AB."""
    simplex: Simplex
    """Simplex that the search ended with."""
    normal: Annotated[Vector, Sized(3)]
    """(3,) unit normal from A to B."""
    distance: float
    """[m] distance, negative where they overlap."""
    at: Annotated[Vector, Sized(3)]
    """(3,) [m] nearest point of A."""


def place_relative(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Write the pose of solid B in the frame of solid A. A kernel."""
    p_AB_W = zeros(3)
    subtract(b.p, a.p, p_AB_W)
    rotate_back(a.R, p_AB_W, placement.p)
    relative_rotation(a.R, b.R, placement.R)


def begin_search(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Write a simplex of one point: project the centre of B onto A, that point onto B, and so on. A
    kernel.
    """
    b_in_A = zeros(3)
    from_b = zeros(3)
    a_in_B = zeros(3)
    simplex = placement.simplex
    b_in_A[:3] = placement.p[:3]
    for _ in range(_FIRST_ROUNDS):
        project(a, b_in_A, simplex.a[0])
        subtract(simplex.a[0], placement.p, from_b)
        rotate_back(placement.R, from_b, a_in_B)
        project(b, a_in_B, simplex.b[0])
        rotate(placement.R, simplex.b[0], b_in_A)
        for i in range(3):
            b_in_A[i] += placement.p[i]
    write_difference(placement, 0)
    simplex.n = 1


def write_support(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Write the point of A - B that is farthest along -v behind those of the simplex, without
    counting it. A kernel.
    """
    simplex = placement.simplex
    towards_origin = zeros(3)
    for i in range(3):
        towards_origin[i] = -simplex.v[i]
    add_support(placement, a, b, towards_origin)
    simplex.n -= 1


def add_support(placement: RelativePlacement, a: Solid, b: Solid, d: Vector) -> None:
    """Add the point of A - B that is farthest along d (3,), in the frame of A. A kernel."""
    simplex = placement.simplex
    against_d_in_B = zeros(3)
    support_point(a, d, simplex.a[simplex.n])
    rotate_back(placement.R, d, against_d_in_B)
    for i in range(3):
        against_d_in_B[i] = -against_d_in_B[i]
    support_point(b, against_d_in_B, simplex.b[simplex.n])
    write_difference(placement, simplex.n)
    simplex.n += 1


def write_difference(placement: RelativePlacement, k: int) -> None:
    """Write point k of the difference, ``w = a - p - R b``. A kernel."""
    Rb = zeros(3)
    simplex = placement.simplex
    rotate(placement.R, simplex.b[k], Rb)
    for i in range(3):
        simplex.w[k][i] = simplex.a[k][i] - placement.p[i] - Rb[i]


def reduce_simplex(simplex: Simplex) -> None:
    """Keep only the points that `v` is a combination of. A kernel."""
    n = 0
    for m in range(3):
        if simplex.weights[m] > 0.0:
            i = simplex.corners[m]  # not below n, as corners are in ascending order
            simplex.a[n][:] = simplex.a[i]
            simplex.b[n][:] = simplex.b[i]
            simplex.w[n][:] = simplex.w[i]
            simplex.weights[n] = simplex.weights[m]
            n += 1
    simplex.n = n


def restart_from_support(simplex: Simplex) -> None:
    """Keep only the point that `write_support` wrote: it is an extreme point of A - B, which that of
    `begin_search` need not be. A kernel.
    """
    simplex.a[0][:] = simplex.a[simplex.n]
    simplex.b[0][:] = simplex.b[simplex.n]
    simplex.w[0][:] = simplex.w[simplex.n]
    simplex.n = 1


def write_separation(placement: RelativePlacement) -> None:
    """Write distance, normal and nearest point of A from the last simplex; the distance is nan where
    points are not finite. A kernel.
    """
    simplex = placement.simplex
    placement.distance = math.sqrt(simplex.squared_distance)
    if not simplex.squared_distance < FAR:
        placement.distance = math.nan
    for i in range(3):
        placement.normal[i] = -simplex.v[i] / placement.distance
        placement.at[i] = 0.0
        for k in range(simplex.n):
            placement.at[i] += simplex.weights[k] * simplex.a[k][i]


def find_nearest(simplex: Simplex) -> None:
    """Find the point of the convex hull that is nearest to the origin, or that four points enclose
    the origin. A kernel.
    """
    simplex.squared_distance = FAR
    simplex.encloses_origin = simplex.n == 4 and encloses_origin(simplex)
    if simplex.n == 1:
        try_point(simplex, 0, 0, 0, 0.0, 0.0)
    elif simplex.n == 2:
        try_edge(simplex, 0, 1)
    elif simplex.n == 3:
        try_face(simplex, 0, 1, 2)
    elif not simplex.encloses_origin:
        try_face(simplex, 0, 1, 2)
        try_face(simplex, 0, 1, 3)
        try_face(simplex, 0, 2, 3)
        try_face(simplex, 1, 2, 3)


def encloses_origin(simplex: Simplex) -> bool:
    """Return whether the origin is inside the tetrahedron of the four points, by its barycentric
    coordinates; not where they lie in a plane. A kernel.
    """
    e = zeros(3)
    f = zeros(3)
    g = zeros(3)
    normal = zeros(3)
    subtract(simplex.w[1], simplex.w[0], e)
    subtract(simplex.w[2], simplex.w[0], f)
    subtract(simplex.w[3], simplex.w[0], g)
    cross(f, g, normal)
    volume = dot(e, normal)
    side = 1.0 if volume > 0.0 else -1.0
    # Coordinates along e, f and g, all times the absolute volume.
    x = -side * dot(simplex.w[0], normal)
    cross(g, e, normal)
    y = -side * dot(simplex.w[0], normal)
    cross(e, f, normal)
    z = -side * dot(simplex.w[0], normal)
    return volume != 0.0 and x >= 0.0 and y >= 0.0 and z >= 0.0 and x + y + z <= abs(volume)


def try_face(simplex: Simplex, i: int, j: int, k: int) -> None:
    """Try the point of a triangle that is nearest to the origin. A kernel."""
    e = zeros(3)
    f = zeros(3)
    normal = zeros(3)
    edge_normal = zeros(3)
    wi = simplex.w[i]
    wj = simplex.w[j]
    wk = simplex.w[k]
    subtract(wj, wi, e)
    subtract(wk, wi, f)
    cross(e, f, normal)
    squared_area = dot(normal, normal)
    # Barycentric coordinates of the origin's projection; outside where the triangle has no area.
    x = -1.0
    y = -1.0
    if squared_area > 0.0:
        cross(f, wi, edge_normal)
        x = dot(normal, edge_normal) / squared_area
        cross(wi, e, edge_normal)
        y = dot(normal, edge_normal) / squared_area
    if x >= 0.0 and y >= 0.0 and x + y <= 1.0:
        try_point(simplex, i, j, k, x, y)
    else:
        try_edge(simplex, i, j)
        try_edge(simplex, i, k)
        try_edge(simplex, j, k)


def try_edge(simplex: Simplex, i: int, j: int) -> None:
    """Try the point of a segment that is nearest to the origin. A kernel."""
    e = zeros(3)
    wi = simplex.w[i]
    wj = simplex.w[j]
    subtract(wj, wi, e)
    squared_length = dot(e, e)
    if squared_length > 0.0:
        share = min(1.0, max(0.0, -dot(wi, e) / squared_length))
        try_point(simplex, i, j, j, share, 0.0)
    else:
        try_point(simplex, i, i, i, 0.0, 0.0)


def try_point(simplex: Simplex, i: int, j: int, k: int, x: float, y: float) -> None:
    """Take the point ``w_i + x (w_j - w_i) + y (w_k - w_i)`` for `v` if it is the nearest so far. A
    kernel.
    """
    v = zeros(3)
    wi = simplex.w[i]
    wj = simplex.w[j]
    wk = simplex.w[k]
    for c in range(3):
        v[c] = wi[c] + x * (wj[c] - wi[c]) + y * (wk[c] - wi[c])
    squared_distance = dot(v, v)
    if squared_distance < simplex.squared_distance:
        simplex.squared_distance = squared_distance
        simplex.corners[0] = i
        simplex.corners[1] = j
        simplex.corners[2] = k
        simplex.weights[0] = 1.0 - x - y
        simplex.weights[1] = x
        simplex.weights[2] = y
        simplex.v[:3] = v[:3]


def support_point(s: Solid, d: Vector, point: Vector) -> None:
    """Write the point (3,) [m] of box and disk that is farthest along d (3,), in the frame of the
    solid. A kernel.
    """
    across = math.sqrt(d[0] * d[0] + d[1] * d[1])
    share = s.disk / across if across > 0.0 else 0.0
    point[0] = math.copysign(s.half[0], d[0]) + share * d[0]
    point[1] = math.copysign(s.half[1], d[1]) + share * d[1]
    point[2] = math.copysign(s.half[2], d[2])


def support_function(s: Solid, d: Vector) -> float:
    """Return the largest product of d (3,) and a point of box and disk [m times the unit of d], in
    the frame of the solid. A kernel.
    """
    box = s.half[0] * abs(d[0]) + s.half[1] * abs(d[1]) + s.half[2] * abs(d[2])
    return box + s.disk * math.sqrt(d[0] * d[0] + d[1] * d[1])


def project(s: Solid, x: Vector, point: Vector) -> None:
    """Write the point (3,) [m] of box and disk that is nearest to x (3,) [m], in the frame of the
    solid. A kernel.
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


def rotate(R: Vector, x: Vector, y: Vector) -> None:
    """Compute y = R x; R (9,) row after row, x and y (3,) not the same array. A kernel."""
    for i in range(3):
        y[i] = R[3 * i] * x[0] + R[3 * i + 1] * x[1] + R[3 * i + 2] * x[2]


def rotate_back(R: Vector, x: Vector, y: Vector) -> None:
    """Compute y = R.T x; R (9,) row after row, x and y (3,) not the same array. A kernel."""
    for i in range(3):
        y[i] = R[i] * x[0] + R[3 + i] * x[1] + R[6 + i] * x[2]


def relative_rotation(R: Vector, S: Vector, T: Vector) -> None:
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
