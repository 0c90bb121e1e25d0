"""How a robot comes to rest: all axes slow down in proportion, as fast as the first of them can.

What glides along an obstacle goes on gliding along it until it stands, while axes that stop one after the other would
swing into it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.functions.kernels.layout import Vector
from uvms_ocp.model.limits import bounded_joints
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.limits import ENDLESS, stopping_speed

_SAMPLES = np.array([0.25, 0.5, 0.75, 1.0])  # shares of the way to rest
_STILL = 1e-12  # [s] to rest
_INWARDS = np.array([[1.0], [-1.0]])  # from the lower and from the upper limit


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StopAhead:
    """A few configurations on the way to rest along the present velocity, all axes slowing down in proportion."""

    velocity: np.ndarray
    """(n_v,) [m/s, rad/s] now."""
    durations: np.ndarray
    """(k,) [s] at the present velocity, as each of them is away."""
    configurations: tuple[np.ndarray, ...]
    """k of (n_q,) [m, rad]."""


class Stop:
    """The velocity of the next tick on the way to rest as a function of this one's."""

    def __init__(self, robot: Robot, dt: float) -> None:
        """dt [s] is the control period."""
        self._model, self._dt = robot.model, dt
        self.acceleration = np.minimum(robot.limits.acceleration, ENDLESS)
        """(n_v,) [m/s2, rad/s2] finite."""
        self._step = self.acceleration * dt
        joints = bounded_joints(robot.joints, robot.limits)
        self._idx_q = np.array([joint.idx_q for joint, _, _ in joints], dtype=int)
        self._idx_v = np.array([joint.idx_v for joint, _, _ in joints], dtype=int)
        self._braking = self.acceleration[self._idx_v]
        self._bounds = np.array([bounds for _, *bounds in joints]).reshape(-1, 2).T

    def slower(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """v (n_v,) [m/s, rad/s] one tick nearer to rest.

        Joints brake harder where their position limit, not far from q (n_q,) [m, rad], asks for it.
        """
        return self._slower(q, v, self._time(v))

    def path(self, q: np.ndarray, v: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Configuration at the end of every tick and velocity during it, until rest.

        From q (n_q,) [m, rad] with v (n_v,) [m/s, rad/s].
        """
        time = self._time(v)
        while True:
            q = pin.integrate(self._model, q, v * self._dt)
            yield q, v
            v = self._slower(q, v, time)
            time = self._time(v)
            # Also where v is not a number.
            if not time >= _STILL:
                return

    def ahead(self, q: np.ndarray, v: np.ndarray) -> StopAhead | None:
        """The proportional stop alone, from q (n_q,) [m, rad] in one motion along v (n_v,) [m/s, rad/s]; None at rest."""
        length = 0.5 * self._time(v)
        if length < self._dt:
            return None
        durations = length * _SAMPLES
        configurations = tuple(pin.integrate(self._model, q, v * duration) for duration in durations)
        return StopAhead(velocity=v, durations=durations, configurations=configurations)

    def _slower(self, q: np.ndarray, v: np.ndarray, time: float) -> np.ndarray:
        """As `slower`, with the time [s] that v needs to rest."""
        slower = v * (1.0 - self._dt / time) if time > self._dt else np.zeros_like(v)
        down, up = self._joint_speeds(q)
        slower[self._idx_v] = np.maximum(np.minimum(slower[self._idx_v], up), -down)
        return np.maximum(np.minimum(slower, v + self._step), v - self._step)

    def _time(self, v: np.ndarray) -> float:
        """[s] that the slowest axis needs to rest."""
        return time_to_rest(self.acceleration.tolist(), v.tolist(), len(v))

    def _joint_speeds(self, q: np.ndarray) -> np.ndarray:
        """Speeds (2, n_bounded) [rad/s or m/s] down and up from which each bounded joint can still stop before its limit."""
        room = _INWARDS * (q[self._idx_q] - self._bounds)
        return np.asarray(stopping_speed(room, deceleration=self._braking, dt=self._dt))


def time_to_rest(acceleration: Vector, v: Vector, n: int) -> float:
    """[s] that the slowest of n axes needs to rest from v [m/s, rad/s] at its `acceleration` [m/s2, rad/s2]. A kernel."""
    time = 0.0
    for i in range(n):
        time = max(time, abs(v[i]) / acceleration[i])
    return time
