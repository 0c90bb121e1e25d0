"""Up to four points of the difference of two solids, and the point of their hull nearest to the origin."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, zeros
from uvms_ocp.model.shapes.distance_kernels.solids import cross, dot, subtract

FAR = 1e300
"""[m2] what `squared` is of points that are no numbers."""


class Simplex(Layout):
    """In the frame of the first solid, A; the second is B."""

    n: int
    """[-] points."""
    a: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] of A."""
    b: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] of B, in the frame of B."""
    w: Annotated[list[Vector], Sized(4, 3)]
    """(4, 3) [m] a - b."""
    v: Annotated[Vector, Sized(3)]
    """(3,) [m] the nearest point."""
    squared: float
    """[m2] from the origin to it."""
    inside: bool
    """The origin is inside of four points."""
    pick: Annotated[list[int], Sized(3)]
    """Which points it lies between."""
    lot: Annotated[Vector, Sized(3)]
    """(3,) [-] their shares."""


def find_nearest(s: Simplex) -> None:
    """The nearest point of the hull of all points, or that the origin is inside. A kernel."""
    s.squared = FAR
    s.inside = s.n == 4 and holds_origin(s)
    if s.n == 1:
        offer_point(s, 0, 0, 0, 0.0, 0.0)
    elif s.n == 2:
        try_edge(s, 0, 1)
    elif s.n == 3:
        try_face(s, 0, 1, 2)
    elif not s.inside:
        try_faces(s)


def try_faces(s: Simplex) -> None:
    """On the four faces. A kernel."""
    try_face(s, 0, 1, 2)
    try_face(s, 0, 1, 3)
    try_face(s, 0, 2, 3)
    try_face(s, 1, 2, 3)


def try_edge(s: Simplex, i: int, j: int) -> None:
    """Between two points. A kernel."""
    e, wi, wj = zeros(3), s.w[i], s.w[j]
    subtract(wj, wi, e)
    length = dot(e, e)
    if length > 0.0:
        offer_point(s, i, j, j, min(1.0, max(0.0, -dot(wi, e) / length)), 0.0)
    else:
        offer_point(s, i, i, i, 0.0, 0.0)


def try_face(s: Simplex, i: int, j: int, k: int) -> None:
    """Between three points. A kernel."""
    e, f, normal, turned = zeros(3), zeros(3), zeros(3), zeros(3)
    wi, wj, wk = s.w[i], s.w[j], s.w[k]
    subtract(wj, wi, e)
    subtract(wk, wi, f)
    cross(e, f, normal)
    area, x, y = dot(normal, normal), -1.0, -1.0
    if area > 0.0:
        cross(f, wi, turned)
        x = dot(normal, turned) / area
        cross(wi, e, turned)
        y = dot(normal, turned) / area
    if x >= 0.0 and y >= 0.0 and x + y <= 1.0:
        offer_point(s, i, j, k, x, y)
    else:
        try_edge(s, i, j)
        try_edge(s, i, k)
        try_edge(s, j, k)


def offer_point(s: Simplex, i: int, j: int, k: int, x: float, y: float) -> None:
    """Take the point w_i + x (w_j - w_i) + y (w_k - w_i), x and y [-], if it is the nearest so far. A kernel."""
    v, wi, wj, wk = zeros(3), s.w[i], s.w[j], s.w[k]
    for c in range(3):
        v[c] = wi[c] + x * (wj[c] - wi[c]) + y * (wk[c] - wi[c])
    squared = dot(v, v)
    if squared < s.squared:
        s.squared = squared
        s.pick[0] = i
        s.pick[1] = j
        s.pick[2] = k
        s.lot[0] = 1.0 - x - y
        s.lot[1] = x
        s.lot[2] = y
        for c in range(3):
            s.v[c] = v[c]


def holds_origin(s: Simplex) -> bool:
    """Whether the origin is inside of the four points, which is not so where they lie in a plane. A kernel."""
    e, f, g, turned = zeros(3), zeros(3), zeros(3), zeros(3)
    subtract(s.w[1], s.w[0], e)
    subtract(s.w[2], s.w[0], f)
    subtract(s.w[3], s.w[0], g)
    cross(f, g, turned)
    volume = dot(e, turned)
    side = 1.0 if volume > 0.0 else -1.0
    x = -side * dot(s.w[0], turned)
    cross(g, e, turned)
    y = -side * dot(s.w[0], turned)
    cross(e, f, turned)
    z = -side * dot(s.w[0], turned)
    return volume != 0.0 and x >= 0.0 and y >= 0.0 and z >= 0.0 and x + y + z <= abs(volume)


def keep_nearest(s: Simplex) -> None:
    """Drop the points that the nearest one does not lie between; `lot` are the shares of those that stay. A kernel."""
    n = 0
    for m in range(3):
        if s.lot[m] > 0.0:
            i = s.pick[m]  # never before n, as the picks are in their order
            for c in range(3):
                s.a[n][c] = s.a[i][c]
                s.b[n][c] = s.b[i][c]
                s.w[n][c] = s.w[i][c]
            s.lot[n] = s.lot[m]
            n += 1
    s.n = n


def keep_last(s: Simplex, others: bool) -> None:
    """Count the point behind the last one; without the others, which first ones that are no corners give way to. A kernel."""
    if not others:
        for c in range(3):
            s.a[0][c] = s.a[s.n][c]
            s.b[0][c] = s.b[s.n][c]
            s.w[0][c] = s.w[s.n][c]
        s.n = 0
    s.n += 1
