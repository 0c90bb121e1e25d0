"""Screen every new reading before the filter sees it, and decide which of two channels that
disagree is at fault.

A reading is checked for its sense, its time stamp, repetition, and against what the estimate of its
time allows.
"""

from __future__ import annotations

import math

from uvms_ocp.codegen.kernel_layout import Vector, zeros
from uvms_ocp.estimation.filter_memory import ChannelIndex, orders_of
from uvms_ocp.estimation.health import floor, plausibility, redundancy
from uvms_ocp.estimation.health.channel_state import (
    TOO_LATE,
    ChannelMemory,
    HealthMemory,
    ScreeningResult,
    exclude,
    suspect,
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


def screen_reading(m: HealthMemory, c: ChannelMemory, slot: int) -> None:
    """Screen the newest reading of a channel, into `belief`; slot of the estimate of its time, -1
    for none.
    """
    b = m.belief
    c.off = -1.0
    b.sane = not (_means_nothing(m, c, b.why) or _cannot_be(m, c, b.why))
    b.used = b.sane
    if not b.sane:
        return
    b.why.code = Reason.NONE
    if slot >= 0 and not is_empty(c):
        _compare_with_estimate(m, c, m.history.kept[slot], b)
    late = m.t - c.stamp - c.delay
    if b.why.code == Reason.NONE and late > m.late + m.dt:
        set_complaint(b.why, Reason.LATE, late, m.late + m.dt)


def is_empty(c: ChannelMemory) -> bool:
    """Return whether the newest reading is an echo that did not come back."""
    return c.number == ChannelIndex.ALTIMETER_RANGE and math.isnan(c.value[0])


def _means_nothing(m: HealthMemory, c: ChannelMemory, why: Complaint) -> bool:
    if not math.isfinite(c.stamp):
        return set_complaint(why, Reason.STAMP, c.stamp, 0.0)
    if c.misshapen > 0:
        return set_complaint(why, Reason.SHAPE, c.misshapen, 0.0)
    return plausibility.is_nonsense(c.number, c.value, c.size, why) or plausibility.is_mistimed(
        c.stamp, c.used, m.t, m.clock, why
    )


def _cannot_be(m: HealthMemory, c: ChannelMemory, why: Complaint) -> bool:
    """Screen a reading by its values and age alone."""
    late = m.t - c.stamp - c.delay
    if late > TOO_LATE:
        return set_complaint(why, Reason.TOO_LATE, late, 0.0)
    if is_empty(c):
        return False
    if c.number == ChannelIndex.JOINT_POSITIONS and plausibility.stands_still(
        m.encoders, c.value, why
    ):
        return True
    return plausibility.repeated(c.repeats, c.value, why) or plausibility.is_impossible(
        c.gate, c.value, why
    )


def _compare_with_estimate(
    m: HealthMemory, c: ChannelMemory, estimate: plausibility.PastEstimate, b: ScreeningResult
) -> None:
    if c.number == ChannelIndex.ALTIMETER_RANGE:
        b.used = _is_floor(m, c, estimate, b.why)
    elif c.gate.exists and not _agrees(m, c, estimate, b.why):
        b.used = c.agreed < _CONFIRMED
        if b.used:
            c.agreed = 0
            b.why.code = Reason.NONE


def _agrees(
    m: HealthMemory, c: ChannelMemory, estimate: plausibility.PastEstimate, why: Complaint
) -> bool:
    gate = c.gate
    carried = _is_good(m, gate.by) or _is_good(m, gate.or_by)
    rate = gate.supported if carried else gate.alone
    if math.isnan(c.taken):
        growth = 0.0
    else:
        growth = rate * max(c.stamp - c.taken, 0.0)
    away = abs(c.stamp - estimate.t)
    error = plausibility.error_of(gate, c.value, estimate)
    moved = plausibility.motion_within(gate, estimate, away)
    c.off = error if orders_of(c.number) > 1 else -1.0  # rates leave no place behind
    c.explained = gate.noise + max(growth, moved)
    if carried and is_persistent(c):
        growth -= 0.5 * gate.base
    allowed = gate.base + growth + moved
    if not error <= allowed and not _goes_on(c):
        set_complaint(why, Reason.OFF, error, allowed)
        c.off_in_a_row += 1
        return False
    c.agreed += 1
    c.off_in_a_row = 0
    return True


def _goes_on(c: ChannelMemory) -> bool:
    """Return whether a DVL goes on from its last reading, which was used: then it is the estimate
    that is off.

    A step of a velocity is an acceleration to the filter until the next reading ends it.
    """
    recent = c.number == ChannelIndex.LINEAR_VELOCITY and c.stamp - c.taken <= _NEXT * c.period
    return recent and plausibility.distance(c.gate, c.value, c.used_value) <= c.gate.base


def is_persistent(c: ChannelMemory) -> bool:
    """Return whether a DVL insists on what cannot be.

    While fixes carry the velocity it is taken again at half its gate: one reading of a biased one
    that noise brings just inside would move velocity and acceleration, and all that follows from
    them.
    """
    return c.number == ChannelIndex.LINEAR_VELOCITY and c.off_in_a_row >= _STUBBORN


def _is_good(m: HealthMemory, channel: int) -> bool:
    return (
        channel >= 0
        and m.channels[channel].present
        and m.channels[channel].trust == signals.Trust.GOOD
    )


def _is_floor(
    m: HealthMemory, c: ChannelMemory, estimate: plausibility.PastEstimate, why: Complaint
) -> bool:
    up = zeros(3)
    at = zeros(3)
    plausibility.rotate(estimate.q, estimate.beam_up, up)
    plausibility.rotate(estimate.q, estimate.beam_at, at)
    if up[2] <= kinematics.STEEP:
        return True
    _place(m.floor.here, c, estimate, up, at)
    return floor.accept_echo(m.floor, why)


def _place(
    point: floor.FloorPoint,
    c: ChannelMemory,
    estimate: plausibility.PastEstimate,
    up: Vector,
    at: Vector,
) -> None:
    """Find the spot of the floor of an echo: up and at [m], axis and place of the altimeter, are in
    W, seen from the vehicle.
    """
    point.t = c.stamp
    point.sensor_x = estimate.q[0] + at[0]
    point.sensor_y = estimate.q[1] + at[1]
    point.sensor_z = estimate.q[2] + at[2]
    point.x = point.sensor_x - c.value[0] * up[0]
    point.y = point.sensor_y - c.value[0] * up[1]
    point.z = point.sensor_z - c.value[0] * up[2]


# Pairs of channels that tell of the same motion, and which of a pair is to blame.


def compare(m: HealthMemory, c: ChannelMemory, estimate: plausibility.PastEstimate) -> None:
    """The newest reading of a channel with what others tell of the same; the estimate is that of
    when it was taken.
    """
    why = m.belief.why
    if c.number == ChannelIndex.POSITION:
        _compare_fix(m, c, estimate, why)
    elif c.number == ChannelIndex.LINEAR_VELOCITY:
        v_W = zeros(3)
        plausibility.rotate(estimate.q, c.value, v_W)
        redundancy.update_velocity(m.velocity, v_W, c.stamp)
    elif c.number == ChannelIndex.DEPTH:
        redundancy.update_depth(m.depth, c.value[0], c.stamp)
        _compare_depth(m, c, why)
    elif c.number == ChannelIndex.ANGULAR_VELOCITY:
        redundancy.update_rate(m.rate, c.value, c.stamp)
    elif c.number == ChannelIndex.ATTITUDE:
        _compare_attitude(m, c, why)
    elif c.number == ChannelIndex.JOINT_VELOCITIES:
        redundancy.update_joint_rates(m.encoder, c.value, c.stamp)
    elif c.number == ChannelIndex.JOINT_POSITIONS and redundancy.is_adrift(
        m.encoder, c.value, c.stamp
    ):
        set_complaint(why, Reason.ENCODER_DRIFT, m.encoder.worst, m.encoder.drift)
        _suspect_likelier(m, ChannelIndex.JOINT_POSITIONS, ChannelIndex.JOINT_VELOCITIES, -1)


def _compare_attitude(m: HealthMemory, c: ChannelMemory, why: Complaint) -> None:
    redundancy.compare_turns(m.rate, c.value, c.stamp)
    quick, slow = m.rate.quick_rate, m.rate.slow_rate
    if quick > 0.0 or slow > 0.0:
        set_complaint(why, Reason.TURN, max(quick, slow), 0.0)
        if quick > 0.0:
            likely = int(ChannelIndex.ANGULAR_VELOCITY)
        else:
            likely = -1
        _suspect_likelier(m, ChannelIndex.ATTITUDE, ChannelIndex.ANGULAR_VELOCITY, likely)


def _compare_fix(
    m: HealthMemory, c: ChannelMemory, estimate: plausibility.PastEstimate, why: Complaint
) -> None:
    velocity, depth = m.channels[ChannelIndex.LINEAR_VELOCITY], m.channels[ChannelIndex.DEPTH]
    v_W = zeros(3)
    is_comparable = redundancy.compare_place(m.velocity, c.value, c.stamp, 0)
    quick = redundancy.drift_rate(m.velocity.quick, 0)
    slow = redundancy.drift_rate(m.velocity.slow, 0)
    plausibility.rotate(estimate.q, estimate.v, v_W)
    by = redundancy.depth_difference(m.depth, c.value[2], v_W[2], c.stamp)
    if is_comparable and quick > 0.0:
        set_complaint(why, Reason.DRIFT, quick, 0.0)
        # The DVL is not used until it agrees again, as the filter cannot find out by itself; unless
        # fixes jumped.
        guilty = _is_guilty(m, c)
        velocity_is_guilty = _is_guilty(m, velocity)
        if (
            velocity.present
            and (velocity_is_guilty or not guilty)
            and exclude(velocity, why, m.t, m.clean)
        ):
            m.exposed = True
        if guilty == velocity_is_guilty and slow > 0.0:
            suspect(c, why, m.t)
    elif is_comparable and slow > 0.0:
        # Nothing tells which of the two drifts, but for depths where it is along z.
        set_complaint(why, Reason.DRIFT, slow, 0.0)
        if redundancy.drift_rate(m.velocity.slow, 2) > 0.0 and _agrees_with_velocity(m, depth):
            exclude(c, why, m.t, m.clean)
        else:
            _suspect_likelier(m, ChannelIndex.POSITION, ChannelIndex.LINEAR_VELOCITY, -1)
    if by > 0.0:
        set_complaint(why, Reason.DEPTH, by, 0.0)
        if (
            not _agrees_with_velocity(m, depth)
            and redundancy.drift_rate(m.velocity.slow, 2) == 0.0
            and is_comparable
        ):
            exclude(depth, why, m.t, m.clean)
        else:
            _suspect_likelier(m, ChannelIndex.DEPTH, ChannelIndex.POSITION, -1)


def _compare_depth(m: HealthMemory, c: ChannelMemory, why: Complaint) -> None:
    """Stop using depths that drift from what the DVL tells, where fixes do not."""
    if redundancy.compare_place(m.velocity, c.value, c.stamp, 2):
        rate = redundancy.drift_rate(m.velocity.depth, 2)
    else:
        rate = 0.0
    if rate > 0.0:
        set_complaint(why, Reason.DEPTH_DRIFT, rate, 0.0)
        if (
            m.channels[ChannelIndex.POSITION].present
            and redundancy.drift_rate(m.velocity.slow, 2) == 0.0
        ):
            exclude(c, why, m.t, m.clean)
        else:
            suspect(c, why, m.t)


def _agrees_with_velocity(m: HealthMemory, depth: ChannelMemory) -> bool:
    return depth.present and redundancy.drift_rate(m.velocity.depth, 2) == 0.0


def _suspect_likelier(m: HealthMemory, first: int, second: int, likely: int) -> None:
    """Doubt the one of the two whose readings were refused not long ago; otherwise the likely one,
    -1 for both.

    Where a rate drifts from attitudes or fixes it is the rate that is biased: those jump, which is
    refused.
    """
    one = m.channels[first]
    other = m.channels[second]
    why = m.belief.why
    one_guilty = _is_guilty(m, one) != _is_guilty(m, other)
    by_likelihood = not one_guilty and likely >= 0 and m.channels[likely].present
    if one.present and (_is_guilty(m, one) if one_guilty else not by_likelihood or likely == first):
        suspect(one, why, m.t)
    if other.present and (
        _is_guilty(m, other) if one_guilty else not by_likelihood or likely == second
    ):
        suspect(other, why, m.t)


def _is_guilty(m: HealthMemory, c: ChannelMemory) -> bool:
    return c.present and m.t - c.impossible_at <= _RECENT
