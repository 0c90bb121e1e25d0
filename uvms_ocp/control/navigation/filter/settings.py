"""What the filter is told once: the noise of the sensors, how the robot is expected to move, and what it knows at first."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.control.navigation.filter.memory import CHANNELS, MAIN, NUMBER, Channel, Memory, Noise, Part
from uvms_ocp.control.navigation.tuning import EstimatorTuning
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import SensorSpec, SensorSpecs

_SMALLEST_SIGMA = 1e-5  # stands in for the noise of an exact sensor, and keeps covariances regular
_LIMITS = (3.0, 1e2, 30.0, 10.0, 3.0, 3.0, 1.0, 10.0, 10.0)  # of each `Part` but the floor
_FIRST = (3.0, 1e2, 1.0, 0.1, 1.0, 0.1)  # of those that are not biases
_FLOOR = 1e2  # [m]
_JOINT_LIMIT, _JOINT_FIRST = (10.0, 10.0), (10.0, 1.0)
_GATES = {1: 25.0, 3: 31.8125}  # chi-squared that 6e-7 exceed: five standard deviations of one number
_MOST_AGILE = 10.0  # [m/s2, rad/s2] where limits are infinite
_EARLY_STEP = 0.25  # [s] for which echoes must agree that the floor has gone down


def prepared(memory: Memory, robot: Robot, specs: SensorSpecs, tuning: EstimatorTuning) -> Memory:
    """`memory` before the first tick."""
    for name in CHANNELS:
        _set_channel(memory, NUMBER[name], getattr(specs, name), tuning)
    memory.recovery[Channel.ALTIMETER_RANGE] = _EARLY_STEP
    memory.limit[:] = [*np.repeat(_LIMITS, 3), _FLOOR]
    memory.joint_limit[:] = _JOINT_LIMIT
    memory.gravity[:] = robot.model.gravity.linear
    memory.floating[0], memory.guided[0] = float(robot.n_vehicle > 0), float(specs.specific_force is None)
    memory.beam_up[2], memory.echo_memory[0] = 1.0, tuning.echo_memory
    memory.agility[:] = _agility(robot)
    _set_drive(memory, tuning)
    _set_first(memory, specs, tuning)
    return memory


def _agility(robot: Robot) -> np.ndarray:
    """(9,) [m/s2, rad/s2] the largest acceleration of what each channel measures, from full acceleration the other way."""
    limits = 2.0 * np.minimum(robot.limits.acceleration, _MOST_AGILE)
    joint = float(limits[robot.joint_v].max(initial=0.0))
    linear, angular = (limits[:3].max(), limits[3:6].max()) if robot.n_vehicle else (0.0, 0.0)
    return np.array([angular, angular, linear, linear, linear, linear, linear, joint, joint])


def sigma_of(spec: SensorSpec | None) -> float:
    """Standard deviation [unit of the channel] of a channel's noise for the filter."""
    return _SMALLEST_SIGMA if spec is None else max(spec.sigma, _SMALLEST_SIGMA)


def _set_channel(memory: Memory, c: Channel, spec: SensorSpec | None, tuning: EstimatorTuning) -> None:
    memory.sigma[c] = sigma_of(spec)
    memory.period[c] = 0.0 if spec is None else 1.0 / spec.rate
    memory.lag[c] = 0.0 if spec is None else spec.delay
    rows = 3 if c <= Channel.SPECIFIC_FORCE and c != Channel.DEPTH else 1
    memory.gate[c], memory.recovery[c] = _GATES[rows], tuning.recovery


def _set_drive(memory: Memory, tuning: EstimatorTuning) -> None:
    drive = memory.drive
    drive[Noise.JERK], drive[Noise.ANGULAR_JERK] = tuning.jerk, tuning.angular_jerk
    drive[Noise.GYRO], drive[Noise.DVL], drive[Noise.FORCE] = tuning.gyro_drift, tuning.dvl_drift, tuning.force_drift
    drive[Noise.ROUGHNESS], drive[Noise.SETTLING] = tuning.floor_roughness, tuning.altitude_drift
    drive[Noise.JOINT] = tuning.joint_acceleration
    drive[Noise.REPLY] = tuning.response_doubt * math.sqrt(2.0 * tuning.response_time)


def _set_first(memory: Memory, specs: SensorSpecs, tuning: EstimatorTuning) -> None:
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
    for never in (memory.last, memory.used, memory.due, memory.echo):
        never[:] = -math.inf
    for none in (memory.owner, memory.joint_owner):
        none[:] = -1.0
    for unknown in (memory.since, memory.joint_since, memory.outcome, memory.range):
        unknown[:] = math.nan


def _size(spec: SensorSpec | None) -> float:
    """Root mean square of the bias that a sensor is said to have: its sign is for the filter to find."""
    return 0.0 if spec is None else math.sqrt(float(np.mean(np.square(spec.biases))))
