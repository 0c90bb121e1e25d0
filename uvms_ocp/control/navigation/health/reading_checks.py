"""All that can be said against one new reading before the filter sees it.

Sense, time stamp, repetition, and what the estimate at the time of the reading allows.
"""

from __future__ import annotations

import math

from uvms_ocp.control.navigation.filter.memory import Channel
from uvms_ocp.control.navigation.health.health_memory import Belief, ChannelMemory, HealthMemory
from uvms_ocp.control.navigation.health.laws.floor_watch import believe
from uvms_ocp.control.navigation.health.laws.history import Estimate
from uvms_ocp.control.navigation.health.laws.plausible import is_impossible, is_off
from uvms_ocp.control.navigation.health.laws.repeats import repeated
from uvms_ocp.control.navigation.health.laws.sanity import is_mistimed, is_nonsense
from uvms_ocp.control.navigation.health.laws.spots import Spot
from uvms_ocp.control.navigation.health.laws.still_encoders import stands_still
from uvms_ocp.control.navigation.health.laws.turns import turn
from uvms_ocp.control.navigation.health.reasons import Reason, Why, give
from uvms_ocp.functions.kernels.layout import Vector, zeros
from uvms_ocp.model.health import Trust
from uvms_ocp.model.kinematics import STEEP

_CONFIRMED = 5
"""Readings in a row that must agree before one that does not is refused: an estimate is made of those before."""
_STUBBORN = 3
"""Readings in a row that were refused: by then it is no spike."""


def look_at(m: HealthMemory, c: ChannelMemory, slot: int) -> None:
    """What to do with the newest reading of a channel, in `belief`; slot [-] of the estimate of its time, -1 for none."""
    b = m.belief
    b.sane = not (_means_nothing(m, c, b.why) or _cannot_be(m, c, b.why))
    b.used = b.sane
    if not b.sane:
        return
    b.why.code = Reason.NONE
    if slot >= 0 and not is_empty(c):
        _compare_with_estimate(m, c, m.history.kept[slot], b)
    late = m.t - c.stamp - c.delay
    if b.why.code == Reason.NONE and late > m.rules.late + m.dt:
        give(b.why, Reason.LATE, late, m.rules.late + m.dt)


def is_empty(c: ChannelMemory) -> bool:
    """Whether the newest reading is an echo that did not come back."""
    return c.number == Channel.ALTIMETER_RANGE and math.isnan(c.value[0])


def _means_nothing(m: HealthMemory, c: ChannelMemory, why: Why) -> bool:
    if not math.isfinite(c.stamp):
        give(why, Reason.STAMP, c.stamp, 0.0)
        return True
    if c.misshapen > 0:
        give(why, Reason.SHAPE, c.misshapen, 0.0)
        return True
    return is_nonsense(c.number, c.value, c.size, why) or is_mistimed(c.stamp, c.used, m.t, m.rules.clock, why)


def _cannot_be(m: HealthMemory, c: ChannelMemory, why: Why) -> bool:
    """What values alone and their age say."""
    late = m.t - c.stamp - c.delay
    if late > m.rules.too_late:
        give(why, Reason.TOO_LATE, late, 0.0)
        return True
    if is_empty(c):
        return False
    if c.number == Channel.JOINT_POSITIONS and stands_still(m.encoders, c.value, why):
        return True
    return repeated(c.repeats, c.value, why) or is_impossible(c.gate, c.value, why)


def _compare_with_estimate(m: HealthMemory, c: ChannelMemory, estimate: Estimate, b: Belief) -> None:
    if c.number == Channel.ALTIMETER_RANGE:
        b.used = _is_floor(m, c, estimate, b.why)
    elif c.gate.exists and not _agrees(m, c, estimate, b.why):
        b.used = c.agreed < _CONFIRMED
        if b.used:
            c.agreed = 0
            b.why.code = Reason.NONE


def _agrees(m: HealthMemory, c: ChannelMemory, estimate: Estimate, why: Why) -> bool:
    gate = c.gate
    carried = _is_good(m, gate.by) or _is_good(m, gate.or_by)
    rate = gate.supported if carried else gate.alone
    growth = 0.0 if math.isnan(c.taken) else rate * max(c.stamp - c.taken, 0.0)
    if carried and is_stubborn(c):
        growth -= 0.5 * gate.base
    if is_off(gate, c.value, estimate, abs(c.stamp - estimate.t), growth, why):
        c.off_in_a_row += 1
        return False
    c.agreed += 1
    c.off_in_a_row = 0
    return True


def is_stubborn(c: ChannelMemory) -> bool:
    """Whether a DVL insists on what cannot be.

    While fixes carry the velocity it is taken again at half its gate: one reading of a biased one that noise brings just
    inside would move velocity and acceleration, and all that follows from them.
    """
    return c.number == Channel.LINEAR_VELOCITY and c.off_in_a_row >= _STUBBORN


def _is_good(m: HealthMemory, channel: int) -> bool:
    return channel >= 0 and m.channels[channel].present and m.channels[channel].trust == Trust.GOOD


def _is_floor(m: HealthMemory, c: ChannelMemory, estimate: Estimate, why: Why) -> bool:
    up, at = zeros(3), zeros(3)
    turn(estimate.q, estimate.beam_up, up)
    turn(estimate.q, estimate.beam_at, at)
    if up[2] <= STEEP:
        return True
    _place(m.floor.here, c, estimate, up, at)
    return believe(m.floor, why)


def _place(here: Spot, c: ChannelMemory, estimate: Estimate, up: Vector, at: Vector) -> None:
    """Of an echo: up [-] and at [m], axis and place of the altimeter, are in W, seen from the vehicle."""
    here.t = c.stamp
    here.sensor_x = estimate.q[0] + at[0]
    here.sensor_y = estimate.q[1] + at[1]
    here.sensor_z = estimate.q[2] + at[2]
    here.x = here.sensor_x - c.value[0] * up[0]
    here.y = here.sensor_y - c.value[0] * up[1]
    here.z = here.sensor_z - c.value[0] * up[2]
