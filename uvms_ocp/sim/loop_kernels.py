"""Pass signals between plant, sensors, filter, monitor and controller, as kernels: these join the
parts of a tick.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.control.force.dynamic import is_at_limit
from uvms_ocp.control.force.tick import ForceMemory, hear_forces
from uvms_ocp.control.velocity.tick_memory import TickMemory
from uvms_ocp.estimation.filter_memory import (
    N_CHANNELS,
    N_VEHICLE,
    RESPONSE_TIME,
    ChannelIndex,
    FilterMemory,
    Part,
)
from uvms_ocp.estimation.health.channel_state import HealthMemory
from uvms_ocp.estimation.health.monitor import EstimateSupport
from uvms_ocp.estimation.vehicle_model import inflate_velocity_variance
from uvms_ocp.mission.progress import is_over
from uvms_ocp.record.meta_values import LARGEST
from uvms_ocp.robot.signals import CHANNELS, Trust
from uvms_ocp.sim.dynamic_plant import BRAKE_FRICTION
from uvms_ocp.sim.dynamic_step import PlantMemory, advance_plant
from uvms_ocp.sim.plant import KinematicMemory, advance_kinematic
from uvms_ocp.sim.sampling import SensorsMemory, read_sensors

GO = 0
LOOK = 1
DIVERGED = 2
"""Reasons why passes end: none; Python has to look at an event; the plant has diverged."""
FARTHEST = LARGEST ** (1 / 3)
"""[m/s, rad/s] Norm of a velocity whose forces and powers, which grow by its square and cube, a
record still holds.
"""


class LoopMemory(Layout):
    """Memory through which parts of the loop pass values to each other."""

    stop: int
    """`GO`, `LOOK` or `DIVERGED`."""
    k: int
    """Number of the tick, from 0."""
    t: float
    """[s] its time."""
    dt: float
    """[s] control period."""
    started: bool
    """There is a command."""
    number: Annotated[list[int], Sized(len(CHANNELS))]
    """(n_channels,) the `ChannelIndex` of each of `CHANNELS`."""
    n_vehicle: int
    """Velocities of the vehicle."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] true."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] true."""
    a: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] true."""
    measured: Annotated[list[Vector], Sized(N_CHANNELS, "n_measured")]
    """(9, n_measured) [unit of the channel, s] new readings, each with its time behind it; NaN for
    none.
    """
    commanded: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] in the tick before."""
    response: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity that commands have brought about."""
    braked: bool
    """Joints are locked."""
    has_range: bool
    """There is an altimeter, whose range the filter estimates."""
    range: Annotated[Vector, Sized(2)]
    """(2,) [m] of the altimeter, and its standard deviation, NaN for none."""
    since: Annotated[Vector, Sized(N_CHANNELS)]
    """(9,) [s] when the verdict on each channel changed."""
    trusts: Annotated[list[int], Sized(N_CHANNELS)]
    """(9,) the `Trust` in each channel that there is, in the order of `Readings`."""
    news: bool
    """A verdict changed."""
    verdict: int
    """The `Freshness` that was told last."""
    phase: int
    """Phase of the mission, at the beginning of the tick."""
    at_limits: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) thrusters that were at their limits the last time that any was, up to the tick
    before.
    """
    now_at_limits: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) up to this one."""


def move_plant(m: LoopMemory, p: PlantMemory) -> None:
    """Begin a tick: the plant has moved by the last command."""
    if m.started:
        advance_plant(p)
    _begin_tick(m, p.q, p.v, p.a)


def move_kinematic(m: LoopMemory, p: KinematicMemory) -> None:
    """Begin a tick, as `move_plant`."""
    if m.started:
        advance_kinematic(p)
    _begin_tick(m, p.q, p.v, p.a)


def _begin_tick(m: LoopMemory, q: Vector, v: Vector, a: Vector) -> None:
    m.q[:] = q
    m.v[:] = v
    m.a[:] = a
    square = 0.0
    for i in range(len(m.v)):
        square += m.v[i] * m.v[i]
    if math.sqrt(square) <= FARTHEST:
        m.stop = int(GO)
    else:
        m.stop = int(DIVERGED)
    m.k += 1 if m.started else 0
    m.t = m.k * m.dt


def sense(m: LoopMemory, s: SensorsMemory, h: HealthMemory) -> None:
    """Give new readings to the monitor."""
    s.q[:] = m.q
    s.v[:] = m.v
    s.a[:] = m.a
    read_sensors(s, m.t)
    for k in range(h.n):
        x = s.channels[h.order[k]]
        c = h.channels[h.order[k]]
        row = m.measured[h.order[k]]
        for i in range(c.size + 1):
            row[i] = math.nan
        if x.fresh:
            c.fresh = True
            c.stamp = x.stamp
            row[c.size] = x.stamp
            for i in range(c.size):
                c.value[i] = x.value[i]
                row[i] = x.value[i]
    h.tick_t = m.t
    h.moving = m.started and not m.braked
    if h.moving:
        for i in range(len(h.encoders.rates)):
            h.encoders.rates[i] = m.commanded[min(m.n_vehicle + i, len(m.commanded) - 1)]


def feed_filter(m: LoopMemory, s: SensorsMemory, h: HealthMemory, f: FilterMemory) -> None:
    """Give the filter the command, and the new readings that were not refused."""
    f.now = m.t
    f.has_command = m.started
    if m.started:
        remaining = math.exp(-(m.t - f.before) / RESPONSE_TIME)
        for i in range(len(m.response)):
            m.response[i] = m.commanded[i] + remaining * (m.response[i] - m.commanded[i])
            f.commanded[6 - m.n_vehicle + i] = m.response[i]
    if m.started and m.braked:
        for j in range(f.n_joints):
            f.joint_x[j][1] = 0.0
    for k in range(h.n):
        number = h.order[k]
        x = s.channels[number]
        c = h.channels[number]
        if x.fresh and not c.behind:
            f.fresh[number] = 1.0
            f.stamp[number] = x.stamp
            for i in range(c.size):
                if number < N_VEHICLE:
                    f.value[number][i] = x.value[i]
                else:
                    f.joint_value[number - N_VEHICLE][i] = x.value[i]
    if h.exposed or h.velocity_unobserved:
        inflate_velocity_variance(f, h.velocity_unobserved)


def note_estimate(m: LoopMemory, h: HealthMemory, f: FilterMemory) -> None:
    """Give the monitor the filter's estimate."""
    if f.floating:
        for i in range(3):
            h.now.q[i] = f.x[Part.PLACE + i]
        for i in range(4):
            h.now.q[3 + i] = f.turn[i]
        for i in range(6):
            h.now.v[i] = f.twist[i]
    for j in range(f.n_joints):
        h.now.q[len(h.now.q) - f.n_joints + j] = f.joint_x[j][0]
        h.now.v[len(h.now.v) - f.n_joints + j] = f.joint_x[j][1]
    for i in range(2):
        m.range[i] = f.range[i] if m.has_range else math.nan


def repeat_range(m: LoopMemory, h: HealthMemory) -> None:
    """Take the altimeter's reading for the truth."""
    m.range[0] = h.channels[ChannelIndex.ALTIMETER_RANGE].used_value[0]


def inform_controller(m: LoopMemory, h: HealthMemory, s: EstimateSupport, c: TickMemory) -> None:
    """Give the controller the estimate and what is thought of the sensors."""
    c.t = m.t
    c.q[:] = h.now.q
    c.v[:] = h.now.v
    m.range[0] = m.range[0] if s.echo else math.nan
    c.altimeter_range = m.range[0]
    c.age = s.age
    c.joint_age = s.joint_age
    m.news = h.n_changed > 0
    m.phase = c.mission.phase
    for k in range(h.n):
        m.trusts[k] = h.channels[h.order[k]].trust
    for k in range(len(m.number)):
        channel = h.channels[m.number[k]]
        if channel.present and channel.changed:
            m.since[m.number[k]] = m.t
        if channel.present:
            trust = channel.trust
        else:
            trust = int(Trust.GOOD)
        c.restriction.level[k] = trust
        c.restriction.since[k] = m.since[m.number[k]] if trust != Trust.GOOD else 0.0


def feed_back(m: LoopMemory, c: TickMemory, f: ForceMemory) -> None:
    """Tell the velocity layer what the force layer met in the tick before."""
    if m.started:
        hear_forces(c, f)
        m.at_limits[:] = m.now_at_limits


def command_plant(m: LoopMemory, c: TickMemory, f: ForceMemory, p: PlantMemory) -> None:
    """Give thrust and torque to the plant."""
    n = f.allocation.count
    p.asked_thrust[:n] = f.outputs.command[:n]
    for j in range(len(p.asked_torque)):
        p.asked_torque[j] = f.outputs.torque[j]
    p.brake = BRAKE_FRICTION if f.locks else 0.0
    if f.allocation.saturated:
        for i in range(n):
            m.now_at_limits[i] = is_at_limit(
                f.outputs.command[i], f.allocation.lower[i], f.allocation.upper[i]
            )
    m.braked = f.locks
    _end_tick(m, c)
    if f.detection.changed or not f.possible:
        m.stop = LOOK


def command_kinematic(m: LoopMemory, c: TickMemory, p: KinematicMemory) -> None:
    """Give the velocity to the plant."""
    for i in range(len(p.asked)):
        p.asked[i] = c.command[i]
    m.braked = c.restriction.joints_held
    _end_tick(m, c)


def _end_tick(m: LoopMemory, c: TickMemory) -> None:
    m.started = True
    m.commanded[:] = c.command
    if m.news or c.eventful or c.freshness != m.verdict or is_over(c.mission):
        m.stop = LOOK
