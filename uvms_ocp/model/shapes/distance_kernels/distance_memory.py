"""Distances of all pairs of a collision model in machine code, for programs that embed them.

A layout that is to measure distances has a field ``DistanceMemory``; what `structure_of` needs for it is
`CollisionModel.memory_sizes`, and `CollisionModel.write` writes into it what never changes. Then, in a kernel of one's own:

    pair_distances(m.distances, m.q)            # m.distances.value[k] [m] of all pairs, at q
    value = distance_of(m.distances, k)         # of one pair, after `place_solids(m.distances, m.q)`
    bound = least_distance(m.distances, k)      # no more than that, by what was found last: ten times as fast
    pair_gradient(m.distances, k, row)          # (n_v,) rate of the distance of the pair measured last, per unit of velocity

Bounded: a pair takes at most `ROUNDS` differences of its solids, and where they overlap `GROWTH` more, and `ROUNDS` for each
look at how they part.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, zeros
from uvms_ocp.functions.kernels.smooth import Smooth
from uvms_ocp.model.shapes.distance_kernels.hull import Hull
from uvms_ocp.model.shapes.distance_kernels.meeting import Meeting
from uvms_ocp.model.shapes.distance_kernels.pair import measure_solids
from uvms_ocp.model.shapes.distance_kernels.solids import Solid, dot, height, rotated, subtract, turned_back

_NOTHING = 1e-5
"""[-, m] rate of an axis that does not change a distance, but for what a search that ends leaves: a hierarchy would heed it."""


class Pair(Layout):
    """Two solids, and what was found of them last."""

    first: int
    """Solid, by its index."""
    second: int
    known: bool
    """It has been measured."""
    normal: Annotated[Vector, Sized(3)]
    """(3,) [-] in W, from the first to the second."""
    at: Annotated[Vector, Sized(3)]
    """(3,) [m] in W, the nearest point of the first."""


class DistanceMemory(Layout):
    """Solids of a robot and its obstacles, and their pairs."""

    places: Smooth
    """q, to the placements of all joints and the twists of all axes."""
    placements: Annotated[Vector, Sized("n_placements")]
    """(12 n_joints,) R_WJ [-], row after row, and p_WJ [m] of each joint."""
    twists: Annotated[Vector, Sized("n_twists")]
    """(6 n_v,) of each axis, at the origin of W: linear [m, or 1], angular [1]."""
    n_solids: int
    solids: Annotated[list[Solid], Sized("n_solids")]
    """(n_solids,)"""
    moves: Annotated[list[list[int]], Sized("n_solids", "n_v")]
    """(n_solids, n_v) whether the axis moves the solid."""
    n_pairs: int
    pairs: Annotated[list[Pair], Sized("n_pairs")]
    """(n_pairs,)"""
    value: Annotated[Vector, Sized("n_pairs")]
    """(n_pairs,) [m] signed distances as measured last."""
    gradient: Annotated[list[Vector], Sized("n_pairs", "n_v")]
    """(n_pairs, n_v) [-, m] of the chosen ones, one after the other."""
    n_chosen: int
    chosen: Annotated[list[int], Sized("n_pairs")]
    """(n_chosen,) pairs that `chosen_distances` measures."""
    meeting: Meeting
    """Of the pair measured last, in the frame of its first solid."""
    hull: Hull
    """Working memory."""


def pair_distances(m: DistanceMemory, q: Vector) -> None:
    """`value` of all pairs at q (n_q,) [m, rad]. A kernel."""
    place_solids(m, q)
    for k in range(m.n_pairs):
        m.value[k] = distance_of(m, k)


def chosen_distances(m: DistanceMemory, q: Vector) -> None:
    """`value` of the chosen pairs, at their places, at q (n_q,) [m, rad]. A kernel."""
    place_solids(m, q)
    for k in range(m.n_chosen):
        m.value[m.chosen[k]] = distance_of(m, m.chosen[k])


def chosen_gradients(m: DistanceMemory) -> None:
    """`gradient` of the chosen pairs, where they were measured last. A kernel."""
    for k in range(m.n_chosen):
        pair_gradient(m, m.chosen[k], m.gradient[k])


def place_solids(m: DistanceMemory, q: Vector) -> None:
    """Everything that is not of a pair, at q (n_q,) [m, rad]. A kernel."""
    m.places(q, m.placements, m.twists)
    for k in range(m.n_solids):
        if m.solids[k].joint >= 0:
            place_solid(m.solids[k], m.placements)


def place_solid(s: Solid, placements: Vector) -> None:
    """One of a joint. A kernel."""
    R, p, first = zeros(9), zeros(3), 12 * s.joint
    for i in range(9):
        R[i] = placements[first + i]
    rotated(R, s.p_JS, p)
    for i in range(3):
        s.p[i] = placements[first + 9 + i] + p[i]
        for j in range(3):
            s.R[3 * i + j] = R[3 * i] * s.R_JS[j] + R[3 * i + 1] * s.R_JS[3 + j] + R[3 * i + 2] * s.R_JS[6 + j]


def distance_of(m: DistanceMemory, k: int) -> float:
    """Signed distance [m] of pair k, as its solids are placed. A kernel."""
    pair, meeting = m.pairs[k], m.meeting
    a, b = m.solids[pair.first], m.solids[pair.second]
    measure_solids(meeting, m.hull, a, b)
    rotated(a.R, meeting.normal, pair.normal)
    rotated(a.R, meeting.at, pair.at)
    for i in range(3):
        pair.at[i] += a.p[i]
    pair.known = True
    return meeting.distance


def least_distance(m: DistanceMemory, k: int) -> float:
    """No more than the distance [m] of pair k: that along the direction found last, or of the balls around. A kernel."""
    pair, way, turned = m.pairs[k], zeros(3), zeros(3)
    a, b = m.solids[pair.first], m.solids[pair.second]
    subtract(b.p, a.p, way)
    found = math.sqrt(dot(way, way)) - a.size - b.size
    if pair.known:
        turned_back(a.R, pair.normal, turned)
        along = dot(pair.normal, way) - height(a, turned) - a.ball
        turned_back(b.R, pair.normal, turned)
        found = max(found, along - height(b, turned) - b.ball)
    return found


def pair_gradient(m: DistanceMemory, k: int, row: Vector) -> None:
    """Rate (n_v,) [-, m] of the distance of pair k per unit of each velocity, where it was measured last. A kernel."""
    pair, moment, n_v = m.pairs[k], zeros(3), len(m.gradient[0])
    n, x = pair.normal, pair.at
    moment[0] = x[1] * n[2] - x[2] * n[1]
    moment[1] = x[2] * n[0] - x[0] * n[2]
    moment[2] = x[0] * n[1] - x[1] * n[0]
    for i in range(n_v):
        row[i] = 0.0
        sign = m.moves[pair.second][i] - m.moves[pair.first][i]
        for c in range(3):
            row[i] += sign * (n[c] * m.twists[6 * i + c] + moment[c] * m.twists[6 * i + 3 + c])
        if abs(row[i]) < _NOTHING:
            row[i] = 0.0
