"""Guard an estimator by a health monitor: it sees screened readings, and its estimate carries the
health of the channels.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from uvms_ocp.checks import checked_constructor, replace_unchecked
from uvms_ocp.codegen.kernel_layout import doubles
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.filter_memory import NUMBER
from uvms_ocp.estimation.health import monitor as health_monitor
from uvms_ocp.estimation.health.channel_state import keep_undisputed_turns
from uvms_ocp.record.display import SmallTable, TableDisplay, format_value, rows_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    ChannelHealth,
    Command,
    Readings,
    SensorSpecs,
    StateEstimate,
    unchecked_estimate,
)
from uvms_ocp.types import Array


@runtime_checkable
class GatedEstimator(Protocol):
    """An estimator with gates of its own, which also finds rates from attitudes where there is no
    gyro.
    """

    @property
    def outcomes(self) -> Array:
        """Outcome (n_channels, 4) [s, -, -, -] of the gate on the newest reading of each channel that was
        compared with the estimate, changed in place.

        When it was taken, its normalised innovation squared, the degrees of freedom of that, and 1
        if it was fused; nan before the first. In the order of `filter_memory.ChannelIndex`, a user's
        own after these.
        """

    def inflate_velocity_variance(self, *, rests: bool = False) -> None:
        """Take the linear velocity for unknown; rests: and for zero, at a guess."""


@checked_constructor
class GuardedEstimator(TableDisplay):
    """Estimator, guarded: a callable ``(Readings, t, command) -> StateEstimate`` around another
    one. Build one per run.

    `StateEstimate.age` counts channels that q and v rest on, as far as no fallback replaces them
    (`support.fallback_sensors`); a lost altimeter gives no range.
    """

    def __init__(
        self,
        estimator: Callable[[Readings, float, Command | None], StateEstimate],
        robot: Robot,
        specs: SensorSpecs | None = None,
        monitor: health_monitor.HealthMonitor | None = None,
    ) -> None:
        """specs: those that the estimator expects. monitor: one for them unless given. Raises
        `InvalidInput` for an estimator whose gates are of other channels than the monitor's.
        """
        specs = specs or SensorSpecs()
        self.robot = robot
        self.estimator = estimator
        self.monitor = monitor or health_monitor.HealthMonitor(robot, specs)
        exact = isinstance(estimator, PassThrough)
        self.repeated: health_monitor.PassThroughMemory | None = None
        # One of a class of its own may do more than to repeat.
        is_plain = type(estimator) is PassThrough
        if isinstance(estimator, PassThrough) and is_plain and self.monitor.repeats:
            self.repeated = health_monitor.pass_through_memory(estimator)
        self._has_all_channels = not exact
        self._gating = estimator if isinstance(estimator, GatedEstimator) else None
        gating = self._gating is not None
        if not gating:
            # Nothing is known to integrate the rates of the joints.
            joint_positions = self.monitor.memory.channels[NUMBER["joint_positions"]]
            joint_positions.gate.by = -1
        numbers = self.monitor.numbers
        self._names = {number: name for name, number in numbers.items()}
        self._needed = health_monitor.supporting_channels(robot, specs, rates=exact)
        fallbacks = health_monitor.fallback_sensors(gyro_from_attitude=gating)
        self.support = health_monitor.support_of(
            self._needed, fallbacks, exact=exact, gating=gating, n_channels=len(numbers)
        )
        """Memory of the kernels, as `repeated` and `outcomes`."""
        outcomes = np.zeros(4 * len(numbers))
        if self._gating is not None:
            outcomes = self._gating.outcomes.reshape(-1)
        if outcomes.size != 4 * len(numbers):
            raise InvalidInput(
                f"outcomes of {outcomes.size // 4} channels, and a monitor of {len(numbers)}; give"
                " estimator, monitor and GuardedEstimator the same specs"
            )
        # The memory of the filter, as kernels take it.
        self.outcomes = (ctypes.c_double * outcomes.size).from_buffer(outcomes.data)
        self._nothing = unchecked_estimate(
            q=robot.configuration(),
            v=np.zeros(robot.n_v),
            altimeter_range=math.nan,
            age=math.inf,
            joint_age=math.inf,
        )

    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        """Return the estimate at time t [s]; `command` has been acting since the last call. Raises
        what the estimator raises.
        """
        screened = self.monitor.screen(readings, t, command)
        return self.estimate_from(screened, t, command)

    def estimate_from(
        self, screened: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        """Return the estimate at time t [s] from readings that the monitor has screened; `command`
        has been acting since the last call. Raises what the estimator raises.
        """
        monitor = self.monitor
        if not self._has_all_channels and not self._begin(screened):
            return replace_unchecked(self._nothing, health=monitor.judge(self._nothing, t))
        is_unobserved = bool(monitor.memory.velocity_unobserved)
        if self._gating is not None and (monitor.memory.exposed or is_unobserved):
            self._gating.inflate_velocity_variance(rests=is_unobserved)
        estimate = self.estimator(screened, t, command)
        health = monitor.finish(estimate, self.support, self.outcomes, t)
        return self._with_support(
            estimate.q,
            estimate.v,
            estimate.altimeter_range,
            health,
            estimate.std,
            estimate.altimeter_std,
        )

    def estimate(self) -> StateEstimate:
        """Return the estimate that the kernels have left in memory at a tick."""
        present = self.monitor.memory.now
        estimator = self.estimator
        if isinstance(estimator, Estimator):
            filtered = estimator.estimate()
            return self._with_support(
                filtered.q,
                filtered.v,
                filtered.altimeter_range,
                self.monitor.health,
                filtered.std,
                filtered.altimeter_std,
            )
        echo = self.monitor.memory.channels[NUMBER["altimeter_range"]].used_value[0]
        return self._with_support(
            np.array(present.q), np.array(present.v), echo, self.monitor.health
        )

    def _table(self) -> SmallTable:
        watched = {channel.channel: channel.trust.name.lower() for channel in self.monitor.health}
        return SmallTable(
            title=type(self).__name__,
            rows=rows_of({"estimator": format_value(self.estimator), **watched}),
        )

    def _with_support(
        self,
        q: Array,
        v: Array,
        echo: float,
        health: tuple[ChannelHealth, ...],
        std: Array | None = None,
        altimeter_std: float = math.nan,
    ) -> StateEstimate:
        """Make the measurement, with the age of what supports the estimate."""
        support = self.support
        if self.monitor.memory.turns_disputed:
            undisputed = doubles(v)
            keep_undisputed_turns(self.monitor.memory, undisputed)
            v = np.array(undisputed)
        oldest = support.oldest
        return unchecked_estimate(
            q=q,
            v=v,
            altimeter_range=echo if support.echo else math.nan,
            age=support.age,
            oldest=self._names[oldest] if oldest >= 0 else "",
            joint_age=support.joint_age,
            health=health,
            std=std,
            altimeter_std=altimeter_std,
        )

    def _begin(self, readings: Readings) -> bool:
        """Return whether every channel has a reading that a pass-through needs; what is there once
        remains.
        """
        required = self._needed
        if "altimeter_range" in self.monitor.channels:
            required = (*required, "altimeter_range")
        self._has_all_channels = all(getattr(readings, name) is not None for name in required)
        return self._has_all_channels
