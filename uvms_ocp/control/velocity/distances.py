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
    """Index at which the measured distances begin among the parameters of all tasks."""
    n: int
    """Rows."""
    n_pairs: int
    """Number of pairs."""
    threshold: float
    """[m] distance that the task keeps."""
    in_c: bool
    """Kernels measure them in `distances`; Python is asked otherwise."""
    distances: DistanceMemory
    reach: Annotated[Vector, Sized("n_v")]
    """(n_v,) [-, m] largest rate of any pair's distance per unit of velocity, infinite where it is
    not known.
    """
    counts: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) 1 for pairs that are measured."""
    value: Annotated[Vector, Sized("n_pairs")]
    """(n_pairs,) [m] distances where they were measured last, or lower bounds of them."""
    lowest: Annotated[Vector, Sized("n_pairs")]
    """(n_pairs,) [m] smallest distance on the way to rest; infinite where a pair cannot come near.
    """
    bounded: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) pairs of which `lowest` is but a lower bound."""
    seen: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) index of the place where a pair was measured last."""
    worst: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) index of the place of the smallest distance: 0 now, k at the k-th place."""
    chosen: Annotated[list[int], Sized("n_asked_pairs")]
    """(n,) pairs that come nearest."""
    taken: Annotated[list[int], Sized("n_pairs")]
    """(n_pairs,) 1 for pairs that are chosen."""
    gradient: Annotated[list[Vector], Sized("n_asked_pairs", "n_v")]
    """(n, n_v) [-, m] gradient of each chosen distance at its place."""


class NearestMemory(Layout):
    """Nearest pairs of all tasks, and the stop along which they are measured: all axes slow down in
    proportion.
    """

    n_asking: int
    """Number of tasks that ask for distances."""
    pairs: Annotated[list[PairsMemory], Sized("n_asking")]
    """(n_asking,) nearest pairs of each of these tasks."""
    integrate: FunctionField
    """Function ``q, displacement (n_v,) [m, rad] -> q`` there."""
    moves: bool
    """Coming to rest takes longer than a tick; the other fields have a meaning only then."""
    velocity: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] now."""
    duration: Annotated[Vector, Sized(1 + N_PLACES)]
    """(1 + N_PLACES,) [s] time at the present velocity to each place."""
    place: Annotated[list[Vector], Sized(1 + N_PLACES, "n_q")]
    """(1 + N_PLACES, n_q) [m, rad] configuration now, and at each place."""
    way: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m, rad] displacement to a place."""
    ask: CallbackField
    """Asks Python for the distances of the pairs of `asked` that count, at the place `at`, or for
    the gradients of those chosen that are nearest there.
    """
    asked: int
    """Index in `pairs` of what is asked for."""
    at: int
    """Index of the place at which it is asked for."""
    of_gradients: bool
    """Gradients are asked for, not distances."""


def place_along_stop(
    nearest: NearestMemory, q: Vector, v: Vector, acceleration: Vector, dt: float
) -> None:
    """Place configurations along the way to rest from q [m, rad] with v [m/s, rad/s], by
    `acceleration` [m/s2, rad/s2]. A kernel.

    dt [s]: of a tick. Where the robot rests within it, as with an infinite one, there is no place
    but q.
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
    """Measure the distances of a task, and write them into the parameters [their units] of all
    tasks, in the order of `NearestPairs.parameters`. A kernel.
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
    """Measure all pairs now: their distances, or bounds of them."""
    for i in range(pairs.n_pairs):
        pairs.counts[i] = 1
        pairs.worst[i] = 0
        pairs.bounded[i] = pairs.in_c
    _look_at(nearest, pairs, 0, -math.inf)
    pairs.lowest[: pairs.n_pairs] = pairs.value[: pairs.n_pairs]


def _look_at(nearest: NearestMemory, pairs: PairsMemory, place: int, limit: float) -> None:
    """Measure distances at a place; for a pair that is beyond the limit [m] there, or was nearer
    before, a bound is enough.
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
    """Choose the pairs of the smallest distances, in their order; measure those of which only a
    bound is known.
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
    """Find the smallest distance on the way to rest of each pair that may become one of the
    nearest.
    """
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
    """Return the largest change [m] of any distance on the whole way to rest."""
    change = 0.0
    for i in range(len(nearest.velocity)):
        if nearest.velocity[i] != 0.0:
            change += pairs.reach[i] * abs(nearest.velocity[i])
    return change * nearest.duration[len(nearest.duration) - 1]


def _take_gradients(nearest: NearestMemory, pairs: PairsMemory) -> None:
    """Measure the gradients of the nearest pairs, each where it is nearest."""
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
