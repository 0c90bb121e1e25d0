"""Ideal sensors of which some are lost or suspect for a while, and an estimator that says so: for tests of what follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from uvms_ocp.control.navigation.estimator import PassThrough
from uvms_ocp.model.health import ChannelHealth, Trust
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import CHANNELS
from uvms_ocp.model.state import Command, Measurement, Readings

FROZEN = {"joint_positions": ("q", slice(7, None)), "altimeter_range": None}
"""Channels that keep their last value; what the others tell, others tell as well, and rightly so."""


@dataclass(kw_only=True)
class BrokenSensors:
    """A callable ``(Readings, t, command) -> Measurement``. Channels are broken from `start` until `end` [s]."""

    robot: Robot
    channels: tuple[str, ...]
    start: float
    end: float = math.inf
    trust: Trust = Trust.LOST
    frozen: tuple[str, ...] = ()
    """Parts of the measurement, "q" or "v", that keep their last value as well."""
    last: Measurement | None = field(default=None, init=False)

    def __call__(self, readings: Readings, t: float, command: Command | None = None) -> Measurement:
        measured = PassThrough(self.robot)(readings, t)
        if self.last is None or not self.start <= t < self.end:
            self.last = measured
            return replace(measured, health=self._health(t, ()))
        q = measured.q.copy()
        if "joint_positions" in self.channels:
            q[7:] = self.last.q[7:]
        echo = self.last.altimeter_range if "altimeter_range" in self.channels else measured.altimeter_range
        kept = {name: getattr(self.last, name) for name in self.frozen}
        return replace(measured, **{"q": q, **kept}, altimeter_range=echo, health=self._health(t, self.channels))

    def _health(self, t: float, broken: tuple[str, ...]) -> tuple[ChannelHealth, ...]:
        return tuple(
            ChannelHealth(channel=name, trust=self.trust, why="broken by a test", since=self.start)
            if name in broken
            else ChannelHealth(channel=name, trust=Trust.GOOD)
            for name in CHANNELS
        )


def vehicle_height(q: np.ndarray) -> np.ndarray:
    """z [m] of the vehicle at each configuration (n, n_q)."""
    return np.asarray(q[:, 2])
