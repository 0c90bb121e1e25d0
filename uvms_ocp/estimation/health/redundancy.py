"""Compare redundant channels over a few seconds: DVL and position, gyro and attitude, rates and
encoders, and depths.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros
from uvms_ocp.estimation.health.plausibility import angle_between, conjugate, small_rotation
from uvms_ocp.estimation.joint_travel import LEAST_TRAVEL, goes_along
from uvms_ocp.estimation.vehicle_model import multiply, normalize

LONGEST = 64

_GAP = 2.0  # [s] of silence after which a comparison begins anew
_SIGMAS = 8.0
_SPACING = 0.1  # [s] between readings that are compared: more tell no more
# [s], [m/s]: a bias that a vehicle may have
_DRIFT_SPAN = 3.0
_DRIFT = 0.04
# [s] in which slow drifts are looked for
_LONG_SPAN = 20.0
_LONG_LEAST = 6.0
_LONG_SPACING = 0.4
_MEDIAN = 1.25  # times the standard deviation of a mean: that of a median
# [m/s] a bias that a DVL may have, and share of the way by which its axes and scale err
_SLOW_DRIFT = 0.01
_OBLIQUE = 0.03
_SLOW_TURN = 0.005  # [rad/s]: a bias that a gyro may have
_BLIND = 1.2  # [s] without a velocity, in which a vehicle may have gone anywhere
# [s], [rad/s]
_TURN_SPAN = 1.0
_TURN = 0.03
# shares of what is allowed, which is eight standard deviations of noise
_DISPUTED = 0.25
_DOUBTFUL = 0.4
_DRIFTS = 0.6
_AGREES_AGAIN = 0.2
_UNDONE = 0.5  # share of what a fix is off the estimate by
_AT_ONCE = 0.8  # of a difference, which comes with one reading
_CLEAR = 2.0
_CLEAR_BY = 0.2
# fixes, fixes, [m]
_FIRST = 10
_LAST = 5
_DEPTH = 0.05
# [s] between marks, [rad/s] a bias, [s] that a rate may be late
_ENCODER_SPAN = 10.0
_SLOW_JOINT = 0.001
_RATE_DELAY = 0.05
_RATE_SIGMAS = 5.0  # of the way that rates integrate to, beside what its bias may make of it


class SampleRing(Layout):
    """Samples in the order of time, in a ring."""

    first: int
    count: int
    t: Annotated[Vector, Sized(LONGEST)]
    """(64,) [s] times of the samples."""
    value: Annotated[list[Vector], Sized(LONGEST, 4)]
    """(64, 4) [unit of what is sampled] up to four numbers of each sample."""


def ring_slot(ring: SampleRing, k: int) -> int:
    """Return the slot of entry k, from the oldest."""
    return (ring.first + k) % len(ring.t)


def time_at(ring: SampleRing, k: int) -> float:
    """Return the time [s] of entry k, from the oldest."""
    return ring.t[ring_slot(ring, k)]


def append_value(ring: SampleRing, t: float, value: Vector, n: int) -> None:
    """Add n numbers of time t [s]; where all places are taken the oldest go."""
    if ring.count == len(ring.t):
        drop_oldest(ring)
    slot = ring_slot(ring, ring.count)
    ring.t[slot] = t
    ring.value[slot][:n] = value[:n]
    ring.count += 1


def drop_oldest(ring: SampleRing) -> None:
    """Drop the oldest number."""
    ring.first = ring_slot(ring, 1)
    ring.count -= 1


def span_of(ring: SampleRing) -> float:
    """Return the time [s] from the oldest to the newest entry."""
    return time_at(ring, ring.count - 1) - time_at(ring, 0)


def mean_time(ring: SampleRing, start: int, n: int) -> float:
    """Return the mean time [s] of n entries from `start` on."""
    total = 0.0
    for k in range(start, start + n):
        total += time_at(ring, k)
    return total / n


def median_of(ring: SampleRing, i: int, start: int, n: int) -> float:
    """Return the median of number i of n entries from `start` on."""
    x = zeros(LONGEST)
    for k in range(n):
        value = ring.value[ring_slot(ring, start + k)][i]
        place = k
        while place > 0 and x[place - 1] > value:
            x[place] = x[place - 1]
            place -= 1
        x[place] = value
    if n % 2 == 1:
        return x[n // 2]
    return 0.5 * (x[n // 2 - 1] + x[n // 2])


def value_at(ring: SampleRing, i: int, t: float) -> float:
    """Interpolate number i linearly at time t [s]; before the oldest entry it is that, after the
    newest that.
    """
    after = ring.count - 1
    while after > 0 and time_at(ring, after - 1) > t:
        after -= 1
    old = ring.value[ring_slot(ring, max(after - 1, 0))][i]
    new = ring.value[ring_slot(ring, after)][i]
    from_t = time_at(ring, max(after - 1, 0))
    to_t = time_at(ring, after)
    if t >= to_t or to_t == from_t:
        return new
    if t <= from_t:
        return old
    return (new - old) / (to_t - from_t) * (t - from_t) + old


# Channels that tell the same in two ways, compared over a few seconds.


class DriftWindow(Layout):
    """Differences of a channel from another one that is integrated, over a span of time."""

    span: float
    """[s] of what is remembered."""
    least: float
    """[s] shortest span that tells something."""
    spacing: float
    """[s] time between two samples."""
    tolerance: float
    """[m/s] largest drift without a fault."""
    share: float
    """Share of the way travelled by which the integrated velocity may err besides: its axes and
    scale.
    """
    noise: float
    """[m] standard deviation of a difference."""
    samples: SampleRing
    """Differences (3,) [m] in W, and the length of the way [m]."""
    drifted: bool
    """They drifted apart, and it is not known yet that this is over."""


class VelocityAgainstPosition(Layout):
    """The way between two position fixes, or depths, against the velocity of the DVL, integrated
    over the same time.
    """

    t: float
    """[s] of the last velocity."""
    way: Annotated[Vector, Sized(4)]
    """(4,) [m] integrated velocity in W, and the length of the way."""
    velocity: Annotated[Vector, Sized(3)]
    """(3,) [m/s] last velocity in W."""
    ways: SampleRing
    """`way` at the last readings of the DVL, which late fixes may be compared with."""
    quick: DriftWindow
    """Position fixes over a few seconds."""
    slow: DriftWindow
    """Position fixes over a longer time, for slow drifts."""
    depth: DriftWindow
    """Depths over that longer time, along z alone."""
    quick_depth: DriftWindow
    """Depths over a few seconds."""
    before: Annotated[Vector, Sized(3)]
    """(3,) [m] difference of fixes from the way in W before they began to drift apart."""
    drifted_t: float
    """[s] when they did so for the last time; -inf where `before` is not known."""
    undone: bool
    """Fixes are back from where they had drifted to, and the estimate is not yet."""


class RateAgainstAttitude(Layout):
    """The turn between two attitudes against that of the gyro, integrated over the same time."""

    tolerance: float
    """[rad/s] largest drift without a fault, over a short time."""
    t: float
    """[s] of the last rate."""
    turn: Annotated[Vector, Sized(4)]
    """(4,) quaternion xyzw of the turn that the rates integrate to."""
    rate: Annotated[Vector, Sized(3)]
    """(3,) [rad/s] last rate in B."""
    slow_tolerance: float
    """[rad/s] largest drift without a fault, over a longer time."""
    slow_noise: float
    """[rad] that two attitudes differ by at most by noise."""
    offsets: SampleRing
    """Difference of attitudes from the integrated rate: constant in B where both turn alike."""
    slow_offsets: SampleRing
    """Difference of attitudes from the integrated rate, over a longer time."""
    quick_rate: float
    """[rad/s] at which they turned apart, by the last attitude, over a short time; 0 where they
    agree.
    """
    slow_rate: float
    """[rad/s] at which they turned apart over a longer time; 0 where they agree."""
    step: float
    """[rad/s] largest change of the gyro between two readings, of late."""
    step_t: float
    """[s] when that was."""
    disagreed_t: float
    """[s] when they turned apart over a short time for the last time; -inf once they agree."""
    culprit: int
    """`TurnCulprit` of these, since they began to."""
    refused_t: float
    """[s] of the first of the attitudes that are refused since; inf while the gyro is silent."""
    refused: Annotated[Vector, Sized(4)]
    """(4,) its difference from the integrated rate."""
    refused_offset: Annotated[Vector, Sized(3)]
    """(3,) [rad] its difference from the estimate, in B."""


class TurnCulprit(IntEnum):
    """Channel that explains why gyro and attitude turn apart."""

    UNKNOWN = 0
    GYRO = 1
    ATTITUDE = 2


class DepthAgainstPosition(Layout):
    """The depth against the z of position fixes, less what they differed by at first."""

    tolerance: float
    """[m] change of the difference without a fault."""
    t: float
    """[s] of the last depth."""
    depth: float
    """[m] z in W by the last depth."""
    count: int
    """Number of fixes."""
    first: float
    """[m] sum of the first differences."""
    last: Annotated[Vector, Sized(_LAST)]
    """(5,) [m] newest differences, in a ring."""
    ratio: float
    """Change of the difference, as a share of what is allowed; -1 where it is not known."""


class RateAgainstEncoder(Layout):
    """The way of each joint by its encoder against its rate, integrated, since one of two marks, 10
    to 20 s ago.
    """

    n: int
    """Joints, 0 where they are not judged."""
    tolerance: float
    """[rad/s or m/s] of a drift."""
    noise: float
    """[rad or m] standard deviation of a difference of two positions."""
    awaited: bool
    """The rates of the newest position have not come yet."""
    position_t: float
    """[s] of the newest position."""
    position_before_t: float
    """[s] of the one before it."""
    position: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] the newest one."""
    position_before: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] the one before it."""
    t: float
    """[s] of the last rates."""
    rate: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] last rates."""
    rate_before: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] rates before the last."""
    way: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] integrated rates."""
    variance: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad2 or m2] of the way, by how much each rate lies off those before and after
    it.
    """
    older_t: float
    """[s] time of the older mark, with which positions are compared."""
    newer_t: float
    """[s] time of the newer mark, -inf before the first."""
    older: Annotated[list[Vector], Sized("n_joints", 4)]
    """(n_joints, 4) at the mark: offset of the encoder, way, what a late rate makes of it [rad or
    m], and variance.
    """
    newer: Annotated[list[Vector], Sized("n_joints", 4)]
    """(n_joints, 4) the same four numbers at the newer mark."""
    worst: int
    """Joint that drifts the most beyond what is allowed."""
    drift: float
    """[rad/s or m/s] drift of that joint."""


def init_comparisons(
    velocity: VelocityAgainstPosition,
    rate: RateAgainstAttitude,
    depth: DepthAgainstPosition,
    encoder: RateAgainstEncoder,
    noise: dict[str, float],
    bias: dict[str, float],
) -> None:
    """Prepare all four comparisons; noise and bias [unit of the channel] of each channel."""
    fix = noise["position"]
    turn = math.sqrt(2.0) * noise["attitude"]
    for window, sigma in ((velocity.quick, fix), (velocity.quick_depth, noise["depth"])):
        window.span = _DRIFT_SPAN + 0.5
        window.least = _DRIFT_SPAN
        window.spacing = _SPACING
        window.tolerance = _DRIFT + _SIGMAS * math.sqrt(2.0) * sigma / _DRIFT_SPAN
    for window, sigma in ((velocity.slow, fix), (velocity.depth, noise["depth"])):
        window.span = _LONG_SPAN
        window.least = _LONG_LEAST
        window.spacing = _LONG_SPACING
        window.tolerance = _SLOW_DRIFT + bias["linear_velocity"]
        window.share = _OBLIQUE
        window.noise = sigma
    rate.tolerance = _TURN + _SIGMAS * turn / _TURN_SPAN
    rate.slow_tolerance = _SLOW_TURN + bias["angular_velocity"]
    rate.slow_noise = _SIGMAS * turn
    depth.tolerance = _DEPTH + _SIGMAS * math.hypot(fix, noise["depth"]) * math.sqrt(
        1.0 / _FIRST + 1.0 / _LAST
    )
    encoder.tolerance = _SLOW_JOINT + bias["joint_velocities"]
    encoder.noise = _SIGMAS * math.sqrt(2.0) * noise["joint_positions"]
    depth.ratio = -1.0
    rate.step_t = rate.disagreed_t = -math.inf
    velocity.drifted_t = -math.inf
    velocity.t = rate.t = depth.t = encoder.t = encoder.newer_t = -math.inf
    encoder.position_t = encoder.position_before_t = -math.inf
    rate.turn[3] = 1.0


def update_velocity(comparison: VelocityAgainstPosition, v_W: Vector, t: float) -> None:
    """Integrate the DVL's velocity v_W (3,) [m/s] in W at time t [s]."""
    dt = t - comparison.t
    is_connected = 0.0 <= dt <= _BLIND
    if not is_connected:
        forget_ways(comparison)
        comparison.ways.count = 0
    squared = 0.0
    for i in range(3):
        step = 0.5 * dt * (v_W[i] + comparison.velocity[i]) if is_connected else 0.0
        comparison.way[i] += step
        squared += step * step
        comparison.velocity[i] = v_W[i]
    comparison.way[3] += math.sqrt(squared)
    comparison.t = t
    append_value(comparison.ways, t, comparison.way, 4)


def forget_ways(comparison: VelocityAgainstPosition) -> None:
    """Begin all comparisons with the DVL anew."""
    comparison.drifted_t = -math.inf
    comparison.undone = False
    _forget_offsets(comparison)


def _forget_offsets(comparison: VelocityAgainstPosition) -> None:
    comparison.quick.samples.count = comparison.slow.samples.count = 0
    comparison.depth.samples.count = comparison.quick_depth.samples.count = 0


def compare_place(comparison: VelocityAgainstPosition, value: Vector, t: float, first: int) -> bool:
    """Compare a fix (3,) [m] in W at time t [s], in `quick` and `slow`, or a depth (1,) [m], in
    `depth`; return whether that was possible.

    first: the axis that the value begins with, 0 of a fix and 2 of a depth.
    """
    offset = zeros(4)
    is_comparable = (
        abs(t - comparison.t) <= _GAP
        and comparison.ways.count > 0
        and t >= time_at(comparison.ways, 0)
    )
    for i in range(first, 3):
        if is_comparable:
            offset[i] = value[i - first] - _way_at(comparison, i, t)
        else:
            offset[i] = 0.0
    offset[3] = comparison.way[3]
    if first == 0:
        _append_offset(comparison.quick, offset, t, is_comparable)
        _append_offset(comparison.slow, offset, t, is_comparable)
        _forget_what_is_over(comparison.slow, comparison.quick, first)
    else:
        _append_offset(comparison.quick_depth, offset, t, is_comparable)
        _append_offset(comparison.depth, offset, t, is_comparable)
        _forget_what_is_over(comparison.depth, comparison.quick_depth, first)
    return is_comparable


def note_drift(comparison: VelocityAgainstPosition, t: float) -> None:
    """Note that fixes and the DVL drift apart at time t [s], and what they differed by before."""
    samples = comparison.slow.samples
    if samples.count == 0:
        return
    if t - comparison.drifted_t > _LONG_SPAN:
        for i in range(3):
            comparison.before[i] = median_of(samples, i, 0, max(samples.count // 3, 1))
    comparison.drifted_t = t


def undo_drift(comparison: VelocityAgainstPosition, value: Vector, off: float, t: float) -> bool:
    """Return whether a fix (3,) [m] in W at time t [s], which is off the estimate by off [m], is where
    the DVL has gone since before the two drifted apart: then fixes drifted, and do no more.

    Comparisons then begin anew, as the way back is no drift of the DVL.
    """
    is_known = 0.0 <= t - comparison.drifted_t <= _LONG_SPAN and comparison.ways.count > 0
    if not (is_known and abs(t - comparison.t) <= _GAP):
        return False
    squared = 0.0
    for i in range(3):
        rest = value[i] - _way_at(comparison, i, t) - comparison.before[i]
        squared += rest * rest
    if math.sqrt(squared) > _UNDONE * off:
        return False
    comparison.undone = True
    _forget_offsets(comparison)
    return True


def end_drift(comparison: VelocityAgainstPosition) -> None:
    """Forget from where fixes had drifted once the estimate is back there too."""
    if comparison.undone:
        comparison.drifted_t = -math.inf
        comparison.undone = False


def _forget_what_is_over(slow: DriftWindow, quick: DriftWindow, first: int) -> None:
    """Begin the longer comparison anew where a drift, or a jump, that shows in the quick one has
    ended: it would be blamed for as long as the longer one remembers, on a sound channel too.
    """
    ratio = drift_ratio(quick, first, quick.least)
    if ratio > _DRIFTS:
        quick.drifted = True
    elif quick.drifted and 0.0 <= ratio < _AGREES_AGAIN:
        quick.drifted = False
        slow.samples.count = 0


def _append_offset(window: DriftWindow, offset: Vector, t: float, is_comparable: bool) -> None:
    samples = window.samples
    if not is_comparable:
        samples.count = 0
    elif samples.count == 0 or t - time_at(samples, samples.count - 1) >= window.spacing:
        append_value(samples, t, offset, 4)
        while span_of(samples) > window.span:
            drop_oldest(samples)


def drift_rate(window: DriftWindow, first: int) -> float:
    """Return the rate [m/s] at which the two places of a window drift apart along axes `first` to
    2; 0 where they agree, or too little is known.
    """
    if drift_ratio(window, first, window.least) > 1.0:
        return _change(window, first) / _time_of_change(window)
    return 0.0


def drift_ratio(window: DriftWindow, first: int, least: float) -> float:
    """Return by how much the two places of a window drift apart along axes `first` to 2, as a share
    of what is allowed; -1 where less is known than of a span of least [s].
    """
    samples = window.samples
    n = samples.count // 3
    if n == 0 or span_of(samples) < least:
        return -1.0
    way = samples.value[ring_slot(samples, samples.count - 1)][3] - samples.value[samples.first][3]
    allowed = (
        window.tolerance * _time_of_change(window)
        + window.share * way
        + _SIGMAS * _MEDIAN * math.sqrt(2.0 / n) * window.noise
    )
    return _change(window, first) / allowed


def _change(window: DriftWindow, first: int) -> float:
    """Return the change [m] along axes `first` to 2 from the first third of the span to the last
    one, by their medians, which fixes that are far off now and then do not move.
    """
    samples = window.samples
    n = samples.count // 3
    squared = 0.0
    for i in range(first, 3):
        change = median_of(samples, i, samples.count - n, n) - median_of(samples, i, 0, n)
        squared += change * change
    return math.sqrt(squared)


def _time_of_change(window: DriftWindow) -> float:
    """Return the time [s] from the first third of the span to the last one."""
    samples = window.samples
    n = samples.count // 3
    return mean_time(samples, samples.count - n, n) - mean_time(samples, 0, n)


def _way_at(comparison: VelocityAgainstPosition, i: int, t: float) -> float:
    """Return the way [m] along axis i by the DVL until time t [s], at which a late fix was taken,
    some readings ago.
    """
    if t >= comparison.t:
        return comparison.way[i] + (t - comparison.t) * comparison.velocity[i]
    return value_at(comparison.ways, i, t)


def update_rate(comparison: RateAgainstAttitude, omega: Vector, t: float) -> None:
    """Integrate the gyro's omega (3,) [rad/s] in B at time t [s]."""
    dt = t - comparison.t
    mean = zeros(3)
    squared = 0.0
    for i in range(3):
        mean[i] = omega[i] + comparison.rate[i]
        change = omega[i] - comparison.rate[i]
        squared += change * change
        comparison.rate[i] = omega[i]
    comparison.t = t
    if 0.0 <= dt <= _GAP:
        if math.sqrt(squared) > comparison.step or t - comparison.step_t > _GAP:
            comparison.step = math.sqrt(squared)
            comparison.step_t = t
        _turn_on(comparison, mean, 0.5 * dt, comparison.turn)
        normalize(comparison.turn)
    else:
        comparison.step = 0.0  # of a silence nothing tells whether the gyro stepped in it
        comparison.offsets.count = comparison.slow_offsets.count = 0


def compare_turns(comparison: RateAgainstAttitude, quaternion: Vector, t: float) -> None:
    """Find the rates at which the two turn apart, by the attitude quaternion (4,), xyzw, at time t
    [s].
    """
    comparison.quick_rate = comparison.slow_rate = 0.0
    if not abs(t - comparison.t) <= _GAP:
        comparison.offsets.count = comparison.slow_offsets.count = 0
        return
    offset = zeros(4)
    _turn_apart(comparison, quaternion, t, offset)
    quick = _turn_in(comparison.offsets, offset, t, _TURN_SPAN, _TURN_SPAN, _SPACING)
    slow = _turn_in(comparison.slow_offsets, offset, t, _LONG_LEAST, _LONG_SPAN, _LONG_SPACING)
    if slow >= 0.0:
        comparison.slow_rate = _slow_turn(comparison)
    if 0.0 <= quick < _AGREES_AGAIN * comparison.tolerance:
        comparison.disagreed_t = -math.inf  # what disagrees next may be the other one
    elif quick > comparison.tolerance:
        comparison.quick_rate = quick
        forget_turns(comparison)
        if t - comparison.disagreed_t > _GAP:
            comparison.culprit = _culprit_of_turn(comparison)
        comparison.disagreed_t = t


def _slow_turn(comparison: RateAgainstAttitude) -> float:
    """Return the rate [rad/s] at which attitudes have turned apart from the gyro since any of the
    offsets that are old enough; 0 where it is within what is allowed, since all of them.
    """
    samples = comparison.slow_offsets
    last = ring_slot(samples, samples.count - 1)
    fastest = 0.0
    for k in range(samples.count):
        span = samples.t[last] - time_at(samples, k)
        if span < _LONG_LEAST - 1e-6:
            break
        turned = angle_between(samples.value[ring_slot(samples, k)], samples.value[last])
        if turned > comparison.slow_tolerance * span + comparison.slow_noise:
            fastest = max(fastest, turned / span)
    return fastest


def _culprit_of_turn(comparison: RateAgainstAttitude) -> int:
    """Return the `TurnCulprit` where gyro and attitude begin to turn apart: which of the two has
    changed at once by what they differ by. What drifts away may be either, and what the gyro read
    wrong by as much as it has changed is no jump of the attitude.
    """
    samples = comparison.offsets
    oldest = samples.value[samples.first]
    newest = samples.value[ring_slot(samples, samples.count - 1)]
    largest = 0.0
    for k in range(1, samples.count):
        before = samples.value[ring_slot(samples, k - 1)]
        turned = angle_between(before, samples.value[ring_slot(samples, k)])
        by_gyro = comparison.step * (time_at(samples, k) - time_at(samples, k - 1))
        if turned > _CLEAR * by_gyro:
            largest = max(largest, turned)
    if largest > _AT_ONCE * angle_between(oldest, newest):
        return TurnCulprit.ATTITUDE
    if comparison.step > _AT_ONCE * comparison.quick_rate:
        return TurnCulprit.GYRO
    return TurnCulprit.UNKNOWN


def forget_turns(comparison: RateAgainstAttitude) -> None:
    """Begin the longer comparison anew: what has turned apart by a fault that was found must not
    count again when it is over.
    """
    comparison.slow_offsets.count = 0


def _turn_in(
    samples: SampleRing,
    offset: Vector,
    t: float,
    least: float,
    longest: float,
    spacing: float,
) -> float:
    """Return the rate [rad/s] at which offsets turn over a span of least [s] to longest [s]; -1
    before, and for an offset that comes within `spacing` [s] of the last.
    """
    if samples.count > 0 and t - time_at(samples, samples.count - 1) < spacing:
        return -1.0
    append_value(samples, t, offset, 4)
    while span_of(samples) > longest + spacing:
        drop_oldest(samples)
    span = span_of(samples)
    if span < least - 1e-6:
        return -1.0
    return (
        angle_between(
            samples.value[samples.first], samples.value[ring_slot(samples, samples.count - 1)]
        )
        / span
    )


def _turn_apart(comparison: RateAgainstAttitude, quaternion: Vector, t: float, out: Vector) -> None:
    """Out (4,) becomes the difference of an attitude (4,) at time t [s] from the integrated rate."""
    turned = zeros(4)
    _turn_on(comparison, comparison.rate, t - comparison.t, turned)
    conjugate(turned)
    multiply(quaternion, turned, out)


def is_estimate_turning(
    comparison: RateAgainstAttitude, quaternion: Vector, offset: Vector, t: float, is_first: bool
) -> bool:
    """Return whether an estimate turns away from attitudes that are refused, and that turn as the
    gyro does: then it is the estimate that is wrong, by what it takes for the bias of the gyro.

    quaternion (4,) at time t [s], offset (3,) [rad] from the estimate in B; is_first: of the
    attitudes that are refused in a row.
    """
    apart = zeros(4)
    _turn_apart(comparison, quaternion, t, apart)
    is_known = abs(t - comparison.t) <= _BLIND
    if is_first or not is_known or not math.isfinite(comparison.refused_t):
        comparison.refused_t = t if is_known else math.inf
        comparison.refused[:4] = apart[:4]
        comparison.refused_offset[:3] = offset[:3]
        return False
    squared = 0.0
    for i in range(3):
        change = offset[i] - comparison.refused_offset[i]
        squared += change * change
    by_gyro = angle_between(apart, comparison.refused)
    allowed = _TURN + comparison.slow_tolerance * (t - comparison.refused_t)
    return math.sqrt(squared) > allowed + _CLEAR * by_gyro


def _turn_on(comparison: RateAgainstAttitude, rate: Vector, dt: float, out: Vector) -> None:
    """Write the turn after dt [s] more of a rate (3,) [rad/s] into out (4,)."""
    by = zeros(4)
    small_rotation(rate, dt, by)
    multiply(comparison.turn, by, out)


def update_depth(comparison: DepthAgainstPosition, z: float, t: float) -> None:
    """Remember the depth z [m] of time t [s]."""
    comparison.depth = z
    comparison.t = t


def depth_difference(comparison: DepthAgainstPosition, z: float, climb: float, t: float) -> float:
    """Return by how much [m] the two differ, by the z [m] of a fix at time t [s] and the climb
    [m/s]; 0 where they agree.
    """
    comparison.ratio = -1.0
    if not abs(t - comparison.t) <= _GAP:
        return 0.0
    difference = z - comparison.depth - (t - comparison.t) * climb
    comparison.count += 1
    if comparison.count <= _FIRST:
        comparison.first += difference
        return 0.0
    comparison.last[comparison.count % _LAST] = difference
    # The last differences, oldest first, added up [m].
    total = 0.0
    for i in range(1, _LAST + 1):
        total += comparison.last[(comparison.count + i) % _LAST]
    by = abs(total / _LAST - comparison.first / _FIRST)
    if comparison.count >= _FIRST + _LAST:
        comparison.ratio = by / comparison.tolerance
    if comparison.ratio > 1.0:
        return by
    return 0.0


# Three channels tell the height: which of them is wrong, by all three pairs at once.


class HeightPairs(Layout):
    """Drifts of the three pairs of channels that tell of the height, as shares of what is allowed;
    -1 where too little is known.
    """

    fixes_and_velocity: float
    depths_and_velocity: float
    fixes_and_depths: float


class Culprit(IntEnum):
    """Channel that explains what the pairs disagree by."""

    UNKNOWN = 0
    FIXES = 1
    DEPTHS = 2
    VELOCITY = 3


def compare_heights(
    pairs: HeightPairs, velocity: VelocityAgainstPosition, depth: DepthAgainstPosition
) -> None:
    """Update all three pairs."""
    pairs.fixes_and_velocity = max(
        drift_ratio(velocity.quick, 2, _DRIFT_SPAN), drift_ratio(velocity.slow, 2, _DRIFT_SPAN)
    )
    pairs.depths_and_velocity = drift_ratio(velocity.depth, 2, _DRIFT_SPAN)
    pairs.fixes_and_depths = depth.ratio


def is_height_disputed(pairs: HeightPairs) -> bool:
    """Return whether two of the three have begun to disagree, by more than noise."""
    largest = max(pairs.depths_and_velocity, pairs.fixes_and_depths)
    return max(pairs.fixes_and_velocity, largest) > _DISPUTED


def culprit_of(pairs: HeightPairs) -> int:
    """Return the `Culprit`: the one channel without which hardly anything is left to explain, where
    without either other one much is.

    A pair that disagrees blames one of two; the pair of the other two tells whether it was this
    one.
    """
    without_fixes = pairs.depths_and_velocity
    without_depths = pairs.fixes_and_velocity
    without_velocity = pairs.fixes_and_depths
    least = min(without_fixes, min(without_depths, without_velocity))
    if least < 0.0 or max(without_fixes, max(without_depths, without_velocity)) < _DOUBTFUL:
        return Culprit.UNKNOWN
    needed = _CLEAR * least + _CLEAR_BY
    if min(without_depths, without_velocity) >= needed:
        return Culprit.FIXES
    if min(without_fixes, without_velocity) >= needed:
        return Culprit.DEPTHS
    if min(without_fixes, without_depths) >= needed:
        return Culprit.VELOCITY
    return Culprit.UNKNOWN


def update_joint_rates(comparison: RateAgainstEncoder, rates: Vector, t: float) -> None:
    """Integrate the rates (n_joints,) [rad/s or m/s] of the joints at time t [s]."""
    dt = t - comparison.t if 0.0 <= t - comparison.t <= _BLIND else 0.0
    for i in range(comparison.n):
        bend = dt * (rates[i] - 2.0 * comparison.rate[i] + comparison.rate_before[i])
        comparison.way[i] += 0.5 * dt * (rates[i] + comparison.rate[i])
        comparison.variance[i] += bend * bend / 6.0
        comparison.rate_before[i] = comparison.rate[i]
        comparison.rate[i] = rates[i]
    if not 0.0 <= t - comparison.t <= _BLIND:
        forget_joint_ways(comparison)
    comparison.t = t


def update_encoders(comparison: RateAgainstEncoder, value: Vector, t: float) -> None:
    """Take in the positions (n_joints,) [rad or m] of the joints at time t [s]."""
    comparison.position_before_t = comparison.position_t
    comparison.position_t = t
    for i in range(comparison.n):
        comparison.position_before[i] = comparison.position[i]
        comparison.position[i] = value[i]
    comparison.awaited = True


def is_seen_by_encoder(comparison: RateAgainstEncoder, i: int, rate: float, t: float) -> bool:
    """Return whether the encoder of joint i has gone along with a rate [rad/s or m/s] at time t [s]
    that is another one than at the last reading.

    An encoder whose rate alone is wrong has gone none of the way.
    """
    span = comparison.position_t - comparison.position_before_t
    change = rate - comparison.rate[i]
    is_of_now = abs(comparison.position_t - t) <= 0.5 * span
    if not (is_of_now and span <= _GAP and comparison.noise < LEAST_TRAVEL * abs(change) * span):
        return False
    gone = (comparison.position[i] - comparison.position_before[i]) / span - comparison.rate[i]
    return goes_along(gone, change)


def forget_joint_ways(comparison: RateAgainstEncoder) -> None:
    """Begin the comparison anew."""
    comparison.newer_t = -math.inf


def is_adrift(comparison: RateAgainstEncoder) -> bool:
    """Return whether the encoder of a joint, `worst`, drifts from its rate, by its newest position,
    once rates of the same time are known.
    """
    t = comparison.position_t
    if not comparison.awaited or t > comparison.t:
        return False
    comparison.awaited = False
    if not comparison.t - t <= _BLIND:
        forget_joint_ways(comparison)
        return False
    first = comparison.newer_t == -math.inf
    due = t - comparison.newer_t >= _ENCODER_SPAN
    excess = 0.0
    if due:
        comparison.older_t = t if first else comparison.newer_t
        comparison.newer_t = t
    for i in range(comparison.n):
        mark = comparison.older[i]
        late = _RATE_DELAY * abs(comparison.rate[i])
        way = comparison.way[i] - (comparison.t - t) * comparison.rate[i]
        offset = comparison.position[i] - way
        if due and not first:
            mark[:4] = comparison.newer[i][:4]
        if due:
            comparison.newer[i][0] = offset
            comparison.newer[i][1] = comparison.way[i]
            comparison.newer[i][2] = late
            comparison.newer[i][3] = comparison.variance[i]
        if first:
            mark[:4] = comparison.newer[i][:4]
        change = abs(offset - mark[0])
        span = t - comparison.older_t
        allowed = (
            comparison.tolerance * span
            + _OBLIQUE * abs(comparison.way[i] - mark[1])
            + late
            + mark[2]
            + comparison.noise
        )
        beyond = change - allowed - _RATE_SIGMAS * math.sqrt(comparison.variance[i] - mark[3])
        if span >= _LONG_LEAST and beyond > excess:
            comparison.worst = i
            comparison.drift = change / span
            excess = beyond
    return excess > 0.0
