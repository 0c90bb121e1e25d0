"""Memory of the Kalman filter, its first values, and the numbers of its channels and states.

The error state of the vehicle has `MAIN` entries, in the order of `Part`: attitude (a rotation
vector in B), position, velocity and acceleration in W, angular velocity and acceleration in B, the
biases of gyro, DVL and accelerometer in B, and the height of the floor below the altimeter. After
them come clones: the predicted measurement of a late channel at the time of a reading that has not
arrived yet, three rows each. Joints are independent of the vehicle and of each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Annotated, Any

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import (
    FunctionField,
    Layout,
    Sized,
    Vector,
    arrays_of,
    structure_of,
)
from uvms_ocp.estimation.tuning import (
    ALTITUDE_DRIFT,
    BIAS_DRIFTS,
    ECHO_MEMORY,
    ECHO_RECOVERY,
    FIRST_DEVIATIONS,
    FLOOR_DEVIATION,
    FULL_TICK,
    GATES,
    JOINT_FIRST_DEVIATIONS,
    JOINT_LARGEST_DEVIATIONS,
    LARGEST_DEVIATIONS,
    LEAST_JERK_SHARE,
    RECOVERY,
    SLOW_TICK,
    SLOWEST_TICK,
    EstimatorTuning,
)
from uvms_ocp.robot.channels import CHANNEL_OF, CHANNELS, Channel, rows_by_name
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpecs
from uvms_ocp.robot.unasked_acceleration import unasked_acceleration

MAIN = 28
SLOTS = 48
"""Clones of the vehicle's channels at most."""
JOINT_SLOTS = 24
"""Clones of the joints at most."""
STATES = MAIN + 3 * SLOTS
JOINT_STATES = 2 + JOINT_SLOTS

RESPONSE_TIME = 0.1
"""[s] time constant with which velocities are taken to follow commands."""
# standard deviation of a velocity after a step of the commanded one, as a share of that step
_RESPONSE_UNCERTAINTY = 0.5
_SMALLEST_SIGMA = 1e-5  # stands in for the noise of an exact sensor, and keeps covariances regular
_MOST_AGILE = 10.0  # [m/s2, rad/s2] acceleration of axes whose limits are infinite


class ChannelIndex(IntEnum):
    """Numbers of the toolkit's channels: those of the joints, then those of the vehicle in the order in
    which readings of one tick are used. A user's own come after them.
    """

    JOINT_POSITIONS = 0
    JOINT_VELOCITIES = 1
    ATTITUDE = 2
    ANGULAR_VELOCITY = 3
    POSITION = 4
    DEPTH = 5
    LINEAR_VELOCITY = 6
    SPECIFIC_FORCE = 7
    ALTIMETER_RANGE = 8


NUMBER = {name: ChannelIndex[name.upper()] for name in CHANNELS}
"""Index of each channel of the toolkit, by its name in `Readings`."""
N_CHANNELS = len(ChannelIndex)
"""Number of the first channel of a user's own."""
N_JOINT_CHANNELS = 2
"""Number of the first channel of the vehicle."""


def numbers_of(own: Iterable[Channel]) -> dict[str, int]:
    """Return the index of each channel of the toolkit, and of a user's own after them, by name."""
    numbers = {name: int(number) for name, number in NUMBER.items()}
    for channel in own:
        numbers[channel.name] = len(numbers)
    return numbers


def by_number(own: Iterable[Channel] = ()) -> dict[int, Channel]:
    """Return the rows of the toolkit's channels, and of a user's own, by their index."""
    numbers = numbers_of(own)
    return {numbers[name]: channel for name, channel in rows_by_name(own).items()}


def pushed_time(time: float) -> float:
    """Return the part of a time [s] between two readings for which gates grant what weight and one
    thruster do; 0 where the loop is quick enough for others to show it, and little where it is but a
    little slower. A kernel.
    """
    slow = max((time - SLOW_TICK) / (FULL_TICK - SLOW_TICK), 0.0)
    return min(slow * FULL_TICK, time, SLOWEST_TICK)


class Part(IntEnum):
    """Indices at which the parts of the vehicle's error state begin."""

    TURN = 0
    PLACE = 3
    SPEED = 6
    ACCELERATION = 9
    SPIN = 12
    SPIN_UP = 15
    GYRO_BIAS = 18
    DVL_BIAS = 21
    FORCE_BIAS = 24
    FLOOR = 27


class ProcessNoise(IntEnum):
    """Process noise densities: indices into `FilterMemory.drive`."""

    JERK = 0
    ANGULAR_JERK = 1
    GYRO = 2
    DVL = 3
    FORCE = 4
    ROUGHNESS = 5
    SETTLING = 6
    JOINT = 7
    REPLY = 8


class PredictedMeasurement(Layout):
    """Predicted measurement of a channel, now or at the time of a clone."""

    h: Annotated[Vector, Sized(4)]
    """(4,) [unit of the channel]; of the altimeter altitude and cosine of the tilt."""
    rate: Annotated[Vector, Sized(3)]
    """(3,) [unit of the channel / s] rate of the predicted measurement."""
    rate_variance: float
    """[square of the unit of the rate] variance of the rate."""
    H: Annotated[list[Vector], Sized(3, MAIN)]
    """(3, MAIN) [SI] derivative of the measurement with respect to the errors."""
    HP: Annotated[list[Vector], Sized(3, STATES)]
    """(3, STATES) [SI] covariance of the measurement with all errors."""
    S: Annotated[list[Vector], Sized(3, 3)]
    """(3, 3) [SI] covariance of the measurement."""
    L: Annotated[list[Vector], Sized(3, 3)]
    """(3, 3) [SI] lower Cholesky factor of `S` with the noise of the reading."""


class FilterMemory(Layout):
    """Memory of the filter. Units are those of the channels and of `EstimatorTuning`."""

    n_joints: int
    # Set once.
    rows: Annotated[list[int], Sized("n_channels")]
    """(n_channels,) entries of the error of one reading; of one joint for the joints' channels."""
    orders: Annotated[list[int], Sized("n_channels")]
    """(n_channels,) integrations from the acceleration to what each channel reads."""
    of_place: Annotated[list[list[int]], Sized("n_channels", 3)]
    """(n_channels, 3) 1 where a channel of a user's own depends on x, y and z in W."""
    sigma: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [unit of the channel] standard deviation of the noise."""
    period: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] time between two readings, 0 for once per tick."""
    gate: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) chi-square gate: largest squared innovation that is accepted; of one joint for the
    joints.
    """
    agility: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [m/s2, rad/s2] largest change of acceleration of what each channel measures."""
    jolt: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [m/s2, rad/s2] unplanned acceleration that gates grant, `Channel.jolt`."""
    push: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [m/s2, rad/s2] acceleration that weight and one thruster give, which gates grant for a whole
    tick.
    """
    surprise: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [unit of the channel] innovation of the last reading that was believed, where it is
    beyond the noise; it fades.
    """
    recovery: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] duration for which rejected readings must agree to be accepted."""
    needed: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) 1 where the age of the channel counts for that of the estimate."""
    drive: Annotated[Vector, Sized(len(ProcessNoise))]
    """(9,) [units of `EstimatorTuning`, times s^0.5] process noise densities, in the order of
    `ProcessNoise`.
    """
    limit: Annotated[Vector, Sized(MAIN)]
    """(MAIN,) [unit of the error] standard deviation beyond which an entry counts as unknown."""
    joint_limit: Annotated[Vector, Sized(2)]
    """(2,) [rad or m, rad/s or m/s] standard deviation beyond which a joint counts as unknown."""
    gravity: Annotated[Vector, Sized(3)]
    """(3,) [m/s2] in W."""
    beam_at: Annotated[Vector, Sized(3)]
    """(3,) [m] the altimeter in B."""
    beam_up: Annotated[Vector, Sized(3)]
    """(3,) z axis of the altimeter in B."""
    echo_memory: float
    """[s] time for which an echo tells the altitude."""
    floating: bool
    """True where the robot has a vehicle."""
    guided: bool
    """True where commanded linear velocities are taken to be followed."""
    # Inputs of a tick.
    now: float
    """[s] time of the tick."""
    has_command: bool
    """True where there was a command."""
    commanded: Annotated[Vector, Sized("n_commanded")]
    """(6 + n_joints,) [m/s, rad/s] velocity that the command asks for."""
    braked: bool
    """True where the command locks the joints."""
    response: Annotated[Vector, Sized("n_commanded")]
    """(6 + n_joints,) [m/s, rad/s] velocity that commands have brought about."""
    fresh: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) 1 where a channel has a new reading."""
    stamp: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] time at which that reading was taken."""
    value: Annotated[list[Vector], Sized("n_channels", 4)]
    """(n_channels, 4) [unit of the channel] readings of the vehicle's channels."""
    joint_value: Annotated[list[Vector], Sized(2, "n_joints")]
    """(2, n_joints) [rad or m, rad/s or m/s] readings of the joints' channels."""
    # State.
    started: bool
    before: float
    """[s] time of the last tick."""
    dt: float
    """[s] time since the last tick."""
    least_jerk_share: float
    """Smallest `jerk_share`; 1 with an accelerometer, and with an exact DVL, whose innovations are
    no noise.
    """
    jerk_share: float
    """Share of `ProcessNoise.JERK` that the vehicle shows, by the innovations of its DVL."""
    shaken: float
    """[s] time of the last reading of the DVL that surprised."""
    turn: Annotated[Vector, Sized(4)]
    """(4,) quaternion xyzw of R_WB."""
    x: Annotated[Vector, Sized(MAIN)]
    """(MAIN,) [SI] state, in the order of `Part`; 0 at `Part.TURN`, as the attitude is in `turn`.
    """
    P: Annotated[list[Vector], Sized(STATES, STATES)]
    """(STATES, STATES) [SI] covariance of the errors; only its upper triangle counts."""
    commanded_W: Annotated[Vector, Sized(3)]
    """(3,) [m/s] linear part of the last `response`, in W."""
    commanded_spin: Annotated[Vector, Sized(3)]
    """(3,) [rad/s] angular part of the last `response`, in B."""
    commanded_rates: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] joints' part of the last `response`."""
    owner: Annotated[Vector, Sized(SLOTS)]
    """(SLOTS,) channel of each clone, -1 for none."""
    taken: Annotated[Vector, Sized(SLOTS)]
    """(SLOTS,) [s] time of each clone."""
    h: Annotated[list[Vector], Sized(SLOTS, 4)]
    """(SLOTS, 4) [unit of the channel] predicted measurement h(x)."""
    rate: Annotated[list[Vector], Sized(SLOTS, 3)]
    """(SLOTS, 3) [unit of the channel / s] rate of the predicted measurement."""
    rate_variance: Annotated[Vector, Sized(SLOTS)]
    """(SLOTS,) [square of the unit of the rate] variance of the rate."""
    last: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] time of the newest reading of each channel."""
    used: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] time of the newest reading of each channel that was accepted."""
    lag: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] largest expected delay of each channel."""
    apart: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] time between two clones of each channel."""
    due: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] time of the next clone of each channel."""
    echo: float
    """[s] time of the last echo that was accepted."""
    since: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] time from which on rejected readings have agreed, nan for none."""
    refused: Annotated[list[Vector], Sized("n_channels", 3)]
    """(n_channels, 3) [unit of the channel] innovation of the last rejected reading of each channel."""
    joint_x: Annotated[list[Vector], Sized("n_joints", 2)]
    """(n_joints, 2) [rad or m, rad/s or m/s] displacement and velocity of each joint."""
    joint_P: Annotated[list[list[Vector]], Sized("n_joints", JOINT_STATES, JOINT_STATES)]
    """(n_joints, JOINT_STATES, JOINT_STATES) [SI] covariance of each joint's errors and clones."""
    joint_owner: Annotated[Vector, Sized(JOINT_SLOTS)]
    """(JOINT_SLOTS,) channel of each clone of the joints, -1 for none."""
    joint_taken: Annotated[Vector, Sized(JOINT_SLOTS)]
    """(JOINT_SLOTS,) [s] time of each clone of the joints."""
    joint_h: Annotated[list[Vector], Sized("n_joints", JOINT_SLOTS)]
    """(n_joints, JOINT_SLOTS) [rad or m, rad/s or m/s] predicted measurement of each clone."""
    joint_rate: Annotated[list[Vector], Sized("n_joints", JOINT_SLOTS)]
    """(n_joints, JOINT_SLOTS) [per s of that] rate of the predicted measurement."""
    joint_rate_variance: Annotated[list[Vector], Sized("n_joints", JOINT_SLOTS)]
    """(n_joints, JOINT_SLOTS) [square of the unit of the rate] variance of the rate."""
    joint_since: Annotated[list[Vector], Sized(2, "n_joints")]
    """(2, n_joints) [s] time at which rejected readings began to agree, nan for none."""
    joint_refused: Annotated[list[Vector], Sized(2, "n_joints")]
    """(2, n_joints) [rad or m, rad/s or m/s] innovation of the last rejected reading."""
    joint_unknown: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) 1 where the fresh reading was the first."""
    # Channels of a user's own, `LARGEST_OWN` rows each.
    measure: FunctionField
    """Function of `turn`, `x` and `joint_state` that gives the four arrays below."""
    joint_state: Annotated[Vector, Sized("n_joint_states")]
    """(2 n_joints,) [rad or m, rad/s or m/s] positions and rates of all joints."""
    own_h: Annotated[Vector, Sized("n_own_rows")]
    """(n_own_rows,) [unit of the channel] predicted measurements."""
    own_H: Annotated[Vector, Sized("n_own_entries")]
    """(n_own_rows MAIN,) [SI] their derivatives with respect to the errors, row by row."""
    own_rate: Annotated[Vector, Sized("n_own_rows")]
    """(n_own_rows,) [unit of the channel / s] their rates."""
    own_joint_H: Annotated[Vector, Sized("n_own_joint_entries")]
    """(n_own_rows n_joints,) [SI] their derivatives with respect to joint positions, row by row."""
    joint_variance: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [square of the unit of the channel] variance by joints that move what a channel of
    a user's own reads.
    """
    # Outputs of a tick.
    predicted: PredictedMeasurement
    """Predicted measurement of the channel that was looked at last."""
    change: Annotated[Vector, Sized(STATES)]
    """(STATES,) [SI] change of the error state by the last correction."""
    outcome: Annotated[list[Vector], Sized("n_channels", 4)]
    """(n_channels, 4) [s, -, -, -] outcome of the gate on the newest reading: its time, squared innovation,
    degrees of freedom, 1 if accepted; nan before the first.
    """
    twist: Annotated[Vector, Sized(6)]
    """(6,) [m/s, rad/s] estimated velocity of the vehicle in B."""
    range: Annotated[Vector, Sized(2)]
    """(2,) [m] estimated range along the altimeter's beam, nan where it is not known, and its
    standard deviation.
    """
    age: Annotated[Vector, Sized(2)]
    """(2,) [s] age of the oldest needed channel, and of the joint positions."""
    std: Annotated[Vector, Sized("n_commanded")]
    """(6 + n_joints,) [m, rad] standard deviations of position in W, attitude in B, joints."""


def filter_memory(
    n_joints: int, own: Sequence[Channel] = (), measure: ca.Function | None = None
) -> FilterMemory:
    """Make the memory of a robot with that many joints and channels of a user's own, whose function is
    that of `own_measurements`.
    """
    dimensions = Dimensions(n_joints=n_joints, n_channels=N_CHANNELS + len(own))
    memory = structure_of(
        FilterMemory,
        dimensions,
        n_own_entries=dimensions.n_own_rows * MAIN,
        measure=measure or _measure_nothing(n_joints),
    )()
    memory.n_joints = n_joints
    for number, channel in by_number(own).items():
        memory.rows[number] = channel.rows
        memory.orders[number] = channel.orders
        memory.jolt[number] = channel.jolt
    return memory


@lru_cache(maxsize=8)
def _measure_nothing(n_joints: int) -> ca.Function:
    """Make the function that stands for the measurements where there are none."""
    inputs = [ca.SX.sym("turn", 4), ca.SX.sym("x", MAIN), ca.SX.sym("joints", 2 * n_joints)]
    return ca.Function("measure_nothing", inputs, [ca.SX(0, 1)] * 4)


# What the filter is told once: the noise of the sensors, how the robot is expected to move, and
# what it knows at first.


def initialise(
    structure: FilterMemory, robot: Robot, specs: SensorSpecs, tuning: EstimatorTuning
) -> None:
    """Write what the filter knows before the first tick."""
    memory = arrays_of(structure)
    sensors = specs.present
    for number, channel in by_number(specs.own).items():
        memory.sigma[number] = _SMALLEST_SIGMA
        memory.period[number] = 0.0
        memory.lag[number] = 0.0
        if channel.name in sensors:
            sensor = sensors[channel.name]
            memory.sigma[number] = max(sensor.sigma, _SMALLEST_SIGMA)
            memory.period[number] = 1.0 / sensor.rate
            memory.lag[number] = sensor.delay
        memory.gate[number] = GATES[channel.rows]
        memory.recovery[number] = RECOVERY
    memory.recovery[ChannelIndex.ALTIMETER_RANGE] = ECHO_RECOVERY
    memory.limit[:] = [*np.repeat(LARGEST_DEVIATIONS, 3), FLOOR_DEVIATION]
    memory.joint_limit[:] = JOINT_LARGEST_DEVIATIONS
    memory.gravity[:] = robot.model.gravity.linear
    memory.beam_up[2] = 1.0
    memory.agility[:N_CHANNELS] = _agility(robot)
    memory.push[[ChannelIndex.ATTITUDE, ChannelIndex.ANGULAR_VELOCITY]] = unasked_turn(robot)
    structure.floating = robot.n_vehicle > 0
    structure.guided = specs.specific_force is None
    structure.echo_memory = ECHO_MEMORY
    structure.echo = -math.inf
    structure.shaken = -math.inf
    structure.jerk_share = 1.0
    is_noisy = memory.sigma[ChannelIndex.LINEAR_VELOCITY] > _SMALLEST_SIGMA
    structure.least_jerk_share = 1.0
    if structure.guided and is_noisy:
        structure.least_jerk_share = LEAST_JERK_SHARE
    memory.drive[ProcessNoise.JERK] = tuning.jerk
    memory.drive[ProcessNoise.ANGULAR_JERK] = tuning.angular_jerk
    gyro_drift, dvl_drift, force_drift = BIAS_DRIFTS
    memory.drive[ProcessNoise.GYRO] = gyro_drift
    memory.drive[ProcessNoise.DVL] = dvl_drift
    memory.drive[ProcessNoise.FORCE] = force_drift
    memory.drive[ProcessNoise.ROUGHNESS] = tuning.floor_roughness
    memory.drive[ProcessNoise.SETTLING] = ALTITUDE_DRIFT
    memory.drive[ProcessNoise.JOINT] = tuning.joint_acceleration
    memory.drive[ProcessNoise.REPLY] = _RESPONSE_UNCERTAINTY * math.sqrt(2.0 * RESPONSE_TIME)
    _set_first(memory, specs, tuning)


def _agility(robot: Robot) -> np.ndarray:
    """Return the largest acceleration (9,) [m/s2, rad/s2] of what each channel of the toolkit measures, from full
    acceleration the other way; of a vehicle along its axes at least what weight and one thruster give
    it, which nobody asks for.
    """
    limits = 2.0 * np.minimum(robot.limits.acceleration, _MOST_AGILE)
    joint = float(limits[robot.joint_v].max(initial=0.0))
    linear = 0.0
    angular = 0.0
    if robot.n_vehicle:
        linear = max(limits[:3].max(), unasked_acceleration(robot)[:3].max())
        angular = limits[3:6].max()
    return np.array([joint, joint, angular, angular, *[linear] * 5])


def unasked_turn(robot: Robot) -> float:
    """Return the angular acceleration [rad/s2] that weight and one thruster can give, as far as
    vehicles turn at all; 0 without a vehicle.
    """
    if not robot.n_vehicle:
        return 0.0
    turn = float(unasked_acceleration(robot)[3:].max())
    return min(turn, CHANNEL_OF["angular_velocity"].jolt)


def _set_first(memory: Any, specs: SensorSpecs, tuning: EstimatorTuning) -> None:
    biases = (
        (Part.GYRO_BIAS, tuning.gyro_bias, specs.angular_velocity),
        (Part.DVL_BIAS, tuning.dvl_bias, specs.linear_velocity),
        (Part.FORCE_BIAS, tuning.force_bias, specs.specific_force),
    )
    sigma = np.concatenate([np.repeat(FIRST_DEVIATIONS, 3), np.zeros(9), [FLOOR_DEVIATION]])
    for first, usual, spec in biases:
        # Of a bias that a sensor is said to have the sign is for the filter to find.
        declared = 0.0 if spec is None else np.sqrt(np.mean(np.square(spec.biases)))
        sigma[first : first + 3] = math.hypot(usual, declared)
    memory.P[range(MAIN), range(MAIN)] = sigma**2
    memory.turn[3] = 1.0
    position_variance, rate_variance = np.square(JOINT_FIRST_DEVIATIONS)
    memory.joint_P[:, 0, 0] = position_variance
    memory.joint_P[:, 1, 1] = rate_variance
    for times in (memory.last, memory.used, memory.due):
        times[:] = -math.inf
    for owners in (memory.owner, memory.joint_owner):
        owners[:] = -1.0
    for unknown in (memory.since, memory.joint_since, memory.outcome, memory.range):
        unknown[:] = math.nan
