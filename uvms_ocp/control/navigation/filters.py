"""Estimates of the parts of a robot: vehicle, joints, and the floor below the altimeter."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from uvms_ocp.control.navigation.track import Track
from uvms_ocp.model.kinematics import STEEP, AltimeterBeam
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import CHANNELS, SensorSpec, SensorSpecs
from uvms_ocp.model.state import Reading, Readings

_SMALLEST_SIGMA = 1e-7  # stands in for the noise of an exact sensor, and keeps covariances regular
_UNKNOWN = 1e3  # [m] uncertainty of a position before its first reading
_FASTEST_GYRO = 200.0  # [Hz] taken for the rate of a gyro that reads once per tick
_STEP = 5.0  # standard deviations beyond which an echo is taken for a step of the floor


def sigma_of(spec: SensorSpec | None) -> float:
    """Standard deviation [unit of the channel] of a channel's noise for a filter."""
    return _SMALLEST_SIGMA if spec is None else max(spec.sigma, _SMALLEST_SIGMA)


class News:
    """Tells new readings from those seen before."""

    def __init__(self) -> None:
        self._last: dict[str, float] = {}

    def of(self, readings: Readings, name: str) -> Reading | None:
        """The reading of a channel if it was taken after the last one that was returned."""
        reading: Reading | None = getattr(readings, name)
        if reading is None or reading.t <= self._last.get(name, -math.inf):
            return None
        self._last[name] = reading.t
        return reading


class VehicleFilter:
    """Pose and velocity of the vehicle.

    Position, velocity and acceleration in W from position fixes, depth and DVL; attitude from the IMU's attitude, with
    its gyro (less an estimated drift) in between. Late readings are compared with where the vehicle was when they were
    taken.
    """

    def __init__(self, specs: SensorSpecs, *, jerk: float, angular_jerk: float, drift: float) -> None:
        """Driving noise: jerk [m/s3/sqrt(Hz)], angular_jerk [rad/s3/sqrt(Hz)], drift [rad/s/sqrt(s)]."""
        self._sigma = {name: sigma_of(getattr(specs, name)) for name in CHANNELS}
        gyro = specs.angular_velocity
        period = 1.0 / min(math.inf if gyro is None else gyro.rate, _FASTEST_GYRO)
        gyro_walk = max(self._sigma["angular_velocity"] * math.sqrt(period), _SMALLEST_SIGMA)
        # Spin is what the gyro shows; the second column of turn is its drift, with the sign that corrects it.
        self._motion = Track(3, sigma=(_UNKNOWN, 1.0, 0.1), density=(0.0, 0.0, jerk))
        self._spin = Track(3, sigma=(1.0, 0.1), density=(0.0, angular_jerk))
        self._turn = Track(3, sigma=(10.0, 1e-3), density=(gyro_walk, drift))
        self._quaternion = pin.Quaternion.Identity()
        self._asked_W, self._asked_omega = np.zeros(3), np.zeros(3)
        self._news = News()

    @property
    def position(self) -> np.ndarray:
        """p_WB (3,) [m]."""
        return self._motion.x[:, 0]

    @property
    def quaternion(self) -> np.ndarray:
        """Quaternion xyzw (4,) [-] of R_WB."""
        return self._quaternion.coeffs()

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation (6,) [m, rad] of the position in W and the attitude in B."""
        return np.concatenate([self._motion.spread(), self._turn.spread()])

    def velocity(self) -> np.ndarray:
        """Twist (6,) [m/s, rad/s] of B in B."""
        v_B = self._quaternion.conjugate() * self._motion.x[:, 1]
        return np.concatenate([v_B, self._angular_velocity()])

    def predict(self, dt: float, asked: np.ndarray | None) -> None:
        """Advance by dt [s]; `asked` (6,) [m/s, rad/s] is the commanded twist, whose changes the vehicle is taken to follow."""
        if asked is not None:
            self._follow(asked)
        before = self._spin.x[:, 0]
        for track in (self._motion, self._spin, self._turn):
            track.predict(dt)
        self._rotate(self._turn.take() + dt / 2 * (before + self._spin.x[:, 0]))

    def correct(self, readings: Readings, t: float) -> None:
        """Use what is new at time t [s]."""
        new = self._news.of
        if reading := new(readings, "angular_velocity"):
            age = t - reading.t
            predicted = self._spin.x[:, 0] - age * self._spin.x[:, 1]
            self._spin.correct(0, reading.value - predicted, self._sigma["angular_velocity"], age=age)
        if reading := new(readings, "attitude"):
            self._correct_attitude(reading, t)
        if reading := new(readings, "position"):
            age = t - reading.t
            self._motion.correct(0, reading.value - self._position_before(age), self._sigma["position"], age=age)
        if reading := new(readings, "depth"):
            age = t - reading.t
            error = reading.value - self._position_before(age)[2:]
            self._motion.correct(0, error, self._sigma["depth"], age=age, axes=slice(2, 3))
        if reading := new(readings, "linear_velocity"):
            self._correct_velocity(reading, t)

    def _angular_velocity(self) -> np.ndarray:
        return self._spin.x[:, 0] + self._turn.x[:, 1]

    def _follow(self, asked: np.ndarray) -> None:
        asked_W = self._quaternion * asked[:3]
        self._motion.x[:, 1] += asked_W - self._asked_W
        self._spin.x[:, 0] += asked[3:] - self._asked_omega
        self._asked_W, self._asked_omega = asked_W, asked[3:]

    def _rotate(self, rotation_vector: np.ndarray) -> None:
        self._quaternion = self._quaternion * pin.Quaternion(pin.exp3(rotation_vector))
        self._quaternion.normalize()

    def _correct_attitude(self, reading: Reading, t: float) -> None:
        age = t - reading.t
        error = pin.log3((self._quaternion.inverse() * pin.Quaternion(reading.value)).matrix())
        self._turn.correct(0, error + age * self._angular_velocity(), self._sigma["attitude"], age=age)
        self._rotate(self._turn.take())

    def _correct_velocity(self, reading: Reading, t: float) -> None:
        age = t - reading.t
        then = self._quaternion * pin.Quaternion(pin.exp3(-age * self._angular_velocity()))
        predicted = self._motion.x[:, 1] - age * self._motion.x[:, 2]
        self._motion.correct(1, then * reading.value - predicted, self._sigma["linear_velocity"], age=age)

    def _position_before(self, age: float) -> np.ndarray:
        return self._motion.x @ np.array([1.0, -age, 0.5 * age * age])


class JointFilter:
    """Positions and velocities of the joints; velocities by differentiation where no sensor gives them."""

    def __init__(self, robot: Robot, specs: SensorSpecs, *, acceleration: float) -> None:
        """acceleration: density of the driving noise [rad/s2/sqrt(Hz)], or [m/s2/sqrt(Hz)]."""
        self._model, self._q, self._v = robot.model, pin.neutral(robot.model), np.zeros(robot.n_v)
        self._joint_q, self._joint_v = robot.joint_q, robot.joint_v
        self._track = Track(robot.n_joints, sigma=(10.0, 1.0), density=(0.0, acceleration))
        self._sigma = {name: sigma_of(getattr(specs, name)) for name in ("joint_positions", "joint_velocities")}
        self._asked = np.zeros(robot.n_joints)
        self._news = News()

    @property
    def position(self) -> np.ndarray:
        """The joint part of q [rad or m]."""
        return self._q[self._joint_q]

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation (n_joints,) [rad or m] of the positions."""
        return self._track.spread()

    @property
    def velocity(self) -> np.ndarray:
        """The joint part of v (n_joints,) [rad/s or m/s]."""
        return self._track.x[:, 1]

    def predict(self, dt: float, asked: np.ndarray | None) -> None:
        """Advance by dt [s]; `asked` (n_joints,) [rad/s or m/s] is the command, whose changes the joints follow."""
        if asked is not None:
            self._track.x[:, 1] += asked - self._asked
            self._asked = asked
        self._track.predict(dt)
        self._move(self._track.take())

    def correct(self, readings: Readings, t: float) -> None:
        """Use what is new at time t [s]."""
        if reading := self._news.of(readings, "joint_positions"):
            age = t - reading.t
            error = self._error(reading.value) + age * self.velocity
            self._track.correct(0, error, self._sigma["joint_positions"], age=age)
        if reading := self._news.of(readings, "joint_velocities"):
            self._track.correct(1, reading.value - self.velocity, self._sigma["joint_velocities"])
        self._move(self._track.take())

    def _move(self, displacement: np.ndarray) -> None:
        self._v[self._joint_v] = displacement
        self._q = pin.integrate(self._model, self._q, self._v)

    def _error(self, measured: np.ndarray) -> np.ndarray:
        q = self._q.copy()
        q[self._joint_q] = measured
        return pin.difference(self._model, self._q, q)[self._joint_v]


class AltitudeFilter:
    """Altitude of the altimeter above the floor: the vertical velocity of the sensor between its echoes."""

    def __init__(
        self, robot: Robot, frame: str, spec: SensorSpec, *, roughness: float, settling: float, memory: float
    ) -> None:
        """roughness [-] is the typical slope of the floor, settling [m/sqrt(s)] what the altitude may wander at rest.

        memory [s] is how long the altitude is known without an echo.
        """
        self._beam = AltimeterBeam(robot, frame)
        self._sigma, self._roughness, self._settling, self._memory = sigma_of(spec), roughness, settling, memory
        self._altitude, self._variance = math.nan, math.inf
        self._last_echo = -math.inf
        self._news = News()

    def update(self, q: np.ndarray, v: np.ndarray, readings: Readings, t: float, dt: float) -> float:
        """The filtered range [m] at time t [s], dt [s] after the last update.

        q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s]: where the robot is and how it moves.
        """
        beam, velocity = self._beam.moving(q, v)
        self._altitude += dt * float(velocity[2])
        self._variance += dt * (self._settling**2 + self._roughness**2 * float(velocity[0] ** 2 + velocity[1] ** 2))
        reading = self._news.of(readings, "altimeter_range")
        if reading is not None and math.isfinite(reading.value):
            self._correct(beam.cosine * reading.value + (t - reading.t) * float(velocity[2]), reading.t)
        known = beam.cosine > STEEP and t - self._last_echo <= self._memory
        return self._altitude / beam.cosine if known else math.nan

    def _correct(self, measured: float, t: float) -> None:
        innovation = measured - self._altitude
        spread = self._variance + self._sigma**2
        if not innovation**2 <= _STEP**2 * spread:  # the first echo, or a step of the floor
            self._altitude, self._variance = measured, self._sigma**2
        else:
            gain = self._variance / spread
            self._altitude += gain * innovation
            self._variance *= 1.0 - gain
        self._last_echo = t
