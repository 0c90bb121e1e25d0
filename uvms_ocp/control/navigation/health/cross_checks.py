"""Pairs of channels that tell of the same motion, and which of a pair is to blame."""

from __future__ import annotations

from uvms_ocp.control.navigation.filter.memory import Channel
from uvms_ocp.control.navigation.health.channel_state import bar, doubt
from uvms_ocp.control.navigation.health.health_memory import ChannelMemory, HealthMemory
from uvms_ocp.control.navigation.health.laws.disagreement import (
    apart_by,
    drift_by,
    hear_depth,
    hear_rate,
    hear_velocity,
    turn_by,
)
from uvms_ocp.control.navigation.health.laws.history import Estimate
from uvms_ocp.control.navigation.health.laws.turns import turn
from uvms_ocp.control.navigation.health.reasons import Reason, Why, give
from uvms_ocp.functions.kernels.layout import zeros

_RECENT = 10.0  # [s] for which a refused reading speaks against its channel when it comes to blame


def compare(m: HealthMemory, c: ChannelMemory, estimate: Estimate) -> None:
    """The newest reading of a channel with what others tell of the same; the estimate is that of when it was taken."""
    why, rate = m.belief.why, 0.0
    if c.number == Channel.POSITION:
        _compare_fix(m, c, estimate, why)
    elif c.number == Channel.LINEAR_VELOCITY:
        v_W = zeros(3)
        turn(estimate.q, c.value, v_W)
        hear_velocity(m.velocity, v_W, c.stamp)
    elif c.number == Channel.DEPTH:
        hear_depth(m.depth, c.value[0], c.stamp)
    elif c.number == Channel.ANGULAR_VELOCITY:
        hear_rate(m.rate, c.value, c.stamp)
    elif c.number == Channel.ATTITUDE:
        rate = turn_by(m.rate, c.value, c.stamp)
    if rate > 0.0:
        give(why, Reason.TURN, rate, 0.0)
        _blame(m, Channel.ANGULAR_VELOCITY, Channel.ATTITUDE, Channel.ANGULAR_VELOCITY)


def _compare_fix(m: HealthMemory, c: ChannelMemory, estimate: Estimate, why: Why) -> None:
    v_W = zeros(3)
    rate = drift_by(m.velocity, c.value, c.stamp)
    turn(estimate.q, estimate.v, v_W)
    by = apart_by(m.depth, c.value[2], v_W[2], c.stamp)
    if rate > 0.0:
        give(why, Reason.DRIFT, rate, 0.0)
        _bar_velocity(m, why)
    if by > 0.0:
        give(why, Reason.DEPTH, by, 0.0)
        _blame(m, Channel.DEPTH, Channel.POSITION, -1)


def _bar_velocity(m: HealthMemory, why: Why) -> None:
    """The DVL is not used until it agrees again, as the filter cannot find out by itself; unless fixes jumped.

    Those have been refused.
    """
    velocity, position = m.channels[Channel.LINEAR_VELOCITY], m.channels[Channel.POSITION]
    lies = velocity.present and (_is_guilty(m, velocity) or not _is_guilty(m, position))
    if lies and bar(velocity, why, m.t, m.rules.clean):
        m.exposed = True


def _blame(m: HealthMemory, first: int, second: int, likely: int) -> None:
    """Doubt the one of the two whose readings were refused not long ago; otherwise the likely one, -1 for both.

    Where a rate drifts from attitudes or fixes it is the rate that is biased: those jump, which is refused.
    """
    one, other, why = m.channels[first], m.channels[second], m.belief.why
    told = _is_guilty(m, one) != _is_guilty(m, other)
    by_likelihood = not told and likely >= 0 and m.channels[likely].present
    if one.present and (_is_guilty(m, one) if told else not by_likelihood or likely == first):
        doubt(one, why, m.t)
    if other.present and (_is_guilty(m, other) if told else not by_likelihood or likely == second):
        doubt(other, why, m.t)


def _is_guilty(m: HealthMemory, c: ChannelMemory) -> bool:
    return c.present and m.t - c.impossible_at <= _RECENT
