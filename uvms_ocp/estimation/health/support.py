"""Which channels an estimate rests on, which stand in for others and for how long, and how old that makes it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, structure_of
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.estimation.filter_memory import N_CHANNELS, NUMBER, ChannelIndex
from uvms_ocp.estimation.health.channel_state import LEAST_TO_SUSPECT, HealthMemory
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpecs, Trust

# Which channel stands in for which, how long, and how old that makes a measurement.

_VEHICLE = ("position", "attitude", "linear_velocity", "angular_velocity")
_JOINTS = ("joint_positions",)


class FallbackSensor(NamedTuple):
    """Channel that replaces another one in the estimate."""

    channel: str
    max_duration: float
    """[s] after which the estimate has drifted too far."""


class EstimateSupport(Layout):
    """Channels that support an estimate, and their age."""

    exact: bool
    """The estimator takes readings for the truth."""
    gating: bool
    """It has gates of its own."""
    n: int
    """Channels that q and v rest on."""
    needed: Annotated[list[int], Sized(N_CHANNELS)]
    """(9,) their numbers."""
    fallback: Annotated[list[int], Sized(N_CHANNELS)]
    """(9,) by the channel that is missing, -1 for none."""
    max_duration: Annotated[Vector, Sized(N_CHANNELS)]
    """(9,) [s] for which it replaces that."""
    age: float
    """[s] of what is least supported; inf before the first reading of any needed channel."""
    oldest: int
    """Its channel, -1 for none."""
    joint_age: float
    """[s] of the joint positions alone."""
    echo: bool
    """The altitude is known."""


def fallback_sensors(*, gyro_from_attitude: bool) -> dict[str, FallbackSensor]:
    """Return the fallback of each channel, by the channel that is missing.

    Depth is replaced by the z of position and joint velocities by the change of joint positions, always: nobody needs them.
    Encoders and the altimeter are replaced by nothing. A DVL replaces the position for as long as a mission allows
    (`uvms_ocp.estimation.degraded_modes`). gyro_from_attitude: the estimator finds rates from attitudes alone.
    """
    gyro = {"angular_velocity": FallbackSensor("attitude", math.inf)} if gyro_from_attitude else {}
    return gyro | {
        "position": FallbackSensor("linear_velocity", math.inf),
        "linear_velocity": FallbackSensor("position", math.inf),
        "attitude": FallbackSensor("angular_velocity", 10.0),  # by then 0.01 rad at a drift of 1e-3 rad/s
    }


def supporting_channels(robot: Robot, specs: SensorSpecs, *, rates: bool) -> tuple[str, ...]:
    """Return the channels that q and v rest on. rates: joint velocities are not found from positions.

    The altitude has a state of its own: its range is nan without an echo.
    """
    wanted = ((*_VEHICLE,) if robot.n_vehicle else ()) + _JOINTS + (("joint_velocities",) if rates else ())
    return tuple(name for name in wanted if getattr(specs, name) is not None)


def support_of(
    needed: tuple[str, ...], fallback: Mapping[str, FallbackSensor], *, exact: bool, gating: bool
) -> EstimateSupport:
    """Make the `EstimateSupport` of an estimator that takes readings for the truth (exact), or has gates (gating)."""
    made = structure_of(EstimateSupport)()
    made.exact, made.gating, made.n = exact, gating, len(needed)
    made.needed[: len(needed)] = [int(NUMBER[name]) for name in needed]
    made.fallback[:] = [-1] * N_CHANNELS
    for name, other in fallback.items():
        made.fallback[NUMBER[name]], made.max_duration[NUMBER[name]] = int(NUMBER[other.channel]), other.max_duration
    return made


def update_age(m: HealthMemory, s: EstimateSupport) -> None:
    """Update the age of the least supported channel, and that of the joints.

    A channel without readings counts as old as its fallback, and ages from when that falls silent too or has replaced it for
    as long as it can.
    """
    joints = m.channels[ChannelIndex.JOINT_POSITIONS].taken
    s.joint_age = math.inf if math.isnan(joints) else m.t - min(joints, m.t)
    s.oldest = -1
    oldest = m.t
    for k in range(s.n):
        number = s.needed[k]
        own = _supported_until(m, s, number)
        if math.isnan(own):
            s.oldest, s.age = number, math.inf
            return
        if own < oldest:
            oldest = own
            s.oldest = number
    s.age = m.t - oldest


def _supported_until(m: HealthMemory, s: EstimateSupport, number: int) -> float:
    """Return until when [s] readings support a channel, nan before its first one."""
    own, other = m.channels[number].taken, s.fallback[number]
    by = m.channels[other].taken if other >= 0 else math.nan
    if math.isnan(own) or math.isnan(by):
        return own
    return max(own, min(by, own + s.max_duration[number]))


def update_echo(m: HealthMemory, s: EstimateSupport) -> None:
    """Update whether the altitude is supported: estimators predict it while the altimeter is suspect; a raw echo ages at once."""
    c = m.channels[ChannelIndex.ALTIMETER_RANGE]
    old = s.exact and m.t - c.taken > LEAST_TO_SUSPECT
    s.echo = not c.present or (not old and c.trust != Trust.LOST)


class PassThroughMemory(Layout):
    """Channels that q and v of a pass-through are made of."""

    n: int
    """Channels of either."""
    of_q: Annotated[list[int], Sized(3)]
    """(n,) their numbers, one after the other."""
    of_v: Annotated[list[int], Sized(3)]
    """(n,) """


def pass_through_memory(estimator: PassThrough) -> PassThroughMemory:
    """Make the `PassThroughMemory` of an estimator."""
    made, n = structure_of(PassThroughMemory)(), len(estimator.q_channels)
    made.n = n
    made.of_q[:n], made.of_v[:n] = (
        [int(NUMBER[name]) for name in names] for names in (estimator.q_channels, estimator.v_channels)
    )
    return made


def repeat(m: HealthMemory, r: PassThroughMemory) -> None:
    """Copy the readings in use into `now`. A kernel."""
    at, there = 0, 0
    for k in range(r.n):
        c = m.channels[r.of_q[k]]
        for i in range(c.size):
            m.now.q[at] = c.used_value[i]
            at += 1
        d = m.channels[r.of_v[k]]
        for i in range(d.size):
            m.now.v[there] = d.used_value[i]
            there += 1
