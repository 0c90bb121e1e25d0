"""Signals between plant, estimator and controller: `Readings`, `StateEstimate`, `Command`; and the
channels of the sensors.

Configuration ``q`` and velocity ``v`` follow Pinocchio's free-flyer order, see
`uvms_ocp.robot.spatial`.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from operator import attrgetter
from typing import Annotated, Any, Generic, TypeAlias, TypeVar

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, unchecked_constructor
from uvms_ocp.robot.channels import (
    CHANNEL_OF,
    CHANNELS as CHANNELS,
    UNITS as UNITS,
    Channel,
    SensorSpec as SensorSpec,
    require_own,
)
from uvms_ocp.robot.description import RobotDescription, SensorDescription
from uvms_ocp.types import Shape, Vector3

Value = TypeVar("Value", float, np.ndarray)
_Configuration: TypeAlias = Annotated[np.ndarray, Shape("n_q")]
_Velocity: TypeAlias = Annotated[np.ndarray, Shape("n_v")]
_Quaternion: TypeAlias = Annotated[np.ndarray, Shape(4)]
_JointPositions: TypeAlias = Annotated[np.ndarray, Shape("n_joint_q")]
_JointVelocities: TypeAlias = Annotated[np.ndarray, Shape("n_joints")]

SAME_TIME = 1e-6  # [s] rounding of times since 1970


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
    own: Mapping[str, Reading[Any]] = field(default_factory=dict)
    """Readings of a user's own channels, by name."""


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

_of_toolkit = attrgetter(*CHANNELS)


def readings_by_channel(readings: Readings, own: Sequence[str]) -> tuple[Reading[Any] | None, ...]:
    """Return the readings of all channels in their order, of which `own` are a user's, which come
    last; `None` for none.
    """
    if not own:
        toolkit: tuple[Reading[Any] | None, ...] = _of_toolkit(readings)
        return toolkit
    return (*_of_toolkit(readings), *map(readings.own.get, own))


def readings_of(by_channel: Mapping[str, Reading[Any] | None]) -> Readings:
    """Return readings that are given by channel, the toolkit's or a user's own, unchecked."""
    toolkit = dict[str, Any]()
    own = dict[str, Reading[Any]]()
    for name, reading in by_channel.items():
        if name in CHANNEL_OF:
            toolkit[name] = reading
        elif reading is not None:
            own[name] = reading
    return unchecked_readings(**toolkit, own=own)


@checked_dataclass()
class SensorSpecs:
    """Sensors of a robot by the channels of `Readings`; `None` where the robot has no such sensor.
    The noise of the defaults is assumed.

    Raises `InvalidInput` for channels of one's own without a measurement function, and for names
    that there are already.
    """

    position: SensorSpec | None = CHANNEL_OF["position"].sensor
    """Position p_WB [m] in W."""
    depth: SensorSpec | None = CHANNEL_OF["depth"].sensor
    """Height z of p_WB [m]."""
    attitude: SensorSpec | None = CHANNEL_OF["attitude"].sensor
    """Attitude in W, whose error is a rotation vector [rad] in B."""
    angular_velocity: SensorSpec | None = CHANNEL_OF["angular_velocity"].sensor
    """Angular velocity [rad/s] in B, of a gyroscope."""
    linear_velocity: SensorSpec | None = CHANNEL_OF["linear_velocity"].sensor
    """Velocity [m/s] over ground in B, of a DVL."""
    joint_positions: SensorSpec | None = CHANNEL_OF["joint_positions"].sensor
    """Positions of the joints [rad or m], of encoders."""
    joint_velocities: SensorSpec | None = CHANNEL_OF["joint_velocities"].sensor
    """Velocities of the joints [rad/s or m/s]."""
    altimeter_range: SensorSpec | None = CHANNEL_OF["altimeter_range"].sensor
    """Range of the altimeter [m]."""
    specific_force: SensorSpec | None = CHANNEL_OF["specific_force"].sensor
    """[m/s2] of an accelerometer at the origin of B; `ACCELEROMETER` is a usual one."""
    own: tuple[Channel, ...] = ()
    """Channels of a user's own, which the filter fuses by their measurement functions."""

    def __post_init__(self) -> None:
        require_own(self.own)

    @property
    def present(self) -> dict[str, SensorSpec]:
        """Sensors that there are, by channel: the toolkit's in the order of `Readings`, then a
        user's own.
        """
        sensors = dict[str, SensorSpec]()
        for name in CHANNELS:
            sensor = getattr(self, name)
            if sensor is not None:
                sensors[name] = sensor
        for channel in self.own:
            assert channel.sensor is not None
            sensors[channel.name] = channel.sensor
        return sensors


def with_sensors(specs: SensorSpecs, sensors: Mapping[str, SensorSpec | None]) -> SensorSpecs:
    """Return specifications with other sensors of some channels; `None` for none."""
    own = list[Channel]()
    for channel in specs.own:
        sensor = sensors.get(channel.name, channel.sensor)
        if sensor is not None:
            own.append(replace(channel, sensor=sensor))
    toolkit = dict[str, Any]()
    for name in CHANNELS:
        if name in sensors:
            toolkit[name] = sensors[name]
    return replace(specs, **toolkit, own=tuple(own))


ACCELEROMETER = SensorSpec(rate=100.0, sigma=0.02)
"""Usual specification for `SensorSpecs.specific_force`, assumed: 2 mm/s2/sqrt(Hz)."""

_IDEAL: dict[str, Any] = dict.fromkeys(CHANNELS, SensorSpec())
IDEAL_SENSORS = SensorSpecs(**{**_IDEAL, "specific_force": None})
"""Every channel of the state itself, once per tick, without error or delay; no accelerometer, as the
filter has no use for it then.
"""


@checked
def robot_sensors(description: RobotDescription) -> SensorSpecs:
    """Return the channels of a robot: the defaults of `SensorSpecs`, changed as its file says."""
    usual = SensorSpecs()
    sensors = dict[str, SensorSpec | None]()
    for name, channel_description in description.sensors.items():
        sensors[name] = _channel(getattr(usual, name), channel_description)
    return with_sensors(usual, sensors)


def _channel(
    default: SensorSpec | None, description: SensorDescription | None
) -> SensorSpec | None:
    if description is None:
        return None
    return replace(default or SensorSpec(), **description.model_dump(exclude_none=True))
