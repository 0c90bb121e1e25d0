"""Pass signals between plant, sensors, filter, monitor and controller, as kernels: these join the
parts of a tick.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.codegen.sequence import DIVERGED, LOOK
from uvms_ocp.control.force.dynamic import is_at_limit
from uvms_ocp.control.force.tick import ForceMemory, hear_forces
from uvms_ocp.control.velocity.tick import is_blind, is_stopped
from uvms_ocp.control.velocity.tick_memory import TickMemory
from uvms_ocp.estimation.filter_memory import (
    N_JOINT_CHANNELS,
    ChannelIndex,
    FilterMemory,
    Part,
)
from uvms_ocp.estimation.health.channel_state import HealthMemory
from uvms_ocp.estimation.health.monitor import EstimateSupport
from uvms_ocp.estimation.vehicle_model import inflate_velocity_variance
from uvms_ocp.mission.progress import is_over
from uvms_ocp.record.meta_values import LARGEST
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.signals import Trust
from uvms_ocp.sim.dynamic_step import PlantMemory, advance_plant
from uvms_ocp.sim.plant import KinematicMemory, advance_kinematic
from uvms_ocp.sim.sampling import SensorsMemory, read_sensors

FARTHEST = LARGEST ** (1 / 3)
"""[m/s, rad/s] Norm of a velocity whose forces and powers, which grow by its square and cube, a
record still holds.
"""


class LoopMemory(Layout):
    """Memory through which parts of the loop pass values to each other."""

    stop: int
    """Whether ticks go on: `GO`, `LOOK` where Python has to look at an event, or `DIVERGED`."""
    k: int
    """Number of the tick, from 0."""
    t: float
    """[s] Time of the tick."""
    dt: float
    """[s] control period."""
    started: bool
    """True where there was a command."""
    ahead: bool
    """True where the plant has moved already by the last command."""
    number: Annotated[list[int], Sized(len(CHANNELS))]
    """(9,) `ChannelIndex` of each of `CHANNELS`."""
    n_vehicle: int
    """Number of velocities of the vehicle."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] true configuration."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] true velocity."""
    a: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] true acceleration."""
    measured: Annotated[list[Vector], Sized("n_channels", "n_measured")]
    """(n_channels, n_measured) [unit of the channel, s] new readings, each with its time behind it; NaN for
    none.
    """
    commanded: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity commanded in the tick before."""
    braked: bool
    """True where joints are locked."""
    blind: bool
    """True where no measurement of the velocity can be trusted."""
    stopped: bool
    """True where nothing is known of the state any more."""
    has_range: bool
    """True where the robot has an altimeter, whose range the filter estimates."""
    range: Annotated[Vector, Sized(2)]
    """(2,) [m] range of the altimeter, and its standard deviation, NaN for none."""
    since: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] times at which the verdicts on the channels changed."""
    trusts: Annotated[list[int], Sized("n_channels")]
    """(n_channels,) `Trust` in each channel that there is, in the order of `Readings`."""
    news: bool
    """True where the verdict on a channel changed."""
    verdict: int
    """`Freshness` that was logged last."""
    at_limits: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) thrusters that were at their limits the last time that any was, up to the tick
    before.
    """
    now_at_limits: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) thrusters that were at their limits the last time that any was, up to this
    tick.
    """


def move_plant(loop: LoopMemory, plant: PlantMemory) -> None:
    """Begin a tick: the plant moves by the last command."""
    if loop.started and not loop.ahead:
        advance_plant(plant)
    loop.q[:] = plant.q
    loop.v[:] = plant.v
    loop.a[:] = plant.a
    begin_tick(loop)


def move_kinematic(loop: LoopMemory, plant: KinematicMemory) -> None:
    """Begin a tick of a kinematic plant, which moves by the last command."""
    if loop.started and not loop.ahead:
        advance_kinematic(plant)
    loop.q[:] = plant.q
    loop.v[:] = plant.v
    loop.a[:] = plant.a
    begin_tick(loop)


def begin_tick(loop: LoopMemory) -> None:
    """Count the tick of the state that the plant has come to, and look whether it has diverged."""
    square = 0.0
    for i in range(len(loop.v)):
        square += loop.v[i] * loop.v[i]
    if loop.started and is_divergent(square):  # what a run begins with is its first row
        loop.stop = int(DIVERGED)
    loop.k += 1 if loop.started and not loop.ahead else 0
    loop.ahead = False
    loop.t = loop.k * loop.dt


def is_divergent(square: float) -> bool:
    """Judge whether a velocity, of this square of its norm, is no number, or larger than any that a
    record holds beside its forces and powers.
    """
    return not math.sqrt(square) <= FARTHEST


def sense(loop: LoopMemory, sensors: SensorsMemory, health: HealthMemory) -> None:
    """Give new readings to the monitor."""
    sensors.q[:] = loop.q
    sensors.v[:] = loop.v
    sensors.a[:] = loop.a
    read_sensors(sensors, loop.t)
    for k in range(health.n):
        sampler = sensors.channels[health.order[k]]
        channel = health.channels[health.order[k]]
        if sampler.fresh:
            channel.fresh = True
            channel.stamp = sampler.stamp
            for i in range(channel.size):
                channel.value[i] = sampler.value[i]


def begin_screening(loop: LoopMemory, health: HealthMemory) -> None:
    """Tell the monitor the time and what acted since the last tick, and keep the new readings."""
    for k in range(health.n):
        channel = health.channels[health.order[k]]
        row = loop.measured[health.order[k]]
        channel.arrived = channel.fresh
        for i in range(channel.size + 1):
            row[i] = math.nan
        if channel.fresh and channel.misshapen == 0:
            row[channel.size] = channel.stamp
            for i in range(channel.size):
                row[i] = channel.value[i]
    health.tick_t = loop.t
    health.moving = loop.started and not loop.braked
    if health.moving:
        for i in range(len(health.encoders.rates)):
            health.encoders.rates[i] = loop.commanded[
                min(loop.n_vehicle + i, len(loop.commanded) - 1)
            ]


def feed_filter(loop: LoopMemory, health: HealthMemory, filter: FilterMemory) -> None:
    """Give the filter the command, and the new readings that were not refused."""
    filter.now = loop.t
    filter.has_command = loop.started
    filter.braked = loop.braked
    for i in range(len(loop.commanded)):
        filter.commanded[6 - loop.n_vehicle + i] = loop.commanded[i]
    for k in range(health.n):
        number = health.order[k]
        channel = health.channels[number]
        if channel.arrived and not channel.behind:
            filter.fresh[number] = 1.0
            filter.stamp[number] = channel.stamp
            for i in range(channel.size):
                if number < N_JOINT_CHANNELS:
                    filter.joint_value[number][i] = channel.value[i]
                else:
                    filter.value[number][i] = channel.value[i]
    if health.exposed or health.velocity_unobserved:
        inflate_velocity_variance(filter, health.velocity_unobserved)


def note_estimate(loop: LoopMemory, health: HealthMemory, filter: FilterMemory) -> None:
    """Give the monitor the filter's estimate."""
    if filter.floating:
        for i in range(3):
            health.now.q[i] = filter.x[Part.PLACE + i]
        for i in range(4):
            health.now.q[3 + i] = filter.turn[i]
        for i in range(6):
            health.now.v[i] = filter.twist[i]
    for j in range(filter.n_joints):
        health.now.q[len(health.now.q) - filter.n_joints + j] = filter.joint_x[j][0]
        health.now.v[len(health.now.v) - filter.n_joints + j] = filter.joint_x[j][1]
    for i in range(2):
        loop.range[i] = filter.range[i] if loop.has_range else math.nan


def repeat_range(loop: LoopMemory, health: HealthMemory) -> None:
    """Take the altimeter's reading for the truth."""
    loop.range[0] = health.channels[ChannelIndex.ALTIMETER_RANGE].used_value[0]


def note_health(loop: LoopMemory, health: HealthMemory, support: EstimateSupport) -> None:
    """Note the trust in each channel, and since when it is as it is."""
    loop.range[0] = loop.range[0] if support.echo else math.nan
    loop.news = health.n_changed > 0
    for k in range(health.n):
        loop.trusts[k] = health.channels[health.order[k]].trust
    for k in range(len(loop.number)):
        channel = health.channels[loop.number[k]]
        if channel.present and channel.changed:
            loop.since[loop.number[k]] = loop.t


def inform_controller(
    loop: LoopMemory, health: HealthMemory, support: EstimateSupport, tick: TickMemory
) -> None:
    """Give the controller the estimate and the trust in the sensors."""
    tick.t = loop.t
    tick.q[:] = health.now.q
    tick.v[:] = health.now.v
    tick.altimeter_range = loop.range[0]
    tick.age = support.age
    tick.joint_age = support.joint_age
    for k in range(len(loop.number)):
        channel = health.channels[loop.number[k]]
        if channel.present:
            trust = channel.trust
        else:
            trust = int(Trust.GOOD)
        tick.restriction.level[k] = trust
        tick.restriction.since[k] = loop.since[loop.number[k]] if trust != Trust.GOOD else 0.0


def feed_back(loop: LoopMemory, tick: TickMemory, force: ForceMemory) -> None:
    """Tell the velocity layer what the force layer met in the tick before."""
    if loop.started:
        hear_forces(tick, force)
        loop.at_limits[:] = loop.now_at_limits


def give_forces(force: ForceMemory, plant: PlantMemory) -> None:
    """Give thrust and torque to the plant."""
    n = force.allocation.count
    plant.asked_thrust[:n] = force.outputs.command[:n]
    for j in range(len(plant.asked_torque)):
        plant.asked_torque[j] = force.outputs.torque[j]
    plant.brake = 1.0 if force.locks else 0.0


def give_velocity(tick: TickMemory, plant: KinematicMemory) -> None:
    """Give the velocity to the plant."""
    for i in range(len(plant.asked)):
        plant.asked[i] = tick.command[i]


def end_force_tick(loop: LoopMemory, tick: TickMemory, force: ForceMemory) -> None:
    """Remember the command, and ask Python to look at events of either layer."""
    if force.allocation.saturated:
        for i in range(force.allocation.count):
            loop.now_at_limits[i] = is_at_limit(
                force.outputs.command[i], force.allocation.lower[i], force.allocation.upper[i]
            )
    loop.braked = force.locks
    _end_tick(loop, tick)
    braked = force.overspeed.joint >= 0 or force.overspeed.moving >= 0
    if force.detection.changed or braked or not force.possible:
        loop.stop = LOOK


def end_velocity_tick(loop: LoopMemory, tick: TickMemory) -> None:
    """Remember the command, and ask Python to look at events."""
    loop.braked = tick.restriction.joints_held
    _end_tick(loop, tick)


def _end_tick(loop: LoopMemory, tick: TickMemory) -> None:
    loop.started = True
    loop.blind = is_blind(tick)
    loop.stopped = is_stopped(tick)
    loop.commanded[:] = tick.command
    if loop.news or tick.eventful or tick.freshness != loop.verdict or is_over(tick.mission):
        loop.stop = LOOK
