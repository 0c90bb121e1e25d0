"""Joints that are asked to move, are pushed, and do not."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.control.actuator_health.thresholds import HealthTuning
from uvms_ocp.control.actuator_health.verdicts import FaultKind, Health, JointVerdict

_MEMORY = 2.0  # [s] of the way that a joint was asked to go
_MOVED = 0.1  # share of that way which counts as having moved


class JointMonitor:
    """Verdicts on all joints. Holds the ways they were asked to go and went: build one per run."""

    def __init__(self, effort: np.ndarray, *, tuning: HealthTuning, dt: float) -> None:
        """effort (n_joints,) [N m or N] limits; dt [s] of a tick."""
        n = len(effort)
        self._effort, self._tuning, self._dt = effort, tuning, dt
        self._keep = math.exp(-dt / _MEMORY)
        self._asked, self._moved = np.zeros(n), np.zeros(n)
        self._since = np.full(n, math.inf)
        self.jammed = np.zeros(n, dtype=bool)
        """(n_joints,)"""
        self.verdicts = [JointVerdict() for _ in range(n)]
        """On each joint."""

    def pause(self) -> None:
        """Encoders are silent: forget."""
        self._asked[:], self._moved[:], self._since[:] = 0.0, 0.0, math.inf

    def update(self, reference: np.ndarray, rate: np.ndarray, resistance: np.ndarray, t: float) -> tuple[int, ...]:
        """Take in the reference (n_joints,) and the measured rate (n_joints,) [rad/s or m/s] at time t [s].

        resistance (n_joints,) [N m or N]: what the observer finds to act on the joints beside motors and model. Returns
        the joints that were found jammed now.
        """
        self._asked = self._keep * self._asked + self._dt * reference
        self._moved = self._keep * self._moved + self._dt * rate
        way = np.abs(self._asked)
        stands = (way > self._tuning.jam_travel) & (np.abs(self._moved) < _MOVED * way)
        resists = -np.sign(self._asked) * resistance > self._tuning.jam_effort * self._effort
        self._since = np.where(stands & resists, np.minimum(self._since, t), math.inf)
        found = np.flatnonzero((t - self._since >= self._tuning.jam_time) & ~self.jammed)
        for j in found:
            self.jammed[j] = True
            since = float(self._since[j])
            self.verdicts[j] = JointVerdict(health=Health.FAULTY, kind=FaultKind.JAMMED, since=since)
        return tuple(int(j) for j in found)
