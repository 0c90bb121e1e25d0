"""Signals between plant, estimator and controller: `Readings`, `StateEstimate`, `Command`; and the
channels of the sensors.

Configuration ``q`` and velocity ``v`` follow Pinocchio's free-flyer order, see
`uvms_ocp.robot.spatial`.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import field, fields, replace
from typing import Annotated, Any, Generic, TypeAlias, TypeVar

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, unchecked_constructor
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.description import RobotDescription, SensorDescription
from uvms_ocp.types import Finite, Magnitude, Range, Shape, Vector3

Value = TypeVar("Value", float, np.ndarray)
_Configuration: TypeAlias = Annotated[np.ndarray, Shape("n_q")]
_Velocity: TypeAlias = Annotated[np.ndarray, Shape("n_v")]
_Quaternion: TypeAlias = Annotated[np.ndarray, Shape(4)]
_JointPositions: TypeAlias = Annotated[np.ndarray, Shape("n_joint_q")]
_JointVelocities: TypeAlias = Annotated[np.ndarray, Shape("n_joints")]

SAME_TIME = 1e-6  # [s] rounding of times since 1970

UNITS: Mapping[str, str] = {
    "position": "m",
    "depth": "m",
    "attitude": "rad",
    "angular_velocity": "rad/s",
    "linear_velocity": "m/s",
    "joint_positions": "rad or m",
    "joint_velocities": "rad/s or m/s",
    "altimeter_range": "m",
    "specific_force": "m/s2",
}
"""Units of the values of each channel."""


class Trust(enum.IntEnum):
    """Trust in one channel of the readings."""

    GOOD = 0
    """Its readings are used."""
    SUSPECT = 1
    """Something speaks against it: its readings are used with care, or not for the moment."""
    LOST = 2
    """Its readings are not used."""


@checked_dataclass()
class ChannelHealth:
    """Health of one channel."""

    channel: str
    """Name of the channel, a field of `Readings`."""
    trust: Trust
    """Trust in the channel."""
    why: str = ""
    """Reason in a few words, with figures; empty where the channel is good."""
    since: float = 0.0
    """Time [s] from which on the channel has had this trust."""


@checked_dataclass(eq=False)
class State:
    """True or estimated state of the robot."""

    q: _Configuration
    """Configuration (n_q,) [m, rad]."""
    v: _Velocity
    """Generalized velocity (n_v,) [m/s, rad/s], vehicle part in B."""
    a: _Velocity | None = None
    """Rate of v (n_v,) [m/s2, rad/s2], where it is known; an accelerometer needs it."""


@checked_dataclass(eq=False)
class Reading(Generic[Value]):
    """The last value that a sensor delivered."""

    value: Value
    """Value, in the unit of the channel (`UNITS`)."""
    t: float
    """Time [s] when it was taken, which is earlier than when it arrived if the sensor has a delay."""


@checked_dataclass(eq=False)
class Readings:
    """The last reading of every channel at one tick; `None` before the first and where there is no
    such sensor.
    """

    position: Reading[Vector3] | None = None
    """Position p_WB (3,) [m]."""
    depth: Reading[float] | None = None
    """Height z of p_WB [m]."""
    attitude: Reading[_Quaternion] | None = None
    """Quaternion xyzw of R_WB (4,)."""
    angular_velocity: Reading[Vector3] | None = None
    """Angular velocity (3,) [rad/s] in B."""
    linear_velocity: Reading[Vector3] | None = None
    """Velocity (3,) [m/s] of B over ground, in B."""
    joint_positions: Reading[_JointPositions] | None = None
    """Joint part of q (n_q - 7,) or (n_q,) [rad or m]."""
    joint_velocities: Reading[_JointVelocities] | None = None
    """Joint rates (n_joints,) [rad/s or m/s]."""
    altimeter_range: Reading[float] | None = None
    """Distance [m] along -z of the altimeter frame; nan without an echo."""
    specific_force: Reading[Vector3] | None = None
    """Acceleration of the origin of B less gravity (3,) [m/s2] in B."""


@checked_dataclass(eq=False)
class StateEstimate:
    """The navigation solution at one tick; the only thing a controller sees."""

    q: _Configuration
    """Configuration (n_q,) [m, rad]."""
    v: _Velocity
    """Generalized velocity (n_v,) [m/s, rad/s]."""
    altimeter_range: float
    """Distance [m] along -z of the altimeter frame; nan where there is no echo."""
    age: float = 0.0
    """Age [s] of the oldest reading that it needs; inf before the first."""
    oldest: str = ""
    """Channel of the oldest reading; empty where it is not known."""
    joint_age: float = 0.0
    """Age [s] of the joint positions alone."""
    health: tuple[ChannelHealth, ...] = ()
    """Health of every channel that the robot has; empty without a health monitor."""
    std: _Velocity | None = None
    """Standard deviations of q (n_v,) [m, rad]: position in W, attitude in B, joints; `None` where
    they are not known.
    """
    altimeter_std: float = np.nan
    """Standard deviation [m] of `altimeter_range`; nan where it is not known."""


@checked_dataclass(eq=False)
class Command:
    """Setpoints for the plant at one tick."""

    v: _Velocity
    """Reference velocity (n_v,) [m/s, rad/s]."""
    thrust: Annotated[np.ndarray, Shape("n_thrusters")] | None = None
    """Desired thrust (n_thrusters,) [N]; kinematic layers leave it out."""
    torque: Annotated[np.ndarray, Shape("n_joints")] | None = None
    """Desired torque or force (n_joints,) [N m or N] of the joint motors."""
    hold: bool = False
    """True where the vehicle's estimated velocity is not to be trusted."""
    stop: bool = False
    """True to cut the thrust."""
    brakes: bool = False
    """True to lock the joints: motors cannot hold them while their encoders are silent."""
    finished: bool = False
    """True when the mission is complete, and the loop may stop."""
    telemetry: Mapping[str, Any] = field(default_factory=dict)
    """Scalars and arrays to record."""


unchecked_state = unchecked_constructor(State)
unchecked_reading = unchecked_constructor(Reading)
unchecked_readings = unchecked_constructor(Readings)
unchecked_estimate = unchecked_constructor(StateEstimate)
unchecked_command = unchecked_constructor(Command)
"""Constructors that neither check their arguments nor copy arrays, for values made at every tick."""


@checked_dataclass()
class SensorSpec:
    """Rate, noise and delay of one channel, for the simulated sensors and the estimator alike.
    Raises `InvalidInput` for a value outside its range.
    """

    rate: float = math.inf
    """Readings per second [Hz]; inf is once per tick."""
    sigma: Magnitude = 0.0
    """Standard deviation [unit of the channel] of the noise of every component."""
    bias: Finite | tuple[Finite, ...] = 0.0
    """Constant error [unit of the channel], of all components or of each."""
    delay: Magnitude = 0.0
    """Time [s] between taking a reading and delivering it."""
    dropout: Annotated[float, Range(0.0, 1.0)] = 0.0
    """Probability that a reading is lost."""

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise InvalidInput(
                f"sensor rate = {self.rate} Hz; give a number > 0, or inf for once per tick"
            )

    @property
    def biases(self) -> tuple[float, ...]:
        """`bias` as one value for all components, or one per component."""
        if isinstance(self.bias, tuple):
            return self.bias
        return (self.bias,)

    @property
    def exact(self) -> bool:
        """True where readings equal the truth."""
        return self.sigma == 0.0 and not any(self.biases)


@checked_dataclass()
class SensorSpecs:
    """All channels of `Readings`; `None` where the robot has no such sensor. The noise of the
    defaults is assumed.
    """

    position: SensorSpec | None = SensorSpec(rate=5.0, sigma=0.02)
    """Position p_WB [m] in W."""
    depth: SensorSpec | None = SensorSpec(rate=10.0, sigma=0.01)
    """Height z of p_WB [m]."""
    attitude: SensorSpec | None = SensorSpec(rate=100.0, sigma=0.001)
    """Attitude in W, whose error is a rotation vector [rad] in B."""
    angular_velocity: SensorSpec | None = SensorSpec(rate=100.0, sigma=0.002)
    """Angular velocity [rad/s] in B, of a gyroscope."""
    linear_velocity: SensorSpec | None = SensorSpec(rate=5.0, sigma=0.002)
    """Velocity [m/s] over ground in B, of a DVL."""
    joint_positions: SensorSpec | None = SensorSpec(rate=200.0, sigma=1e-4)
    """Positions of the joints [rad or m], of encoders."""
    joint_velocities: SensorSpec | None = None
    """Velocities of the joints [rad/s or m/s]."""
    altimeter_range: SensorSpec | None = SensorSpec(rate=10.0, sigma=0.01)
    """Range of the altimeter [m]."""
    specific_force: SensorSpec | None = None
    """[m/s2] of an accelerometer at the origin of B; `ACCELEROMETER` is a usual one."""


CHANNELS = tuple(field.name for field in fields(SensorSpecs))
"""Names of the channels, the fields of `SensorSpecs` and of `Readings`."""


ACCELEROMETER = SensorSpec(rate=100.0, sigma=0.02)
"""Usual specification for `SensorSpecs.specific_force`, assumed: 2 mm/s2/sqrt(Hz)."""

IDEAL_SENSORS = SensorSpecs(**dict.fromkeys(CHANNELS, SensorSpec()) | {"specific_force": None})
"""Every channel of the state itself, once per tick, without error or delay; no accelerometer, as the
filter has no use for it then.
"""


@checked
def robot_sensors(description: RobotDescription) -> SensorSpecs:
    """Return the channels of a robot: the defaults of `SensorSpecs`, changed as its file says."""
    channels = {
        name: _channel(getattr(SensorSpecs(), name), channel_description)
        for name, channel_description in description.sensors.items()
    }
    return replace(SensorSpecs(), **channels)


def _channel(
    default: SensorSpec | None, description: SensorDescription | None
) -> SensorSpec | None:
    if description is None:
        return None
    return replace(default or SensorSpec(), **description.model_dump(exclude_none=True))
