"""Whether a reading can be true, given where the robot was estimated to be when it was taken."""

from __future__ import annotations

import math

from uvms_ocp.control.navigation.filter.memory import Channel
from uvms_ocp.control.navigation.health.laws.history import Estimate
from uvms_ocp.control.navigation.health.reasons import Reason, Why, give
from uvms_ocp.functions.kernels.layout import Layout, Vector


class Gate(Layout):
    """By how much a reading may differ from the estimate: at once, and by how much more for every second without any.

    It grows with that time without end, so that it never shuts a channel out for good.
    """

    exists: bool
    channel: int
    """`Channel`"""
    size: int
    """[-] numbers of its value."""
    start: int
    """[-] where they begin in q or v."""
    base: float
    """[unit of the channel]"""
    supported: float
    """[unit of the channel / s] growth while another channel carries the estimate."""
    alone: float
    """[unit of the channel / s] growth otherwise: what is physically possible."""
    by: int
    """A channel that carries the estimate, -1 for none."""
    or_by: int
    """Another one."""
    most: float
    """[unit of the channel] norm that no value exceeds."""


def is_off(g: Gate, value: Vector, estimate: Estimate, away: float, growth: float, why: Why) -> bool:
    """Whether a value cannot be, against an estimate made `away` [s] from it; growth [unit of the channel] of the gate."""
    error = _error(g, value, estimate)
    allowed = g.base + growth + g.alone * away
    if error <= allowed:
        return False
    give(why, Reason.OFF, error, allowed)
    return True


def is_impossible(g: Gate, value: Vector, why: Why) -> bool:
    """Whether no robot of this kind can ever read the value (size,) [unit of the channel]."""
    if not (g.exists and math.isfinite(g.most)):
        return False
    squared = 0.0
    for i in range(g.size):
        squared += value[i] * value[i]
    if math.sqrt(squared) <= g.most:
        return False
    give(why, Reason.LARGE, math.sqrt(squared), g.most)
    return True


def _error(g: Gate, value: Vector, estimate: Estimate) -> float:
    if g.channel == Channel.ATTITUDE:
        q = estimate.q
        along = value[0] * q[3] + value[1] * q[4] + value[2] * q[5] + value[3] * q[6]
        return 2.0 * math.acos(min(1.0, abs(along)))
    if g.channel == Channel.POSITION or g.channel == Channel.DEPTH:
        return _distance(g, value, estimate.q)
    if g.channel == Channel.JOINT_POSITIONS:
        return _largest(g, value, estimate.q)
    if g.channel == Channel.JOINT_VELOCITIES:
        return _largest(g, value, estimate.v)
    return _distance(g, value, estimate.v)


def _distance(g: Gate, value: Vector, estimated: Vector) -> float:
    squared = 0.0
    for i in range(g.size):
        by = value[i] - estimated[g.start + i]
        squared += by * by
    return math.sqrt(squared)


def _largest(g: Gate, value: Vector, estimated: Vector) -> float:
    most = 0.0
    for i in range(g.size):
        most = max(most, abs(value[i] - estimated[g.start + i]))
    return most
