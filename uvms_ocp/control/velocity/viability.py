"""Viability rule: accept a velocity only if a full stop from it respects every limit on positions.

A velocity that is refused gives way to the one nearest to it from which the stop is clear, on the
way to a slower one. That is, if it is clear, the same velocity with the axes braked that bring the
robot to the limit, so that an arm that may go no farther does not stop its vehicle; else the stop's
own next velocity. The latter was part of the stop that the tick before accepted, so that from a
viable state there is always an answer, whatever the hierarchy asks for.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import (
    CallbackField,
    FunctionField,
    Layout,
    Sized,
    Vector,
)
from uvms_ocp.control.velocity import braking
from uvms_ocp.robot.shapes.distance_kernels import (
    DistanceMemory,
    distance_lower_bound,
    distance_of,
    place_solids,
)
from uvms_ocp.solvers.bounded_least_squares import dot

_HALVINGS = 5


class ViabilityMemory(Layout):
    """Limits on positions, and which of them a velocity could come to within its stop."""

    stop: braking.StopMemory
    """Stop of the robot, with the reach of its limits."""
    smooth: FunctionField
    """Function of q that gives the positions with an expression, those of the first limits."""
    ask: CallbackField
    """Asks Python for the positions of the limit `asked` at `place`, which have no expression and
    are no distances.
    """
    asked: int
    place: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration at which Python is asked."""
    n_limits: int
    lower: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] the limits."""
    task: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) index of the task of each limit."""
    quantity: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) index of the quantity that each limits."""
    relative: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) 1 where positions tell only how the measured quantity changes."""
    asks: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) which of them Python is asked about."""
    pairs: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) which of `distances` their positions are, or `NONE`."""
    distances: Annotated[list[DistanceMemory], Sized("n_distances")]
    """(n_distances,) models whose pairs kernels measure."""
    first: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) first position of each."""
    end: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) the one after its last."""

    travel: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m, rad] largest way of each axis until the robot rests."""
    near: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) 1 for limits that some position may come to."""
    room: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] smallest height of the positions above their floor now."""
    base: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] the limits, in terms of positions."""
    position: Annotated[Vector, Sized("n_positions")]
    """(n_positions,) [m] values when they were last evaluated; of distances lower bounds."""
    counts: Annotated[list[int], Sized("n_positions")]
    """(n_positions,) 1 for positions that may come to their limit."""
    floor: Annotated[Vector, Sized("n_positions")]
    """(n_positions,) [m] height over its limit that each position is to keep: 0, or where the stop
    leads, if that is below.
    """
    slower: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity one tick nearer to rest."""
    blocking: int
    """Limit that the last stop that was not clear comes to first."""
    mixed: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity between `slower` and the desired one."""


def may_reach_limit(
    viability: ViabilityMemory, v: Vector, gates: Vector, quantities: Vector
) -> bool:
    """Return whether some position may come to a limit that counts until the robot rests from v
    [m/s, rad/s]. A kernel.

    gates of tasks, quantities [in their units] as measured. Leaves what each axis moves at most,
    and which limits it is.
    """
    any_near = False
    n = len(viability.travel)
    time = braking.time_to_rest(viability.stop.acceleration, v, n)
    for i in range(n):
        viability.travel[i] = abs(v[i]) * (viability.stop.dt + 0.5 * time)
    for k in range(viability.n_limits):
        viability.near[k] = gates[viability.task[k]] > 0 and quantities[
            viability.quantity[k]
        ] - viability.lower[k] <= _farthest(viability, k)
        any_near = any_near or viability.near[k] != 0
    return any_near


def _farthest(viability: ViabilityMemory, k: int) -> float:
    """Return the largest way [m] of any position of a limit until the robot rests."""
    return dot(viability.stop.reach[k], viability.travel, len(viability.travel))


def enforce_viability(
    viability: ViabilityMemory,
    q: Vector,
    previous: Vector,
    desired: Vector,
    gates: Vector,
    quantities: Vector,
) -> float:
    """Slow the `desired` velocity [m/s, rad/s] down to the one for this tick; return the share that
    is left of it. A kernel.

    The rest is slowing down: of the axes that bring the robot to the limit, where that is enough,
    or of all. q [m, rad]: now. previous [m/s, rad/s]: of the tick before. gates: a
    limit counts while its task is on at all. quantities [in their units]: as measured at q. A
    position that the stop from `previous` would not keep either may fall as far as it does there,
    no farther.
    """
    braking.slow_down(viability.stop, q, previous, viability.slower)
    for i in range(len(viability.mixed)):
        # Of every mixture of the two: it may be as fast as the one and need as long to rest as the
        # other.
        viability.mixed[i] = max(abs(desired[i]), abs(viability.slower[i]))
    if not may_reach_limit(viability, viability.mixed, gates, quantities):
        return 1.0
    _select_near(viability, q, quantities)
    if _is_clear(viability, q, desired):
        return 1.0
    blocking = viability.blocking
    _lower_floors(viability, q)
    _brake_toward_limit(viability, blocking, previous, desired)
    if not _is_clear(viability, q, viability.slower):
        braking.slow_down(viability.stop, q, previous, viability.slower)
    share = _largest_share(viability, q, desired)
    _interpolate(viability, desired, share)
    n = len(viability.mixed)
    desired[:n] = viability.mixed[:n]
    return share


def _select_near(viability: ViabilityMemory, q: Vector, quantities: Vector) -> None:
    """Take the limits that are near as they are at q [m, rad], with the positions that may come to
    them.
    """
    for k in range(viability.n_limits):
        if viability.near[k] != 0:
            for i in range(viability.first[k], viability.end[k]):
                viability.counts[i] = 1
                viability.floor[i] = 0.0
            _look_at(viability, k, q)
            _measure(viability, k, quantities[viability.quantity[k]])


def _measure(viability: ViabilityMemory, k: int, measured: float) -> None:
    """Compute the room [m] before a limit from its measured quantity [m], and which positions may
    come to it.
    """
    lowest = math.inf
    way = _farthest(viability, k)
    for i in range(viability.first[k], viability.end[k]):
        lowest = min(lowest, viability.position[i])
    viability.room[k] = measured - viability.lower[k]
    viability.base[k] = viability.lower[k] + (
        lowest - measured if viability.relative[k] != 0 else 0.0
    )
    for i in range(viability.first[k], viability.end[k]):
        viability.counts[i] = viability.position[i] - viability.base[k] <= way


def _look_at(viability: ViabilityMemory, k: int, q: Vector) -> None:
    """Evaluate the positions of a limit that count at q [m, rad]; for distances a lower bound is
    enough.
    """
    if viability.pairs[k] != braking.NONE:
        _look_at_pairs(viability, k, q)
        return
    if viability.asks[k] == 0:
        viability.smooth(q, viability.position)
        return
    viability.asked = k
    viability.place[:] = q
    viability.ask()


def _look_at_pairs(viability: ViabilityMemory, k: int, q: Vector) -> None:
    distances = viability.distances[viability.pairs[k]]
    place_solids(distances, q)
    for i in range(viability.first[k], viability.end[k]):
        if viability.counts[i] != 0:
            viability.position[i] = distance_lower_bound(distances, i - viability.first[k])


def _height(viability: ViabilityMemory, k: int, i: int, enough: float) -> float:
    """Return the height [m] of a position over its limit when it was last evaluated; from `enough`
    [m] on a lower bound.
    """
    if (
        viability.pairs[k] != braking.NONE
        and not viability.position[i] - viability.base[k] >= enough
    ):
        viability.position[i] = distance_of(
            viability.distances[viability.pairs[k]], i - viability.first[k]
        )
    return viability.position[i] - viability.base[k]


def _is_clear(viability: ViabilityMemory, q: Vector, v: Vector) -> bool:
    """Return whether the stop from v [m/s, rad/s] keeps all positions that count at or above their
    floors, at every tick.

    Ticks that no position can have reached its floor at since it was last looked at are passed over
    (conservative advancement).
    """
    for k in range(viability.n_limits):
        viability.stop.room[k] = viability.room[k] if viability.near[k] != 0 else math.inf
    braking.begin_stop(viability.stop, q, v)
    k = braking.advance_stop(viability.stop)
    while k != braking.NONE:
        _look_at(viability, k, viability.stop.q)
        viability.stop.room[k] = _slack(viability, k)
        if viability.stop.room[k] < 0.0:
            viability.blocking = k
            return False
        k = braking.advance_stop(viability.stop)
    return True


def _slack(viability: ViabilityMemory, k: int) -> float:
    """Return by how much [m] the positions of a limit that count are above their floors, when they
    were last evaluated.
    """
    slack = math.inf
    for i in range(viability.first[k], viability.end[k]):
        if viability.counts[i] != 0:
            slack = min(
                slack, _height(viability, k, i, slack + viability.floor[i]) - viability.floor[i]
            )
    return slack


def _lower_floors(viability: ViabilityMemory, q: Vector) -> None:
    """Lower the floors of positions to where the stop from the slower velocity leads, if that is
    below the limit.
    """
    braking.begin_stop(viability.stop, q, viability.slower)
    while not viability.stop.done:
        braking.step_stop(viability.stop)
        for k in range(viability.n_limits):
            if viability.near[k] != 0:
                _look_at(viability, k, viability.stop.q)
                _lower_floor(viability, k)
    for k in range(viability.n_limits):
        viability.room[k] = 0.0


def _brake_toward_limit(
    viability: ViabilityMemory, k: int, previous: Vector, desired: Vector
) -> None:
    """Make `slower` the desired velocity [m/s, rad/s] with the axes that limit k depends on braked
    from the previous one as hard as they can: each comes to rest by itself, and not with the
    slowest.
    """
    for i in range(len(viability.slower)):
        if viability.stop.reach[k][i] > 0.0:
            step = viability.stop.acceleration[i] * viability.stop.dt
            viability.slower[i] = previous[i] - min(max(previous[i], -step), step)
        else:
            viability.slower[i] = desired[i]


def _lower_floor(viability: ViabilityMemory, k: int) -> None:
    for i in range(viability.first[k], viability.end[k]):
        if viability.counts[i] != 0:
            viability.floor[i] = min(
                viability.floor[i], _height(viability, k, i, viability.floor[i])
            )


def _interpolate(viability: ViabilityMemory, desired: Vector, share: float) -> None:
    for i in range(len(viability.mixed)):
        viability.mixed[i] = viability.slower[i] + share * (desired[i] - viability.slower[i])


def _largest_share(viability: ViabilityMemory, q: Vector, desired: Vector) -> float:
    """Find the share of the `desired` velocity [m/s, rad/s] from which the stop is clear, by
    halving; 0 is known to be clear.
    """
    _interpolate(viability, desired, 1.0)
    if _is_clear(viability, q, viability.mixed):
        return 1.0
    low = 0.0
    high = 1.0
    halvings_left = _HALVINGS
    while halvings_left > 0:
        halvings_left -= 1
        middle = 0.5 * (low + high)
        _interpolate(viability, desired, middle)
        if _is_clear(viability, q, viability.mixed):
            low = middle
        else:
            high = middle
    return low
