"""Truths drawn from the process model of the estimator, and what sensors with drifting biases read
of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.tuning import ALTITUDE_DRIFT, BIAS_DRIFTS, EstimatorTuning
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, SensorSpecs, State
from uvms_ocp.sim.seafloor import Seafloor
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.types import Array

_BIASED = ("angular_velocity", "linear_velocity", "specific_force")
_SHOCK = np.linalg.cholesky(
    np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
)
"""Root of the covariance of a value and its two derivatives after unit time of white noise of the
third."""


class DrawnFloor(Seafloor):
    """Level, at the height that the process has brought it to."""

    def __init__(self, z: float) -> None:
        self.z = z

    def height(self, x: float, y: float) -> float:
        """z [m], everywhere."""
        return self.z

    def normal(self, x: float, y: float) -> np.ndarray:
        """Upwards."""
        return np.array([0.0, 0.0, 1.0])

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """[m]; nan without a hit."""
        if direction[2] >= 0.0:
            return np.nan
        return float((self.z - origin[2]) / direction[2])


@dataclass(kw_only=True, slots=True)
class Drawn:
    """A true motion that goes as the process model says."""

    robot: Robot
    tuning: EstimatorTuning
    rng: np.random.Generator
    dt: float
    floor: DrawnFloor = field(default_factory=lambda: DrawnFloor(-30.0))
    place: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3) position, velocity and acceleration in W, one per row [m, m/s, m/s2]."""
    R: Array = field(default_factory=lambda: np.eye(3))
    spin: Array = field(default_factory=lambda: np.zeros((2, 3)))
    """(2, 3) angular velocity and acceleration in B [rad/s, rad/s2]."""
    joints: Array = field(init=False)
    """(2, n_joints) [rad or m, rad/s or m/s]"""
    biases: dict[str, Array] = field(init=False)

    def __post_init__(self) -> None:
        sizes = (self.tuning.gyro_bias, self.tuning.dvl_bias, self.tuning.force_bias)
        self.biases = {}
        for name, size in zip(_BIASED, sizes, strict=True):
            self.biases[name] = size * self._normal(3)
        self.joints = np.zeros((2, self.robot.n_joints))

    def state(self) -> State:
        """The truth now."""
        v_B = self.R.T @ self.place[1]
        spin = self.spin[0]
        a_B = self.R.T @ self.place[2] - np.cross(spin, v_B)
        q = np.concatenate([self.place[0], pin.Quaternion(self.R).coeffs(), self.joints[0]])
        v = np.concatenate([v_B, spin, self.joints[1]])
        a = np.concatenate([a_B, self.spin[1], 0.0 * self.joints[1]])
        return State(q=q, v=v, a=a)

    def step(self) -> None:
        """Go on by dt."""
        dt = self.dt
        tuning = self.tuning
        self._raise_floor()
        shock = tuning.jerk * self._shock()
        self.place = _carried(self.place, dt) + shock
        turn, spin, spin_up = tuning.angular_jerk * self._shock()
        angle = dt * self.spin[0] + dt * dt / 2 * self.spin[1] + turn
        self.R = self.R @ pin.exp3(angle)
        self.spin = _carried(self.spin, dt) + np.array([spin, spin_up])
        for name, drift in zip(_BIASED, BIAS_DRIFTS, strict=True):
            self.biases[name] = self.biases[name] + drift * np.sqrt(dt) * self._normal(3)
        push = tuning.joint_acceleration * np.sqrt(dt) * self._normal(2, self.robot.n_joints)
        halves = np.linalg.cholesky(np.array([[dt * dt / 3, dt / 2], [dt / 2, 1.0]]))
        self.joints = _carried(self.joints, dt) + halves @ push

    def _raise_floor(self) -> None:
        speed = np.hypot(*self.place[1, :2])
        variance = self.dt * (ALTITUDE_DRIFT**2 + (self.tuning.floor_roughness * speed) ** 2)
        self.floor.z += np.sqrt(variance) * float(self._normal())

    def _shock(self) -> Array:
        """(3, 3) what white noise of the third derivative does in dt, one derivative per row."""
        powers = np.array([self.dt**2.5, self.dt**1.5, self.dt**0.5])
        return powers[:, None] * (_SHOCK @ self._normal(3, 3))

    def _normal(self, *shape: int) -> Array:
        return np.asarray(self.rng.standard_normal(shape))


def _carried(values: Array, dt: float) -> Array:
    """Integrate each row with its derivatives, the next rows, over dt [s]."""
    moved = values.copy()
    moved[:-1] += dt * values[1:]
    if len(values) == 3:
        moved[0] += dt * dt / 2 * values[2]
    return moved


class Watched:
    """A drawn truth, its sensors and one or several estimators that see the same or less late
    readings.
    """

    def __init__(
        self,
        robot: Robot,
        specs: SensorSpecs,
        tuning: EstimatorTuning,
        *,
        seed: int,
        dt: float = 0.01,
    ) -> None:
        streams = np.random.SeedSequence(seed).spawn(2)
        self.truth = Drawn(robot=robot, tuning=tuning, rng=np.random.default_rng(streams[0]), dt=dt)
        self.estimator = Estimator(robot, specs, tuning)
        self._suite = SensorSuite(
            robot, self.truth.floor, specs, int(streams[1].generate_state(1)[0])
        )
        self._biases: list[dict[str, Array]] = []
        self._dt = dt
        self._k = 0
        self._shown: dict[str, tuple[Reading, Reading]] = {}

    @property
    def t(self) -> float:
        """[s] of the last tick."""
        return (self._k - 1) * self._dt

    def tick(self) -> None:
        """Measure, estimate, and let the truth go on; the truth stays that of the tick until the
        next call.
        """
        if self._k:
            self.truth.step()
        self._biases.append(self.truth.biases.copy())
        t = self._k * self._dt
        readings = self._suite.read(self.truth.state(), t)
        self.estimator(self._biased(readings), t)
        self._k += 1

    def _biased(self, readings: Readings) -> Readings:
        values = {name: getattr(readings, name) for name in readings.__dataclass_fields__}
        for name in _BIASED:
            if values[name] is not None:
                values[name] = self._with_bias(name, values[name])
        return Readings(**values)

    def _with_bias(self, name: str, reading: Reading) -> Reading:
        shown = self._shown.get(name)
        if shown is None or shown[0] is not reading:
            bias = self._biases[round(reading.t / self._dt)][name]
            self._shown[name] = reading, Reading(value=reading.value + bias, t=reading.t)
        return self._shown[name][1]
