"""What the estimator expects of the robot, the floor and its sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput


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
    gyro_drift: float = 1e-5
    """[rad/s/sqrt(s)] of the bias."""
    dvl_drift: float = 1e-5
    """[m/s/sqrt(s)] of the bias."""
    force_drift: float = 1e-4
    """[m/s2/sqrt(s)] of the bias."""
    joint_acceleration: float = 0.04
    """[rad/s2/sqrt(Hz)]"""
    floor_roughness: float = 0.3
    """[-] slope."""
    altitude_drift: float = 0.005
    """[m/sqrt(s)] at rest."""
    echo_memory: float = 1.0
    """[s] for which the altitude is known without an echo."""
    response_time: float = 0.1
    """[s] with which velocities are taken to follow commands."""
    response_doubt: float = 0.5
    """[-] standard deviation of a velocity after a step of the commanded one, as a share of that step."""
    recovery: float = 1.0
    """[s] for which readings that contradict the estimate must agree with each other to be believed."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of the estimator = {value}; give a finite number > 0")
