"""The pairs of shapes that come nearest now or at places that lie ahead, with gradients, as kernels.

`measure_nearest` does all of it in machine code. Where coal measures, who calls it does the steps one by one: `choose_near` and
`choose_nearest` after `table` is filled for now and for the places ahead, `tell_closing` after `gradient` is.
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector
from uvms_ocp.model.shapes.distance_kernels.distance_memory import (
    DistanceMemory,
    distance_of,
    least_distance,
    pair_distances,
    pair_gradient,
    place_solids,
)


class NearestMemory(Layout):
    """What is asked, and what is found."""

    distances: DistanceMemory
    """Of the pairs, for `measure_nearest`."""
    n_pairs: int
    n_rows: int
    """[-] pairs that are to be found, n_pairs at most."""
    threshold: float
    """[m] by which they stay apart."""
    reach: Annotated[Vector, Sized("n_v")]
    """(n_v,) [-, m] as that of the collision model, finite."""
    far: float
    """[m/s] speed of approach that limits nothing."""
    n_places: int
    """[-] now and ahead."""
    q: Annotated[list[Vector], Sized("n_places", "n_q")]
    """(n_places, n_q) [m, rad] now, and ahead."""
    duration: Annotated[Vector, Sized("n_places")]
    """(n_places,) [s] at the present velocity to each of them, growing from 0."""
    velocity: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] now."""
    table: Annotated[list[Vector], Sized("n_places", "n_pairs")]
    """(n_places, n_pairs) [m] distances; ahead, of those in `near`."""
    n_near: int
    near: Annotated[list[int], Sized("n_pairs")]
    """(n_near,) pairs that may be among the nearest."""
    lowest: Annotated[Vector, Sized("n_pairs")]
    """(n_pairs,) [m] of each over the places that were looked at."""
    taken: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) whether it is among those found."""
    limit: float
    """[m] that the nearest ones are not beyond."""
    smallest: float
    """[m] distance of all pairs now."""
    pair: Annotated[list[int], Sized("n_rows")]
    """(n_rows,) the nearest, nearest first."""
    place: Annotated[list[int], Sized("n_rows")]
    """(n_rows,) where each of them is nearest; 0 is now."""
    distance: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m] of each at that place."""
    closing: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m/s] speed of approach whose stop just leaves the threshold."""
    gradient: Annotated[list[Vector], Sized("n_rows", "n_v")]
    """(n_rows, n_v) [-, m] of each distance at that place."""


def measure_nearest(m: NearestMemory) -> None:
    """Everything that is found. A kernel."""
    pair_distances(m.distances, m.q[0])
    for k in range(m.n_pairs):
        m.table[0][k] = m.distances.value[k]
    choose_near(m)
    for place in range(1, m.n_places):
        look_at(m, place)
    choose_nearest(m)
    for place in range(m.n_places):
        take_gradients(m, place)
    tell_closing(m)


def look_at(m: NearestMemory, place: int) -> None:
    """Distances at a place ahead; beyond the limit a lower bound says as much. A kernel."""
    place_solids(m.distances, m.q[place])
    for i in range(m.n_near):
        k = m.near[i]
        bound = least_distance(m.distances, k)
        m.table[place][k] = bound if bound > m.limit else distance_of(m.distances, k)


def take_gradients(m: NearestMemory, place: int) -> None:
    """Of those that are nearest there. A kernel."""
    placed = False
    for row in range(m.n_rows):
        if m.place[row] == place:
            if not placed:
                place_solids(m.distances, m.q[place])
                placed = True
            distance_of(m.distances, m.pair[row])
            pair_gradient(m.distances, m.pair[row], m.gradient[row])


def choose_near(m: NearestMemory) -> None:
    """From distances now: the smallest, and the pairs that the way may bring among the nearest. A kernel."""
    m.n_near = m.n_pairs
    for k in range(m.n_pairs):
        m.near[k] = k
        m.lowest[k] = m.table[0][k]
    select_pairs(m)
    m.smallest = m.lowest[m.pair[0]]
    m.limit = m.lowest[m.pair[m.n_rows - 1]]
    bound = m.limit + approach_on_way(m)
    m.n_near = 0
    for k in range(m.n_pairs):
        if not m.lowest[k] > bound:  # also what is not a number
            m.near[m.n_near] = k
            m.n_near += 1


def approach_on_way(m: NearestMemory) -> float:
    """[m] that any pair comes nearer by on the way, at most. A kernel."""
    speed = 0.0
    for i in range(len(m.velocity)):
        speed += m.reach[i] * abs(m.velocity[i])
    return speed * m.duration[m.n_places - 1]


def choose_nearest(m: NearestMemory) -> None:
    """From all distances: the pairs that come nearest, and where. A kernel."""
    for i in range(m.n_near):
        k = m.near[i]
        for place in range(1, m.n_places):
            m.lowest[k] = min(m.lowest[k], m.table[place][k])
    select_pairs(m)
    for row in range(m.n_rows):
        k = m.pair[row]
        m.distance[row] = m.lowest[k]
        m.place[row] = first_place(m, k)


def first_place(m: NearestMemory, k: int) -> int:
    """Where a pair is nearest. A kernel."""
    for place in range(m.n_places):
        if m.table[place][k] <= m.lowest[k]:
            return place
    return 0


def select_pairs(m: NearestMemory) -> None:
    """The n_rows pairs of `near` that are lowest, the first ones of equals. A kernel."""
    for k in range(m.n_pairs):
        m.taken[k] = 0
    for row in range(m.n_rows):
        m.pair[row] = lowest_left(m)
        m.taken[m.pair[row]] = 1


def lowest_left(m: NearestMemory) -> int:
    """The lowest of `near` that is not taken. A kernel."""
    found = m.near[0]
    for i in range(m.n_near):
        k = m.near[i]
        if m.taken[k] == 0 and (m.taken[found] != 0 or m.lowest[k] < m.lowest[found]):
            found = k
    return found


def tell_closing(m: NearestMemory) -> None:
    """Speeds of approach, as the way to rest grows with the square of the speed. A kernel."""
    for row in range(m.n_rows):
        place, rate = m.place[row], 0.0
        for i in range(len(m.velocity)):
            rate += m.gradient[row][i] * m.velocity[i]
        m.closing[row] = m.far
        if place > 0:
            m.closing[row] = (m.distance[row] - m.threshold) / (2.0 * m.duration[place]) - rate
