"""Viability rule: accept a velocity only if a full stop from it respects every limit on positions.

A velocity that is refused gives way to the one nearest to it, on the way to the stop's own next
velocity, from which the stop is clear. That next velocity was part of the stop that the tick before
accepted, so that from a viable state there is always an answer, whatever the hierarchy asks for.
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
    """Limits, and which of them a velocity could come to within its stop."""

    stop: braking.StopMemory
    """With the reach of the limits."""
    smooth: FunctionField
    """Q to the positions that have an expression, those of the first limits."""
    ask: CallbackField
    """Asks for the positions, of the limit `asked` at `place`, that have no expression and are no
    distances.
    """
    asked: int
    place: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad]"""
    n_limits: int
    lower: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] the limits."""
    task: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) whose they are."""
    quantity: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) index of what they limit."""
    relative: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) as that of `PositionLimit`."""
    asks: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) which of them Python is asked about."""
    pairs: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) which of `distances` their positions are, or `NONE`."""
    distances: Annotated[list[DistanceMemory], Sized("n_distances")]
    """(n_distances,)"""
    first: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) first position of each."""
    end: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) the one after its last."""

    travel: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m, rad] that each axis moves at most."""
    near: Annotated[list[int], Sized("n_limits")]
    """(n_limits,) which of them some position may come to."""
    room: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] by which all positions are above their floor now."""
    base: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] the limits, as positions tell them."""
    position: Annotated[Vector, Sized("n_positions")]
    """(n_positions,) [m] as last looked at; of a distance no more than that."""
    counts: Annotated[list[int], Sized("n_positions")]
    """(n_positions,) which of them may come to their limit."""
    floor: Annotated[Vector, Sized("n_positions")]
    """(n_positions,) [m] that each stays at or above, over its limit: 0, or where the stop leads,
    if that is below.
    """
    slower: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] one tick nearer to rest."""
    mixed: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] between that and what is wanted."""


def may_reach_limit(m: ViabilityMemory, v: Vector, gates: Vector, quantities: Vector) -> bool:
    """Return whether some position may come to a limit that counts until the robot rests from v
    [m/s, rad/s]. A kernel.

    gates of tasks, quantities [in their units] as measured. Leaves what each axis moves at most,
    and which limits it is.
    """
    any_near = False
    n = len(m.travel)
    time = braking.time_to_rest(m.stop.acceleration, v, n)
    for i in range(n):
        m.travel[i] = abs(v[i]) * (m.stop.dt + 0.5 * time)
    for k in range(m.n_limits):
        m.near[k] = gates[m.task[k]] > 0 and quantities[m.quantity[k]] - m.lower[k] <= _farthest(
            m, k
        )
        any_near = any_near or m.near[k] != 0
    return any_near


def _farthest(m: ViabilityMemory, k: int) -> float:
    """[m] that any position of a limit moves at most."""
    return dot(m.stop.reach[k], m.travel, len(m.travel))


def enforce_viability(
    m: ViabilityMemory,
    q: Vector,
    previous: Vector,
    desired: Vector,
    gates: Vector,
    quantities: Vector,
) -> float:
    """Makes of the velocity `wanted` [m/s, rad/s] the one for this tick, and returns the share that
    is left of it. A kernel.

    The rest is slowing down. q [m, rad]: now. previous [m/s, rad/s]: of the tick before. gates: a
    limit counts while its task is on at all. quantities [in their units]: as measured at q. A
    position that the stop from `previous` would not keep either may fall as far as it does there,
    no farther.
    """
    braking.slow_down(m.stop, q, previous, m.slower)
    for i in range(len(m.mixed)):
        # Of every mixture of the two: it may be as fast as the one and need as long to rest as the
        # other.
        m.mixed[i] = max(abs(desired[i]), abs(m.slower[i]))
    if not may_reach_limit(m, m.mixed, gates, quantities):
        return 1.0
    _select_near(m, q, quantities)
    if _is_clear(m, q, desired):
        return 1.0
    _lower_floors(m, q)
    share = _largest_share(m, q, desired)
    _interpolate(m, desired, share)
    n = len(m.mixed)
    desired[:n] = m.mixed[:n]
    return share


def _select_near(m: ViabilityMemory, q: Vector, quantities: Vector) -> None:
    """Take the limits that are near as they are at q [m, rad], with the positions that may come to
    them.
    """
    for k in range(m.n_limits):
        if m.near[k] != 0:
            for i in range(m.first[k], m.end[k]):
                m.counts[i] = 1
                m.floor[i] = 0.0
            _look_at(m, k, q)
            _measure(m, k, quantities[m.quantity[k]])


def _measure(m: ViabilityMemory, k: int, measured: float) -> None:
    """Room [m] before a limit from what is measured [m], and the positions that may come to it."""
    lowest = math.inf
    way = _farthest(m, k)
    for i in range(m.first[k], m.end[k]):
        lowest = min(lowest, m.position[i])
    m.room[k] = measured - m.lower[k]
    m.base[k] = m.lower[k] + (lowest - measured if m.relative[k] != 0 else 0.0)
    for i in range(m.first[k], m.end[k]):
        m.counts[i] = m.position[i] - m.base[k] <= way


def _look_at(m: ViabilityMemory, k: int, q: Vector) -> None:
    """The positions of a limit at q [m, rad], of those that count at least; of distances a bound
    from below.
    """
    if m.pairs[k] != braking.NONE:
        _look_at_pairs(m, k, q)
        return
    if m.asks[k] == 0:
        m.smooth(q, m.position)
        return
    m.asked = k
    m.place[:] = q
    m.ask()


def _look_at_pairs(m: ViabilityMemory, k: int, q: Vector) -> None:
    distances = m.distances[m.pairs[k]]
    place_solids(distances, q)
    for i in range(m.first[k], m.end[k]):
        if m.counts[i] != 0:
            m.position[i] = distance_lower_bound(distances, i - m.first[k])


def _height(m: ViabilityMemory, k: int, i: int, enough: float) -> float:
    """[m] of a position over its limit, as last looked at; where that is `enough` [m], no less than
    that.
    """
    if m.pairs[k] != braking.NONE and not m.position[i] - m.base[k] >= enough:
        m.position[i] = distance_of(m.distances[m.pairs[k]], i - m.first[k])
    return m.position[i] - m.base[k]


def _is_clear(m: ViabilityMemory, q: Vector, v: Vector) -> bool:
    """Return whether the stop from v [m/s, rad/s] keeps all positions that count at or above their
    floors, at every tick.

    Ticks that no position can have reached its floor at since it was last looked at are passed over
    (conservative advancement).
    """
    for k in range(m.n_limits):
        m.stop.room[k] = m.room[k] if m.near[k] != 0 else math.inf
    braking.begin_stop(m.stop, q, v)
    k = braking.advance_stop(m.stop)
    while k != braking.NONE:
        _look_at(m, k, m.stop.q)
        m.stop.room[k] = _slack(m, k)
        if m.stop.room[k] < 0.0:
            return False
        k = braking.advance_stop(m.stop)
    return True


def _slack(m: ViabilityMemory, k: int) -> float:
    """[m] by which the positions of a limit that count are above their floors, as last looked
    at.
    """
    slack = math.inf
    for i in range(m.first[k], m.end[k]):
        if m.counts[i] != 0:
            slack = min(slack, _height(m, k, i, slack + m.floor[i]) - m.floor[i])
    return slack


def _lower_floors(m: ViabilityMemory, q: Vector) -> None:
    """To where the stop from the slower velocity leads, if that is below the limit."""
    braking.begin_stop(m.stop, q, m.slower)
    while not m.stop.done:
        braking.step_stop(m.stop)
        for k in range(m.n_limits):
            if m.near[k] != 0:
                _look_at(m, k, m.stop.q)
                _lower_floor(m, k)
    for k in range(m.n_limits):
        m.room[k] = 0.0


def _lower_floor(m: ViabilityMemory, k: int) -> None:
    for i in range(m.first[k], m.end[k]):
        if m.counts[i] != 0:
            m.floor[i] = min(m.floor[i], _height(m, k, i, m.floor[i]))


def _interpolate(m: ViabilityMemory, desired: Vector, share: float) -> None:
    for i in range(len(m.mixed)):
        m.mixed[i] = m.slower[i] + share * (desired[i] - m.slower[i])


def _largest_share(m: ViabilityMemory, q: Vector, desired: Vector) -> float:
    """Find the share of `wanted` [m/s, rad/s] from which the stop is clear, by halving; 0 is known
    to be clear.
    """
    _interpolate(m, desired, 1.0)
    if _is_clear(m, q, m.mixed):
        return 1.0
    low = 0.0
    high = 1.0
    halvings_left = _HALVINGS
    while halvings_left > 0:
        halvings_left -= 1
        middle = 0.5 * (low + high)
        _interpolate(m, desired, middle)
        if _is_clear(m, q, m.mixed):
            low = middle
        else:
            high = middle
    return low
