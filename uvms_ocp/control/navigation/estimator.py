"""State estimation: the readings of the sensors in, what controllers see out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uvms_ocp.arguments import checked, late, trusted
from uvms_ocp.control.navigation.filters import AltitudeFilter, JointFilter, VehicleFilter
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import CHANNELS, IDEAL_SENSORS, SensorSpecs
from uvms_ocp.model.state import Command, Measurement, Readings

_measurement = trusted(Measurement)

_VEHICLE_CHANNELS = ("position", "attitude", "linear_velocity", "angular_velocity")
_JOINT_CHANNELS = ("joint_positions",)
_OPTIONAL_CHANNELS = ("depth", "joint_velocities")  # improve an estimate that does not need them
_LATEST = 1e9  # [s] of any clock; thirty years


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorTuning:
    """How fast the robot and the floor are expected to change. Raises `InvalidInput` for a number not > 0.

    Larger: less lag, more noise.
    """

    jerk: float = 0.1
    """[m/s3/sqrt(Hz)] of the vehicle."""
    angular_jerk: float = 0.5
    """[rad/s3/sqrt(Hz)] of the vehicle."""
    gyro_drift: float = 1e-5
    """[rad/s/sqrt(s)]"""
    joint_acceleration: float = 0.02
    """[rad/s2/sqrt(Hz)]"""
    floor_roughness: float = 0.3
    """[-] slope."""
    altitude_drift: float = 0.005
    """[m/sqrt(s)] at rest."""
    echo_memory: float = 1.0
    """[s] for which the altitude is known without an echo."""
    response_time: float = 0.1
    """[s] with which velocities are taken to follow commands."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of the estimator = {value}; give a finite number > 0")


@checked
class Estimator:
    """A callable ``(Readings, t, command) -> Measurement``. Holds its estimate: build one per run.

    Until a channel has its first reading its part of the estimate means nothing, and `Measurement.age` is inf.
    """

    def __init__(
        self,
        robot: Robot,
        specs: SensorSpecs | None = None,
        tuning: EstimatorTuning | None = None,
        altimeter_frame: str | None = None,
    ) -> None:
        """specs: the noise to expect. altimeter_frame: the one of the robot's description unless given.

        Raises `FrameNotFound` for an unknown altimeter frame.
        """
        specs, tuning = specs or SensorSpecs(), tuning or EstimatorTuning()
        altimeter_frame = altimeter_frame or robot.description.altimeter
        self._n_vehicle = robot.n_vehicle
        self._needed = _needed_channels(robot, specs, altimeter_frame)
        self._vehicle = VehicleFilter(
            specs, jerk=tuning.jerk, angular_jerk=tuning.angular_jerk, drift=tuning.gyro_drift
        )
        self._joints = JointFilter(robot, specs, acceleration=tuning.joint_acceleration)
        self._altitude = _altitude_filter(robot, specs, tuning, altimeter_frame)
        self._response_time = tuning.response_time
        self._response = np.zeros(robot.n_v)
        self._t: float | None = None

    @late
    def __call__(self, readings: Readings, t: float, command: Command | None = None) -> Measurement:
        """The estimate at time t [s]; `command` has been acting since the last call.

        Raises `InvalidInput` for a time before that of the last call, or beyond 1e9 s.
        """
        if not abs(t) <= _LATEST:
            raise InvalidInput(f"estimator called at t = {t} s; give a time of at most {_LATEST:g} s")
        dt = 0.0 if self._t is None else t - self._t
        if dt < 0:
            raise InvalidInput(f"estimator called at t = {t} s after t = {self._t} s; give increasing times")
        self._t = t
        asked = None if command is None else self._follow(command, dt)
        q, v = self._joints_at(readings, t, dt, asked)
        if self._n_vehicle:
            q_vehicle, v_vehicle = self._vehicle_at(readings, t, dt, asked)
            q, v = np.concatenate([*q_vehicle, q]), np.concatenate([v_vehicle, v])
        echo = math.nan if self._altitude is None else self._altitude.update(q, v, readings, t, dt)
        age, oldest = oldest_of(readings, self._needed, t)
        joint_age = age_of(readings, _JOINT_CHANNELS, t)
        return _measurement(q=q, v=v, altimeter_range=echo, age=age, oldest=oldest, joint_age=joint_age)

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation (n_v,) [m, rad] of the estimated q, by its own covariance: position in W, attitude in B, joints."""
        vehicle = self._vehicle.spread[: self._n_vehicle]
        return np.concatenate([vehicle, self._joints.spread])

    def _follow(self, command: Command, dt: float) -> np.ndarray:
        """The velocity (n_v,) [m/s, rad/s] that the command has brought about, were there nothing else."""
        self._response = command.v + math.exp(-dt / self._response_time) * (self._response - command.v)
        return self._response

    def _joints_at(
        self, readings: Readings, t: float, dt: float, asked: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        self._joints.predict(dt, None if asked is None else asked[self._n_vehicle :])
        self._joints.correct(readings, t)
        return self._joints.position.copy(), self._joints.velocity.copy()

    def _vehicle_at(
        self, readings: Readings, t: float, dt: float, asked: np.ndarray | None
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        self._vehicle.predict(dt, None if asked is None else asked[:6])
        self._vehicle.correct(readings, t)
        return (self._vehicle.position, self._vehicle.quaternion), self._vehicle.velocity()


@checked
class PassThrough:
    """Takes readings for the truth: for sensors without noise, which it repeats exactly."""

    def __init__(self, robot: Robot, specs: SensorSpecs = IDEAL_SENSORS, altimeter_frame: str | None = None) -> None:
        """altimeter_frame: the one of the robot's description unless given.

        Raises `InvalidInput` where a channel that it needs is missing: it estimates nothing.
        """
        free = robot.n_vehicle > 0
        self._q_channels = (*(("position", "attitude") if free else ()), "joint_positions")
        self._v_channels = (*(("linear_velocity", "angular_velocity") if free else ()), "joint_velocities")
        for name in (*self._q_channels, *self._v_channels):
            if getattr(specs, name) is None:
                raise InvalidInput(f"sensor {name} is missing; add it, or use an Estimator instead of PassThrough")
        self._needed = (
            *_needed_channels(robot, specs, altimeter_frame or robot.description.altimeter),
            "joint_velocities",
        )

    @late
    def __call__(self, readings: Readings, t: float, command: Command | None = None) -> Measurement:
        """The last readings at time t [s]; `command` is not read. Raises `InvalidInput` before the first ones."""
        age, oldest = oldest_of(readings, self._needed, t)
        if age == math.inf:
            raise InvalidInput(f"no reading of every channel yet at t = {t} s; use an Estimator for such sensors")
        q, v = (
            np.concatenate([getattr(readings, name).value for name in channels])
            for channels in (self._q_channels, self._v_channels)
        )
        echo = readings.altimeter_range
        return _measurement(
            q=q,
            v=v,
            altimeter_range=math.nan if echo is None else echo.value,
            age=age,
            oldest=oldest,
            joint_age=age_of(readings, _JOINT_CHANNELS, t),
        )


def age_of(readings: Readings, channels: tuple[str, ...], t: float) -> float:
    """Age [s] at time t [s] of the oldest of the channels' readings; inf where one is missing."""
    return oldest_of(readings, channels, t)[0]


def oldest_of(readings: Readings, channels: tuple[str, ...], t: float) -> tuple[float, str]:
    """Age [s] at time t [s] of the oldest of the channels' readings, inf where one is missing, and which channel that is."""
    taken, oldest = t, ""
    for name in channels:
        reading = getattr(readings, name)
        if reading is None:
            return math.inf, name
        if reading.t < taken:
            taken, oldest = reading.t, name
    return t - taken, oldest


def _needed_channels(robot: Robot, specs: SensorSpecs, altimeter_frame: str | None) -> tuple[str, ...]:
    """Channels that the robot has and that no other replaces."""
    skipped = (
        *_OPTIONAL_CHANNELS,
        *(() if robot.n_vehicle else _VEHICLE_CHANNELS),
        *(() if altimeter_frame else ("altimeter_range",)),
    )
    return tuple(name for name in CHANNELS if getattr(specs, name) is not None and name not in skipped)


def _altitude_filter(
    robot: Robot, specs: SensorSpecs, tuning: EstimatorTuning, frame: str | None
) -> AltitudeFilter | None:
    if specs.altimeter_range is None or frame is None:
        return None
    return AltitudeFilter(
        robot,
        frame,
        specs.altimeter_range,
        roughness=tuning.floor_roughness,
        settling=tuning.altitude_drift,
        memory=tuning.echo_memory,
    )
