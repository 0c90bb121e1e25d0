"""Penetration depth of two overlapping solids, as kernels: separating axes, then an expanding
polytope where they are curved.

Without disks these are all (separating axes, [Ericson2005] 4.4.1); with one disk and a point
besides, the way outward of the axis of the disk is left; for the rest they are where `hull` begins.

Expanding polytope: what its nearest face and the difference there leave open is certain not to be
missed. Faces are turned away from the middle of the difference, which is always inside, as both
solids look the same from either side.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros
from uvms_ocp.robot.shapes.gjk import (
    RelativePlacement,
    Solid,
    add_support,
    cross,
    dot,
    height,
    subtract,
    turned_back,
)

# How deep solids overlap along directions that may be the shallowest: those of their faces and
# edges.
#
# Without disks these are all (separating axes, [Ericson2005] 4.4.1); with one disk and a point
# besides, the way outward of the axis of the disk is left; for the rest they are where `hull`
# begins.

_PARALLEL = 1e-20  # squared sine of edges that span no face

GROWTH = 96
"""Largest number of points by which a polytope grows."""
POINTS = GROWTH + 6
FACES = 2 * POINTS
_OPEN = 1e-7  # [m] between a face and what lies beyond it
_FLAT = 1e-30  # [m4] squared area of a face that has no direction
_SEEN = 1e-13  # [m] by which a point lies beyond a face that goes


def try_axes(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Find the shallowest of the separating axes, and the distance along it. A kernel."""
    placement.distance = -math.inf
    for i in range(3):
        try_face_and_edges(placement, a, b, i)
    try_outward(placement, a, b)


def try_face_and_edges(placement: RelativePlacement, a: Solid, b: Solid, i: int) -> None:
    """Try the i-th axes of both, and the directions across that of A and any of B. A kernel."""
    along = zeros(3)
    edge = zeros(3)
    both = zeros(3)
    along[i] = 1.0
    try_axis(placement, a, b, along)
    for j in range(3):
        for k in range(3):
            edge[k] = placement.R[3 * k + j]
        if j == i:
            try_axis(placement, a, b, edge)
        cross(along, edge, both)
        try_axis(placement, a, b, both)


def try_outward(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Try the directions from the z axis of either to the middle of the other. A kernel."""
    out = zeros(3)
    z = zeros(3)
    out[:2] = placement.p[:2]
    try_axis(placement, a, b, out)
    for k in range(3):
        z[k] = placement.R[3 * k + 2]
    along = dot(z, placement.p)
    for k in range(3):
        out[k] = placement.p[k] - along * z[k]
    try_axis(placement, a, b, out)


def try_axis(placement: RelativePlacement, a: Solid, b: Solid, d: Vector) -> None:
    """Take d (3,), of any length, if the solids overlap less along it than along what was taken
    before. A kernel.
    """
    n = zeros(3)
    length = math.sqrt(dot(d, d))
    if not length * length > _PARALLEL:
        return
    side = 1.0 if dot(d, placement.p) >= 0.0 else -1.0
    for i in range(3):
        n[i] = side * d[i] / length
    distance = distance_along(placement, a, b, n)
    if distance > placement.distance:
        placement.distance = distance
        placement.normal[:3] = n[:3]


def distance_along(placement: RelativePlacement, a: Solid, b: Solid, n: Vector) -> float:
    """Compute how far B lies beyond A along n (3,) of length 1, in the frame of A [m]. A kernel."""
    back = zeros(3)
    turned_back(placement.R, n, back)
    return dot(n, placement.p) - height(a, n) - height(b, back)


# How deep two solids overlap whose difference is curved: a polytope inside of it grows where it is
# nearest to the origin.
#
# Expanding polytope: what its nearest face and the difference there leave open is certain not to be
# missed. Faces are turned away from the middle of the difference, which is always inside, as both
# solids look the same from either side.


class Hull(Layout):
    """A polytope inside of A - B, in the frame of A."""

    n: int
    """Number of points."""
    w: Annotated[list[Vector], Sized(POINTS, 3)]
    """(n, 3) [m] points."""
    n_faces: int
    face: Annotated[list[list[int]], Sized(FACES, 3)]
    """(n_faces, 3) points of each face."""
    normal: Annotated[list[Vector], Sized(FACES, 3)]
    """(n_faces, 3) outward normal of each face."""
    offset: Annotated[Vector, Sized(FACES)]
    """(n_faces,) [m] distance of each face from the origin along its normal."""
    n_edges: int
    edge: Annotated[list[list[int]], Sized(FACES, 2)]
    """(n_edges, 2) points of the edges of the hole that faces leave which go."""


def expand_polytope(hull: Hull, placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Find a shallower direction than that of `placement`, or that there is none. A kernel."""
    enclose(hull, placement, a, b)
    for _ in range(GROWTH):
        k = nearest_face(hull)
        if -placement.distance - hull.offset[k] <= _OPEN:
            break
        try_axis(placement, a, b, hull.normal[k])
        write_polytope_support(hull, placement, a, b, hull.normal[k])
        if dot(hull.normal[k], hull.w[hull.n]) - hull.offset[k] <= _OPEN:
            break
        remove_visible_faces(hull)
        if not fill_hole(hull, placement):
            break


def write_polytope_support(
    hull: Hull, placement: RelativePlacement, a: Solid, b: Solid, d: Vector
) -> None:
    """Write the point that is farthest along d (3,) behind the others, without counting it. A
    kernel.
    """
    placement.simplex.n = 0
    add_support(placement, a, b, d)
    placement.simplex.n = 0
    hull.w[hull.n][:3] = placement.simplex.w[0][:3]


def nearest_face(hull: Hull) -> int:
    """Return the face with the smallest offset. A kernel."""
    nearest = 0
    for k in range(1, hull.n_faces):
        if hull.offset[k] < hull.offset[nearest]:
            nearest = k
    return nearest


def enclose(hull: Hull, placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Begin with three points that lie in different directions from the middle, and those opposite.
    A kernel.
    """
    d = zeros(3)
    first = zeros(3)
    second = zeros(3)
    across = zeros(3)
    hull.n = 0
    hull.n_faces = 0
    d[0] = 1.0
    add_opposite(hull, placement, a, b, d, first)
    smallest = 0
    for i in range(1, 3):
        if abs(first[i]) < abs(first[smallest]):
            smallest = i
    across[smallest] = 1.0
    cross(first, across, d)
    add_opposite(hull, placement, a, b, d, second)
    cross(first, second, d)
    add_opposite(hull, placement, a, b, d, across)
    for k in range(8):
        add_face(hull, placement, k % 2, 2 + k // 2 % 2, 4 + k // 4)


def add_opposite(
    hull: Hull, placement: RelativePlacement, a: Solid, b: Solid, d: Vector, u: Vector
) -> None:
    """Add two points, farthest along d (3,) and against it; u (3,) [m] becomes the way from the
    middle to the first. A kernel.
    """
    write_polytope_support(hull, placement, a, b, d)
    for i in range(3):
        u[i] = hull.w[hull.n][i] + placement.p[i]
        hull.w[hull.n + 1][i] = -u[i] - placement.p[i]
    hull.n += 2


def add_face(hull: Hull, placement: RelativePlacement, i: int, j: int, k: int) -> None:
    """Add the face between three points, outward. A kernel."""
    e = zeros(3)
    f = zeros(3)
    n = hull.normal[hull.n_faces]
    new = hull.n_faces
    subtract(hull.w[j], hull.w[i], e)
    subtract(hull.w[k], hull.w[i], f)
    hull.face[new][0] = i
    hull.face[new][1] = j
    hull.face[new][2] = k
    cross(e, f, n)
    length = math.sqrt(dot(n, n))
    beyond = dot(n, hull.w[i]) + dot(n, placement.p)
    for c in range(3):
        if length * length > _FLAT:
            n[c] = math.copysign(1.0, beyond) * n[c] / length
        else:
            n[c] = 0.0
    if length * length > _FLAT:
        hull.offset[new] = dot(n, hull.w[i])
    else:
        hull.offset[new] = math.inf
    hull.n_faces += 1


def remove_visible_faces(hull: Hull) -> None:
    """Take away the faces that the new point sees. A kernel."""
    hull.n_edges = 0
    k = 0
    while k < hull.n_faces:
        if dot(hull.normal[k], hull.w[hull.n]) > hull.offset[k] + _SEEN:
            for c in range(3):
                toggle_edge(hull, hull.face[k][c], hull.face[k][(c + 1) % 3])
            drop_face(hull, k)
        else:
            k += 1


def toggle_edge(hull: Hull, i: int, j: int) -> None:
    """Note an edge of a face that goes as one of the hole, or forget it where the other face goes
    too. A kernel.
    """
    for k in range(hull.n_edges):
        if (hull.edge[k][0] == i and hull.edge[k][1] == j) or (
            hull.edge[k][0] == j and hull.edge[k][1] == i
        ):
            hull.n_edges -= 1
            hull.edge[k][:2] = hull.edge[hull.n_edges][:2]
            return
    if hull.n_edges < FACES:
        hull.edge[hull.n_edges][0] = i
        hull.edge[hull.n_edges][1] = j
        hull.n_edges += 1


def drop_face(hull: Hull, k: int) -> None:
    """Drop a face, whose place the last one takes. A kernel."""
    hull.n_faces -= 1
    last = hull.n_faces
    hull.face[k][:] = hull.face[last]
    hull.normal[k][:] = hull.normal[last]
    hull.offset[k] = hull.offset[last]


def fill_hole(hull: Hull, placement: RelativePlacement) -> bool:
    """Add faces from the edges of the hole to the new point; return false where there is no room
    for them. A kernel.
    """
    if hull.n_faces + hull.n_edges > FACES or hull.n_edges < 3 or hull.n + 1 >= POINTS:
        return False
    for k in range(hull.n_edges):
        add_face(hull, placement, hull.edge[k][0], hull.edge[k][1], hull.n)
    hull.n += 1
    return True
