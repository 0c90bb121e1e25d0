"""Recordings of the vehicle of the tests, driven by its actuators, where the truth is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from vehicles import HULL, vehicle

from uvms_ocp.identification.model import PAST, StageFunctions, Vehicle
from uvms_ocp.identification.parameters import Declaration, Unknowns
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    NominalParameters,
    vehicle_declaration,
)

ACTUATORS = ActuatorModel(dead_zone=0.3, lag=0.15, delay=0.2)
FINE = 0.01  # [s]


def known() -> Declaration:
    """All of the vehicle's quantities."""
    return vehicle_declaration(NominalParameters.of(vehicle()), HULL, ACTUATORS)


def vehicle_of(declaration: Declaration) -> Vehicle:
    return Vehicle(
        dynamics=vehicle(),
        shared=Unknowns(declaration),
        per_recording=Unknowns(declaration, per_recording=True),
        actuators=ACTUATORS,
    )


SIZE = (12.0, 12.0, 10.0, 0.8, 0.8, 3.0)
"""[N, N m] of commands."""


def drive(
    stage: StageFunctions,
    p: np.ndarray,
    *,
    seed: int,
    t_end: float = 30.0,
    noise: float = 0.0,
    size: Sequence[float] = SIZE,
    pose_alone: bool = False,
) -> Recording:
    """A recording at 10 Hz of random steps of all commands, every 2 s, with late commands and
    velocities as p has it.
    """
    rng = np.random.default_rng(seed)
    n = round(t_end / FINE)
    commands = rng.normal(size=(round(t_end / 2) + 1, stage.n_u)) * np.array(size)
    delay, late = np.asarray(stage.delays(p)[0]).ravel()
    begun = np.asarray(stage.begun(np.repeat(commands[:1].T, PAST, axis=1), p)[0]).ravel()
    x = np.concatenate([[0, 0, -2, 0, 0, 0, 1.0], np.zeros(6), begun])
    states = [x]
    for k in range(n):
        index = max(0, int(np.floor((k * FINE - delay) / 2 + 1e-9)))
        x = np.asarray(stage.step(x, commands[index], np.zeros(0), p, FINE)).ravel()
        states.append(x)
    every = np.array(states)[::10]
    t = 0.1 * np.arange(len(every))
    seen = np.asarray(
        stage.outputs.map(len(t))(every.T, np.repeat(p[:, None], len(t), axis=1))[0]
    ).T
    blur = noise * rng.normal(size=(len(t), 6))
    channels = {
        "attitude": Channel(t=t, values=every[:, 3:7] * _signs(every[:, 3:7])),
        "linear_velocity": Channel(t=t + late, values=seen[:, :3] + blur[:, :3]),
        "angular_velocity": Channel(t=t, values=seen[:, 3:6] + blur[:, 3:]),
        "wrench": Channel(t=2.0 * np.arange(len(commands)), values=commands),
    }
    if pose_alone:
        channels = {"position": Channel(t=t, values=every[:, :3] + blur[:, :3])} | {
            k: channels[k] for k in ("attitude", "wrench")
        }
    return Recording(name=f"drive{seed}", channels=channels)


def turned(recording: Recording, yaw: float) -> Recording:
    """The same seen from another world frame."""
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(0, 0, yaw))
    attitude = recording.channels["attitude"]
    values = np.array([(turn * pin.Quaternion(x)).coeffs() for x in attitude.values])
    channels = dict(recording.channels) | {
        "attitude": Channel(t=attitude.t, values=values * _signs(values))
    }
    return Recording(name=recording.name, channels=channels)


def _signs(quaternions: np.ndarray) -> np.ndarray:
    products = (quaternions[1:] * quaternions[:-1]).sum(axis=1)
    return np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))[:, None]
