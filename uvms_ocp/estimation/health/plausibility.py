"""Check one reading by itself and against the estimate of its time: sanity, time stamps,
plausibility gates.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros
from uvms_ocp.estimation.filter_memory import ChannelIndex, pushed_time
from uvms_ocp.estimation.health.tuning import Complaint, Reason, set_complaint
from uvms_ocp.estimation.tuning import JOLT_TIME
from uvms_ocp.estimation.vehicle_model import multiply, normalize

_UNIT = 1e-3  # by which the norm of a quaternion may differ from 1, as in records

_SHARE = 0.5  # of the noise that a sensor is said to have, which it is taken to have at least
_FINE = 1e-3  # of the noise: a resolution that is finer makes no difference
_ENOUGH = 5e-3  # of the noise: what is known to be finer is not looked at any more
_LEAST = 3  # repetitions, however unlikely: some sensors send a reading twice
_NEVER = 1e-300

CHANCE = 1e-9
"""Probability below which noise does not repeat a value, nor chance lose readings in a row; 1e8
readings fit into a hundred hours of gyro.
"""


# Quaternions xyzw for kernels.


def conjugate(a: Vector) -> None:
    """Conjugate the quaternion a (4,) in place."""
    for i in range(3):
        a[i] = -a[i]


def small_rotation(by: Vector, share: float, out: Vector) -> None:
    """Write the quaternion of a small rotation by a share of the vector `by` (3,) [rad] into out
    (4,).
    """
    for i in range(3):
        out[i] = 0.5 * (share * by[i])
    out[3] = 1.0 - 0.5 * (out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    normalize(out)


def rotate(q: Vector, by: Vector, out: Vector) -> None:
    """Write the vector `by` (3,), rotated by the quaternion at entries 3 to 6 of q, into out (3,),
    which is another array.
    """
    u = zeros(3)
    u[0] = 2.0 * (q[4] * by[2] - q[5] * by[1])
    u[1] = 2.0 * (q[5] * by[0] - q[3] * by[2])
    u[2] = 2.0 * (q[3] * by[1] - q[4] * by[0])
    out[0] = by[0] + q[6] * u[0] + (q[4] * u[2] - q[5] * u[1])
    out[1] = by[1] + q[6] * u[1] + (q[5] * u[0] - q[3] * u[2])
    out[2] = by[2] + q[6] * u[2] + (q[3] * u[1] - q[4] * u[0])


def angle_between(a: Vector, b: Vector) -> float:
    """Return the angle [rad] between the rotations of the quaternions a (4,) and b (4,)."""
    back = zeros(4)
    between = zeros(4)
    back[:4] = b[:4]
    conjugate(back)
    multiply(a, back, between)
    size = math.sqrt(between[0] * between[0] + between[1] * between[1] + between[2] * between[2])
    return 2.0 * math.atan2(size, abs(between[3]))


# The last estimates, to ask what was estimated when a late reading was taken.


class PastEstimate(Layout):
    """Estimate of one tick, kept for comparisons with later readings."""

    t: float
    """[s] time of the tick."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] estimated configuration."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] estimated velocity."""
    beam_at: Annotated[Vector, Sized(3)]
    """(3,) [m] the altimeter in B."""
    beam_up: Annotated[Vector, Sized(3)]
    """(3,) z axis of the altimeter in B."""


class EstimateHistory(Layout):
    """Estimates in the order of time, in a ring."""

    length: float
    """[s] for which they are kept."""
    spacing: float
    """[s] between two at least, the newest aside: so many fit."""
    first: int
    count: int
    kept: Annotated[list[PastEstimate], Sized("n_estimates")]


def remember(history: EstimateHistory, present: PastEstimate) -> None:
    """Keep the estimate of a tick."""
    if (
        history.count >= 2
        and _time(history, history.count - 1) - _time(history, history.count - 2) < history.spacing
    ):
        history.count -= 1
    if history.count == len(history.kept):
        _drop(history)
    _copy_estimate(history.kept[(history.first + history.count) % len(history.kept)], present)
    history.count += 1
    while _time(history, 0) < present.t - history.length:
        _drop(history)


def slot_at(history: EstimateHistory, t: float) -> int:
    """Return the slot of the estimate that was made nearest to time t [s]; -1 before the first."""
    if history.count == 0:
        return -1
    low = 0
    high = history.count - 1
    if t >= _time(history, high):
        low = high
    while high - low > 1:
        middle = (low + high) // 2
        if _time(history, middle) <= t:
            low = middle
        else:
            high = middle
    nearest = low if abs(_time(history, low) - t) <= abs(_time(history, high) - t) else high
    return (history.first + nearest) % len(history.kept)


def _time(history: EstimateHistory, k: int) -> float:
    return history.kept[(history.first + k) % len(history.kept)].t


def _drop(history: EstimateHistory) -> None:
    history.first = (history.first + 1) % len(history.kept)
    history.count -= 1


def _copy_estimate(to: PastEstimate, source: PastEstimate) -> None:
    to.t = source.t
    to.q[:] = source.q
    to.v[:] = source.v
    to.beam_at[:] = source.beam_at
    to.beam_up[:] = source.beam_up


# What no reading of a working sensor can be: not a number, of another size, from the future.


def is_nonsense(channel: int, value: Vector, size: int, why: Complaint) -> bool:
    """Return whether a value of size numbers means nothing. A range that is nan is no echo."""
    if channel == ChannelIndex.ALTIMETER_RANGE and value[0] < 0.0:
        return set_complaint(why, Reason.RANGE, value[0], 0.0)
    for i in range(size):
        if not math.isfinite(value[i]) and not (
            channel == ChannelIndex.ALTIMETER_RANGE and math.isnan(value[i])
        ):
            return set_complaint(why, Reason.NO_NUMBER, 0.0, 0.0)
    return channel == ChannelIndex.ATTITUDE and _is_no_rotation(value, why)


def is_mistimed(stamp: float, last: float, t: float, clock: float, why: Complaint) -> bool:
    """Return whether a time stamp [s] cannot be, after the `last` [s] one that was used and at time
    t [s]; clock [s] of grace.
    """
    if stamp > t + clock:
        set_complaint(why, Reason.FUTURE, stamp - t, 0.0)
    elif stamp < last:
        set_complaint(why, Reason.BEFORE, last - stamp, 0.0)
    return stamp > t + clock or stamp < last


def _is_no_rotation(value: Vector, why: Complaint) -> bool:
    squared = value[0] * value[0] + value[1] * value[1] + value[2] * value[2] + value[3] * value[3]
    if abs(squared - 1.0) <= 2.0 * _UNIT:
        return False
    return set_complaint(why, Reason.LENGTH, math.sqrt(squared), 0.0)


# Whether a reading can be true, given where the robot was estimated to be when it was taken.


class PlausibilityGate(Layout):
    """Gate of plausibility: how far a reading may differ from the estimate, at once and for every
    second without any.

    It grows with that time without end, so that it never shuts a channel out for good.
    """

    exists: bool
    channel: int
    """`ChannelIndex` of the channel."""
    orders: int
    """Integrations from an acceleration to what the channel reads."""
    size: int
    """Numbers of its value."""
    start: int
    """Index at which they begin in q or v."""
    base: float
    """[unit of the channel] difference that is allowed at once."""
    noise: float
    """[unit of the channel] by which readings differ by themselves, of the base."""
    supported: float
    """[unit of the channel / s] growth while another channel carries the estimate."""
    alone: float
    """[unit of the channel / s] growth otherwise: what is physically possible."""
    jolt: float
    """[unit of the channel / s2, or of a rate's / s] unplanned acceleration that is allowed."""
    push: float
    """[unit of a rate / s] acceleration by weight and one thruster, which is allowed for a whole tick of
    a slow loop; 0 of what is no rate.
    """
    rates: int
    """Index in v of the first rate of the joints whose positions the channel tells; -1 for another
    channel.
    """
    by: int
    """A channel that carries the estimate, -1 for none."""
    or_by: int
    """A second channel that carries the estimate, -1 for none."""
    most: float
    """[unit of the channel] largest norm of a value that is possible."""


def motion_within(gate: PlausibilityGate, estimate: PastEstimate, time: float) -> float:
    """Return how far [unit of the channel] the robot may move unforeseen within a time [s]."""
    rate = gate.alone
    short = min(time, JOLT_TIME)
    for i in range(gate.rates, len(estimate.v) if gate.rates >= 0 else -1):
        rate = max(
            rate, 2.0 * abs(estimate.v[i])
        )  # what is known to move faster than it should, and faster yet
    if gate.orders == 1:
        return rate * time + max(gate.jolt * short, gate.push * pushed_time(time))
    return rate * time + gate.jolt * (short * short / 2.0)


def is_impossible(gate: PlausibilityGate, value: Vector, why: Complaint) -> bool:
    """Return whether no robot of this kind can ever read the value (size,) [unit of the
    channel].
    """
    if not (gate.exists and math.isfinite(gate.most)):
        return False
    squared = 0.0
    for i in range(gate.size):
        squared += value[i] * value[i]
    if math.sqrt(squared) <= gate.most:
        return False
    return set_complaint(why, Reason.LARGE, math.sqrt(squared), gate.most)


def error_of(gate: PlausibilityGate, value: Vector, estimate: PastEstimate) -> float:
    """Return how far a value (size,) is from the estimate [unit of the channel]."""
    if gate.channel == ChannelIndex.ATTITUDE:
        q = estimate.q
        along = value[0] * q[3] + value[1] * q[4] + value[2] * q[5] + value[3] * q[6]
        return 2.0 * math.acos(min(1.0, abs(along)))
    if gate.channel == ChannelIndex.POSITION or gate.channel == ChannelIndex.DEPTH:
        return distance(gate, value, estimate.q)
    if gate.channel == ChannelIndex.JOINT_POSITIONS:
        return _largest(gate, value, estimate.q)
    if gate.channel == ChannelIndex.JOINT_VELOCITIES:
        return _largest(gate, value, estimate.v)
    return distance(gate, value, estimate.v)


def distance(gate: PlausibilityGate, value: Vector, estimated: Vector) -> float:
    """Return how far a value (size,) [unit of the channel] is from that of q or v, in which its
    gate knows its place.
    """
    squared = 0.0
    for i in range(gate.size):
        by = value[i] - estimated[gate.start + i]
        squared += by * by
    return math.sqrt(squared)


def offset_of(gate: PlausibilityGate, value: Vector, estimate: PastEstimate, out: Vector) -> None:
    """Out (size,) becomes a value (size,) of a place less the estimate [unit of the channel]; of an
    attitude, nearly, a rotation vector in B, and 0. Rates leave no place behind: 0.
    """
    if gate.channel == ChannelIndex.ATTITUDE:
        back = zeros(4)
        between = zeros(4)
        for i in range(4):
            back[i] = estimate.q[3 + i]
        conjugate(back)
        multiply(back, value, between)
        twice = 2.0 if between[3] >= 0.0 else -2.0
        for i in range(3):
            out[i] = twice * between[i]
        out[3] = 0.0
        return
    for i in range(gate.size):
        if gate.orders > 1:
            out[i] = value[i] - estimate.q[gate.start + i]
        else:
            out[i] = 0.0


def _largest(gate: PlausibilityGate, value: Vector, estimated: Vector) -> float:
    largest = 0.0
    for i in range(gate.size):
        largest = max(largest, abs(value[i] - estimated[gate.start + i]))
    return largest


# Whether a sensor repeats itself although it has noise: it is frozen.
#
# A sensor repeats a value by chance where its resolution is no finer than its noise. All changes of a
# component are multiples of its resolution, whose upper bound is their greatest common measure; so
# the chance p of one repetition is at most that of noise staying within it, and n repetitions speak
# against the sensor where p^n is below a chance that one does not expect to meet. Components of a
# position come from instruments of their own, such as a depth beside fixes in the plane, so each has
# its own p; of other sensors one that has never changed has that of the others. One at rest whose
# resolution is much coarser than its noise has p near 1 and never alarms; nor does one without noise.


class RepetitionMemory(Layout):
    """Counts of how often each component of a channel has repeated itself."""

    noise: float
    """[unit of the channel] standard deviation of the noise that the channel has, or less."""
    each: bool
    """Judge every component by itself, not all together alone."""
    alike: bool
    """All components have one resolution."""
    chance: float
    """Logarithm of the probability below which repetitions are no chance."""
    size: int
    """Components."""
    started: bool
    finest: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] greatest common measure of all changes of each so far; no
    finer than `_FINE` of the noise.
    """
    last: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] the newest value, `size` numbers."""
    runs: Annotated[list[int], Sized("n_width")]
    """(n_width,) repetitions of each."""


def init_repetitions(
    memory: RepetitionMemory, sigma: float, *, size: int, each: bool, alike: bool = True
) -> None:
    """Prepare a `RepetitionMemory`: noise sigma [unit of the channel] of size components."""
    memory.noise = _SHARE * sigma
    memory.each = each
    memory.alike = alike
    memory.chance = math.log(CHANCE)
    memory.size = size
    memory.finest[:size] = [math.inf] * size


def repeated(repetition: RepetitionMemory, value: Vector, why: Complaint) -> bool:
    """Return whether the channel counts as frozen, by its newest value (size,) [unit of the
    channel].
    """
    if repetition.noise == 0.0:
        return False
    fresh = not repetition.started
    same = False
    for i in range(repetition.size):
        if fresh:
            repetition.runs[i] = 0
        elif value[i] == repetition.last[i]:
            repetition.runs[i] += 1
            same = True
        else:
            repetition.runs[i] = 0
            if repetition.finest[i] > _ENOUGH * repetition.noise:
                change = abs(value[i] - repetition.last[i])
                least = _FINE * repetition.noise
                repetition.finest[i] = _common(repetition.finest[i], change, least)
        repetition.last[i] = value[i]
    repetition.started = True
    return same and _too_often(repetition, why)


def _too_often(repetition: RepetitionMemory, why: Complaint) -> bool:
    together = repetition.runs[0]
    for i in range(1, repetition.size):
        together = min(together, repetition.runs[i])
    stand_still = together >= _LEAST and _are_unlikely(repetition, together)
    least_likely = _least_likely(repetition) if repetition.each else -1
    if stand_still or (least_likely >= 0 and (together >= _LEAST or repetition.size == 1)):
        return set_complaint(why, Reason.REPEATED, _longest_run(repetition) + 1, 0)
    if least_likely >= 0:
        run = repetition.runs[least_likely]
        return set_complaint(why, Reason.REPEATED, run + 1, least_likely + 1)
    return False


def _are_unlikely(repetition: RepetitionMemory, together: int) -> bool:
    """Return whether so many repetitions of all components together cannot be by chance."""
    log_probability = 0.0
    for i in range(repetition.size):
        log_probability += together * _log_probability(repetition, i)
    return log_probability < repetition.chance


def _least_likely(repetition: RepetitionMemory) -> int:
    """Return the component whose repetitions are the least likely; -1 where all may be by
    chance.
    """
    component = -1
    least = repetition.chance
    for i in range(repetition.size):
        log_probability = repetition.runs[i] * _log_probability(repetition, i)
        if repetition.runs[i] >= _LEAST and log_probability < least:
            least = log_probability
            component = i
    return component


def _longest_run(repetition: RepetitionMemory) -> int:
    longest = 0
    for i in range(repetition.size):
        longest = max(longest, repetition.runs[i])
    return longest


def _log_probability(repetition: RepetitionMemory, i: int) -> float:
    """Return the logarithm of the chance of one repetition of a component."""
    finest = repetition.finest[i]
    if repetition.alike and not math.isfinite(finest):
        for k in range(repetition.size):
            finest = min(finest, repetition.finest[k])
    if not math.isfinite(finest):
        return 0.0
    p = math.erf(finest / (2.0 * repetition.noise))
    return math.log(max(p, _NEVER))


def _common(measure: float, step: float, tolerance: float) -> float:
    """Compute the greatest common measure of two lengths > 0 by Euclid's algorithm, not below the
    tolerance; inf is a multiple of all.
    """
    while step > tolerance:
        if math.isfinite(measure):
            rest = abs(math.remainder(measure, step))
        else:
            rest = 0.0
        measure = step
        step = rest
    return max(measure, tolerance)


# Encoders that do not change by a bit while their joints are asked to move.
#
# This holds for exact and for coarse encoders too: a joint that follows its command changes them.
# Joints with locked brakes are not asked to move, and robots whose joints have several numbers each
# are not judged.


class EncoderMemory(Layout):
    """Way that each joint was asked to go since its encoder last changed."""

    n: int
    """Joints, 0 where they are not judged."""
    allowed: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] that may be asked: some travel, and what encoders are late by at full
    speed.
    """
    rates: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] that have been asked since the last tick."""
    asked: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] way that each joint was asked to go since its encoder last changed."""
    started: bool
    last: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] the newest value."""


def integrate_command(encoder: EncoderMemory, moving: bool, dt: float) -> None:
    """Integrate the commanded rates over dt [s]; moving: there was a command, and no brakes."""
    for i in range(encoder.n):
        encoder.asked[i] = encoder.asked[i] + encoder.rates[i] * dt if moving else 0.0


def stands_still(encoder: EncoderMemory, value: Vector, why: Complaint) -> bool:
    """Return whether an encoder counts as frozen, by the newest value (n_joints,) [rad or m]."""
    worst = 0
    excess = 0.0
    for i in range(encoder.n):
        if encoder.started and value[i] != encoder.last[i]:
            encoder.asked[i] = 0.0
        encoder.last[i] = value[i]
        beyond = abs(encoder.asked[i]) - encoder.allowed[i]
        if beyond > excess:
            worst = i
            excess = beyond
    encoder.started = True
    if excess > 0.0:
        set_complaint(why, Reason.STILL, worst, encoder.asked[worst])
    return excess > 0.0
