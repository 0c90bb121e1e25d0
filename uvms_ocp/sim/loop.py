"""Simulate the closed loop of plant, sensors, state estimator and controller.

The parts know nothing of each other: what they exchange is `uvms_ocp.robot.signals`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from uvms_ocp.checks import checked, replace_unchecked
from uvms_ocp.codegen.kernel_layout import number_in_memory
from uvms_ocp.codegen.sequence import DIVERGED, LOOK, Elapsed, Source, StepSequence
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.interrupts import Interrupted, Stopped, on_interrupt
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.signals import Command, Readings, State, StateEstimate
from uvms_ocp.sim.loop_kernels import is_divergent
from uvms_ocp.sim.plant import Plant
from uvms_ocp.sim.sampling import N_DRAWN
from uvms_ocp.sim.tick import Tick
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
Watch = Callable[[float, State], None]
"""Callback with time [s] and true state after events, and every few ticks."""
LookingOn = Callable[[State, Command], None]
"""Callback with the true state and the command of a tick."""
_FLAGS = ("brakes", "saturated")
_CODES = ("health", "thruster_health", "joint_health")

MOST_TICKS = 4_000_000
"""Ticks of a run whose record is kept in memory, about 2.4 kB each."""


def has_diverged(state: State) -> bool:
    """Judge whether a plant's velocity is no number, or larger than a record holds."""
    return is_divergent(sum(speed * speed for speed in state.v.tolist()))


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
    which anything happened, and every few others. Parts of the toolkit run in machine code, for
    many ticks at once where nobody looks on at every one; others are asked
    (`uvms_ocp.sim.tick`). recorder: by default one that keeps all in memory. Where the plant
    `has_diverged`, the rows before it are what there is.

    Raises `NameNotFound` for channels that there are not, `InvalidInput` for readings of other
    sizes or that no `GuardedEstimator` keeps and for more ticks than ordinary memory holds, and
    `Interrupted`, whose result is the recorder, after the tick in which Ctrl-C is pressed.
    """
    if recorder is None and not duration / dt <= MOST_TICKS:
        problem = (
            f"duration = {duration:g} s in ticks of dt = {dt:g} s, whose record takes more than 10"
            " GB of memory"
        )
        raise InvalidInput(
            f"{problem}; give a folder for it, or at most {MOST_TICKS:,} ticks, {MOST_TICKS * dt:g} s"
        )
    known = CHANNELS
    if isinstance(estimator, GuardedEstimator):
        known = tuple(estimator.monitor.numbers)
    for name in kept_readings or ():
        require_known("channel", name, known)
    recorder = recorder or Recorder()
    stops = list[object]()
    loop = Loop(
        plant=plant,
        sensors=sensors,
        estimator=estimator,
        controller=controller,
        dt=dt,
        kept_readings=kept_readings or {},
        recorder=recorder,
        presses=stops,
    )
    looking_on = None
    if progress is not None or observer is not None:

        def looking_on(state: State, command: Command) -> None:
            if progress is not None:
                progress(loop.t, command)
            if observer is not None:
                observer(loop.t, state, command)

    # A planner within a tick passes the interrupt on.
    with on_interrupt(stops.append), suppress(Interrupted):
        loop.run(round(duration / dt) + 1, watch or _watch_nothing, looking_on)
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


class Loop:
    """Ticks of one run: `Tick` as a sequence, whose rows go to a recorder."""

    def __init__(
        self,
        *,
        plant: Plant,
        sensors: Sensors,
        estimator: StateEstimator,
        controller: Controller,
        dt: float,
        recorder: Recorder,
        kept_readings: Mapping[str, Count],
        presses: Sequence[object] = (),
    ) -> None:
        """plant, sensors, estimator, controller: of this run alone. dt [s]: control period.
        kept_readings: channels whose new readings are recorded, and how many numbers each has.
        presses: no longer empty once somebody wants to stop.
        """
        self.recorder = recorder
        self._presses = presses
        self._tick = Tick(
            plant=plant,
            sensors=sensors,
            estimator=estimator,
            controller=controller,
            dt=dt,
            kept_readings=kept_readings,
        )
        self._tick.plant.begin()
        self._sequence: StepSequence | None = None
        """The steps, as far as the plant has not become another one by a fault."""
        self._has_rows = False
        """The series of a row are known: that is after the first tick."""
        self._telemetry: Mapping[str, Source] = {}
        """Series of the controller."""
        self._n_looked = 0
        """Ticks that the controller's `look` has seen."""

    @property
    def t(self) -> float:
        """Time [s] of the newest tick; 0 before the first."""
        return self._tick.memory.t

    def run(
        self,
        n_ticks: int,
        watch: Watch,
        looking_on: LookingOn | None,
    ) -> None:
        """Run so many ticks, or until the controller says that all is over, the plant diverges, or
        somebody wants to stop; after the last the plant moves once more.

        looking_on: called at every tick. watch: see `simulate`.
        """
        n_done = 0
        while n_done < n_ticks:
            most = 1 if looking_on is not None or self._presses else n_ticks - n_done
            n_rows = self.advance(most)
            state = self.state()
            if self._has_diverged:
                return
            n_done += n_rows
            if looking_on is not None:
                looking_on(state, self.command())
            watch(self.t, state)
            if self.is_over or self._presses:
                break
        if not (self.is_over or self._presses):
            self.move()

    def advance(self, most: int) -> int:
        """Make ticks until one in which something happens, at most so many; return how many rows
        were recorded.
        """
        tick = self._tick
        recorder = self.recorder
        sequence = self._present_sequence()
        if not self._has_rows:
            most = 1
        n_ticks = min(
            most,
            recorder.room,
            N_DRAWN,
            int(min(tick.plant.quiet_ticks(), most)),
            int(min(tick.controller.quiet_ticks(), most)),
        )
        tick.sensors.begin(n_ticks)
        row = recorder.place
        n_rows = sequence.run(n_ticks, row)
        if tick.memory.stop > LOOK:
            recorder.filled(n_rows)
            sequence.check()
            return n_rows
        tick.sensors.check()
        # The row of a tick with an event is left, as is that of the first tick, whose series were
        # not known.
        is_left = tick.memory.stop == LOOK
        if not self._has_rows:
            self._write_rows(sequence)
            self._has_rows = True
            is_left = True
            n_rows = 0
        n_seen = tick.memory.k + 1
        tick.estimator.publish()
        tick.controller.look(n_seen - self._n_looked)
        self._n_looked = n_seen
        if is_left:
            n_rows += sequence.run(1, row + n_rows, done=True)
        recorder.filled(n_rows)
        return n_rows

    def move(self) -> None:
        """Let the plant move for a control period under the newest command."""
        tick = self._tick
        if tick.plant.begin():
            self._sequence = None
        for step in tick.motion():
            step.kernel(*step.memories)
        tick.memory.ahead = True
        tick.plant.state()

    @property
    def _has_diverged(self) -> bool:
        """The plant's motion has grown beyond what a record holds."""
        return self._tick.memory.stop == DIVERGED

    @property
    def is_over(self) -> bool:
        """The controller has finished."""
        return self._tick.controller.is_over()

    def state(self) -> State:
        """Return the true state that the plant has come to."""
        return self._tick.plant.state()

    def command(self) -> Command:
        """Return the command of the newest tick, with its telemetry."""
        command = self._tick.controller.command()
        if self._sequence is None:
            return command
        telemetry = {name: self._sequence.value(source) for name, source in self._telemetry.items()}
        return replace_unchecked(command, telemetry={**telemetry, **command.telemetry})

    def estimate(self) -> StateEstimate:
        """Return the estimate of the newest tick."""
        return self._tick.estimator.estimate()

    def readings(self) -> Readings:
        """Return the newest readings; to be asked at every tick."""
        return self._tick.sensors.readings()

    def _present_sequence(self) -> StepSequence:
        """Return the steps, with the faults that there are now."""
        tick = self._tick
        # A plant that has moved already takes on other faults at its next motion.
        if not tick.memory.ahead and tick.plant.begin():
            self._sequence = None
        if self._sequence is None:
            self._sequence = StepSequence(
                tick.steps(), number_in_memory(tick.memory, "stop"), self._presses
            )
            if self._has_rows:
                self._write_rows(self._sequence)
        return self._sequence

    def _write_rows(self, sequence: StepSequence) -> None:
        """Have the sequence write its rows into the block of the recorder."""
        sources = self._tick.sources()
        self._telemetry = self._tick.controller.sources()
        examples = {name: _recorded(name, source) for name, source in sources.items()}
        sequence.write_rows(sources, self.recorder.block(examples))


def _watch_nothing(t: float, state: State) -> None:
    """Stand for a callback that is not given."""


def _recorded(name: str, source: Source) -> Any:
    """Return a number of the type that records have it in."""
    if isinstance(source, Elapsed):
        return 0.0
    if source.dtype != np.int32:  # of kernels: they have no other whole numbers
        return source.copy()
    if name in _FLAGS:
        return source.astype(np.bool_)
    if name in _CODES:
        return source.astype(np.int8)
    return source.astype(np.int64)
