"""Ideal sensors of which some are lost or suspect for a while, and an estimator that says so: for
tests of what follows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    CHANNELS,
    IDEAL_SENSORS,
    ChannelHealth,
    Command,
    Readings,
    StateEstimate,
    Trust,
)


@dataclass(kw_only=True)
class BrokenSensors:
    """A callable ``(Readings, t, command) -> StateEstimate``. Channels are broken from `start`
    until `end` [s].

    Joints and range keep their last values meanwhile; what other channels tell, others tell as
    well, and rightly so.
    """

    robot: Robot
    channels: tuple[str, ...]
    start: float
    end: float = math.inf
    trust: Trust = Trust.LOST
    last: StateEstimate | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.estimator = PassThrough(self.robot)
        self.monitor = HealthMonitor(self.robot, IDEAL_SENSORS)

    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        measured = self.estimator(readings, t)
        if self.last is None or not self.start <= t < self.end:
            self.last = measured
            return replace(measured, health=self._health(()))
        q = measured.q.copy()
        echo = measured.altimeter_range
        if "joint_positions" in self.channels:
            q[7:] = self.last.q[7:]
        if "altimeter_range" in self.channels:
            echo = self.last.altimeter_range
        v = measured.v if len(self.channels) == 1 else self.last.v
        return replace(measured, q=q, v=v, altimeter_range=echo, health=self._health(self.channels))

    def _health(self, broken: tuple[str, ...]) -> tuple[ChannelHealth, ...]:
        health = []
        for name in CHANNELS:
            if name in broken:
                health.append(
                    ChannelHealth(
                        channel=name, trust=self.trust, why="broken by a test", since=self.start
                    )
                )
            else:
                health.append(ChannelHealth(channel=name, trust=Trust.GOOD))
        return tuple(health)
