"""Sound recordings: drawn vehicles with an arm that waves, driven by thrust, and all that their
sensors tell.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drawn_vehicles.driving import LEARNT, drawn, recorded, vehicle

from uvms_ocp.identification.gravity_checks import G
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.parameters import Prior
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import (
    interpolated,
    rotations,
    smoothed,
)
from uvms_ocp.identification.series_agreement import WINDOW

DURATION = 60.0  # [s] of a recording
SENT = 0.1  # [s] between two commands
HELD = 2.0  # [s] for which a drawn thrust is commanded
THRUST = 8.0  # [N] standard deviation of a drawn thrust
# Standard deviations of the noise of sensors
_POSITION = 0.01  # [m]
_FORCE = 0.05  # [m/s2]
_ANGLE = 0.002  # [rad]
_RATE = 0.01  # [rad/s]
_START = np.array([0.0, 0.0, -20.0])  # [m]
_JOINTS = 3
_UPRIGHT = 0.003  # [m] deviation of the centre of buoyancy: so small that vehicles stay upright
_LEVEL = (0.75, 0.95)
"""Share of the moments in roll and pitch that is left out: no pilot lets a vehicle tumble."""


def sound(rng: np.random.Generator, robots: int) -> list[Recording]:
    """Draw them."""
    auv = vehicle(LEARNT | {"centre_of_buoyancy": Prior(sigma=_UPRIGHT)})
    stage = stage_of(auv)
    B = auv.actuators.wrench
    recordings = []
    for k, truth in enumerate(drawn(auv, rng, robots)):
        thrust = THRUST * rng.normal(size=(round(DURATION / HELD), len(auv.actuators.names)))
        thrust -= rng.uniform(*_LEVEL) * thrust @ B[3:5].T @ np.linalg.pinv(B[3:5]).T
        commands = Channel(
            t=np.arange(0.0, DURATION, SENT), values=np.repeat(thrust, round(HELD / SENT), axis=0)
        )
        recording = recorded(auv, stage, truth, rng, commands, f"dive{k}")
        channels = {**_sensors(recording, rng), **_arm(recording.channels["attitude"].t, rng)}
        channels["wrench"] = replace(commands, values=commands.values @ B.T)
        recordings.append(replace(recording, channels={**recording.channels, **channels}))
    return recordings


def _sensors(recording: Recording, rng: np.random.Generator) -> dict[str, Channel]:
    """Add what sensors of position and an accelerometer read."""
    velocity = recording.channels["linear_velocity"]
    turning = recording.channels["angular_velocity"]
    attitude = recording.channels["attitude"]
    R = rotations(attitude, velocity.t)
    in_world = np.einsum("nij,nj->ni", R, velocity.values)
    steps = np.diff(velocity.t)[:, None] * (in_world[1:] + in_world[:-1]) / 2
    place = np.vstack([_START, _START + np.cumsum(steps, axis=0)])
    grid, rates = smoothed(velocity.t, velocity.values, WINDOW, derivative=1)
    turned = np.cross(interpolated(velocity.t, turning.t, turning.values), velocity.values)
    felt = interpolated(velocity.t, grid, rates) + turned + G * R[:, 2]
    return {
        "position": Channel(t=velocity.t, values=place + _POSITION * rng.normal(size=place.shape)),
        "specific_force": Channel(t=velocity.t, values=felt + _FORCE * rng.normal(size=felt.shape)),
    }


def _arm(t: np.ndarray, rng: np.random.Generator) -> dict[str, Channel]:
    frequency = rng.uniform(0.3, 1.2, size=_JOINTS)
    phase = rng.uniform(0.0, 6.0, size=_JOINTS)
    angles = 0.8 * np.sin(frequency * t[:, None] + phase)
    rates = 0.8 * frequency * np.cos(frequency * t[:, None] + phase)
    return {
        "joint_positions": Channel(t=t, values=angles + _ANGLE * rng.normal(size=angles.shape)),
        "joint_velocities": Channel(t=t, values=rates + _RATE * rng.normal(size=rates.shape)),
    }
