"""Compare redundant channels over a few seconds: DVL and position, gyro and attitude, depth and position."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros
from uvms_ocp.estimation.health.plausibility import angle_between, conjugate, small_rotation
from uvms_ocp.estimation.vehicle_model import multiply, normalize

# Values of the last seconds with their times, in a ring.

LONGEST = 64


class SampleRing(Layout):
    """In the order of time."""

    first: int
    count: int
    t: Annotated[Vector, Sized(LONGEST)]
    """(64,) [s]"""
    value: Annotated[list[Vector], Sized(LONGEST, 4)]
    """(64, 4) of any unit."""


def ring_slot(s: SampleRing, k: int) -> int:
    """Return the slot of entry k, from the oldest."""
    return (s.first + k) % len(s.t)


def time_at(s: SampleRing, k: int) -> float:
    """[s] of entry k, from the oldest."""
    return s.t[ring_slot(s, k)]


def append_value(s: SampleRing, t: float, value: Vector, n: int) -> None:
    """Add n numbers of time t [s]; where all places are taken the oldest go."""
    if s.count == len(s.t):
        drop_oldest(s)
    slot = ring_slot(s, s.count)
    s.t[slot] = t
    s.value[slot][:n] = value[:n]
    s.count += 1


def drop_oldest(s: SampleRing) -> None:
    """One goes."""
    s.first = ring_slot(s, 1)
    s.count -= 1


def span_of(s: SampleRing) -> float:
    """[s] from the oldest to the newest."""
    return time_at(s, s.count - 1) - time_at(s, 0)


def mean_time(s: SampleRing, start: int, n: int) -> float:
    """[s] of n entries from `start` on."""
    total = 0.0
    for k in range(start, start + n):
        total += time_at(s, k)
    return total / n


def median_of(s: SampleRing, i: int, start: int, n: int) -> float:
    """Return the slot of number i of n entries from `start` on."""
    x = zeros(LONGEST)
    for k in range(n):
        value, place = s.value[ring_slot(s, start + k)][i], k
        while place > 0 and x[place - 1] > value:
            x[place] = x[place - 1]
            place -= 1
        x[place] = value
    return x[n // 2] if n % 2 == 1 else 0.5 * (x[n // 2 - 1] + x[n // 2])


def value_at(s: SampleRing, i: int, t: float) -> float:
    """Number i at time t [s], straight between entries, the oldest before them and the newest after."""
    after = s.count - 1
    while after > 0 and time_at(s, after - 1) > t:
        after -= 1
    old, new = s.value[ring_slot(s, max(after - 1, 0))][i], s.value[ring_slot(s, after)][i]
    from_t, to_t = time_at(s, max(after - 1, 0)), time_at(s, after)
    if t >= to_t or to_t == from_t:
        return new
    return old if t <= from_t else (new - old) / (to_t - from_t) * (t - from_t) + old


# Channels that tell the same in two ways, compared over a few seconds.

_GAP = 2.0  # [s] of silence after which a comparison begins anew
_SIGMAS = 8.0
_SPACING = 0.1  # [s] between readings that are compared: more tell no more
_DRIFT_SPAN, _DRIFT = 3.0, 0.04  # [s], [m/s]: a bias that a vehicle may have
_BLIND = 1.2  # [s] without a velocity, in which a vehicle may have gone anywhere
_TURN_SPAN, _TURN = 1.0, 0.03  # [s], [rad/s]
_FIRST, _LAST, _DEPTH = 10, 5, 0.05  # fixes, fixes, [m]


class VelocityAgainstPosition(Layout):
    """The way between two position fixes against the velocity of the DVL, integrated over the same time."""

    tolerance: float
    """[m/s]"""
    t: float
    """[s] of the last velocity."""
    way: Annotated[Vector, Sized(3)]
    """(3,) [m] in W."""
    velocity: Annotated[Vector, Sized(3)]
    """(3,) [m/s] in W."""
    ways: SampleRing
    """`way` at the last readings of the DVL, which late fixes may be compared with."""
    offsets: SampleRing
    """Difference of fixes from the integrated velocity."""


class RateAgainstAttitude(Layout):
    """The turn between two attitudes against that of the gyro, integrated over the same time."""

    tolerance: float
    """[rad/s]"""
    t: float
    """[s] of the last rate."""
    turn: Annotated[Vector, Sized(4)]
    """(4,) """
    rate: Annotated[Vector, Sized(3)]
    """(3,) [rad/s]"""
    offsets: SampleRing
    """Difference of attitudes from the integrated rate: constant in B where both turn alike."""


class DepthAgainstPosition(Layout):
    """The depth against the z of position fixes, less what they differed by at first."""

    tolerance: float
    """[m]"""
    t: float
    """[s] of the last depth."""
    depth: float
    """[m]"""
    count: int
    """Fixes."""
    first: float
    """[m] the sum of the first differences."""
    last: Annotated[Vector, Sized(_LAST)]
    """(5,) [m] of the newest ones, in a ring."""


def init_comparisons(
    velocity: VelocityAgainstPosition, rate: RateAgainstAttitude, depth: DepthAgainstPosition, noise: dict[str, float]
) -> None:
    """Prepare all three; noise [unit of the channel] of position, attitude and depth."""
    fix = noise["position"]
    velocity.tolerance = _DRIFT + _SIGMAS * math.sqrt(2.0) * fix / _DRIFT_SPAN
    rate.tolerance = _TURN + _SIGMAS * math.sqrt(2.0) * noise["attitude"] / _TURN_SPAN
    depth.tolerance = _DEPTH + _SIGMAS * math.hypot(fix, noise["depth"]) * math.sqrt(1.0 / _FIRST + 1.0 / _LAST)
    velocity.t = rate.t = depth.t = -math.inf
    rate.turn[3] = 1.0


def update_velocity(d: VelocityAgainstPosition, v_W: Vector, t: float) -> None:
    """The DVL's velocity v_W (3,) [m/s] in W at time t [s]."""
    dt = t - d.t
    known = 0.0 <= dt <= _BLIND
    if not known:
        d.offsets.count = d.ways.count = 0
    for i in range(3):
        if known:
            d.way[i] += 0.5 * dt * (v_W[i] + d.velocity[i])
        d.velocity[i] = v_W[i]
    d.t = t
    append_value(d.ways, t, d.way, 3)


def drift_rate(d: VelocityAgainstPosition, p: Vector, t: float) -> float:
    """How fast [m/s] the two drift apart, by a fix p (3,) [m] in W at time t [s]; 0 where they agree.

    Thirds of the span are compared by their medians, which fixes that are far off now and then do not move.
    """
    found = d.offsets
    if not (abs(t - d.t) <= _GAP and d.ways.count > 0 and t >= time_at(d.ways, 0)):
        found.count = 0
        return 0.0
    if found.count > 0 and t - time_at(found, found.count - 1) < _SPACING:
        return 0.0
    offset = zeros(3)
    for i in range(3):
        offset[i] = p[i] - _way_at(d, i, t)
    append_value(found, t, offset, 3)
    while span_of(found) > _DRIFT_SPAN + 0.5:
        drop_oldest(found)
    if span_of(found) < _DRIFT_SPAN or found.count < 3:
        return 0.0
    n = found.count // 3
    rate = _change(found) / (mean_time(found, found.count - n, n) - mean_time(found, 0, n))
    return rate if rate > d.tolerance else 0.0


def _change(found: SampleRing) -> float:
    """[m] from the first third to the last."""
    n, squared = found.count // 3, 0.0
    for i in range(3):
        change = median_of(found, i, found.count - n, n) - median_of(found, i, 0, n)
        squared += change * change
    return math.sqrt(squared)


def _way_at(d: VelocityAgainstPosition, i: int, t: float) -> float:
    """[m] along axis i by the DVL until time t [s], which a late fix was taken at some readings ago."""
    return d.way[i] + (t - d.t) * d.velocity[i] if t >= d.t else value_at(d.ways, i, t)


def update_rate(d: RateAgainstAttitude, omega: Vector, t: float) -> None:
    """The gyro's omega (3,) [rad/s] in B at time t [s]."""
    dt = t - d.t
    mean = zeros(3)
    for i in range(3):
        mean[i] = omega[i] + d.rate[i]
        d.rate[i] = omega[i]
    d.t = t
    if 0.0 <= dt <= _GAP:
        _turn_on(d, mean, 0.5 * dt, d.turn)
        normalize(d.turn)
    else:
        d.offsets.count = 0


def rotation_drift(d: RateAgainstAttitude, quaternion: Vector, t: float) -> float:
    """How fast [rad/s] the two turn apart, by the attitude quaternion (4,), xyzw, at time t [s]; 0 where they agree."""
    found = d.offsets
    if not abs(t - d.t) <= _GAP:
        found.count = 0
        return 0.0
    if found.count > 0 and t - time_at(found, found.count - 1) < _SPACING:
        return 0.0
    turned, offset = zeros(4), zeros(4)
    _turn_on(d, d.rate, t - d.t, turned)
    conjugate(turned)
    multiply(quaternion, turned, offset)
    append_value(found, t, offset, 4)
    while span_of(found) > _TURN_SPAN + _SPACING:
        drop_oldest(found)
    span = span_of(found)
    if span < _TURN_SPAN - 1e-6:
        return 0.0
    rate = angle_between(found.value[found.first], found.value[ring_slot(found, found.count - 1)]) / span
    return rate if rate > d.tolerance else 0.0


def _turn_on(d: RateAgainstAttitude, rate: Vector, dt: float, out: Vector) -> None:
    """Out (4,) becomes the turn after dt [s] more of a rate (3,) [rad/s]."""
    by = zeros(4)
    small_rotation(rate, dt, by)
    multiply(d.turn, by, out)


def update_depth(d: DepthAgainstPosition, z: float, t: float) -> None:
    """The depth z [m] at time t [s]."""
    d.depth, d.t = z, t


def depth_difference(d: DepthAgainstPosition, z: float, climb: float, t: float) -> float:
    """Return by how much [m] the two differ, by the z [m] of a fix at time t [s] and the climb [m/s]; 0 where they agree."""
    if not abs(t - d.t) <= _GAP:
        return 0.0
    difference = z - d.depth - (t - d.t) * climb
    d.count += 1
    if d.count <= _FIRST:
        d.first += difference
        return 0.0
    d.last[d.count % _LAST] = difference
    # The last differences, oldest first, added up [m].
    total = 0.0
    for i in range(1, _LAST + 1):
        total += d.last[(d.count + i) % _LAST]
    by = abs(total / _LAST - d.first / _FIRST)
    return by if d.count >= _FIRST + _LAST and by > d.tolerance else 0.0
