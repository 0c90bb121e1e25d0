"""An estimator that sees vetted readings, and whose measurements say how far each channel can be trusted."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from uvms_ocp.arguments import changed, checked, late, trusted
from uvms_ocp.control.navigation.health.monitor import HealthMonitor
from uvms_ocp.control.navigation.health.support import age_by_support, needed_channels, stand_ins
from uvms_ocp.control.navigation.pass_through import PassThrough
from uvms_ocp.model.health import Trust
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import SensorSpecs
from uvms_ocp.model.state import Command, Measurement, Readings

_measurement = trusted(Measurement)


class Outcome(Protocol):
    """What the gate of a filter said of the newest reading of a channel."""

    @property
    def t(self) -> float:
        """[s] when it was taken."""

    @property
    def squared(self) -> float:
        """[-] normalised innovation, squared."""

    @property
    def degrees(self) -> int:
        """[-] of freedom."""

    @property
    def accepted(self) -> bool:
        """Whether it was fused."""


@runtime_checkable
class Gating(Protocol):
    """An estimator with gates of its own, which also finds rates from attitudes where there is no gyro."""

    def outcome(self, channel: str) -> Outcome | None:
        """Of the newest reading of a channel that was compared with the estimate; `None` before the first."""

    def doubt_velocity(self) -> None:
        """Take the linear velocity for unknown."""


@checked
class GuardedEstimator:
    """A callable ``(Readings, t, command) -> Measurement`` around another one. Build one per run.

    `Measurement.age` counts channels that q and v rest on, as far as nothing stands in for them (`support.stand_ins`); a lost
    altimeter gives no range.
    """

    def __init__(
        self,
        estimator: Callable[[Readings, float, Command | None], Measurement],
        robot: Robot,
        specs: SensorSpecs | None = None,
        monitor: HealthMonitor | None = None,
    ) -> None:
        """specs: those that the estimator expects. monitor: one for them unless given."""
        specs = specs or SensorSpecs()
        self.estimator, self.monitor = estimator, monitor or HealthMonitor(robot, specs)
        self._exact = isinstance(estimator, PassThrough)
        self._gating = estimator if isinstance(estimator, Gating) else None
        self._needed = needed_channels(robot, specs, rates=self._exact)
        self._stand_ins = stand_ins(self.monitor.tuning, gyro_by_attitude=self._gating is not None)
        self._nothing = _measurement(
            q=robot.configuration(), v=np.zeros(robot.n_v), altimeter_range=math.nan, age=math.inf, joint_age=math.inf
        )
        self._heard: dict[str, float] = {}

    @late
    def __call__(self, readings: Readings, t: float, command: Command | None = None) -> Measurement:
        """The measurement at time t [s]; `command` has been acting since the last call. Raises what the estimator raises."""
        vetted = self.monitor.vet(readings, t, command)
        if self._exact and not self._begun(vetted):
            return changed(self._nothing, health=self.monitor.judge(self._nothing, t))
        if self._gating is not None and self.monitor.velocity_exposed:
            self._gating.doubt_velocity()
        measurement = self.estimator(vetted, t, command)
        if self._gating is not None:
            self._tell_outcomes(self._gating, t)
        taken = self.monitor.taken()
        age, oldest = age_by_support(self._needed, taken, self._stand_ins, t)
        aged = changed(
            measurement,
            age=age,
            oldest=oldest,
            joint_age=age_by_support(("joint_positions",), taken, {}, t)[0],
        )
        health = self.monitor.judge(aged, t)
        echo = measurement.altimeter_range if self._altitude_known(t) else math.nan
        return changed(aged, altimeter_range=echo, health=health)

    def _begun(self, readings: Readings) -> bool:
        """Whether there is a reading of everything that one who estimates nothing asks for."""
        asked = (*self._needed, *({"altimeter_range"} & set(self.monitor.channels)))
        return all(getattr(readings, name) is not None for name in asked)

    def _altitude_known(self, t: float) -> bool:
        """An estimator carries the altitude on while the altimeter is suspect; an echo alone is true for its moment only."""
        name = "altimeter_range"
        if name not in self.monitor.channels:
            return True
        since = self.monitor.taken()[name]
        recent = since is None or t - since <= self.monitor.tuning.least_to_suspect or not self._exact
        return recent and self.monitor.trust(name) is not Trust.LOST

    def _tell_outcomes(self, estimator: Gating, t: float) -> None:
        """Every outcome once, at time t [s]."""
        for name in self.monitor.channels:
            outcome = estimator.outcome(name)
            if outcome is not None and outcome.t > self._heard.get(name, -math.inf):
                self._heard[name] = outcome.t
                self.monitor.hear(name, t, outcome.squared, outcome.degrees, outcome.accepted)
