"""Two solids that meet: where one is as the other sees it, and the nearest points of both while they are apart.

The search is that of [Gilbert1988] (GJK), on boxes and disks; balls are added to what it finds. It remembers nothing, so that
the same configuration always gives the same distances.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, zeros
from uvms_ocp.model.shapes.distance_kernels.simplex import FAR, Simplex, find_nearest, keep_last, keep_nearest
from uvms_ocp.model.shapes.distance_kernels.solids import (
    Solid,
    between,
    dot,
    farthest,
    nearest_to,
    rotated,
    subtract,
    turned_back,
)

ROUNDS = 128
"""[-] bound of a search; what it found is then what is told."""
_TURNS = 3  # [-] of nearest points, after which most pairs are almost done
_EXACT = 1e-12  # [-] of the distance, by which none can be smaller: its square root is what the normal is wrong by
_STALLS = 4  # [-] rounds without a gain, after which rounding is all that is left
TOUCHING = 1e-9
"""[m] nearer solids count as overlapping, as rounding is all that is left of a direction."""


class Meeting(Layout):
    """Of solids A and B, in the frame of A; balls left out."""

    R: Annotated[Vector, Sized(9)]
    """(9,) [-] R_AB, row after row."""
    p: Annotated[Vector, Sized(3)]
    """(3,) [m] p_AB."""
    simplex: Simplex
    """Of the search, between whose points the nearest ones lie."""
    normal: Annotated[Vector, Sized(3)]
    """(3,) [-] from A to B."""
    distance: float
    """[m] negative where they overlap."""
    at: Annotated[Vector, Sized(3)]
    """(3,) [m] the nearest point of A."""


def bring_together(m: Meeting, a: Solid, b: Solid) -> None:
    """Where B is, as A sees it. A kernel."""
    way = zeros(3)
    subtract(b.p, a.p, way)
    turned_back(a.R, way, m.p)
    between(a.R, b.R, m.R)


def begin_search(m: Meeting, a: Solid, b: Solid) -> None:
    """One point of each, which lie near each other: nearest to the other's, in turn. A kernel."""
    x, y, s = zeros(3), zeros(3), m.simplex
    for i in range(3):
        x[i] = m.p[i]
    for _ in range(_TURNS):
        nearest_to(a, x, s.a[0])
        subtract(s.a[0], m.p, x)
        turned_back(m.R, x, y)
        nearest_to(b, y, s.b[0])
        rotated(m.R, s.b[0], x)
        for i in range(3):
            x[i] += m.p[i]
    place_difference(m, 0)
    s.n = 1


def place_difference(m: Meeting, k: int) -> None:
    """The difference of the k-th points. A kernel."""
    there, s = zeros(3), m.simplex
    rotated(m.R, s.b[k], there)
    for i in range(3):
        s.w[k][i] = s.a[k][i] - m.p[i] - there[i]


def add_corners(m: Meeting, a: Solid, b: Solid, d: Vector) -> None:
    """The points of A and B whose difference is farthest along d (3,). A kernel."""
    s, back = m.simplex, zeros(3)
    farthest(a, d, s.a[s.n])
    turned_back(m.R, d, back)
    for i in range(3):
        back[i] = -back[i]
    farthest(b, back, s.b[s.n])
    place_difference(m, s.n)
    s.n += 1


def search_apart(m: Meeting, a: Solid, b: Solid) -> bool:
    """Whether A and B are apart; if so, their distance, normal and nearest points. A kernel."""
    s, before, stalled = m.simplex, math.inf, 0
    begin_search(m, a, b)
    for k in range(ROUNDS):
        find_nearest(s)
        if s.inside or s.squared <= TOUCHING * TOUCHING:
            return False
        keep_nearest(s)
        look_beyond(m, a, b)
        stalled += 1 if s.squared >= before else 0
        if s.squared - dot(s.v, s.w[s.n]) <= _EXACT * s.squared or stalled > _STALLS:
            break
        before = s.squared if k > 0 else math.inf
        keep_last(s, k > 0)
    tell_apart(m)
    return True


def look_beyond(m: Meeting, a: Solid, b: Solid) -> None:
    """Write the points that are farthest towards the origin behind those of the simplex, without counting them. A kernel."""
    s, away = m.simplex, zeros(3)
    for i in range(3):
        away[i] = -s.v[i]
    add_corners(m, a, b, away)
    s.n -= 1


def tell_apart(m: Meeting) -> None:
    """Distance, normal and nearest point from what the search ended with. A kernel."""
    s = m.simplex
    m.distance = math.sqrt(s.squared)
    if not s.squared < FAR:
        m.distance = math.nan
    for i in range(3):
        m.normal[i] = -s.v[i] / m.distance
        m.at[i] = 0.0
        for k in range(s.n):
            m.at[i] += s.lot[k] * s.a[k][i]
