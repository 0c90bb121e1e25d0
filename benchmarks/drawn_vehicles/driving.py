"""Vehicles with drawn numbers, driven by steps and chirps of thrust."""

from __future__ import annotations

import numpy as np

from uvms_ocp import load_robot, without_arm
from uvms_ocp.identification.models.stage import PAST, Stage, Vehicle
from uvms_ocp.identification.parameters.status import Free, Prior, Status
from uvms_ocp.identification.parameters.unknowns import Unknowns
from uvms_ocp.identification.parameters.vehicle_quantities import Actuators, Start, vehicle_declaration
from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.identification.recordings.sampling import Held
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.thrusters import thruster_matrix

FINE, EVERY = 0.005, 20
"""[s] of the simulation; [-] steps between samples."""
VELOCITY, RATE, VERTICAL = 0.01, 0.01, 0.005
"""[m/s], [rad/s], [-] of the noise of sensors."""
_HULL = np.array([[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]])
_WITHOUT_PRIOR = 0.3  # [-] deviation of what is drawn where the declaration has none
LEARNT: dict[str, Status] = {
    "mass": Prior(sigma=0.01),
    "added_mass": Free(),
    "linear_drag": Free(),
    "quadratic_drag": Free(),
    "volume": Prior(sigma=0.01),
    "centre_of_buoyancy": Prior(sigma=0.2),
    "gain": Prior(sigma=0.03),
    "lag": Prior(sigma=0.3),
    "delay": Prior(sigma=0.02),
    "velocity_delay": Prior(sigma=0.02),
}
"""What is drawn, and learnt again: the vehicle was weighed, in air and in water, and its thrusters were tried on a scale."""


def vehicle(name: str = "bluerov2_alpha5") -> Vehicle:
    """A robot of the package without its arm."""
    robot = without_arm(load_robot(name))
    dynamics, B = robot_dynamics(robot).symbolic, thruster_matrix(robot)
    names = tuple(thruster.name for thruster in robot.description.thrusters)
    actuators = Actuators(names=names, wrench=B, allocation=np.eye(len(names)), lag=0.1, dead_zone=0.3, delay=0.05)
    known = vehicle_declaration(Start.of(dynamics), _HULL, actuators).learning(**LEARNT)
    return Vehicle(dynamics=dynamics, shared=Unknowns(known), own=Unknowns(known, own=True), actuators=actuators)


def drawn(one: Vehicle, rng: np.random.Generator) -> np.ndarray:
    """Unknowns (n,) [as `Unknowns.start`] of another vehicle."""
    sigma = np.where(np.isfinite(one.shared.sigma), one.shared.sigma, _WITHOUT_PRIOR)
    return np.asarray(one.shared.start + sigma * rng.normal(size=len(sigma)))


def recorded(one: Vehicle, stage: Stage, p: np.ndarray, rng: np.random.Generator, t_end: float) -> Recording:
    """Of a vehicle with unknowns p (n,) [as `Unknowns.start`], over t_end [s]."""
    t = FINE * np.arange(round(t_end / FINE))
    thrust = _wanted(t, rng) @ np.linalg.pinv(one.actuators.wrench).T
    late = float(np.asarray(stage.delays(p)[0])[0, 0])
    told = Held(Channel(t=t, values=thrust)).mean(FINE * np.arange(len(t) + 1) - late)
    begun = np.asarray(stage.begun(np.repeat(thrust[:1].T, PAST, axis=1), p)[0]).ravel()
    x = np.concatenate([[0, 0, -2, 0, 0, 0, 1.0], np.zeros(6), begun])
    after = stage.step.mapaccum(len(t))(
        x, told.T, np.zeros((0, len(t))), np.tile(p[:, None], len(t)), FINE * np.ones((1, len(t)))
    )
    states = np.vstack([x, np.asarray(after).T])[::EVERY]
    return _seen(states, Channel(t=t, values=thrust), stage, p, rng)


def _wanted(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Wrenches (n, 6) [N, N m]: steps of all axes one after the other, chirps beside them."""
    size = np.array([25.0, 25.0, 25.0, 2.0, 2.0, 4.0])
    steps = size * rng.uniform(-1, 1, size=(int(t[-1] / 3) + 2, 6)) * (rng.uniform(size=(int(t[-1] / 3) + 2, 6)) < 0.5)
    chirp = 0.3 * size * np.sin(2 * np.pi * (0.05 + 0.15 * t / t[-1])[:, None] * t[:, None] + np.arange(6))
    return np.asarray(steps[(t / 3).astype(int)] + chirp)


def _seen(states: np.ndarray, thrust: Channel, stage: Stage, p: np.ndarray, rng: np.random.Generator) -> Recording:
    t = FINE * EVERY * np.arange(len(states))
    y = np.asarray(stage.seen.map(len(t))(states.T, np.tile(p[:, None], len(t)))[0]).T
    quaternions = states[:, 3:7] + VERTICAL / 2 * rng.normal(size=(len(t), 4))
    late = float(np.asarray(stage.delays(p)[0])[1, 0])
    return Recording(
        name="drawn",
        channels={
            "attitude": Channel(t=t, values=quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)),
            "linear_velocity": Channel(t=t + late, values=y[:, :3] + VELOCITY * rng.normal(size=(len(t), 3))),
            "angular_velocity": Channel(t=t, values=y[:, 3:6] + RATE * rng.normal(size=(len(t), 3))),
            "thrust": thrust,
        },
    )
