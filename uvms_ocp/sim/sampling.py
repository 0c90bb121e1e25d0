"""Sample the true state by sensors, as kernels: readings at a rate of each, which arrive after its
delay, or are lost.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import (
    CallbackField,
    FunctionField,
    Layout,
    Sized,
    Vector,
    zeros,
)
from uvms_ocp.estimation.filter_memory import N_CHANNELS, ChannelIndex
from uvms_ocp.estimation.vehicle_model import cross, rotate_back, rotation
from uvms_ocp.sim.seafloor import LEVEL_RAY

N_DRAWN = 256
"""Errors of a channel that are drawn at once."""
_EARLY = (
    1e-9  # of a period or a second: a tick that rounding puts just before a sampling time counts
)


class Disturbance(IntEnum):
    """Way in which an error acts on a value."""

    ADDED = 0
    TURNED = 1
    """By a rotation vector in B."""
    ASKED = 2
    """Python knows."""


class ChannelSampler(Layout):
    """Memory of a sensor, and of its readings under way."""

    present: bool
    number: int
    """A `ChannelIndex`."""
    of_velocity: bool
    """The value is a part of v, and not of q."""
    first: int
    """Index at which that part begins."""
    size: int
    """Numbers of the value."""
    disturbance: int
    """A `Disturbance`."""
    exact: bool
    """Without noise and bias."""
    rate: float
    """[Hz] infinite for once per tick."""
    delay: float
    """[s]"""
    dropout: float
    """Probability that a reading is lost."""
    faulty: bool
    """`strike` is asked about every sample."""
    disturb: CallbackField
    """`sample` by `error`."""
    strike: CallbackField
    """`sample`, `stamped`, `extra_delay` and `lost` as faults change them."""
    error: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] error of the sample."""
    errors: Annotated[list[Vector], Sized(N_DRAWN, "n_width")]
    """(N_DRAWN, n_width) [unit of the channel] of the next samples, in order."""
    losses: Annotated[Vector, Sized(N_DRAWN)]
    """(N_DRAWN,) in [0, 1): a reading is lost where it is below `dropout`."""
    n_used: int
    """Drawn numbers of both kinds that are used up."""
    due: float
    """[s] time of the next sample."""
    sample: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] value of the last sample."""
    stamped: float
    """[s] when it was taken, by its own clock."""
    extra_delay: float
    """[s] on top of the sensor's own."""
    lost: bool
    """The reading never arrives."""
    n_waiting: int
    """Readings under way, in order of arrival."""
    arrival: Annotated[Vector, Sized("n_room")]
    """(n_room,) [s] of each."""
    taken: Annotated[Vector, Sized("n_room")]
    """(n_room,) [s] when it was taken."""
    stamps: Annotated[Vector, Sized("n_room")]
    """(n_room,) [s] `stamped`"""
    values: Annotated[list[Vector], Sized("n_room", "n_width")]
    """(n_room, n_width) [unit of the channel]"""
    newest: float
    """[s] when the reading was taken that arrived last."""
    fresh: bool
    """A new one arrived at this tick."""
    value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] the last that arrived."""
    stamp: float
    """[s] its own."""


class SensorsMemory(Layout):
    """All sensors of a robot, and the true state that they sample."""

    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad]"""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s]"""
    a: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2]"""
    gravity: Annotated[Vector, Sized(3)]
    """(3,) [m/s2] in W."""
    carried: bool
    """The Doppler log is not at the origin of B, to which a gyroscope's reading carries its
    velocity.
    """
    log_at: Annotated[Vector, Sized(3)]
    """(3,) [m] the Doppler log in B."""
    flat: bool
    """The floor is a plane."""
    floor: float
    """[m] z in W of the plane."""
    look: FunctionField
    """Q to `beam`, as that of `AltimeterMemory`."""
    beam: Annotated[Vector, Sized(4)]
    """(4,) [m] origin in W of the altimeter's beam, and cosine of the angle between it and straight
    down.
    """
    find_range: CallbackField
    """Finds the range to any other floor."""
    range: float
    """[m] what it finds."""
    turn: FunctionField
    """Quaternion (4,) and rotation vector (3,) in B to `turned`."""
    turned: Annotated[Vector, Sized(4)]
    """(4,) """
    n: int
    """Channels that there are."""
    order: Annotated[list[int], Sized(N_CHANNELS)]
    """(n,) their numbers, in the order of `Readings`."""
    channels: Annotated[list[ChannelSampler], Sized(N_CHANNELS)]
    """By `ChannelIndex`."""
    crowded: bool
    """More readings of one were under way than there is room for."""


def read_sensors(s: SensorsMemory, t: float) -> None:
    """Take the samples that are due at time t [s], and deliver what arrives. A kernel."""
    for k in range(s.n):
        x = s.channels[s.order[k]]
        x.fresh = False
        if t >= x.due:
            _take_sample(s, x, t)
        while x.n_waiting > 0 and t >= x.arrival[0] - _EARLY:
            if x.taken[0] > x.newest:  # a newer one may have overtaken it
                x.newest = x.taken[0]
                x.stamp = x.stamps[0]
                x.fresh = True
                for i in range(x.size):
                    x.value[i] = x.values[0][i]
            x.n_waiting -= 1
            for place in range(x.n_waiting):
                _move(x, place + 1, place)


def _take_sample(s: SensorsMemory, x: ChannelSampler, t: float) -> None:
    if math.isinf(x.rate):
        x.due = t
    else:
        x.due = (math.floor(t * x.rate + _EARLY) + 1.0 - _EARLY) / x.rate
    _measure(s, x)
    if not x.exact:
        _disturb(s, x)
    x.lost = x.losses[x.n_used] < x.dropout
    x.n_used += 1
    x.stamped = t
    x.extra_delay = 0.0
    if x.faulty and not x.lost:
        x.strike()
    if not x.lost:
        _send(s, x, t)


def _measure(s: SensorsMemory, x: ChannelSampler) -> None:
    """Write the true value."""
    for i in range(x.size):
        x.sample[i] = s.v[x.first + i] if x.of_velocity else s.q[x.first + i]
    if x.number == ChannelIndex.ALTIMETER_RANGE:
        x.sample[0] = _range(s)
    if x.number == ChannelIndex.LINEAR_VELOCITY and s.carried:
        _carry_velocity(s, x)
    if x.number == ChannelIndex.SPECIFIC_FORCE:
        _measure_specific_force(s, x)


def _range(s: SensorsMemory) -> float:
    if not s.flat:
        s.find_range()
        return s.range
    s.look(s.q, s.beam, None)
    if s.beam[3] > LEVEL_RAY:
        return (s.beam[2] - s.floor) / s.beam[3]
    return math.nan


def _carry_velocity(s: SensorsMemory, x: ChannelSampler) -> None:
    """By the error of the gyroscope, if it has read anything."""
    gyroscope = s.channels[ChannelIndex.ANGULAR_VELOCITY]
    off = zeros(3)
    by = zeros(3)
    if gyroscope.newest > -math.inf:
        for i in range(3):
            off[i] = s.v[3 + i] - gyroscope.value[i]
        cross(s.log_at, 0, off, by)
        for i in range(3):
            x.sample[i] -= by[i]


def _measure_specific_force(s: SensorsMemory, x: ChannelSampler) -> None:
    R = zeros(9)
    spin = zeros(3)
    turning = zeros(3)
    turn = zeros(4)
    weight = zeros(3)
    for i in range(4):
        turn[i] = s.q[3 + i]
    for i in range(3):
        spin[i] = s.v[3 + i]
    rotation(turn, R)
    rotate_back(R, s.gravity, 0, weight)
    cross(spin, 0, s.v, turning)  # v is that of B in B, whose axes turn
    for i in range(3):
        x.sample[i] = s.a[i] + turning[i] - weight[i]


def _disturb(s: SensorsMemory, x: ChannelSampler) -> None:
    errors = x.errors[x.n_used]
    for i in range(len(x.error)):
        x.error[i] = errors[i]
    if x.disturbance == Disturbance.TURNED:
        s.turn(x.sample, x.error, s.turned)
        for i in range(x.size):
            x.sample[i] = s.turned[i]
    elif x.disturbance == Disturbance.ASKED:
        x.disturb()
    else:
        for i in range(x.size):
            x.sample[i] += x.error[i]


def _send(s: SensorsMemory, x: ChannelSampler, t: float) -> None:
    """Put the sample among those under way; one that a fault makes so late that there is no room
    any more never arrives.
    """
    if x.n_waiting == len(x.arrival):
        s.crowded = s.crowded or x.extra_delay == 0.0
        return
    arrival = t + x.delay + x.extra_delay
    place = x.n_waiting
    while place > 0 and x.arrival[place - 1] > arrival:
        _move(x, place - 1, place)
        place -= 1
    x.arrival[place] = arrival
    x.taken[place] = t
    x.stamps[place] = x.stamped
    for i in range(x.size):
        x.values[place][i] = x.sample[i]
    x.n_waiting += 1


def _move(x: ChannelSampler, source: int, to: int) -> None:
    x.arrival[to] = x.arrival[source]
    x.taken[to] = x.taken[source]
    x.stamps[to] = x.stamps[source]
    for i in range(x.size):
        x.values[to][i] = x.values[source][i]
