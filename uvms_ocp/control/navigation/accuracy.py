"""What the sensors of a robot allow: how well the estimator can know where a robot at rest is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uvms_ocp.arguments import trusted
from uvms_ocp.control.navigation.estimator import Estimator
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import SensorSpec, SensorSpecs
from uvms_ocp.model.state import Reading, Readings

_reading = trusted(Reading)
_readings = trusted(Readings)

_RATE = 100.0  # [Hz] at which the estimator is run
_SETTLED = 20.0  # [s] after which its covariance no longer changes


def spread_at_rest(robot: Robot, specs: SensorSpecs) -> np.ndarray:
    """Standard deviation (n_v,) [m, rad] of the estimated configuration, when the filter has settled.

    The vehicle's position in W, its attitude in B, the joints. From the filter's own covariance, which rests on the noise,
    rates and delays of the sensors and on the motion that it expects; constant errors are added as squares.
    """
    estimator, truth = Estimator(robot, specs), _truth(robot)
    channels = {name: spec for name in truth if (spec := getattr(specs, name)) is not None}
    for k in range(int(_SETTLED * _RATE)):
        t = k / _RATE
        taken = {name: _taken(spec, t) for name, spec in channels.items()}
        estimator(_readings(**{name: _reading(value=truth[name], t=at) for name, at in taken.items() if at >= 0.0}), t)
    return np.hypot(estimator.spread, _bias(robot, specs))


def _truth(robot: Robot) -> dict[str, Any]:
    """What each channel reads of the robot at rest."""
    q = robot.configuration()
    joints = {"joint_positions": q[robot.joint_q], "joint_velocities": np.zeros(robot.n_v)[robot.joint_v]}
    if not robot.n_vehicle:
        return joints
    rates = {"linear_velocity": np.zeros(3), "angular_velocity": np.zeros(3)}
    return {**joints, **rates, "position": q[:3], "depth": float(q[2]), "attitude": q[3:7]}


def _taken(spec: SensorSpec, t: float) -> float:
    """Time [s] of the reading that is the last one at time t [s]; below 0 before the first one. Losses make it rarer."""
    rate = min(spec.rate * (1.0 - spec.dropout), _RATE)
    return math.floor((t - spec.delay) * rate + 1e-6) / rate if rate > 0.0 else -math.inf


def _bias(robot: Robot, specs: SensorSpecs) -> np.ndarray:
    """(n_v,) [m, rad]"""
    channels = [("joint_positions", robot.n_joints)]
    if robot.n_vehicle:
        channels = [("position", 3), ("attitude", 3), *channels]
    given = ((getattr(specs, name), n) for name, n in channels)
    return np.concatenate([np.zeros(n) if spec is None else np.broadcast_to(spec.biases, (n,)) for spec, n in given])
