"""Lock the brakes where a joint is about to outrun its velocity limit, and nobody asked it to: an arm
whose weight is made up for in another posture than its own, or without its load, falls, however it is
fed back.

So does a loop that shakes an arm to and fro, as one of a posture that is far from the true one may:
it is locked at any rate of the loop.

An encoder that drifts slowly enough takes its joint along and is doubted by nobody, so that it is
not asked whether one is, but where the loop is quick enough to catch an arm and to learn its load: it
is locked where it is not caught soon. Where no thruster drives an axis of the vehicle it is left to
the loop: an arm that is locked cannot steady a vehicle that swings, whose swing throws it again.
A lock lasts as long as one is, or as the vehicle is carried off: it would throw the arm. So it does
as long as a joint seems to move that is locked: its readings are wrong.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.robot.signals import SAME_TIME

_TICKS_TO_ACT = 2.0  # until brakes act on what is seen
_SLOW_TICK = 0.02  # [s] of control from which on a loop catches no arm that is thrown
_CAUGHT = 1.1  # share of its limit at which a joint is that a quick loop has not caught
_THROWN = 1.5  # share of its limit that a joint is about to reach, which no loop catches any more
_UNASKED = 0.25  # share of the limit by which a joint is off the velocity that is asked of it
_CARRIED_OFF = 0.5  # share of the limit by which a vehicle is off the velocity that is asked of it
_DOUBTFUL = 10.0  # [s] after a doubt or a lock for which a posture, or a load, may be another one
_SHORTEST_LOCK = 0.5  # [s], and the dead time of rates: by then a locked joint that moves is known
_LONGEST_LOCK = 64.0  # [s]
_LONGER = 64.0  # times the lock before it is the lock of a joint that falls again: no blow made it
_SETTLED = 0.1  # [s] after which, and the dead time of the rates, a locked joint is seen to rest
_AVERAGED = 0.15  # [s] time constant of the mean rate of a locked joint
_COUNTS = 2.0 * _AVERAGED  # [s] after which that mean counts
_SHAKES = (
    3  # times in a row that a joint is off to the other side, by which a loop is known to swing
)
_SWING = 0.15  # share of the limit by which a joint is off then
_HALF_SWING = 0.15  # [s] from one side to the other at most
_MOVES = 0.05  # share of its limit that the mean rate of a joint is beyond that moves


class OverspeedMemory(Layout):
    """Velocity limits of the joints, and until when brakes are locked."""

    count: int
    """Joints."""
    limit: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] largest velocities."""
    late: float
    """[s] dead time of the rates that is known."""
    steadies: bool
    """True where an axis of the vehicle is driven by no thruster, so that its arm steadies it."""
    vehicle_limit: Annotated[Vector, Sized(6)]
    """(6,) [m/s, rad/s] largest velocities of the vehicle."""
    before: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] velocities of the tick before."""
    asked: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] velocities that were asked for in the tick before."""
    asked_earlier: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] velocities that were asked for in the tick before that one."""
    before_t: float
    """[s] time of the tick before."""
    doubted_until: float
    """[s] time until which posture and load count as doubtful."""
    locked_until: float
    """[s] time until which brakes are locked."""
    locked_at: float
    """[s] time of the last lock."""
    locked_rate: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] mean rates since the joints were locked, low-passed."""
    moved: bool
    """True where a joint has seemed to move since brakes were locked."""
    moving: int
    """Joint that was first seen to move while it is locked in this tick, -1 for none."""
    lock: float
    """[s] shortest duration of the last lock; 0 before the first one since the posture was sound.
    """
    side: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) side, 1 or -1, to which each joint was off what is asked for the last time; 0 before.
    """
    side_t: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [s] when it came to that side."""
    sides: Annotated[list[int], Sized("n_joints")]
    """(n_joints,) times in a row that it was off to the other side soon."""
    shaking: bool
    """True where the joint that locked the brakes was shaken."""
    escaped: bool
    """True where a joint is farther beyond its limit than a loop that catches it lets it come."""
    thrown: bool
    """True where the joint came to its limit within one tick: let go, it would do so again before
    the brakes can act.
    """
    joint: int
    """Joint that locked the brakes in this tick, -1 for none."""


def start_overspeed(overspeed: OverspeedMemory) -> None:
    """Initialise the memory: no posture or load is doubtful."""
    overspeed.before_t = -math.inf
    overspeed.doubted_until = -math.inf
    overspeed.locked_until = -math.inf
    overspeed.joint = -1
    overspeed.moving = -1


def locks_at_overspeed(
    overspeed: OverspeedMemory, first: int, v: Vector, reference: Vector, doubted: bool, t: float
) -> bool:
    """Return whether brakes are to be locked at time t [s].

    first: index of the first joint in v (n_v,) [m/s, rad/s] as estimated, and in the reference
    (n_v,). doubted: encoders are, or rates of joints; it keeps locked what is, as does a vehicle
    that is carried off, and a joint that seems to move though it is locked. Every lock is longer
    than the one before it.
    """
    if doubted:
        overspeed.doubted_until = t + _DOUBTFUL
    overspeed.joint = _fastest_unasked(overspeed, first, v, reference, t)
    shaken = _most_shaken(overspeed)
    overspeed.shaking = shaken >= 0
    if overspeed.shaking:
        overspeed.joint = shaken
        overspeed.thrown = False
    overspeed.moving = -1
    period = t - overspeed.before_t
    catches_none = period >= _SLOW_TICK - SAME_TIME
    overspeed.before_t = t
    if t < overspeed.locked_until - SAME_TIME:
        _forget_swings(overspeed)
        moves = _moves_though_locked(overspeed, first, v, period, t)
        if moves or doubted or is_carried_off(overspeed, first, v, reference):
            overspeed.locked_until = max(overspeed.locked_until, t + _SHORTEST_LOCK)
            _doubt_after_lock(overspeed)
        overspeed.joint = -1
        return True
    if t > overspeed.doubted_until + SAME_TIME:
        overspeed.lock = 0.0
    is_doubtful = doubted or t <= overspeed.doubted_until + SAME_TIME
    is_caught = not (catches_none or overspeed.escaped or overspeed.shaking)
    if overspeed.joint < 0 or (is_caught and not is_doubtful):
        overspeed.joint = -1
        return False
    shortest = _SHORTEST_LOCK + overspeed.late
    if overspeed.thrown:
        shortest = _LONGER * _SHORTEST_LOCK
    overspeed.lock = min(max(shortest, _LONGER * overspeed.lock), _LONGEST_LOCK)
    overspeed.locked_until = t + overspeed.lock
    overspeed.locked_at = t
    overspeed.moved = False
    for j in range(overspeed.count):
        overspeed.locked_rate[j] = 0.0
    _doubt_after_lock(overspeed)
    return True


def _doubt_after_lock(overspeed: OverspeedMemory) -> None:
    """Count posture and load as doubtful until long after the end of the lock."""
    overspeed.doubted_until = max(overspeed.doubted_until, overspeed.locked_until + _DOUBTFUL)


def is_carried_off(overspeed: OverspeedMemory, first: int, v: Vector, reference: Vector) -> bool:
    """Return whether the vehicle does by far not move as it is asked to."""
    carried_off = False
    for i in range(first):
        off = abs(v[i] - reference[i])
        carried_off = carried_off or off > _CARRIED_OFF * overspeed.vehicle_limit[i]
    return carried_off


def _moves_though_locked(
    overspeed: OverspeedMemory, first: int, v: Vector, period: float, t: float
) -> bool:
    """Return whether a joint seems to move on average that has been locked for long enough; the one
    that moves most, as a share of its limit, is named.
    """
    settled = overspeed.locked_at + _SETTLED + overspeed.late
    share = min(1.0, period / _AVERAGED)
    for j in range(overspeed.count):
        rate = v[first + j]
        if t > settled and math.isfinite(rate):
            overspeed.locked_rate[j] += share * (rate - overspeed.locked_rate[j])
    moving = _fastest_locked(overspeed)
    if moving < 0 or t < settled + _COUNTS - SAME_TIME:
        return False
    if not overspeed.moved:
        overspeed.moving = moving
    overspeed.moved = True
    return True


def _fastest_locked(overspeed: OverspeedMemory) -> int:
    """Return the locked joint whose mean rate is the largest share of its limit, -1 where none
    moves.
    """
    fastest = -1
    largest_share = _MOVES
    for j in range(overspeed.count):
        rate = abs(overspeed.locked_rate[j])
        if rate > largest_share * overspeed.limit[j]:
            largest_share = rate / overspeed.limit[j]
            fastest = j
    return fastest


def _fastest_unasked(
    overspeed: OverspeedMemory, first: int, v: Vector, reference: Vector, t: float
) -> int:
    """Return the joint that is about to be the farthest beyond its limit at time t [s]; -1 for none."""
    joint = -1
    largest_excess = 0.0
    overspeed.escaped = False
    for j in range(overspeed.count):
        rate = v[first + j]
        growth = abs(rate - overspeed.before[j])
        expected = rate + _TICKS_TO_ACT * (rate - overspeed.before[j])
        excess = max(abs(rate), abs(expected)) - overspeed.limit[j]
        overspeed.before[j] = rate
        asked = reference[first + j]
        deviation = _deviation(overspeed, j, rate, asked)
        is_unasked = abs(deviation) > _UNASKED * overspeed.limit[j]
        is_fast = abs(rate) > _CAUGHT * overspeed.limit[j]
        is_thrown = abs(expected) > _THROWN * overspeed.limit[j]
        if is_unasked and (is_fast or is_thrown) and not overspeed.steadies:
            overspeed.escaped = True
        if abs(deviation) > _SWING * overspeed.limit[j]:
            _note_side(overspeed, j, 1.0 if deviation > 0.0 else -1.0, t)
        overspeed.asked_earlier[j] = overspeed.asked[j]
        overspeed.asked[j] = asked
        if is_unasked and excess > largest_excess:
            largest_excess = excess
            joint = j
            overspeed.thrown = growth > overspeed.limit[j]
    return joint


def _deviation(overspeed: OverspeedMemory, j: int, rate: float, asked: float) -> float:
    """Return how far [rad/s or m/s] the rate of a joint is beyond all that was asked of it of late, to
    either side.

    It shows up to two ticks after it was asked for, by which time the opposite may be asked for: a
    tick until it is in force, and one until its rate is read. What sensors are late by, of quick loops
    many ticks, is not made up for.
    """
    lowest = min(asked, overspeed.asked[j], overspeed.asked_earlier[j])
    highest = max(asked, overspeed.asked[j], overspeed.asked_earlier[j])
    if rate < lowest:
        return rate - lowest
    return max(rate - highest, 0.0)


def _note_side(overspeed: OverspeedMemory, j: int, side: float, t: float) -> None:
    """Count how often joint j has been off to the other side at time t [s], soon after the last time."""
    if side == overspeed.side[j]:
        return
    if t - overspeed.side_t[j] > _HALF_SWING + SAME_TIME:
        overspeed.sides[j] = 0
    overspeed.sides[j] += 1
    overspeed.side[j] = side
    overspeed.side_t[j] = t


def _most_shaken(overspeed: OverspeedMemory) -> int:
    """Return the joint that has swung to and fro most often, -1 where none has often enough."""
    joint = -1
    most = _SHAKES - 1
    for j in range(overspeed.count):
        if overspeed.sides[j] > most:
            most = overspeed.sides[j]
            joint = j
    return joint


def _forget_swings(overspeed: OverspeedMemory) -> None:
    """Count swings anew: under brakes readings swing that are wrong."""
    for j in range(overspeed.count):
        overspeed.sides[j] = 0
