"""Tuning of the Kalman filter: process and measurement noise, chi-square gates and the initial covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.codegen.kernel_layout import arrays_of
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.filter_memory import MAIN, NUMBER, ChannelIndex, FilterMemory, Part, ProcessNoise, rows_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import CHANNELS, SensorSpec, SensorSpecs

# What the estimator expects of the robot, the floor and its sensors.


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorTuning:
    """How fast the robot, the floor and the biases of sensors are expected to change.

    Larger: less lag, more noise. Raises `InvalidInput` for a number not > 0.
    """

    jerk: float = 0.1
    """[m/s3/sqrt(Hz)] of the vehicle."""
    angular_jerk: float = 0.5
    """[rad/s3/sqrt(Hz)] of the vehicle."""
    gyro_bias: float = 1e-3
    """[rad/s] expected at first, beside the one that the sensor is said to have; so are the next two."""
    dvl_bias: float = 1e-4
    """[m/s]"""
    force_bias: float = 0.02
    """[m/s2] of the accelerometer."""
    joint_acceleration: float = 0.04
    """[rad/s2/sqrt(Hz)]"""
    floor_roughness: float = 0.3
    """Slope."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of the estimator = {value}; give a finite number > 0")


# What the filter is told once: the noise of the sensors, how the robot is expected to move, and what it knows at first.

BIAS_DRIFTS = (1e-5, 1e-5, 1e-4)
"""[rad/s/sqrt(s), m/s/sqrt(s), m/s2/sqrt(s)] of gyro, DVL and accelerometer."""
ALTITUDE_DRIFT = 0.005
"""[m/sqrt(s)] at rest."""
RESPONSE_TIME = 0.1
"""[s] with which velocities are taken to follow commands."""
_ECHO_MEMORY = 1.0  # [s] for which the altitude is known without an echo
_RESPONSE_UNCERTAINTY = (
    0.5  # standard deviation of a velocity after a step of the commanded one, as a share of that step
)
_RECOVERY = 1.0  # [s] for which readings that contradict the estimate must agree with each other to be believed
_SMALLEST_SIGMA = 1e-5  # stands in for the noise of an exact sensor, and keeps covariances regular
_LIMITS = (3.0, 1e2, 30.0, 10.0, 3.0, 3.0, 1.0, 10.0, 10.0)  # of each `Part` but the floor
_FIRST = (3.0, 1e2, 1.0, 0.1, 1.0, 0.1)  # of those that are not biases
_FLOOR = 1e2  # [m]
_JOINT_LIMIT, _JOINT_FIRST = (10.0, 10.0), (10.0, 1.0)
_GATES = {1: 25.0, 3: 31.8125}  # chi-squared that 6e-7 exceed: five standard deviations of one number
_MOST_AGILE = 10.0  # [m/s2, rad/s2] where limits are infinite
_EARLY_STEP = 0.25  # [s] for which echoes must agree that the floor has gone down


def initialise(structure: FilterMemory, robot: Robot, specs: SensorSpecs, tuning: EstimatorTuning) -> None:
    """Write what the filter knows before the first tick."""
    memory = arrays_of(structure)
    for name in CHANNELS:
        spec = getattr(specs, name)
        memory.sigma[NUMBER[name]] = sigma_of(spec)
        memory.period[NUMBER[name]] = 0.0 if spec is None else 1.0 / spec.rate
        memory.lag[NUMBER[name]] = 0.0 if spec is None else spec.delay
        memory.gate[NUMBER[name]], memory.recovery[NUMBER[name]] = _GATES[rows_of(NUMBER[name])], _RECOVERY
    memory.recovery[ChannelIndex.ALTIMETER_RANGE] = _EARLY_STEP
    memory.limit[:] = [*np.repeat(_LIMITS, 3), _FLOOR]
    memory.joint_limit[:] = _JOINT_LIMIT
    memory.gravity[:] = robot.model.gravity.linear
    memory.beam_up[2], memory.agility[:] = 1.0, _agility(robot)
    structure.floating, structure.guided = robot.n_vehicle > 0, specs.specific_force is None
    structure.echo_memory, structure.echo = _ECHO_MEMORY, -math.inf
    memory.drive[ProcessNoise.JERK], memory.drive[ProcessNoise.ANGULAR_JERK] = tuning.jerk, tuning.angular_jerk
    memory.drive[ProcessNoise.GYRO], memory.drive[ProcessNoise.DVL], memory.drive[ProcessNoise.FORCE] = BIAS_DRIFTS
    memory.drive[ProcessNoise.ROUGHNESS], memory.drive[ProcessNoise.SETTLING] = tuning.floor_roughness, ALTITUDE_DRIFT
    memory.drive[ProcessNoise.JOINT] = tuning.joint_acceleration
    memory.drive[ProcessNoise.REPLY] = _RESPONSE_UNCERTAINTY * math.sqrt(2.0 * RESPONSE_TIME)
    _set_first(memory, specs, tuning)


def _agility(robot: Robot) -> np.ndarray:
    """(9,) [m/s2, rad/s2] the largest acceleration of what each channel measures, from full acceleration the other way."""
    limits = 2.0 * np.minimum(robot.limits.acceleration, _MOST_AGILE)
    joint = float(limits[robot.joint_v].max(initial=0.0))
    linear, angular = (limits[:3].max(), limits[3:6].max()) if robot.n_vehicle else (0.0, 0.0)
    return np.array([angular, angular, linear, linear, linear, linear, linear, joint, joint])


def sigma_of(spec: SensorSpec | None) -> float:
    """Standard deviation [unit of the channel] of a channel's noise for the filter."""
    return _SMALLEST_SIGMA if spec is None else max(spec.sigma, _SMALLEST_SIGMA)


def _set_first(memory: Any, specs: SensorSpecs, tuning: EstimatorTuning) -> None:
    biases = (
        (Part.GYRO_BIAS, tuning.gyro_bias, specs.angular_velocity),
        (Part.DVL_BIAS, tuning.dvl_bias, specs.linear_velocity),
        (Part.FORCE_BIAS, tuning.force_bias, specs.specific_force),
    )
    sigma = np.concatenate([np.repeat(_FIRST, 3), np.zeros(9), [_FLOOR]])
    for first, usual, spec in biases:
        sigma[first : first + 3] = math.hypot(usual, _size(spec))
    memory.P[range(MAIN), range(MAIN)] = sigma**2
    memory.turn[3] = 1.0
    memory.joint_P[:, 0, 0], memory.joint_P[:, 1, 1] = np.square(_JOINT_FIRST)
    for never in (memory.last, memory.used, memory.due):
        never[:] = -math.inf
    for none in (memory.owner, memory.joint_owner):
        none[:] = -1.0
    for unknown in (memory.since, memory.joint_since, memory.outcome, memory.range):
        unknown[:] = math.nan


def _size(spec: SensorSpec | None) -> float:
    """Root mean square of the bias that a sensor is said to have: its sign is for the filter to find."""
    return 0.0 if spec is None else math.sqrt(float(np.mean(np.square(spec.biases))))
