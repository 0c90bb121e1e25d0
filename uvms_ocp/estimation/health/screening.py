"""Screen every new reading before the filter sees it, and decide which of two channels that
disagree is at fault.

A reading is checked for its sense, its time stamp, repetition, and against what the estimate of its
time allows.
"""

from __future__ import annotations

import math

from uvms_ocp.codegen.kernel_layout import Vector, zeros
from uvms_ocp.estimation.filter_memory import ChannelIndex
from uvms_ocp.estimation.health import floor, plausibility, redundancy
from uvms_ocp.estimation.health.channel_state import (
    TOO_LATE,
    ChannelMemory,
    HealthMemory,
    ScreeningResult,
    culprit_of_height,
    exclude,
    is_attitude_doubted,
    is_turned_by_attitude,
    is_vouched_for,
    suspect,
    undoes_jump,
)
from uvms_ocp.estimation.health.tuning import Complaint, Reason, set_complaint
from uvms_ocp.robot import kinematics, signals

_CONFIRMED = 5
"""Readings in a row that must agree before one that does not is refused: an estimate is made of
those before.
"""
_STUBBORN = 3
"""Readings in a row that were refused: by then it is no spike."""
_NEXT = 1.5
"""Periods of a channel in which its next reading arrives."""

_RECENT = 10.0  # [s] for which a refused reading speaks against its channel when it comes to blame


def screen_reading(health: HealthMemory, channel: ChannelMemory, slot: int) -> None:
    """Screen the newest reading of a channel, into `belief`; slot of the estimate of its time, -1
    for none.
    """
    belief = health.belief
    channel.off = -1.0
    belief.sane = not (
        _means_nothing(health, channel, belief.why) or _cannot_be(health, channel, belief.why)
    )
    belief.used = belief.sane
    if not belief.sane:
        return
    belief.why.code = Reason.NONE
    if slot >= 0 and not is_empty(channel):
        _compare_with_estimate(health, channel, health.history.kept[slot], belief)
    late = health.t - channel.stamp - channel.delay
    if belief.why.code == Reason.NONE and late > health.late + health.dt:
        set_complaint(belief.why, Reason.LATE, late, health.late + health.dt)


def is_empty(channel: ChannelMemory) -> bool:
    """Return whether the newest reading is an echo that did not come back."""
    return channel.number == ChannelIndex.ALTIMETER_RANGE and math.isnan(channel.value[0])


def _means_nothing(health: HealthMemory, channel: ChannelMemory, why: Complaint) -> bool:
    if not math.isfinite(channel.stamp):
        return set_complaint(why, Reason.STAMP, channel.stamp, 0.0)
    if channel.misshapen > 0:
        return set_complaint(why, Reason.SHAPE, channel.misshapen, 0.0)
    return plausibility.is_nonsense(
        channel.number, channel.value, channel.size, why
    ) or plausibility.is_mistimed(channel.stamp, channel.used, health.t, health.clock, why)


def _cannot_be(health: HealthMemory, channel: ChannelMemory, why: Complaint) -> bool:
    """Screen a reading by its values and age alone."""
    late = health.t - channel.stamp - channel.delay
    if late > TOO_LATE:
        return set_complaint(why, Reason.TOO_LATE, late, 0.0)
    if is_empty(channel):
        return False
    if channel.number == ChannelIndex.JOINT_POSITIONS and plausibility.stands_still(
        health.encoders, channel.value, why
    ):
        return True
    return plausibility.repeated(channel.repeats, channel.value, why) or plausibility.is_impossible(
        channel.gate, channel.value, why
    )


def _compare_with_estimate(
    health: HealthMemory,
    channel: ChannelMemory,
    estimate: plausibility.PastEstimate,
    screening: ScreeningResult,
) -> None:
    if channel.number == ChannelIndex.ALTIMETER_RANGE:
        screening.used = _is_floor(health, channel, estimate, screening.why)
        if screening.why.code != Reason.NONE and is_vouched_for(health, channel.number):
            # It is the height that has jumped, not the floor.
            screening.used = True
            screening.why.code = Reason.NONE
    elif channel.gate.exists and not _agrees(health, channel, estimate, screening.why):
        screening.used = channel.agreed < _CONFIRMED
        if screening.used:
            channel.agreed = 0
            screening.why.code = Reason.NONE


def _agrees(
    health: HealthMemory,
    channel: ChannelMemory,
    estimate: plausibility.PastEstimate,
    why: Complaint,
) -> bool:
    gate = channel.gate
    carried = _carries(health, gate.by) or _carries(health, gate.or_by)
    rate = gate.supported if carried else gate.alone
    if math.isnan(channel.taken):
        growth = 0.0
    else:
        growth = rate * max(channel.stamp - channel.taken, 0.0)
    away = abs(channel.stamp - estimate.t)
    error = plausibility.error_of(gate, channel.value, estimate)
    moved = plausibility.motion_within(gate, estimate, away)
    channel.off = error if gate.orders > 1 else -1.0  # rates leave no place behind
    channel.explained = gate.noise + max(growth, moved)
    if carried and is_persistent(channel):
        growth -= 0.5 * gate.base
    allowed = gate.base + growth + moved
    plausibility.offset_of(gate, channel.value, estimate, channel.offset)
    is_back = _undoes_drift(health, channel, error)
    if not (
        error <= allowed
        or _goes_on(channel)
        or undoes_jump(channel)
        or _turns_with_gyro(health, channel)
        or _are_seen(health, channel, estimate, allowed)
        or is_back
    ):
        set_complaint(why, Reason.OFF, error, allowed)
        channel.off_in_a_row += 1
        _forget_what_is_off(health, channel)
        return False
    channel.agreed += 1
    channel.off_in_a_row = 0
    return True


def _forget_what_is_off(health: HealthMemory, channel: ChannelMemory) -> None:
    """Begin longer comparisons of a channel that is off anew: they would blame what it did while it
    was wrong on others, once it is right again.
    """
    if channel.number == ChannelIndex.ATTITUDE:
        redundancy.forget_turns(health.rate)
    elif channel.number == ChannelIndex.JOINT_POSITIONS:
        redundancy.forget_joint_ways(health.encoder)


def _goes_on(channel: ChannelMemory) -> bool:
    """Return whether a DVL goes on from its last reading, which was used: then it is the estimate
    that is off.

    A step of a velocity is an acceleration to the filter until the next reading ends it.
    """
    recent = (
        channel.number == ChannelIndex.LINEAR_VELOCITY
        and channel.stamp - channel.taken <= _NEXT * channel.period
    )
    return (
        recent
        and plausibility.distance(channel.gate, channel.value, channel.used_value)
        <= channel.gate.base
    )


def _undoes_drift(health: HealthMemory, channel: ChannelMemory, off: float) -> bool:
    """Return whether fixes are back from where they had drifted to, which the estimate is not."""
    if channel.number != ChannelIndex.POSITION:
        return False
    if off <= channel.gate.base:
        redundancy.end_drift(health.velocity)
        return False
    return redundancy.undo_drift(health.velocity, channel.value, off, channel.stamp)


def _turns_with_gyro(health: HealthMemory, channel: ChannelMemory) -> bool:
    """Return whether attitudes that are off the estimate turn as the gyro does and the estimate does
    not: what was wrong with them before has become a bias of the gyro to it.
    """
    return (
        channel.number == ChannelIndex.ATTITUDE
        and health.channels[ChannelIndex.ANGULAR_VELOCITY].present
        and redundancy.is_estimate_turning(
            health.rate, channel.value, channel.offset, channel.stamp, channel.off_in_a_row == 0
        )
    )


def _are_seen(
    health: HealthMemory,
    channel: ChannelMemory,
    estimate: plausibility.PastEstimate,
    allowed: float,
) -> bool:
    """Return whether rates of joints that are farther off the estimate than allowed [rad/s or m/s]
    are those that the encoders show too: then it is the estimate that is off.
    """
    if channel.number != ChannelIndex.JOINT_VELOCITIES:
        return False
    seen = health.encoder.n > 0
    for i in range(health.encoder.n):
        rate = channel.value[i]
        is_off = not abs(rate - estimate.v[channel.gate.start + i]) <= allowed
        seen = seen and (
            not is_off or redundancy.is_seen_by_encoder(health.encoder, i, rate, channel.stamp)
        )
    return seen


def is_persistent(channel: ChannelMemory) -> bool:
    """Return whether a DVL repeats readings that cannot be.

    While fixes carry the velocity it is taken again at half its gate: one reading of a biased one
    that noise brings just inside would move velocity and acceleration, and all that follows from
    them.
    """
    return channel.number == ChannelIndex.LINEAR_VELOCITY and channel.off_in_a_row >= _STUBBORN


def _carries(health: HealthMemory, channel: int) -> bool:
    """Return whether a channel is good, and carries an estimate in W by an attitude that is not in
    dispute.
    """
    if health.turns_disputed and is_turned_by_attitude(channel):
        return False
    return _is_good(health, channel)


def _is_good(health: HealthMemory, channel: int) -> bool:
    return (
        channel >= 0
        and health.channels[channel].present
        and health.channels[channel].trust == signals.Trust.GOOD
    )


def _is_floor(
    health: HealthMemory,
    channel: ChannelMemory,
    estimate: plausibility.PastEstimate,
    why: Complaint,
) -> bool:
    up = zeros(3)
    at = zeros(3)
    plausibility.rotate(estimate.q, estimate.beam_up, up)
    plausibility.rotate(estimate.q, estimate.beam_at, at)
    if up[2] <= kinematics.STEEP:
        return True
    _place(health.floor.here, channel, estimate, up, at)
    if is_attitude_doubted(health):
        # What seems to be another floor may be another tilt: a nearer one is the safe case.
        return not floor.is_farther(health.floor)
    return floor.accept_echo(health.floor, why)


def _place(
    point: floor.FloorPoint,
    channel: ChannelMemory,
    estimate: plausibility.PastEstimate,
    up: Vector,
    at: Vector,
) -> None:
    """Find the spot of the floor of an echo: up and at [m], axis and place of the altimeter, are in
    W, seen from the vehicle.
    """
    point.t = channel.stamp
    point.sensor_x = estimate.q[0] + at[0]
    point.sensor_y = estimate.q[1] + at[1]
    point.sensor_z = estimate.q[2] + at[2]
    point.x = point.sensor_x - channel.value[0] * up[0]
    point.y = point.sensor_y - channel.value[0] * up[1]
    point.z = point.sensor_z - channel.value[0] * up[2]


# Pairs of channels that tell of the same motion, and which of a pair is to blame.


def compare(
    health: HealthMemory, channel: ChannelMemory, estimate: plausibility.PastEstimate
) -> None:
    """Compare the newest reading of a channel with what others tell of the same; estimate: of the
    time at which it was taken.
    """
    why = health.belief.why
    if channel.number == ChannelIndex.POSITION:
        _compare_fix(health, channel, estimate, why)
    elif channel.number == ChannelIndex.LINEAR_VELOCITY:
        v_W = zeros(3)
        plausibility.rotate(estimate.q, channel.value, v_W)
        redundancy.update_velocity(health.velocity, v_W, channel.stamp)
    elif channel.number == ChannelIndex.DEPTH:
        redundancy.update_depth(health.depth, channel.value[0], channel.stamp)
        _compare_depth(health, channel, why)
    elif channel.number == ChannelIndex.ANGULAR_VELOCITY:
        redundancy.update_rate(health.rate, channel.value, channel.stamp)
    elif channel.number == ChannelIndex.ATTITUDE:
        _compare_attitude(health, channel, why)
    elif channel.number == ChannelIndex.JOINT_VELOCITIES:
        redundancy.update_joint_rates(health.encoder, channel.value, channel.stamp)
        _compare_encoders(health, why)
    elif channel.number == ChannelIndex.JOINT_POSITIONS:
        redundancy.update_encoders(health.encoder, channel.value, channel.stamp)
        _compare_encoders(health, why)


def _compare_encoders(health: HealthMemory, why: Complaint) -> None:
    if redundancy.is_adrift(health.encoder):
        set_complaint(why, Reason.ENCODER_DRIFT, health.encoder.worst, health.encoder.drift)
        _suspect_likelier(health, ChannelIndex.JOINT_POSITIONS, ChannelIndex.JOINT_VELOCITIES, -1)


def _compare_attitude(health: HealthMemory, channel: ChannelMemory, why: Complaint) -> None:
    redundancy.compare_turns(health.rate, channel.value, channel.stamp)
    quick, slow = health.rate.quick_rate, health.rate.slow_rate
    if quick > 0.0 or slow > 0.0:
        set_complaint(why, Reason.TURN, max(quick, slow), 0.0)
        likely = -1
        if quick > 0.0 and health.rate.culprit == redundancy.TurnCulprit.GYRO:
            likely = int(ChannelIndex.ANGULAR_VELOCITY)
        elif quick > 0.0 and health.rate.culprit == redundancy.TurnCulprit.ATTITUDE:
            likely = int(ChannelIndex.ATTITUDE)
        _suspect_likelier(health, ChannelIndex.ATTITUDE, ChannelIndex.ANGULAR_VELOCITY, likely)


def _compare_fix(
    health: HealthMemory,
    channel: ChannelMemory,
    estimate: plausibility.PastEstimate,
    why: Complaint,
) -> None:
    velocity, depth = (
        health.channels[ChannelIndex.LINEAR_VELOCITY],
        health.channels[ChannelIndex.DEPTH],
    )
    v_W = zeros(3)
    is_comparable = redundancy.compare_place(health.velocity, channel.value, channel.stamp, 0)
    quick = redundancy.drift_rate(health.velocity.quick, 0)
    slow = redundancy.drift_rate(health.velocity.slow, 0)
    plausibility.rotate(estimate.q, estimate.v, v_W)
    by = redundancy.depth_difference(health.depth, channel.value[2], v_W[2], channel.stamp)
    _find_culprit(health)
    culprit = culprit_of_height(health)
    if _explains_drift(health):
        _note_turned_ways(health, max(quick, slow))
    elif is_comparable and quick > 0.0:
        set_complaint(why, Reason.DRIFT, quick, 0.0)
        _blame_quick_drift(health, channel, velocity, why, slow)
    elif is_comparable and slow > 0.0:
        set_complaint(why, Reason.DRIFT, slow, 0.0)
        _blame_slow_drift(health, channel, velocity, why)
    if by > 0.0:
        set_complaint(why, Reason.DEPTH, by, 0.0)
        if culprit == ChannelIndex.DEPTH:
            exclude(depth, why, health.t, health.clean)
        elif culprit == ChannelIndex.POSITION:
            exclude(channel, why, health.t, health.clean)
        else:
            _suspect_likelier(health, ChannelIndex.DEPTH, ChannelIndex.POSITION, -1)


def _find_culprit(health: HealthMemory) -> None:
    """Find which channel height is wrong by; what was found is remembered for a while."""
    redundancy.compare_heights(health.heights, health.velocity, health.depth)
    culprit = redundancy.culprit_of(health.heights)
    is_by_attitude = culprit == redundancy.Culprit.VELOCITY and _explains_drift(health)
    if culprit == redundancy.Culprit.UNKNOWN or is_by_attitude:
        return
    health.blamed_at = health.t
    if culprit == redundancy.Culprit.FIXES:
        health.culprit = int(ChannelIndex.POSITION)
    elif culprit == redundancy.Culprit.DEPTHS:
        health.culprit = int(ChannelIndex.DEPTH)
    else:
        health.culprit = int(ChannelIndex.LINEAR_VELOCITY)


def _explains_drift(health: HealthMemory) -> bool:
    """Return whether the attitude is in doubt, and the DVL did not drift before it was: then the one
    explains what ways that it turns into W do.
    """
    velocity = health.channels[ChannelIndex.LINEAR_VELOCITY]
    code = velocity.complaint.code
    is_drift = code == Reason.DRIFT or code == Reason.DEPTH_DRIFT
    is_adrift = velocity.trust != signals.Trust.GOOD and is_drift
    return (is_attitude_doubted(health) or health.ways_turned) and not is_adrift


def _note_turned_ways(health: HealthMemory, drift: float) -> None:
    """Note that ways which a doubted attitude turns into W drift from fixes or depths by so much [m/s]:
    they speak against nobody once it is good again.
    """
    if drift > 0.0:
        health.ways_turned = True
        # Of an attitude that may be any the fixes are right, and what the DVL made of it is not.
        health.exposed = health.exposed or health.turns_disputed


def _blame_quick_drift(
    health: HealthMemory,
    position: ChannelMemory,
    velocity: ChannelMemory,
    why: Complaint,
    slow: float,
) -> None:
    """Blame fixes or the DVL, which drift apart quickly; slow [m/s]: at which they do for longer.

    The DVL is not used until it agrees again, as the filter cannot find out by itself; unless
    fixes jumped, or depths tell that they drift.
    """
    if culprit_of_height(health) == ChannelIndex.POSITION:
        redundancy.note_drift(health.velocity, position.stamp)
        exclude(position, why, health.t, health.clean)
        return
    guilty = _is_guilty(health, position)
    velocity_is_guilty = _is_guilty(health, velocity)
    if (
        velocity.present
        and (velocity_is_guilty or not guilty)
        and exclude(velocity, why, health.t, health.clean)
    ):
        health.exposed = True
    is_told = culprit_of_height(health) == ChannelIndex.LINEAR_VELOCITY
    if guilty == velocity_is_guilty and slow > 0.0 and not is_told:
        redundancy.note_drift(health.velocity, position.stamp)
        suspect(position, why, health.t)


def _blame_slow_drift(
    health: HealthMemory, position: ChannelMemory, velocity: ChannelMemory, why: Complaint
) -> None:
    """Blame fixes or the DVL, which drift apart slowly: nothing tells which of the two, but for
    depths where it is along z too.
    """
    if culprit_of_height(health) == ChannelIndex.POSITION:
        redundancy.note_drift(health.velocity, position.stamp)
        exclude(position, why, health.t, health.clean)
    elif culprit_of_height(health) == ChannelIndex.LINEAR_VELOCITY:
        if exclude(velocity, why, health.t, health.clean):
            health.exposed = True
    else:
        if _is_guilty(health, position) or not _is_guilty(health, velocity):
            redundancy.note_drift(health.velocity, position.stamp)
        _suspect_likelier(health, ChannelIndex.POSITION, ChannelIndex.LINEAR_VELOCITY, -1)


def _compare_depth(health: HealthMemory, channel: ChannelMemory, why: Complaint) -> None:
    """Blame depths, or the DVL, where what it tells and depths drift apart."""
    if redundancy.compare_place(health.velocity, channel.value, channel.stamp, 2):
        rate = redundancy.drift_rate(health.velocity.depth, 2)
    else:
        rate = 0.0
    if rate > 0.0:
        set_complaint(why, Reason.DEPTH_DRIFT, rate, 0.0)
        if _explains_drift(health):
            _note_turned_ways(health, rate)
        elif not health.channels[ChannelIndex.POSITION].present:
            suspect(channel, why, health.t)
        elif culprit_of_height(health) == ChannelIndex.LINEAR_VELOCITY:
            suspect(health.channels[ChannelIndex.LINEAR_VELOCITY], why, health.t)
        elif culprit_of_height(health) == ChannelIndex.DEPTH:
            exclude(channel, why, health.t, health.clean)
        else:
            _suspect_likelier(health, ChannelIndex.DEPTH, ChannelIndex.LINEAR_VELOCITY, -1)


def _suspect_likelier(health: HealthMemory, first: int, second: int, likely: int) -> None:
    """Doubt the one of the two whose readings were refused not long ago; otherwise the likely one,
    -1 for both.

    Where a rate drifts from attitudes or fixes it is the rate that is biased: those jump, which is
    refused.
    """
    one = health.channels[first]
    other = health.channels[second]
    why = health.belief.why
    one_guilty = _is_guilty(health, one) != _is_guilty(health, other)
    by_likelihood = not one_guilty and likely >= 0 and health.channels[likely].present
    if one.present and (
        _is_guilty(health, one) if one_guilty else not by_likelihood or likely == first
    ):
        suspect(one, why, health.t)
    if other.present and (
        _is_guilty(health, other) if one_guilty else not by_likelihood or likely == second
    ):
        suspect(other, why, health.t)


def _is_guilty(health: HealthMemory, channel: ChannelMemory) -> bool:
    return channel.present and health.t - channel.impossible_at <= _RECENT
