"""Tuning of the filter: what is expected of the robot, the floor and the biases of sensors."""

from __future__ import annotations

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.types import Positive


@checked_dataclass()
class EstimatorTuning:
    """Tuning of the filter: rates at which the robot, the floor and the biases of sensors are
    expected to change.

    Larger: less lag, more noise. Raises `InvalidInput` for a number not > 0.
    """

    jerk: Positive = 0.1
    """[m/s3/sqrt(Hz)] largest jerk of the vehicle; without an accelerometer less, where the
    innovations of the DVL are smaller.
    """
    angular_jerk: Positive = 0.5
    """[rad/s3/sqrt(Hz)] density of the angular jerk of the vehicle, a white noise."""
    gyro_bias: Positive = 1e-3
    """[rad/s] bias of the gyro that is expected at first, beside the one that the sensor is said to
    have.
    """
    dvl_bias: Positive = 1e-4
    """[m/s] bias of the DVL that is expected at first, beside the one that the sensor is said to
    have.
    """
    force_bias: Positive = 0.02
    """[m/s2] bias of the accelerometer that is expected at first, beside the one that the sensor is
    said to have.
    """
    joint_acceleration: Positive = 0.04
    """[rad/s2/sqrt(Hz)] density of the acceleration of the joints, a white noise."""
    floor_roughness: Positive = 0.3
    """Slope of the floor, which makes its height below the vehicle change with the way."""
