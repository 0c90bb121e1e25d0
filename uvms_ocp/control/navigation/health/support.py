"""Which channel stands in for which, how long, and how old that makes a measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import SensorSpecs

_VEHICLE = ("position", "attitude", "linear_velocity", "angular_velocity")
_JOINTS = ("joint_positions",)


class StandIn(NamedTuple):
    """A channel whose readings carry the estimate of another one."""

    channel: str
    time: float
    """[s] for which they do, after which the estimate has drifted too far."""


def stand_ins(tuning: HealthTuning, *, gyro_by_attitude: bool) -> dict[str, StandIn]:
    """By the channel that is missing.

    Depth is replaced by the z of position and joint velocities by the change of joint positions, always: nobody needs them.
    Encoders and the altimeter are replaced by nothing. A DVL carries the position for as long as the mission bears it
    (`uvms_ocp.control.navigation.degraded`). gyro_by_attitude: the estimator finds rates from attitudes alone.
    """
    gyro = {"angular_velocity": StandIn("attitude", math.inf)} if gyro_by_attitude else {}
    return gyro | {
        "position": StandIn("linear_velocity", math.inf),
        "linear_velocity": StandIn("position", math.inf),
        "attitude": StandIn("angular_velocity", tuning.gyro_alone),
    }


def needed_channels(robot: Robot, specs: SensorSpecs, *, rates: bool) -> tuple[str, ...]:
    """Channels that q and v rest on. rates: joint velocities are not found from positions.

    The altitude has a state of its own: its range is nan without an echo.
    """
    wanted = ((*_VEHICLE,) if robot.n_vehicle else ()) + _JOINTS + (("joint_velocities",) if rates else ())
    return tuple(name for name in wanted if getattr(specs, name) is not None)


def age_by_support(
    needed: tuple[str, ...], taken: Mapping[str, float | None], stand_in: Mapping[str, StandIn], t: float
) -> tuple[float, str]:
    """Age [s] at time t [s] of what is least supported, and its channel; inf before the first reading of any needed one.

    taken [s]: when the last used reading of each channel was taken, `None` before the first. A channel without readings counts
    as old as its stand-in's, and ages from when that falls silent too or has carried it for as long as it can.
    """
    oldest, channel = t, ""
    for name in needed:
        own = taken[name]
        if own is None:
            return math.inf, name
        other = stand_in.get(name)
        carried = None if other is None else taken.get(other.channel)
        if other is not None and carried is not None:
            own = max(own, min(carried, own + other.time))
        if own < oldest:
            oldest, channel = own, name
    return t - oldest, channel
