"""Simulate the closed loop of plant, sensors, state estimator and controller.

The parts know nothing of each other: what they exchange is `uvms_ocp.robot.signals`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from time import perf_counter
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.interrupts import Interrupted, Stopped, on_interrupt
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.robot.signals import CHANNELS, Command, Reading, Readings, State, StateEstimate
from uvms_ocp.sim.compiled_loop import Watch, compiled_loop, require_kept
from uvms_ocp.sim.loop_kernels import FARTHEST
from uvms_ocp.sim.plant import Plant
from uvms_ocp.types import Count, Positive

_log = logging.getLogger(__name__)

Sensors = Callable[[State, float], Readings]
"""True state and time [s] to readings."""
StateEstimator = Callable[[Readings, float, Command | None], StateEstimate]
"""Readings, time [s] and the command that has been acting since the last call to a measurement."""
Controller = Callable[[StateEstimate, float], Command]
"""StateEstimate and time [s] to a command."""
Progress = Callable[[float, Command], None]
"""Callback with the time [s] and the command of a tick."""
TickObserver = Callable[[float, State, Command], None]
"""Callback with the time [s], the true state and the command of a tick, which it must not
change.
"""

MOST_TICKS = 4_000_000
"""Ticks of a run whose record is kept in memory, about 2.4 kB each."""


def has_diverged(state: State) -> bool:
    """Judge whether a plant's velocity is no number, or larger than any that a record holds beside
    its forces and powers.
    """
    return not math.hypot(*state.v.tolist()) <= FARTHEST


@checked
def simulate(
    *,
    plant: Plant,
    sensors: Sensors,
    estimator: StateEstimator,
    controller: Controller,
    dt: Positive,
    duration: Positive,
    progress: Progress | None = None,
    observer: TickObserver | None = None,
    watch: Watch | None = None,
    kept_readings: Mapping[str, Count] | None = None,
    recorder: Recorder | None = None,
) -> Recorder:
    """Run until the command says finished or `duration` [s] is over; one row per tick, before its
    step.

    dt [s] is the control period. kept_readings: channels whose new readings are recorded, and how
    many numbers each has; with them goes whether the brakes were locked, so that an estimator can
    be run again over the record. `progress` is called after every tick with the time and the
    command, `observer` with the true state too; `watch`, with time and true state, after ticks in
    which anything happened, and every few others. Where only that looks on, fresh parts of the
    toolkit run in machine code for many ticks at once (`uvms_ocp.sim.compiled_loop`), with the same
    numbers. recorder: by default one that keeps all in memory. Where the plant `has_diverged`, the
    rows before it are what there is.

    Raises `NameNotFound` for channels that there are not, `InvalidInput` for readings of other
    sizes and for more ticks than ordinary memory holds, and `Interrupted`, whose result is the
    recorder, after the tick in which Ctrl-C is pressed.
    """
    if recorder is None and not duration / dt <= MOST_TICKS:
        problem = (
            f"duration = {duration:g} s in ticks of dt = {dt:g} s, whose record takes more than 10"
            " GB of memory"
        )
        raise InvalidInput(
            f"{problem}; give a folder for it, or at most {MOST_TICKS:,} ticks, {MOST_TICKS * dt:g} s"
        )
    for name in kept_readings or ():
        require_known("channel", name, CHANNELS)
    recorder = recorder or Recorder()
    stops = list[object]()
    n_ticks = round(duration / dt) + 1
    single = progress is not None or observer is not None
    if single:
        quick = None
    else:
        quick = compiled_loop(plant, sensors, estimator, controller, dt)
    # A planner within a tick passes the interrupt on.
    with on_interrupt(stops.append), suppress(Interrupted):
        if quick is not None:
            quick.run(n_ticks, recorder, kept_readings or {}, watch or _watch_nothing, stops)
            n_ticks = 0
        ticks = SingleTicks(
            plant=plant,
            sensors=sensors,
            estimator=estimator,
            controller=controller,
            dt=dt,
            kept_readings=kept_readings,
            recorder=recorder,
        )
        for _ in range(n_ticks):
            command = ticks.decide()
            if progress is not None:
                progress(ticks.t, command)
            if observer is not None:
                observer(ticks.t, plant.state, command)
            if watch is not None:
                watch(ticks.t, plant.state)
            if command.finished or stops:
                break
            ticks.move()
            if has_diverged(plant.state):
                break
    if has_diverged(plant.state):
        when = recorder.last("t")
        _log.warning(
            "the run ends at t = %g s: after it the plant's motion grew beyond what a record holds",
            when,
        )
    if stops and "t" not in recorder:
        raise Stopped
    if stops:
        raise Interrupted(f"stopped by hand at t = {recorder.last('t'):g} s", recorder)
    return recorder


class SingleTicks:
    """The ticks of one run, one by one: each decides on a command and records it, and then the
    plant moves.
    """

    def __init__(
        self,
        *,
        plant: Plant,
        sensors: Sensors,
        estimator: StateEstimator,
        controller: Controller,
        dt: float,
        recorder: Recorder,
        kept_readings: Mapping[str, Count] | None = None,
    ) -> None:
        """plant, sensors, estimator, controller: fresh ones. dt [s]: control period. kept_readings:
        channels whose new readings are recorded, and how many numbers each has.
        """
        self.plant = plant
        self.recorder = recorder
        self.t = 0.0
        """Time [s] of the newest tick; 0 before the first."""
        self.readings: Readings | None = None
        """Readings of the sensors at the newest tick."""
        self.estimate: StateEstimate | None = None
        """What the estimator made of it."""
        self.command: Command | None = None
        """What the controller asked for."""
        self._sensors = sensors
        self._estimator = estimator
        self._controller = controller
        self._dt = dt
        self._n_ticks = 0
        self._keeps_readings = bool(kept_readings)
        self._new_readings = _NewReadings(kept_readings or {})

    def decide(self) -> Command:
        """Read, estimate and control at the time of the next tick, and record the row; return the
        command. Raises `InvalidInput` for what cannot be recorded.
        """
        self.t = self._n_ticks * self._dt
        self._n_ticks += 1
        state = self.plant.state
        self.readings = self._sensors(state, self.t)
        self.estimate = self._estimator(self.readings, self.t, self.command)
        begin = perf_counter()
        self.command = self._controller(self.estimate, self.t)
        spent = perf_counter() - begin
        telemetry = self.plant.telemetry()
        asked_thrust = _asked_thrust(self.command, telemetry, self.recorder)
        measured = {}
        if self._keeps_readings:
            measured = self._new_readings(self.readings) | {"brakes": self.command.brakes}
        row = _row(self.t, state, self.estimate, self.command, asked_thrust, measured)
        row.setdefault("controller_time", spent)  # one that measures itself knows better
        row.update(telemetry)
        self.recorder.append(row)
        return self.command

    def move(self) -> None:
        """Let the plant move for a control period under the newest command."""
        assert self.command is not None
        self.plant.step(self.command, self._dt)


def _watch_nothing(t: float, state: State) -> None:
    """Stand for a callback that is not given."""


class _NewReadings:
    """Readings that are new at a tick, each with when it was taken; NaN where none is."""

    __slots__ = ("_missing", "_seen")

    def __init__(self, widths: Mapping[str, int]) -> None:
        self._seen: dict[str, Reading[Any] | None] = dict.fromkeys(widths)
        self._missing = {name: np.full(width + 1, np.nan) for name, width in widths.items()}

    def __call__(self, readings: Readings) -> dict[str, Any]:
        columns = dict[str, Any]()
        for channel, missing in self._missing.items():
            reading = getattr(readings, channel)
            column = missing
            # Also with the time of an earlier one, as clocks that fail give them.
            if reading is not None and reading is not self._seen[channel]:
                self._seen[channel] = reading
                column = np.array([*np.ravel(reading.value).tolist(), reading.t])
                require_kept(channel, column.size - 1, missing.size - 1)
            columns[f"measured_{channel}"] = column
        return columns


def _asked_thrust(
    command: Command, telemetry: Mapping[str, Any], recorder: Recorder
) -> np.ndarray | None:
    """Return the thrust (n_thrusters,) [N] that a plant with thrusters is asked for; `None` where
    there are none.
    """
    # Such as with the last command of a run.
    if command.thrust is None and "asked_thrust" in recorder:
        return np.zeros_like(telemetry["thrust"])
    if "thrust" in telemetry:
        return command.thrust
    return None


def _row(
    t: float,
    state: State,
    estimate: StateEstimate,
    command: Command,
    asked_thrust: np.ndarray | None,
    measured: Mapping[str, np.ndarray],
) -> dict[str, Any]:
    row = {
        **measured,
        "t": t,
        "q": state.q,
        "v": state.v,
        "q_estimated": estimate.q,
        "v_estimated": estimate.v,
        "altimeter_range": float(estimate.altimeter_range),
    }
    if estimate.std is not None:  # how well the estimate is known, where the estimator tells
        row["q_std"] = estimate.std
        row["altimeter_std"] = float(estimate.altimeter_std)
    row["command"] = command.v
    if asked_thrust is not None:
        row["asked_thrust"] = asked_thrust
    if estimate.health:
        row["health"] = np.array([channel.trust for channel in estimate.health], dtype=np.int8)
    n_recorded = len(row)
    row.update(command.telemetry)
    if len(row) != n_recorded + len(command.telemetry):
        doubled = sorted(set(list(row)[:n_recorded]) & command.telemetry.keys())
        raise InvalidInput(f"telemetry {doubled} is what the loop records; rename it")
    return row
