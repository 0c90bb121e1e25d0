"""Distances of the pairs of shapes that come nearest on the way to rest, for tasks, as kernels.

Distance and gradient are those of the place on the way where the pair is nearest: on a curved path,
or with a face that turns, that is nearer than the gradient of here and now tells. The speed is the
one whose stop just leaves the threshold.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import CallbackField, FunctionField, Layout, Sized, Vector
from uvms_ocp.control.velocity.braking import time_to_rest
from uvms_ocp.robot.shapes.distance_kernels import (
    DistanceMemory,
    distance_lower_bound,
    distance_of,
    pair_gradient,
    place_solids,
)
from uvms_ocp.tasks.nearest_pairs import FAR

N_PLACES = 4
"""Places along the stop at which distances are measured, besides the present one."""


class PairsMemory(Layout):
    """Nearest pairs of one task, as `NearestPairs`, and their measured distances."""

    task: int
    """Index in the hierarchy."""
    first: int
    """Index at which what is measured begins among the parameters of all tasks."""
    n: int
    """Rows."""
    n_pairs: int
    """All of them."""
    threshold: float
    """[m]"""
    in_c: bool
    """Kernels measure them in `distances`; Python is asked otherwise."""
    distances: DistanceMemory
    reach: Annotated[Vector, Sized("n_v")]
    """(n_v,) [-, m] of any pair's distance, infinite where nobody knows."""
    counts: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) which are asked for."""
    value: Annotated[Vector, Sized("n_pairs")]
    """(n_pairs,) [m] distances of those where they were asked for last, or what they are not
    below.
    """
    lowest: Annotated[Vector, Sized("n_pairs")]
    """(n_pairs,) [m] smallest on the way; infinite of those that cannot come near."""
    bounded: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) of which `lowest` is no more than a bound from below."""
    seen: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) place where it was measured last, if it was."""
    worst: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) where that is: 0 now, k at the k-th place."""
    chosen: Annotated[list[int], Sized("n_rows")]
    """(n,) pairs that come nearest."""
    taken: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) which they are."""
    gradient: Annotated[list[Vector], Sized("n_rows", "n_v")]
    """(n, n_v) [-, m] of each at its place."""


class NearestMemory(Layout):
    """Nearest pairs of all tasks, and the stop along which they are measured: all axes slow down in
    proportion.
    """

    n_asking: int
    """Tasks that ask."""
    pairs: Annotated[list[PairsMemory], Sized("n_asking")]
    """(n_asking,)"""
    integrate: FunctionField
    """Q and a displacement (n_v,) [m, rad] to q."""
    moves: bool
    """Coming to rest takes longer than a tick; the other fields have a meaning only then."""
    velocity: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] now."""
    duration: Annotated[Vector, Sized(1 + N_PLACES)]
    """(1 + N_PLACES,) [s] at the present velocity, as each place is away."""
    place: Annotated[list[Vector], Sized(1 + N_PLACES, "n_q")]
    """(1 + N_PLACES, n_q) [m, rad] configuration now, and at each place."""
    way: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m, rad] to a place."""
    ask: CallbackField
    """The distances of `asked` at the place `at` of pairs that count; of those chosen whose worst
    it is the gradients.
    """
    asked: int
    """Index in `pairs`."""
    at: int
    """Index of a place."""
    of_gradients: bool
    """Gradients are asked for, not distances."""


def place_along_stop(
    m: NearestMemory, q: Vector, v: Vector, acceleration: Vector, dt: float
) -> None:
    """Places on the way to rest from q [m, rad] with v [m/s, rad/s], by `acceleration` [m/s2,
    rad/s2]. A kernel.

    dt [s]: of a tick, within which a robot rests; infinite: nothing but q is looked at.
    """
    length = 0.5 * time_to_rest(acceleration, v, len(m.velocity))
    place = m.place[0]
    m.moves = length >= dt
    place[:] = q
    m.velocity[:] = v
    for k in range(len(m.duration)):
        m.duration[k] = length * k / N_PLACES
        if m.moves and k > 0:
            for i in range(len(m.way)):
                m.way[i] = v[i] * m.duration[k]
            m.integrate(q, m.way, m.place[k])


def measure_pairs(m: NearestMemory, k: int, values: Vector) -> None:
    """Write the distances of a task into the parameters [their units] of all, as
    `NearestPairs.parameters`. A kernel.
    """
    p = m.pairs[k]
    m.asked = k
    _look_around(m, p)
    _choose_nearest(p)
    values[p.first] = p.lowest[p.chosen[0]]
    if m.moves:
        _follow_the_way(m, p)
    _take_gradients(m, p)
    for row in range(p.n):
        _write_row(m, p, row, values)


def _look_around(m: NearestMemory, p: PairsMemory) -> None:
    """All pairs now: their distances, or bounds of them."""
    for i in range(p.n_pairs):
        p.counts[i] = 1
        p.worst[i] = 0
        p.bounded[i] = p.in_c
    _look_at(m, p, 0, -math.inf)
    p.lowest[: p.n_pairs] = p.value[: p.n_pairs]


def _look_at(m: NearestMemory, p: PairsMemory, place: int, limit: float) -> None:
    """Distances at a place; of a pair that is beyond the limit [m] there, or was nearer before, a
    bound says as much.
    """
    if not p.in_c:
        _ask_at(m, place, False)
        return
    place_solids(p.distances, m.place[place])
    for i in range(p.n_pairs):
        if p.counts[i] != 0:
            p.value[i] = distance_lower_bound(p.distances, i)
            if p.value[i] <= min(limit, p.lowest[i]):
                p.value[i] = _measured(p, i, place)


def _measured(p: PairsMemory, pair: int, place: int) -> float:
    p.seen[pair] = place
    return distance_of(p.distances, pair)


def _ask_at(m: NearestMemory, place: int, of_gradients: bool) -> None:
    m.at = place
    m.of_gradients = of_gradients
    m.ask()


def _choose_nearest(p: PairsMemory) -> None:
    """The pairs of the smallest distances, in their order; where they stand, those are measured
    that only a bound is known of.
    """
    for i in range(p.n_pairs):
        p.taken[i] = 0
    for row in range(p.n):
        best = _lowest_left(p)
        while p.bounded[best] != 0:
            p.lowest[best] = _measured(p, best, 0)
            p.bounded[best] = 0
            best = _lowest_left(p)
        p.chosen[row] = best
        p.taken[best] = 1


def _lowest_left(p: PairsMemory) -> int:
    best = -1
    for i in range(p.n_pairs):
        if p.taken[i] == 0 and (best < 0 or p.lowest[i] < p.lowest[best]):
            best = i
    return best


def _follow_the_way(m: NearestMemory, p: PairsMemory) -> None:
    """The smallest distance of each pair that may become one of the nearest."""
    limit = p.lowest[p.chosen[p.n - 1]]
    way = _approach(m, p)
    for i in range(p.n_pairs):
        p.counts[i] = p.lowest[i] <= limit + way
        if p.counts[i] == 0 or p.bounded[i] != 0:
            p.lowest[i] = math.inf
            p.bounded[i] = 0
    for place in range(1, len(m.duration)):
        _look_at(m, p, place, limit)
        for i in range(p.n_pairs):
            if p.counts[i] != 0 and p.value[i] < p.lowest[i]:
                p.lowest[i] = p.value[i]
                p.worst[i] = place
    _choose_nearest(p)


def _approach(m: NearestMemory, p: PairsMemory) -> float:
    """[m] that any distance changes on the whole way at most."""
    change = 0.0
    for i in range(len(m.velocity)):
        if m.velocity[i] != 0.0:
            change += p.reach[i] * abs(m.velocity[i])
    return change * m.duration[len(m.duration) - 1]


def _take_gradients(m: NearestMemory, p: PairsMemory) -> None:
    """Distances of the nearest pairs, each where it is nearest."""
    for place in range(len(m.duration)):
        asks = False
        for row in range(p.n):
            asks = asks or p.worst[p.chosen[row]] == place
        if asks and p.in_c:
            _measure_gradients(m, p, place)
        elif asks:
            _ask_at(m, place, True)


def _measure_gradients(m: NearestMemory, p: PairsMemory, place: int) -> None:
    place_solids(p.distances, m.place[place])
    for row in range(p.n):
        k = p.chosen[row]
        if p.worst[k] == place:
            if p.seen[k] != place:
                _measured(p, k, place)
            pair_gradient(p.distances, k, p.gradient[row])


def _write_row(m: NearestMemory, p: PairsMemory, row: int, values: Vector) -> None:
    pair = p.chosen[row]
    gradient = p.gradient[row]
    speed = 0.0
    closing = FAR
    place = p.worst[p.chosen[row]]
    for i in range(len(m.velocity)):
        speed += gradient[i] * m.velocity[i]
        values[p.first + 1 + 2 * p.n + i * p.n + row] = gradient[i]
    if place > 0:
        # The way to rest grows with the square of the speed.
        closing = (p.lowest[pair] - p.threshold) / (2.0 * m.duration[place]) - speed
    values[p.first + 1 + row] = p.lowest[pair]
    values[p.first + 1 + p.n + row] = closing
