"""Memory of the Kalman filter: named parts of one array of numbers, which the core in C and its NumPy twin both work on.

The error state of the vehicle has `MAIN` entries, in the order of `Part`: attitude (a rotation vector in B), position, velocity
and acceleration in W, angular velocity and acceleration in B, the biases of gyro, DVL and accelerometer in B, and the height of
the floor below the altimeter. After them come clones: the predicted measurement of a late channel at the time of a reading that
has not arrived yet, three rows each. Joints are independent of the vehicle and of each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from uvms_ocp.robot.kinematics import STEEP
from uvms_ocp.robot.signals import CHANNELS
from uvms_ocp.types import Array


class ChannelIndex(IntEnum):
    """Numbers of the channels, those of the vehicle first, in the order in which readings of one tick are used."""

    ATTITUDE = 0
    ANGULAR_VELOCITY = 1
    POSITION = 2
    DEPTH = 3
    LINEAR_VELOCITY = 4
    SPECIFIC_FORCE = 5
    ALTIMETER_RANGE = 6
    JOINT_POSITIONS = 7
    JOINT_VELOCITIES = 8


NUMBER = {name: ChannelIndex[name.upper()] for name in CHANNELS}
"""Index of each channel, by its name in `Readings`."""
N_VEHICLE, N_CHANNELS = 7, len(ChannelIndex)
ROWS = (3, 3, 3, 1, 3, 3, 1, 1, 1)
"""Entries of one reading of each channel; of one joint."""


ORDERS = (2, 1, 2, 2, 1, 0, 2, 2, 1)
"""How often the acceleration is integrated until it is what the channel reads."""


class Part(IntEnum):
    """Where the parts of the vehicle's error state begin."""

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


MAIN = 28
SLOTS = 48
"""Clones of the vehicle's channels at most."""
JOINT_SLOTS = 24
"""Clones of the joints at most."""
STATES, JOINT_STATES = MAIN + 3 * SLOTS, 2 + JOINT_SLOTS


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


@dataclass(frozen=True, kw_only=True, slots=True)
class FilterConstants:
    """Constants that C and NumPy share beside the sizes."""

    early: float = 1e-9
    """[s] by which clocks may differ through rounding."""
    longest_step: float = 1.0
    """[s] of a tick over which the motion is carried on; after it the robot is taken to stay."""
    longest_lag: float = 3.0
    """[s] of readings that are older no state is remembered."""
    most_clones: float = 24.0
    """Largest number of clones of one channel; where more are needed they stand further apart."""
    spacing: float = 0.01
    """[s] between two clones at least, for each time that an acceleration is integrated in what they see."""
    gate_relaxation: float = 4.0
    """Gate relaxation: variance, in squared innovations, added to the states that rejected readings contradict."""
    surprise: float = 0.05
    """[s] for which the robot may have accelerated as it can before the process model notices."""
    unit: float = 1e-3
    """Tolerance on the norm of a measured quaternion."""
    exposed: float = 1.0
    """[m/s, m/s2] by which the motion may be wrong where its source proves wrong: more than vehicles make."""
    largest: float = 1e9
    """[unit of the channel] no sensor reads more: a larger number is none."""
    unknown: float = 0.25
    """Share of the largest variance from which on a part counts as unknown."""
    steep: float = STEEP
    """Cosine of a beam's tilt below which its range says nothing about the height."""


CONSTANTS = FilterConstants()


class FilterMemory:
    """Named views of one array, `numbers`. Units are those of the channels and of `EstimatorTuning`."""

    # Set once.
    sigma: Array
    """(9,) [unit of the channel] its noise."""
    period: Array
    """(9,) [s] between its readings, 0 for once per tick."""
    gate: Array
    """(9,) chi-square gate: largest squared innovation that is accepted; of one joint for the joints."""
    agility: Array
    """(9,) [m/s2, rad/s2] largest change of acceleration of what each channel measures."""
    recovery: Array
    """(9,) [s] for which rejected readings must agree to be accepted."""
    needed: Array
    """(9,) 1 where the age counts."""
    drive: Array
    """(9,) [of `EstimatorTuning`, and s^0.5] `Noise`."""
    limit: Array
    """(MAIN,) [unit of the error] standard deviation beyond which an entry counts as unknown."""
    joint_limit: Array
    """(2,) [rad or m, rad/s or m/s] the same of a joint."""
    gravity: Array
    """(3,) [m/s2] in W."""
    beam_at: Array
    """(3,) [m] the altimeter in B."""
    beam_up: Array
    """(3,) its z axis in B."""
    echo_memory: Array
    """(1,) [s]"""
    floating: Array
    """(1,) 1 where there is a vehicle."""
    guided: Array
    """(1,) 1 where commanded linear velocities are taken to be followed."""
    # Inputs of a tick.
    now: Array
    """(1,) [s]"""
    has_command: Array
    """(1,) 1 if there is a command."""
    commanded: Array
    """(6 + n_joints,) [m/s, rad/s] velocity that the command has brought about."""
    fresh: Array
    """(9,) 1 where there is a reading."""
    stamp: Array
    """(9,) [s] when it was taken."""
    value: Array
    """(7, 4) [unit of the channel] what the vehicle's channels read."""
    joint_value: Array
    """(2, n_joints) [rad or m, rad/s or m/s] what the joints' channels read."""
    # State.
    started: Array
    """(1,) """
    before: Array
    """(1,) [s] time of the last tick."""
    dt: Array
    """(1,) [s]"""
    turn: Array
    """(4,) quaternion xyzw of R_WB."""
    x: Array
    """(MAIN - 3,) [SI] the parts from `PLACE` on."""
    P: Array
    """(STATES, STATES) [SI] covariance of the errors; only its upper triangle counts."""
    commanded_W: Array
    """(3,) [m/s] linear part of the last `commanded`, in W."""
    commanded_spin: Array
    """(3,) [rad/s]"""
    commanded_rates: Array
    """(n_joints,) [rad/s or m/s]"""
    owner: Array
    """(SLOTS,) channel of each clone, -1 for none."""
    taken: Array
    """(SLOTS,) [s] its time."""
    h: Array
    """(SLOTS, 4) [unit of the channel] predicted measurement h(x)."""
    rate: Array
    """(SLOTS, 3) how fast that changed [per s]."""
    rate_variance: Array
    """(SLOTS,) [square of its unit] variance of the rate."""
    last: Array
    """(9,) [s] time of the newest reading of each channel."""
    used: Array
    """(9,) [s] time of the newest that was accepted."""
    lag: Array
    """(9,) [s] largest delay expected."""
    apart: Array
    """(9,) [s] between two clones of each."""
    due: Array
    """(9,) [s] time of the next clone."""
    echo: Array
    """(1,) [s] time of the last echo that was accepted."""
    since: Array
    """(9,) [s] when rejected readings began to agree, nan for none."""
    refused: Array
    """(7, 3) [unit of the channel] innovation of the last one."""
    joint_x: Array
    """(n_joints, 2) [rad or m, rad/s or m/s] displacement and velocity."""
    joint_P: Array
    """(n_joints, JOINT_STATES, JOINT_STATES) [SI]"""
    joint_owner: Array
    """(JOINT_SLOTS,) """
    joint_taken: Array
    """(JOINT_SLOTS,) [s]"""
    joint_h: Array
    """(n_joints, JOINT_SLOTS) [SI]"""
    joint_rate: Array
    """(n_joints, JOINT_SLOTS) [SI]"""
    joint_rate_variance: Array
    """(n_joints, JOINT_SLOTS) [SI]"""
    joint_since: Array
    """(2, n_joints) [s]"""
    joint_refused: Array
    """(2, n_joints) [rad or m, rad/s or m/s]"""
    # Outputs of a tick.
    outcome: Array
    """(9, 4) [s, -, -, -] time, squared innovation, degrees of freedom, 1 if accepted; nan before the first."""
    twist: Array
    """(6,) [m/s, rad/s] in B."""
    range: Array
    """(2,) [m] along the altimeter's beam, nan where it is not known, and its standard deviation."""
    age: Array
    """(2,) [s] of the oldest needed channel, and of the joint positions."""
    std: Array
    """(6 + n_joints,) [m, rad] standard deviations of position in W, attitude in B, joints."""

    def __init__(self, n_joints: int) -> None:
        self.n_joints = n_joints
        self.places, size = places(n_joints)
        self.numbers = np.zeros(size)
        for name, (start, shape) in self.places.items():
            setattr(self, name, self.numbers[start : start + int(np.prod(shape))].reshape(shape))

    @property
    def covariance(self) -> Array:
        """(MAIN, MAIN) of the vehicle's errors."""
        upper = np.triu(self.P[:MAIN, :MAIN])
        return upper + np.triu(upper, 1).T


def places(n_joints: int) -> tuple[dict[str, tuple[int, tuple[int, ...]]], int]:
    """Return offset and shape of each part of the memory, by name, and the size of the whole."""
    found, at = {}, 0
    for name, shape in shapes(n_joints).items():
        found[name] = at, shape
        at += int(np.prod(shape))
    return found, at


def shapes(n_joints: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each part of the memory, by name."""
    n, c = n_joints, N_CHANNELS
    return {
        **dict.fromkeys(("sigma", "period", "gate", "agility", "recovery", "needed", "fresh", "stamp"), (c,)),
        **dict.fromkeys(("last", "used", "lag", "apart", "due", "since"), (c,)),
        **dict.fromkeys(
            ("echo_memory", "floating", "guided", "now", "has_command", "started", "before", "dt", "echo"), (1,)
        ),
        **dict.fromkeys(("gravity", "beam_at", "beam_up", "commanded_W", "commanded_spin"), (3,)),
        "drive": (len(ProcessNoise),),
        "limit": (MAIN,),
        "joint_limit": (2,),
        "commanded": (6 + n,),
        "commanded_rates": (n,),
        "value": (N_VEHICLE, 4),
        "refused": (N_VEHICLE, 3),
        "joint_value": (2, n),
        "turn": (4,),
        "x": (MAIN - 3,),
        "P": (STATES, STATES),
        **dict.fromkeys(("owner", "taken", "rate_variance"), (SLOTS,)),
        "h": (SLOTS, 4),
        "rate": (SLOTS, 3),
        "joint_x": (n, 2),
        "joint_P": (n, JOINT_STATES, JOINT_STATES),
        **dict.fromkeys(("joint_owner", "joint_taken"), (JOINT_SLOTS,)),
        **dict.fromkeys(("joint_h", "joint_rate", "joint_rate_variance"), (n, JOINT_SLOTS)),
        **dict.fromkeys(("joint_since", "joint_refused"), (2, n)),
        "outcome": (c, 4),
        "twist": (6,),
        "range": (2,),
        "age": (2,),
        "std": (6 + n,),
    }
