"""What flows between plant and controller: `Readings` to an estimator, its `Measurement` in, `Command` out.

Configuration ``q`` and velocity ``v`` follow Pinocchio's free-flyer order, see `uvms_ocp.model.spatial`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, TypeAlias, TypeVar

import numpy as np

from uvms_ocp.arguments import Shape, Vector3, checked
from uvms_ocp.model.health import ChannelHealth

Value = TypeVar("Value", float, np.ndarray)
_Configuration: TypeAlias = Annotated[np.ndarray, Shape("n_q")]
_Velocity: TypeAlias = Annotated[np.ndarray, Shape("n_v")]
_Quaternion: TypeAlias = Annotated[np.ndarray, Shape(4)]
_JointPositions: TypeAlias = Annotated[np.ndarray, Shape("n_joint_q")]
_JointVelocities: TypeAlias = Annotated[np.ndarray, Shape("n_joints")]


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class State:
    """True or estimated state of the robot."""

    q: _Configuration
    """(n_q,) [m, rad] configuration."""
    v: _Velocity
    """(n_v,) [m/s, rad/s] generalized velocity, vehicle part in B."""
    a: _Velocity | None = None
    """(n_v,) [m/s2, rad/s2] rate of v, where it is known; an accelerometer needs it."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Reading(Generic[Value]):
    """The last value that a sensor delivered."""

    value: Value
    t: float
    """[s] when it was taken, which is earlier than when it arrived if the sensor has a delay."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Readings:
    """The last reading of every channel at one tick; `None` before the first and where there is no such sensor."""

    position: Reading[Vector3] | None = None
    """(3,) [m] p_WB"""
    depth: Reading[float] | None = None
    """[m] z of p_WB."""
    attitude: Reading[_Quaternion] | None = None
    """(4,) [-] quaternion xyzw of R_WB."""
    angular_velocity: Reading[Vector3] | None = None
    """(3,) [rad/s] in B."""
    linear_velocity: Reading[Vector3] | None = None
    """(3,) [m/s] of B over ground, in B."""
    joint_positions: Reading[_JointPositions] | None = None
    """(n_q - 7,) or (n_q,) [rad or m] the joint part of q."""
    joint_velocities: Reading[_JointVelocities] | None = None
    """(n_joints,) [rad/s or m/s]"""
    altimeter_range: Reading[float] | None = None
    """[m] along -z of the altimeter frame; nan without an echo."""
    specific_force: Reading[Vector3] | None = None
    """(3,) [m/s2] in B: acceleration of the origin of B less gravity."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Measurement:
    """The navigation solution at one tick; the only thing a controller sees."""

    q: _Configuration
    """(n_q,) [m, rad] configuration."""
    v: _Velocity
    """(n_v,) [m/s, rad/s] generalized velocity."""
    altimeter_range: float
    """[m] along -z of the altimeter frame; nan where there is no echo."""
    age: float = 0.0
    """[s] of the oldest reading that it needs; inf before the first."""
    oldest: str = ""
    """The channel of that reading; empty where nobody tells."""
    joint_age: float = 0.0
    """[s] of the joint positions alone."""
    health: tuple[ChannelHealth, ...] = ()
    """Of every channel that the robot has; empty where nobody judges."""
    spread: _Velocity | None = None
    """(n_v,) [m, rad] standard deviations of q: position in W, attitude in B, joints; `None` where nobody tells."""
    altimeter_spread: float = np.nan
    """[m] standard deviation of `altimeter_range`; nan where it is not known."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Command:
    """What a controller asks of the plant at one tick."""

    v: _Velocity
    """(n_v,) [m/s, rad/s] reference velocity."""
    thrust: Annotated[np.ndarray, Shape("n_thrusters")] | None = None
    """(n_thrusters,) [N] asked of the thrusters; kinematic layers leave it out."""
    torque: Annotated[np.ndarray, Shape("n_joints")] | None = None
    """(n_joints,) [N m or N] asked of the joint motors."""
    hold: bool = False
    """The vehicle's measured velocity is not to be trusted."""
    stop: bool = False
    """Cut the thrust."""
    brakes: bool = False
    """Lock the joints: they cannot be held by motors while their encoders are silent."""
    finished: bool = False
    """The mission is complete; the loop may stop."""
    telemetry: Mapping[str, Any] = field(default_factory=dict)
    """Scalars and arrays to record."""
