"""Joints that are asked to move, are pushed, and do not."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning
from uvms_ocp.control.actuator_health.verdicts import FaultKind, Health, JointVerdict

_MEMORY = 2.0  # [s] of the way that a joint was asked to go
_MOVED = 0.1  # share of that way which counts as having moved


class JointMonitor:
    """Verdicts on all joints. Holds the ways they were asked to go and went: build one per run."""

    def __init__(self, effort: np.ndarray, *, tuning: ActuatorHealthTuning) -> None:
        """effort (n_joints,) [N m or N] limits."""
        n = len(effort)
        self._effort, self._tuning = effort, tuning
        self._asked, self._moved = np.zeros(n), np.zeros(n)
        self._before: np.ndarray | None = None
        self._t = 0.0
        self._since = np.full(n, math.inf)
        self.jammed = np.zeros(n, dtype=bool)
        """(n_joints,)"""
        self.verdicts = [JointVerdict() for _ in range(n)]
        """On each joint."""

    def pause(self) -> None:
        """Encoders are silent or doubted: forget."""
        self._asked[:], self._moved[:], self._since[:] = 0.0, 0.0, math.inf
        self._before = None

    def look(self, way: np.ndarray, q: np.ndarray, resistance: np.ndarray, t: float) -> tuple[int, ...]:
        """Take in the way (n_joints,) [rad or m] asked since the last look, and q (n_joints,) where they
        are, by the way they went, at time t [s].

        resistance (n_joints,) [N m or N]: what the observer finds to act on the joints beside motors and model. Returns
        the joints that were found jammed now.
        """
        if self._before is None:
            self._before, self._t = q.copy(), t
            return ()
        keep = math.exp(-(t - self._t) / _MEMORY)
        self._asked = keep * self._asked + way
        self._moved = keep * self._moved + q - self._before
        self._before, self._t = q.copy(), t
        wanted = np.abs(self._asked)
        stands = (wanted > self._tuning.jam_travel) & (np.abs(self._moved) < _MOVED * wanted)
        resists = -np.sign(self._asked) * resistance > self._tuning.jam_effort * self._effort
        self._since = np.where(stands & resists, np.minimum(self._since, t), math.inf)
        found = np.flatnonzero((t - self._since >= self._tuning.jam_time - 1e-9) & ~self.jammed)
        for j in found:
            self.jammed[j] = True
            since = float(self._since[j])
            self.verdicts[j] = JointVerdict(health=Health.FAULTY, kind=FaultKind.JAMMED, since=since)
        return tuple(int(j) for j in found)
