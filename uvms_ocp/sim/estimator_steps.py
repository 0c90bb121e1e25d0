"""The estimator's part of a tick: readings to an estimate, with the trust in each channel. The toolkit's
filter and its monitor are kernels; what is a user's own is asked.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np

from uvms_ocp.codegen.kernel_layout import arrays_of, view
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import Source, Step
from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.robot.signals import Command, StateEstimate
from uvms_ocp.sim import loop_kernels as kernels
from uvms_ocp.sim.sensor_steps import SensorSteps
from uvms_ocp.sim.series_of_objects import SeriesOfObjects

CommandBefore = Callable[[], Command | None]
"""Returns the command that has been acting since the last tick; `None` at the first."""


class EstimatorSteps(Protocol):
    """The estimator of a run, as steps of its ticks."""

    def steps(self, last_command: CommandBefore) -> list[Step]:
        """Return the steps. last_command: asked before each estimate."""

    def estimate(self) -> StateEstimate:
        """Return the estimate of the tick."""

    def publish(self) -> None:
        """Log the verdicts on channels that kernels have changed at this tick."""

    def sources(self) -> dict[str, Source]:
        """Return the series of the estimate, in memory."""

    def health_sources(self) -> dict[str, Source]:
        """Return the series of the trust in channels, in memory; empty where nobody judges them."""


class KernelEstimator:
    """The toolkit's filter, or readings as they are, with the monitor around it: as kernels."""

    def __init__(self, loop: kernels.LoopMemory, guarded: GuardedEstimator) -> None:
        self._loop = loop
        self._guarded = guarded

    def steps(self, last_command: CommandBefore) -> list[Step]:
        loop = self._loop
        guarded = self._guarded
        health = guarded.monitor.memory
        screen, finish, repeat = guarded.monitor.ticks
        begin, note = bind_kernels(
            (kernels.begin_screening, kernels.note_health),
            map(type, (loop, health, guarded.support)),
        )
        first = Step("begin_screening", begin, (loop, health))
        last = Step("note_health", note, (loop, health, guarded.support))
        inner = guarded.estimator
        if isinstance(inner, Estimator):
            memories = (loop, health, inner.structure)
            feed, take = bind_kernels(
                (kernels.feed_filter, kernels.note_estimate), map(type, memories)
            )
            return [
                first,
                Step("screen", screen, (health,)),
                Step("feed_filter", feed, memories),
                Step("filter", inner.tick, (inner.structure,)),
                Step("note_estimate", take, memories),
                Step("judge", finish, (health, guarded.support, guarded.outcomes)),
                last,
            ]
        (repeat_range,) = bind_kernels((kernels.repeat_range,), map(type, (loop, health)))
        return [
            first,
            Step("repeat", repeat, (health, guarded.support, guarded.repeated)),
            Step("repeat_range", repeat_range, (loop, health)),
            last,
        ]

    def estimate(self) -> StateEstimate:
        self.publish()
        return self._guarded.estimate()

    def publish(self) -> None:
        monitor = self._guarded.monitor
        if monitor.memory.n_changed:
            monitor.publish(self._loop.t)
            monitor.memory.n_changed = 0

    def sources(self) -> dict[str, Source]:
        now = arrays_of(self._guarded.monitor.memory.now)
        echo = view(self._loop.range)
        sources: dict[str, Source] = {
            "q_estimated": now.q,
            "v_estimated": now.v,
            "altimeter_range": echo[:1].reshape(()),
        }
        inner = self._guarded.estimator
        if isinstance(inner, Estimator):
            sources["q_std"] = inner.std_in_memory
            sources["altimeter_std"] = echo[1:].reshape(())
        return sources

    def health_sources(self) -> dict[str, Source]:
        n = self._guarded.monitor.memory.n
        if n == 0:
            return {}
        return {"health": view(self._loop.trusts)[:n]}


class OwnEstimator:
    """An estimator that is asked: a user's own, or one of the toolkit that Python has a part in.
    Around it may be a monitor, whose kernels screen the readings.
    """

    def __init__(
        self,
        loop: kernels.LoopMemory,
        estimator: Any,
        sensors: SensorSteps,
    ) -> None:
        """estimator: a callable ``(Readings, t, command) -> StateEstimate``, such as a
        `GuardedEstimator`. sensors: whose readings it is given.
        """
        self._loop = loop
        self._estimator = estimator
        self._sensors = sensors
        self._estimate: StateEstimate | None = None
        self._series = SeriesOfObjects()
        self._health = SeriesOfObjects()

    def steps(self, last_command: CommandBefore) -> list[Step]:
        guarded = self._estimator
        if not isinstance(guarded, GuardedEstimator):
            return [Step("estimate", partial(self._ask, last_command))]
        loop = self._loop
        health = guarded.monitor.memory
        begin, note = bind_kernels(
            (kernels.begin_screening, kernels.note_health),
            map(type, (loop, health, guarded.support)),
        )
        screen = guarded.monitor.ticks[0]
        now = arrays_of(health.now)
        return [
            Step("begin_screening", begin, (loop, health)),
            Step("screen", screen, (health,)),
            Step("estimate", partial(self._ask_guarded, last_command, guarded, now)),
            Step("note_health", note, (loop, health, guarded.support)),
        ]

    def estimate(self) -> StateEstimate:
        assert self._estimate is not None
        return self._estimate

    def publish(self) -> None:
        pass

    def sources(self) -> dict[str, Source]:
        return {**self._series.arrays}

    def health_sources(self) -> dict[str, Source]:
        return {**self._health.arrays}

    def _ask(self, last_command: CommandBefore) -> None:
        self._take(self._estimator(self._sensors.readings(), self._loop.t, last_command()))

    def _ask_guarded(
        self, last_command: CommandBefore, guarded: GuardedEstimator, now: Any
    ) -> None:
        """Ask the estimator within the monitor, and write what it says where kernels read it. now:
        arrays of the monitor's estimate.
        """
        loop = self._loop
        monitor = guarded.monitor
        verdicts = monitor.health
        screened = monitor.screened(self._sensors.readings())
        estimate = guarded.estimate_from(screened, loop.t, last_command())
        self._take(estimate)
        monitor.memory.n_changed = monitor.health is not verdicts
        now.q[:] = estimate.q
        now.v[:] = estimate.v
        loop.range[0] = estimate.altimeter_range
        guarded.support.echo = True
        guarded.support.age = estimate.age
        guarded.support.joint_age = estimate.joint_age

    def _take(self, estimate: StateEstimate) -> None:
        """Take down the series of an estimate."""
        self._estimate = estimate
        values: dict[str, Any] = {
            "q_estimated": estimate.q,
            "v_estimated": estimate.v,
            "altimeter_range": float(estimate.altimeter_range),
        }
        if estimate.std is not None:  # how well the estimate is known, where the estimator tells
            values["q_std"] = estimate.std
            values["altimeter_std"] = float(estimate.altimeter_std)
        self._series.write(values)
        trusts = np.array([channel.trust for channel in estimate.health], dtype=np.int8)
        self._health.write({"health": trusts} if estimate.health else {})
