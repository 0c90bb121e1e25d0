"""Vehicles with drawn numbers, driven by thrust and seen by noisy sensors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import ndtri

from uvms_ocp import load_robot, without_arm
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.experiment_limits import ExperimentLimits
from uvms_ocp.identification.model import PAST, StageFunctions, Vehicle
from uvms_ocp.identification.parameters import (
    Free,
    ParameterStatus,
    Prior,
    Unknowns,
)
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import ZeroOrderHold
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    NominalParameters,
    vehicle_declaration,
)
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.thrusters import thruster_matrix

FINE = 0.0025  # [s] step of the simulation
EVERY = 40  # number of steps between two samples
# Standard deviations of the noise of sensors
VELOCITY = 0.01  # [m/s]
RATE = 0.01  # [rad/s]
VERTICAL = 0.005  # [-] of each component of the vertical
NOISE = Noise(velocity=VELOCITY, rate=RATE, vertical=VERTICAL, process=0.02, start=0.05)
"""Noise that a search assumes."""
_HULL = np.array([[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]])
_WITHOUT_PRIOR = 0.3  # standard deviation of drawn unknowns without a prior
LEARNT: dict[str, ParameterStatus] = {
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
"""Numbers that are drawn, and learnt again. Priors are those of a vehicle that was weighed in air and
in water, and whose thrusters were tried on a scale.
"""


def vehicle(
    learnt: Mapping[str, ParameterStatus] = LEARNT, name: str = "bluerov2_alpha5"
) -> Vehicle:
    """Make the vehicle of a robot of the package without its arm."""
    robot = without_arm(load_robot(name))
    dynamics = robot_dynamics(robot).symbolic
    B = thruster_matrix(robot)
    names = robot.thruster_names
    actuators = ActuatorModel(
        names=names, wrench=B, allocation=np.eye(len(names)), lag=0.1, dead_zone=0.3, delay=0.05
    )
    nominal = vehicle_declaration(NominalParameters.of(dynamics), _HULL, actuators)
    declaration = nominal.with_status(**learnt)
    return Vehicle(
        dynamics=dynamics,
        shared=Unknowns(declaration),
        per_recording=Unknowns(declaration, per_recording=True),
        actuators=actuators,
    )


def limits(auv: Vehicle) -> ExperimentLimits:
    """Return the limits of experiments with half of the thrust, in a small pool."""
    thrust = np.tile([-20.0, 20.0], (len(auv.actuators.names), 1))
    return ExperimentLimits(
        thrust=thrust, pool=np.array([[-3.0, -2.0, -1.0], [3.0, 2.0, 1.0]]), slew=100.0
    )


def drawn(auv: Vehicle, rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw the unknowns (n, n_p) [as `Unknowns.start`] of n vehicles, by a Latin hypercube of their
    priors.
    """
    sigma = np.where(np.isfinite(auv.shared.sigma), auv.shared.sigma, _WITHOUT_PRIOR)
    places = rng.permuted(np.tile(np.arange(n)[:, None], len(sigma)), axis=0) + rng.uniform(
        size=(n, len(sigma))
    )
    return np.asarray(auv.shared.start + sigma * ndtri(places / n))


def recorded(
    auv: Vehicle,
    stage: StageFunctions,
    p: np.ndarray,
    rng: np.random.Generator,
    commands: Channel,
    name: str = "drawn",
) -> Recording:
    """Simulate the recording of a vehicle with unknowns p (n,) [as `Unknowns.start`], from rest;
    commands (n, n_u) [N] are held for equal times.
    """
    n = round((commands.t[-1] + commands.t[1]) / FINE)
    delay = float(np.asarray(stage.delays(p)[0])[0, 0])
    thrust = ZeroOrderHold(commands).mean(FINE * np.arange(n + 1) - delay)
    actuators = np.asarray(
        stage.begun(np.repeat(commands.values[:1].T, PAST, axis=1), p)[0]
    ).ravel()
    x = np.concatenate([[0, 0, 0, 0, 0, 0, 1.0], np.zeros(6), actuators])
    after = stage.step.mapaccum(n)(
        x, thrust.T, np.zeros((0, n)), np.tile(p[:, None], n), FINE * np.ones((1, n))
    )
    states = np.vstack([x, np.asarray(after).T])[::EVERY]
    return _seen(states, commands, stage, p, rng, name)


def _seen(
    states: np.ndarray,
    thrust: Channel,
    stage: StageFunctions,
    p: np.ndarray,
    rng: np.random.Generator,
    name: str,
) -> Recording:
    """Return what noisy sensors record of simulated states (n, n_x)."""
    t = FINE * EVERY * np.arange(len(states))
    y = np.asarray(stage.outputs.map(len(t))(states.T, np.tile(p[:, None], len(t)))[0]).T
    quaternions = states[:, 3:7] + VERTICAL / 2 * rng.normal(size=(len(t), 4))
    delay = float(np.asarray(stage.delays(p)[0])[1, 0])
    return Recording(
        name=name,
        channels={
            "attitude": Channel(
                t=t, values=quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
            ),
            "linear_velocity": Channel(
                t=t + delay, values=y[:, :3] + VELOCITY * rng.normal(size=(len(t), 3))
            ),
            "angular_velocity": Channel(
                t=t, values=y[:, 3:6] + RATE * rng.normal(size=(len(t), 3))
            ),
            "thrust": thrust,
        },
    )
