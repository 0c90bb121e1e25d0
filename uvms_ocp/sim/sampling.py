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
from uvms_ocp.robot.channels import LARGEST_OWN
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
    """Turned by a rotation vector in B."""
    ASKED = 2
    """Disturbed by Python, which is asked."""


class ChannelSampler(Layout):
    """Memory of a sensor, and of its readings under way."""

    present: bool
    number: int
    """`ChannelIndex` of the channel."""
    of_velocity: bool
    """True where the value is a part of v, and not of q."""
    first: int
    """Index at which that part begins in q or v."""
    size: int
    """Numbers of the value."""
    disturbance: int
    """`Disturbance`, by its code."""
    exact: bool
    """True where the sensor has no noise and no bias."""
    rate: float
    """[Hz] rate of the readings, infinite for once per tick."""
    delay: float
    """[s] delay of the readings."""
    dropout: float
    """Probability that a reading is lost."""
    faulty: bool
    """True where `strike` is asked about every sample."""
    disturb: CallbackField
    """Disturbs `sample` by `error`."""
    strike: CallbackField
    """Lets faults change `sample`, `stamped`, `extra_delay` and `lost`."""
    error: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] error of the sample."""
    errors: Annotated[list[Vector], Sized(N_DRAWN, "n_width")]
    """(N_DRAWN, n_width) [unit of the channel] errors of the next samples, in order."""
    losses: Annotated[Vector, Sized(N_DRAWN)]
    """(N_DRAWN,) in [0, 1): a reading is lost where it is below `dropout`."""
    n_used: int
    """Drawn numbers of both kinds that are used up."""
    due: float
    """[s] time of the next sample."""
    sample: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] value of the last sample."""
    stamped: float
    """[s] Time when the sample was taken, by its own clock."""
    extra_delay: float
    """[s] Delay on top of the sensor's own."""
    lost: bool
    """The reading never arrives."""
    n_waiting: int
    """Readings under way, in order of arrival."""
    arrival: Annotated[Vector, Sized("n_room")]
    """(n_room,) [s] times of arrival of the samples on their way."""
    taken: Annotated[Vector, Sized("n_room")]
    """(n_room,) [s] times at which the samples on their way were taken."""
    stamps: Annotated[Vector, Sized("n_room")]
    """(n_room,) [s] times of the samples on their way, by the sensor's own clock."""
    values: Annotated[list[Vector], Sized("n_room", "n_width")]
    """(n_room, n_width) [unit of the channel] values of the samples on their way."""
    newest: float
    """[s] Time at which the reading was taken that arrived last."""
    fresh: bool
    """True where a new reading arrived at this tick."""
    value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] value of the reading that arrived last."""
    stamp: float
    """[s] Time of that reading, by its own clock."""


class SensorsMemory(Layout):
    """All sensors of a robot, and the true state that they sample."""

    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] true configuration."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] true velocity."""
    a: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] true acceleration."""
    gravity: Annotated[Vector, Sized(3)]
    """(3,) [m/s2] in W."""
    carried: bool
    """True where the velocity of the DVL, which is not at the origin of B, is carried there by a
    reading of the gyroscope.
    """
    log_at: Annotated[Vector, Sized(3)]
    """(3,) [m] position of the DVL in B."""
    flat: bool
    """True where the floor is a plane."""
    floor: float
    """[m] z in W of the plane."""
    look: FunctionField
    """Function of q (n_q,) that gives `beam`."""
    beam: Annotated[Vector, Sized(4)]
    """(4,) [m] origin in W of the altimeter's beam, and cosine of the angle between it and straight
    down.
    """
    find_range: CallbackField
    """Asks Python for the range to a floor that is no plane."""
    range: float
    """[m] Range that the beam finds."""
    turn: FunctionField
    """Function of a quaternion (4,) and a rotation vector (3,) in B that gives `turned`."""
    turned: Annotated[Vector, Sized(4)]
    """(4,) quaternion xyzw, turned by the vector."""
    measure: FunctionField
    """Function of q (n_q,) and v (n_v,) that gives `own`."""
    own: Annotated[Vector, Sized("n_own_rows")]
    """(n_own_rows,) [unit of the channel] true values of a user's own channels, `LARGEST_OWN` each."""
    n: int
    """Number of channels that the robot has."""
    order: Annotated[list[int], Sized("n_channels")]
    """(n,) `ChannelIndex` of these, in the order of `Readings`, then those of a user's own."""
    channels: Annotated[list[ChannelSampler], Sized("n_channels")]
    """Samplers of the channels, by `ChannelIndex`."""
    crowded: bool
    """True where more readings of a channel were under way than there is room for."""


def read_sensors(sensors: SensorsMemory, t: float) -> None:
    """Take the samples that are due at time t [s], and deliver what arrives. A kernel."""
    for k in range(sensors.n):
        channel = sensors.channels[sensors.order[k]]
        channel.fresh = False
        if t >= channel.due:
            _take_sample(sensors, channel, t)
        while channel.n_waiting > 0 and t >= channel.arrival[0] - _EARLY:
            if channel.taken[0] > channel.newest:  # a newer one may have overtaken it
                channel.newest = channel.taken[0]
                channel.stamp = channel.stamps[0]
                channel.fresh = True
                for i in range(channel.size):
                    channel.value[i] = channel.values[0][i]
            channel.n_waiting -= 1
            for place in range(channel.n_waiting):
                _move(channel, place + 1, place)


def _take_sample(sensors: SensorsMemory, sampler: ChannelSampler, t: float) -> None:
    if math.isinf(sampler.rate):
        sampler.due = t
    else:
        sampler.due = (math.floor(t * sampler.rate + _EARLY) + 1.0 - _EARLY) / sampler.rate
    _measure(sensors, sampler)
    if not sampler.exact:
        _disturb(sensors, sampler)
    sampler.lost = sampler.losses[sampler.n_used] < sampler.dropout
    sampler.n_used += 1
    sampler.stamped = t
    sampler.extra_delay = 0.0
    if sampler.faulty and not sampler.lost:
        sampler.strike()
    if not sampler.lost:
        _send(sensors, sampler, t)


def _measure(sensors: SensorsMemory, sampler: ChannelSampler) -> None:
    """Write the true value of the channel into the sample."""
    if sampler.number >= N_CHANNELS:
        first = LARGEST_OWN * (sampler.number - N_CHANNELS)
        sensors.measure(sensors.q, sensors.v, sensors.own)
        for i in range(sampler.size):
            sampler.sample[i] = sensors.own[first + i]
        return
    for i in range(sampler.size):
        sampler.sample[i] = (
            sensors.v[sampler.first + i] if sampler.of_velocity else sensors.q[sampler.first + i]
        )
    if sampler.number == ChannelIndex.ALTIMETER_RANGE:
        sampler.sample[0] = _range(sensors)
    if sampler.number == ChannelIndex.LINEAR_VELOCITY and sensors.carried:
        _carry_velocity(sensors, sampler)
    if sampler.number == ChannelIndex.SPECIFIC_FORCE:
        _measure_specific_force(sensors, sampler)


def _range(sensors: SensorsMemory) -> float:
    if not sensors.flat:
        sensors.find_range()
        return sensors.range
    sensors.look(sensors.q, sensors.beam, None)
    if sensors.beam[3] > LEVEL_RAY:
        return (sensors.beam[2] - sensors.floor) / sensors.beam[3]
    return math.nan


def _carry_velocity(sensors: SensorsMemory, sampler: ChannelSampler) -> None:
    """Move the velocity to the origin of B, with the error that the gyroscope's last reading makes
    there.
    """
    gyroscope = sensors.channels[ChannelIndex.ANGULAR_VELOCITY]
    off = zeros(3)
    by = zeros(3)
    if gyroscope.newest > -math.inf:
        for i in range(3):
            off[i] = sensors.v[3 + i] - gyroscope.value[i]
        cross(sensors.log_at, 0, off, by)
        for i in range(3):
            sampler.sample[i] -= by[i]


def _measure_specific_force(sensors: SensorsMemory, sampler: ChannelSampler) -> None:
    R = zeros(9)
    spin = zeros(3)
    turning = zeros(3)
    turn = zeros(4)
    weight = zeros(3)
    for i in range(4):
        turn[i] = sensors.q[3 + i]
    for i in range(3):
        spin[i] = sensors.v[3 + i]
    rotation(turn, R)
    rotate_back(R, sensors.gravity, 0, weight)
    cross(spin, 0, sensors.v, turning)  # v is that of B in B, whose axes turn
    for i in range(3):
        sampler.sample[i] = sensors.a[i] + turning[i] - weight[i]


def _disturb(sensors: SensorsMemory, sampler: ChannelSampler) -> None:
    errors = sampler.errors[sampler.n_used]
    for i in range(len(sampler.error)):
        sampler.error[i] = errors[i]
    if sampler.disturbance == Disturbance.TURNED:
        sensors.turn(sampler.sample, sampler.error, sensors.turned)
        for i in range(sampler.size):
            sampler.sample[i] = sensors.turned[i]
    elif sampler.disturbance == Disturbance.ASKED:
        sampler.disturb()
    else:
        for i in range(sampler.size):
            sampler.sample[i] += sampler.error[i]


def _send(sensors: SensorsMemory, sampler: ChannelSampler, t: float) -> None:
    """Put the sample among those under way; one that a fault makes so late that there is no room
    any more never arrives.
    """
    if sampler.n_waiting == len(sampler.arrival):
        sensors.crowded = sensors.crowded or sampler.extra_delay == 0.0
        return
    arrival = t + sampler.delay + sampler.extra_delay
    place = sampler.n_waiting
    while place > 0 and sampler.arrival[place - 1] > arrival:
        _move(sampler, place - 1, place)
        place -= 1
    sampler.arrival[place] = arrival
    sampler.taken[place] = t
    sampler.stamps[place] = sampler.stamped
    for i in range(sampler.size):
        sampler.values[place][i] = sampler.sample[i]
    sampler.n_waiting += 1


def _move(sampler: ChannelSampler, source: int, to: int) -> None:
    sampler.arrival[to] = sampler.arrival[source]
    sampler.taken[to] = sampler.taken[source]
    sampler.stamps[to] = sampler.stamps[source]
    for i in range(sampler.size):
        sampler.values[to][i] = sampler.values[source][i]
