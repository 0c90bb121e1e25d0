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
    nearest: NearestMemory, q: Vector, v: Vector, acceleration: Vector, dt: float
) -> None:
    """Places on the way to rest from q [m, rad] with v [m/s, rad/s], by `acceleration` [m/s2,
    rad/s2]. A kernel.

    dt [s]: of a tick, within which a robot rests; infinite: nothing but q is looked at.
    """
    length = 0.5 * time_to_rest(acceleration, v, len(nearest.velocity))
    place = nearest.place[0]
    nearest.moves = length >= dt
    place[:] = q
    nearest.velocity[:] = v
    for k in range(len(nearest.duration)):
        nearest.duration[k] = length * k / N_PLACES
        if nearest.moves and k > 0:
            for i in range(len(nearest.way)):
                nearest.way[i] = v[i] * nearest.duration[k]
            nearest.integrate(q, nearest.way, nearest.place[k])


def measure_pairs(nearest: NearestMemory, k: int, values: Vector) -> None:
    """Write the distances of a task into the parameters [their units] of all, as
    `NearestPairs.parameters`. A kernel.
    """
    pair = nearest.pairs[k]
    nearest.asked = k
    _look_around(nearest, pair)
    _choose_nearest(pair)
    values[pair.first] = pair.lowest[pair.chosen[0]]
    if nearest.moves:
        _follow_the_way(nearest, pair)
    _take_gradients(nearest, pair)
    for row in range(pair.n):
        _write_row(nearest, pair, row, values)


def _look_around(nearest: NearestMemory, pairs: PairsMemory) -> None:
    """All pairs now: their distances, or bounds of them."""
    for i in range(pairs.n_pairs):
        pairs.counts[i] = 1
        pairs.worst[i] = 0
        pairs.bounded[i] = pairs.in_c
    _look_at(nearest, pairs, 0, -math.inf)
    pairs.lowest[: pairs.n_pairs] = pairs.value[: pairs.n_pairs]


def _look_at(nearest: NearestMemory, pairs: PairsMemory, place: int, limit: float) -> None:
    """Distances at a place; of a pair that is beyond the limit [m] there, or was nearer before, a
    bound says as much.
    """
    if not pairs.in_c:
        _ask_at(nearest, place, False)
        return
    place_solids(pairs.distances, nearest.place[place])
    for i in range(pairs.n_pairs):
        if pairs.counts[i] != 0:
            pairs.value[i] = distance_lower_bound(pairs.distances, i)
            if pairs.value[i] <= min(limit, pairs.lowest[i]):
                pairs.value[i] = _measured(pairs, i, place)


def _measured(pairs: PairsMemory, pair: int, place: int) -> float:
    pairs.seen[pair] = place
    return distance_of(pairs.distances, pair)


def _ask_at(nearest: NearestMemory, place: int, of_gradients: bool) -> None:
    nearest.at = place
    nearest.of_gradients = of_gradients
    nearest.ask()


def _choose_nearest(pairs: PairsMemory) -> None:
    """The pairs of the smallest distances, in their order; where they stand, those are measured
    that only a bound is known of.
    """
    for i in range(pairs.n_pairs):
        pairs.taken[i] = 0
    for row in range(pairs.n):
        best = _lowest_left(pairs)
        while pairs.bounded[best] != 0:
            pairs.lowest[best] = _measured(pairs, best, 0)
            pairs.bounded[best] = 0
            best = _lowest_left(pairs)
        pairs.chosen[row] = best
        pairs.taken[best] = 1


def _lowest_left(pairs: PairsMemory) -> int:
    best = -1
    for i in range(pairs.n_pairs):
        if pairs.taken[i] == 0 and (best < 0 or pairs.lowest[i] < pairs.lowest[best]):
            best = i
    return best


def _follow_the_way(nearest: NearestMemory, pairs: PairsMemory) -> None:
    """The smallest distance of each pair that may become one of the nearest."""
    limit = pairs.lowest[pairs.chosen[pairs.n - 1]]
    way = _approach(nearest, pairs)
    for i in range(pairs.n_pairs):
        pairs.counts[i] = pairs.lowest[i] <= limit + way
        if pairs.counts[i] == 0 or pairs.bounded[i] != 0:
            pairs.lowest[i] = math.inf
            pairs.bounded[i] = 0
    for place in range(1, len(nearest.duration)):
        _look_at(nearest, pairs, place, limit)
        for i in range(pairs.n_pairs):
            if pairs.counts[i] != 0 and pairs.value[i] < pairs.lowest[i]:
                pairs.lowest[i] = pairs.value[i]
                pairs.worst[i] = place
    _choose_nearest(pairs)


def _approach(nearest: NearestMemory, pairs: PairsMemory) -> float:
    """[m] that any distance changes on the whole way at most."""
    change = 0.0
    for i in range(len(nearest.velocity)):
        if nearest.velocity[i] != 0.0:
            change += pairs.reach[i] * abs(nearest.velocity[i])
    return change * nearest.duration[len(nearest.duration) - 1]


def _take_gradients(nearest: NearestMemory, pairs: PairsMemory) -> None:
    """Distances of the nearest pairs, each where it is nearest."""
    for place in range(len(nearest.duration)):
        asks = False
        for row in range(pairs.n):
            asks = asks or pairs.worst[pairs.chosen[row]] == place
        if asks and pairs.in_c:
            _measure_gradients(nearest, pairs, place)
        elif asks:
            _ask_at(nearest, place, True)


def _measure_gradients(nearest: NearestMemory, pairs: PairsMemory, place: int) -> None:
    place_solids(pairs.distances, nearest.place[place])
    for row in range(pairs.n):
        k = pairs.chosen[row]
        if pairs.worst[k] == place:
            if pairs.seen[k] != place:
                _measured(pairs, k, place)
            pair_gradient(pairs.distances, k, pairs.gradient[row])


def _write_row(nearest: NearestMemory, pairs: PairsMemory, row: int, values: Vector) -> None:
    pair = pairs.chosen[row]
    gradient = pairs.gradient[row]
    speed = 0.0
    closing = FAR
    place = pairs.worst[pairs.chosen[row]]
    for i in range(len(nearest.velocity)):
        speed += gradient[i] * nearest.velocity[i]
        values[pairs.first + 1 + 2 * pairs.n + i * pairs.n + row] = gradient[i]
    if place > 0:
        # The way to rest grows with the square of the speed.
        closing = (pairs.lowest[pair] - pairs.threshold) / (2.0 * nearest.duration[place]) - speed
    values[pairs.first + 1 + row] = pairs.lowest[pair]
    values[pairs.first + 1 + pairs.n + row] = closing
