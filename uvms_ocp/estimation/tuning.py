"""Tuning of the filter: what is expected of the robot, the floor and the biases of sensors; gates,
and what counts as unknown.
"""

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


# Gates: which readings are believed.

GATES = {1: 25.0, 2: 28.75, 3: 31.8125}
"""Largest squared innovation that is accepted, by the number of rows: chi-squared that 6e-7 exceed,
five standard deviations of one number.
"""
GATE_RELAXATION = 4.0
"""Gate relaxation: variance, in squared innovations, added to the states that rejected readings
contradict.
"""
RECOVERY = 1.0
"""[s] for which readings that contradict the estimate must agree with each other to be believed."""
ECHO_RECOVERY = 0.25
"""[s] for which echoes must agree that the floor has gone down."""
LARGEST = 1e9
"""[unit of the channel] no sensor reads more: a larger number is none."""
JOLT_TIME = 0.015
"""[s] longest time for which gates allow an unplanned acceleration, `Channel.jolt`: what lasts longer
shows in other readings.
"""
SLOW_TICK = 0.02
"""[s] longest tick of a loop in which other readings show in time what weight and one thruster do."""
FULL_TICK = 0.03
"""[s] of a loop from which on gates allow it for a whole tick."""
SLOWEST_TICK = 0.05
"""[s] longest tick of a slower loop for whose whole length gates allow that."""

# Drifts, and what is known at first and at worst.

BIAS_DRIFTS = (1e-5, 1e-5, 1e-4)
"""[rad/s/sqrt(s), m/s/sqrt(s), m/s2/sqrt(s)] random walk of the biases of gyro, DVL and
accelerometer.
"""
ALTITUDE_DRIFT = 0.005
"""[m/sqrt(s)] random walk of the floor below a vehicle at rest."""
LEAST_JERK_SHARE = 0.02
"""Share of `EstimatorTuning.jerk` that a vehicle shows at least, by the innovations of its DVL."""
FIRST_DEVIATIONS = (3.0, 1e2, 1.0, 0.1, 1.0, 0.1)
"""[rad, m, m/s, m/s2, rad/s, rad/s2] first standard deviation of attitude, position, velocity,
acceleration, angular velocity and angular acceleration.
"""
LARGEST_DEVIATIONS = (3.0, 1e2, 30.0, 10.0, 3.0, 3.0, 1.0, 10.0, 10.0)
"""[the same; rad/s, m/s, m/s2] largest standard deviation of these and of the biases of gyro, DVL
and accelerometer.
"""
FLOOR_DEVIATION = 1e2
"""[m] standard deviation of an unknown floor."""
JOINT_FIRST_DEVIATIONS = (10.0, 1.0)
"""[rad or m, rad/s or m/s] first standard deviation of position and velocity of a joint."""
JOINT_LARGEST_DEVIATIONS = (10.0, 10.0)
"""[rad or m, rad/s or m/s] largest standard deviation of position and velocity of a joint."""
UNKNOWN = 0.25
"""Share of the largest variance from which on a part counts as unknown."""

# Times: clocks, late readings, and ticks that are left out.

EARLY = 1e-9
"""[s] by which clocks may differ through rounding."""
LONGEST_STEP = 1.0
"""[s] of a tick over which the motion is carried on; after it the robot is taken to stay."""
LONGEST_LAG = 3.0
"""[s] age of readings beyond which no state is remembered."""
ECHO_MEMORY = 1.0
"""[s] for which the altitude is known without an echo."""
EXPOSED = 1.0
"""[m/s, m/s2] by which the motion may be wrong where its source proves wrong: more than vehicles
make.
"""
EXPOSED_FOR = 3.0
"""[s] for which the motion may have been wrong where its source proves wrong."""
