"""Penetration depth of two overlapping solids, as kernels: separating axes, and an expanding
polytope (EPA) where their difference is curved.

The depth is the least distance by which B has to move until A and B only touch. Directions are those
of the frame of A, from A to B; distances along them are negative as long as the solids overlap.
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
    rotate_back,
    subtract,
    support_function,
)

_PARALLEL = (
    1e-20  # squared length of a direction, such as the product of parallel axes, that is none
)

GROWTH = 96
"""Largest number of points that are added to the first six of a polytope."""
POINTS = GROWTH + 6
FACES = 2 * POINTS
_CONVERGED = 1e-7  # [m] by which the depth may be less than the one that was found
_NO_AREA = 1e-30  # [m4] squared area of a face whose normal would be rounding
_IN_PLANE = 1e-13  # [m] beyond a face at which a point still counts as in its plane


def try_axes(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Find the direction along which A and B overlap least, among those that boxes can have
    ([Ericson2005] 4.4.1), and write the distance along it. A kernel.

    They suffice without disks and, with the radial directions, for a disk and a ball. For other pairs
    `expand_polytope` goes on from the direction that is found here.
    """
    placement.distance = -math.inf
    for i in range(3):
        try_face_and_edges(placement, a, b, i)
    try_radial(placement, a, b)


def try_face_and_edges(placement: RelativePlacement, a: Solid, b: Solid, i: int) -> None:
    """Try the i-th axes of A and B, and the products of that of A and all of B. A kernel."""
    axis_A = zeros(3)
    axis_B = zeros(3)
    product = zeros(3)
    axis_A[i] = 1.0
    try_axis(placement, a, b, axis_A)
    for j in range(3):
        for k in range(3):
            axis_B[k] = placement.R[3 * k + j]
        if j == i:
            try_axis(placement, a, b, axis_B)
        cross(axis_A, axis_B, product)
        try_axis(placement, a, b, product)


def try_radial(placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Try the directions from the z axis of each solid, perpendicular to it, to the centre of the
    other. A kernel.
    """
    radial = zeros(3)
    z_B = zeros(3)
    radial[:2] = placement.p[:2]
    try_axis(placement, a, b, radial)
    for k in range(3):
        z_B[k] = placement.R[3 * k + 2]
    along = dot(z_B, placement.p)
    for k in range(3):
        radial[k] = placement.p[k] - along * z_B[k]
    try_axis(placement, a, b, radial)


def try_axis(placement: RelativePlacement, a: Solid, b: Solid, d: Vector) -> None:
    """Take d or -d (3,), of any length, for the normal if A and B overlap less along it than along
    the one before. A kernel.
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
    """Return the distance [m] from the last point of A along n (3,), of length 1, to the first of B.
    A kernel.
    """
    n_B = zeros(3)
    rotate_back(placement.R, n, n_B)
    return dot(n, placement.p) - support_function(a, n) - support_function(b, n_B)


class Polytope(Layout):
    """A convex polytope of triangles inside the Minkowski difference A - B, in the frame of A."""

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
    """(n_edges, 2) points of the edges of the hole that removed faces leave."""


def expand_polytope(polytope: Polytope, placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Search for a direction in which A and B overlap less than along the normal in `placement`, and
    write it with its distance. A kernel.

    The nearest face of the polytope is no farther from the origin than the boundary of A - B, whose
    distance is the depth: a smaller depth by more than `_CONVERGED` is missed only where memory ends.
    """
    begin_polytope(polytope, placement, a, b)
    for _ in range(GROWTH):
        k = nearest_face(polytope)
        depth = -placement.distance
        if depth - polytope.offset[k] <= _CONVERGED:
            break
        try_axis(placement, a, b, polytope.normal[k])
        write_polytope_support(polytope, placement, a, b, polytope.normal[k])
        support = dot(polytope.normal[k], polytope.w[polytope.n])
        if support - polytope.offset[k] <= _CONVERGED:
            break
        remove_visible_faces(polytope)
        if not fill_hole(polytope, placement):
            break


def begin_polytope(polytope: Polytope, placement: RelativePlacement, a: Solid, b: Solid) -> None:
    """Write an octahedron: three support points in different directions from the centre of A - B, and
    the three opposite ones. A kernel.
    """
    d = zeros(3)
    first = zeros(3)
    second = zeros(3)
    third = zeros(3)
    axis = zeros(3)
    polytope.n = 0
    polytope.n_faces = 0
    d[0] = 1.0
    add_opposite_points(polytope, placement, a, b, d, first)
    smallest = 0
    for i in range(1, 3):
        if abs(first[i]) < abs(first[smallest]):
            smallest = i
    axis[smallest] = 1.0
    cross(first, axis, d)
    add_opposite_points(polytope, placement, a, b, d, second)
    cross(first, second, d)
    add_opposite_points(polytope, placement, a, b, d, third)
    for k in range(8):
        add_face(polytope, placement, k % 2, 2 + k // 2 % 2, 4 + k // 4)


def add_opposite_points(
    polytope: Polytope,
    placement: RelativePlacement,
    a: Solid,
    b: Solid,
    d: Vector,
    from_centre: Vector,
) -> None:
    """Add the point of A - B that is farthest along d (3,), and the one that is farthest against it;
    write `from_centre` (3,) [m], from the centre of A - B, which is at -p, to the first. A kernel.
    """
    write_polytope_support(polytope, placement, a, b, d)
    for i in range(3):
        from_centre[i] = polytope.w[polytope.n][i] + placement.p[i]
        polytope.w[polytope.n + 1][i] = -from_centre[i] - placement.p[i]
    polytope.n += 2


def write_polytope_support(
    polytope: Polytope, placement: RelativePlacement, a: Solid, b: Solid, d: Vector
) -> None:
    """Write the point of A - B that is farthest along d (3,) behind those of the polytope, without
    counting it. A kernel.
    """
    placement.simplex.n = 0
    add_support(placement, a, b, d)
    placement.simplex.n = 0
    polytope.w[polytope.n][:3] = placement.simplex.w[0][:3]


def nearest_face(polytope: Polytope) -> int:
    """Return the face with the smallest offset. A kernel."""
    nearest = 0
    for k in range(1, polytope.n_faces):
        if polytope.offset[k] < polytope.offset[nearest]:
            nearest = k
    return nearest


def add_face(polytope: Polytope, placement: RelativePlacement, i: int, j: int, k: int) -> None:
    """Add the face of three points. A kernel.

    Its normal points away from the centre of A - B, which is at -p and always inside, as A and B are
    symmetric. A face without area has normal 0 and an infinite offset, so that it is never nearest.
    """
    e = zeros(3)
    f = zeros(3)
    n = polytope.normal[polytope.n_faces]
    new = polytope.n_faces
    subtract(polytope.w[j], polytope.w[i], e)
    subtract(polytope.w[k], polytope.w[i], f)
    polytope.face[new][0] = i
    polytope.face[new][1] = j
    polytope.face[new][2] = k
    cross(e, f, n)
    length = math.sqrt(dot(n, n))
    has_area = length * length > _NO_AREA
    outward = dot(n, polytope.w[i]) + dot(n, placement.p)
    for c in range(3):
        if has_area:
            n[c] = math.copysign(1.0, outward) * n[c] / length
        else:
            n[c] = 0.0
    if has_area:
        polytope.offset[new] = dot(n, polytope.w[i])
    else:
        polytope.offset[new] = math.inf
    polytope.n_faces += 1


def remove_visible_faces(polytope: Polytope) -> None:
    """Remove the faces that the new point, which is not counted yet, lies beyond, and write the edges
    of the hole. A kernel.
    """
    polytope.n_edges = 0
    k = 0
    while k < polytope.n_faces:
        height = dot(polytope.normal[k], polytope.w[polytope.n])
        if height > polytope.offset[k] + _IN_PLANE:
            for c in range(3):
                toggle_edge(polytope, polytope.face[k][c], polytope.face[k][(c + 1) % 3])
            remove_face(polytope, k)
        else:
            k += 1


def toggle_edge(polytope: Polytope, i: int, j: int) -> None:
    """Add an edge of a removed face to those of the hole, or drop it from them where both its faces
    are removed. A kernel.
    """
    for k in range(polytope.n_edges):
        is_same = polytope.edge[k][0] == i and polytope.edge[k][1] == j
        is_reversed = polytope.edge[k][0] == j and polytope.edge[k][1] == i
        if is_same or is_reversed:
            polytope.n_edges -= 1
            polytope.edge[k][:2] = polytope.edge[polytope.n_edges][:2]
            return
    if polytope.n_edges < FACES:
        polytope.edge[polytope.n_edges][0] = i
        polytope.edge[polytope.n_edges][1] = j
        polytope.n_edges += 1


def remove_face(polytope: Polytope, k: int) -> None:
    """Remove face k; the last face takes its number. A kernel."""
    polytope.n_faces -= 1
    last = polytope.n_faces
    polytope.face[k][:] = polytope.face[last]
    polytope.normal[k][:] = polytope.normal[last]
    polytope.offset[k] = polytope.offset[last]


def fill_hole(polytope: Polytope, placement: RelativePlacement) -> bool:
    """Add the faces from the edges of the hole to the new point, and count it; return False where
    there is no hole or no memory for them. A kernel.
    """
    has_hole = polytope.n_edges >= 3
    has_room = polytope.n_faces + polytope.n_edges <= FACES and polytope.n + 1 < POINTS
    if not (has_hole and has_room):
        return False
    for k in range(polytope.n_edges):
        add_face(polytope, placement, polytope.edge[k][0], polytope.edge[k][1], polytope.n)
    polytope.n += 1
    return True
