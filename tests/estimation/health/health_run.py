"""A robot that sways above a floor, its sensors, a defect for some seconds, and what the guarded
estimator makes of it.
"""

from __future__ import annotations

from collections.abc import Callable

import corruptors
import numpy as np
import pinocchio as pin

from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, Reading, Readings, SensorSpecs, State, Trust
from uvms_ocp.sim.seafloor import FlatSeafloor, Seafloor
from uvms_ocp.sim.sensors import SensorSuite

Motion = Callable[[float], np.ndarray]
Spoil = Callable[[Readings, float], Readings]

FLOOR = FlatSeafloor(z=-40.0)
_H = 1e-4  # [s] of finite differences


def swaying(robot: Robot) -> Motion:
    amplitude = np.array([0.3, 0.2, 0.2, 0.1, 0.1, 0.2] + [0.3] * robot.n_joints)
    frequency = np.linspace(0.5, 1.2, robot.n_v)  # [rad/s]
    return lambda t: amplitude * np.sin(frequency * t)


def resting(robot: Robot) -> Motion:
    still = np.zeros(robot.n_v)
    return lambda t: still


class HealthRun:
    """Series over the ticks of one run."""

    def __init__(
        self,
        robot: Robot,
        *,
        duration: float,
        spoil: Spoil = lambda readings, t: readings,
        motion: Motion | None = None,
        specs: SensorSpecs | None = None,
        floor: Seafloor = FLOOR,
        dt: float = 0.01,
        start_z: float = -36.0,
        seed: int = 0,
        requested: Motion | None = None,
    ) -> None:
        """spoil: what happens to the readings on their way. asked: the commanded velocity, the true
        one unless given.
        """
        specs = specs or SensorSpecs()
        motion = motion or swaying(robot)
        suite = SensorSuite(robot, floor, specs, seed=seed)
        q = robot.configuration(position=(0.0, 0.0, start_z))
        self.guard = GuardedEstimator(Estimator(robot, specs), robot, specs)
        self.t = dt * np.arange(round(duration / dt))
        rows = []
        command = None
        for t in self.t:
            v = motion(t)
            a = (motion(t + _H) - motion(t - _H)) / (2 * _H)
            m = self.guard(spoil(suite.read(State(q=q, v=v, a=a), t), t), t, command)
            rows.append(
                (
                    q,
                    m.q,
                    v,
                    m.v,
                    m.std,
                    m.altimeter_range,
                    m.age,
                    m.joint_age,
                    [h.trust for h in m.health],
                )
            )
            command = Command(v=(requested or motion)(t + dt))
            q = pin.integrate(robot.model, q, motion(t + dt / 2) * dt)
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        self.q, self.q_estimated, self.v, self.v_estimated, self.std = columns[:5]
        self.range, self.age, self.joint_age, self.trust = columns[5:]

    def of(self, channel: str) -> np.ndarray:
        """The verdicts on a channel."""
        return np.asarray(self.trust[:, self.guard.monitor.channels.index(channel)])

    def first_bad(self, channel: str, since: float) -> float:
        """Time after `since` [s] until the channel is no longer good; inf if it stays good."""
        bad = self.t[(self.of(channel) != Trust.GOOD) & (self.t >= since)]
        return float(bad[0]) - since if len(bad) else np.inf

    def last_bad(self, channel: str) -> float:
        """[s] when the channel was bad for the last time."""
        bad = self.t[self.of(channel) != Trust.GOOD]
        return float(bad[-1]) if len(bad) else -np.inf


def between(name: str, defect: str, start: float, end: float) -> Spoil:
    """A defect of a channel from `start` to `end` [s]."""
    corrupt = corruptors.DEFECTS[defect](name)

    def spoil(readings: Readings, t: float) -> Readings:
        if not start <= t < end or getattr(readings, name) is None:
            return readings
        return corruptors.with_defect(readings, name, corrupt, t)

    return spoil


def drifting(channel: str, rate: np.ndarray | float, onset: float) -> Spoil:
    """A channel is off by what grows with a rate [unit of the channel per s] from the onset [s]
    on.
    """

    def spoil(readings: Readings, t: float) -> Readings:
        reading = getattr(readings, channel)
        if reading is None or reading.t < onset:
            return readings
        off = np.asarray(rate) * (reading.t - onset)
        if channel == "attitude":
            turn = pin.Quaternion(pin.exp3(off))
            value = (pin.Quaternion(reading.value) * turn).coeffs()
        else:
            value = reading.value + off
        if np.ndim(value) == 0:
            value = float(value)
        fields = {name: getattr(readings, name) for name in Readings.__dataclass_fields__}
        fields[channel] = Reading(value=value, t=reading.t)
        return Readings(**fields)

    return spoil


def drifting_until(channel: str, rate: np.ndarray | float, onset: float, end: float) -> Spoil:
    """A channel that drifts, as `drifting` does, and is right again from the end [s] on."""
    drift = drifting(channel, rate, onset)

    def spoil(readings: Readings, t: float) -> Readings:
        reading = getattr(readings, channel)
        if reading is None or reading.t >= end:
            return readings
        return drift(readings, t)

    return spoil
