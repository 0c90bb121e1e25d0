"""Which channels an estimate needs, and how old they are."""

from __future__ import annotations

import math

from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import CHANNELS, SensorSpecs
from uvms_ocp.model.state import Readings

JOINT_CHANNELS = ("joint_positions",)
_VEHICLE_CHANNELS = ("position", "attitude", "linear_velocity", "angular_velocity")
_OPTIONAL_CHANNELS = ("depth", "joint_velocities", "specific_force")  # improve an estimate that does not need them


def age_of(readings: Readings, channels: tuple[str, ...], t: float) -> float:
    """Age [s] at time t [s] of the oldest of the channels' readings; inf where one is missing."""
    return oldest_of(readings, channels, t)[0]


def oldest_of(readings: Readings, channels: tuple[str, ...], t: float) -> tuple[float, str]:
    """Age [s] at time t [s] of the oldest of the channels' readings, inf where one is missing, and which channel that is."""
    taken, oldest = t, ""
    for name in channels:
        reading = getattr(readings, name)
        if reading is None:
            return math.inf, name
        if reading.t < taken:
            taken, oldest = reading.t, name
    return t - taken, oldest


def needed_channels(robot: Robot, specs: SensorSpecs, altimeter_frame: str | None) -> tuple[str, ...]:
    """Channels that the robot has and that no other replaces."""
    skipped = (
        *_OPTIONAL_CHANNELS,
        *(() if robot.n_vehicle else _VEHICLE_CHANNELS),
        *(() if altimeter_frame else ("altimeter_range",)),
    )
    return tuple(name for name in CHANNELS if getattr(specs, name) is not None and name not in skipped)
