"""One run of a scenario: its parts are simulated tick by tick, and what happened goes into a
`Record` with its metadata.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.errors import plain_line
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.mission import MissionState
from uvms_ocp.progress import SILENT, progress_bar
from uvms_ocp.record.record import Record
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.robot import IDEAL_SENSORS, State, StateEstimate
from uvms_ocp.robot.channels import shapes_of
from uvms_ocp.scenario.part_factories import MissionController
from uvms_ocp.scenario.run_metadata import RunOutcome, computed_or, energy_used, run_meta
from uvms_ocp.sim import Plant, SensorSuite, injected_faults
from uvms_ocp.sim.loop import Progress, Sensors, TickObserver, has_diverged, simulate
from uvms_ocp.sim.own_parts import plant_name

if TYPE_CHECKING:
    from uvms_ocp.scenario.scenario import Scenario

_BAR_EVERY = 40  # ticks between two updates of the bar
_BAR_TEXT = 60  # letters of a bar's text, however long the name of a phase is

_WRITE_EVERY = 2.0  # [s] rows of so much time are held in memory before they go to a folder
_MOST_HELD_ROWS = 512


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunParts:
    """Parts of one run, made for it alone: they keep its state."""

    plant: Plant
    """Simulated robot in its water."""
    sensors: Sensors
    """Sensors that read the plant."""
    estimator: GuardedEstimator
    """Estimator behind the checks of its readings."""
    controller: MissionController
    """Controller that carries out the mission."""


class ScenarioRun:
    """A run of a scenario, which ends in a record of it."""

    def __init__(self, scenario: Scenario, parts: RunParts) -> None:
        self._scenario = scenario
        self._parts = parts
        self._kinematic = parts.controller.kinematic
        self._begin = perf_counter()
        self._states_at_events: list[State] = []
        self._counts: tuple[int, ...] | None = None  # events and alarms in the last metadata
        if scenario.record_rate is None:
            self._ticks_per_row = 1
        else:
            self._ticks_per_row = max(1, round(1.0 / (scenario.record_rate * scenario.dt)))
        self._meta = self._metadata()

    def record(
        self,
        show_time: Callable[[float], None],
        progress: Progress | None,
        observer: TickObserver | None,
        folder: Path | str | None,
        presses: Sequence[object],
    ) -> Record:
        """Simulate, and return the record; where Ctrl-C ends the run, the record up to there.

        show_time: called with the time [s] of ticks. progress, observer: called at every tick, see
        `simulate`. folder: gets the rows in place of memory. presses: one entry for each Ctrl-C.
        """
        scenario = self._scenario

        def watch(t: float, state: State) -> None:
            self.look(state)
            show_time(t)

        try:
            recorder = simulate(
                plant=self._parts.plant,
                sensors=self._parts.sensors,
                estimator=self._parts.estimator,
                controller=self._parts.controller,
                progress=progress,
                observer=observer,
                watch=watch,
                dt=scenario.dt,
                duration=scenario.duration,
                kept_readings=self.reading_sizes(),
                recorder=self._recorder(folder),
            )
        except Interrupted as stop:
            recorder = stop.result
        return self.record_of(recorder, stopped_by_hand=bool(presses))

    def look(self, state: State) -> None:
        """Keep the true state if a phase has ended since the last call."""
        if len(self._kinematic.events) > len(self._states_at_events):
            self._states_at_events.append(state)

    def record_of(self, recorder: Recorder, *, stopped_by_hand: bool) -> Record:
        """Return the record of the rows so far, with the outcome of the run."""
        wall_s = perf_counter() - self._begin
        outcome = self._outcome(recorder, wall_s, stopped_by_hand)
        return recorder.freeze(self._meta(ending=outcome))

    def _recorder(self, folder: Path | str | None) -> Recorder | None:
        """Make a recorder that writes to the folder or leaves out ticks; `None` where the rows of
        all ticks stay in memory.
        """
        if folder is None and self._ticks_per_row == 1:
            return None
        place = None if folder is None else Path(folder)
        capacity = min(_MOST_HELD_ROWS, max(1, round(_WRITE_EVERY / self._scenario.dt)))
        return Recorder(capacity, place, self._meta_if_news, self._ticks_per_row)

    def reading_sizes(self) -> dict[str, int]:
        """Return how many numbers a reading of each recorded channel has.

        No channels are recorded beside an estimator that passes readings on.
        """
        estimator = self._parts.estimator
        if isinstance(estimator.estimator, PassThrough):
            return {}
        shapes = shapes_of(self._scenario.robot, self._scenario.specs.own)
        channels = estimator.monitor.channels
        return {name: math.prod(shapes[name]) for name in channels if name in shapes}

    def _meta_if_news(self) -> RunMeta | None:
        """Return the metadata so far if there are new events or alarms, else `None`: a folder has
        them even if the program is killed.
        """
        counts = (
            len(self._kinematic.events),
            len(self._parts.estimator.monitor.alarms),
            len(self._kinematic.watchdog.alarms),
        )
        has_news = counts != self._counts
        self._counts = counts
        if not has_news or has_diverged(self._parts.plant.state):
            return None
        outcome = RunOutcome(
            q=self._parts.plant.state.q,
            t=self._scenario.duration,
            quantities={},
            wall_s=perf_counter() - self._begin,
            stopped="cut off",
        )
        return self._meta(ending=outcome)

    def _metadata(self) -> Callable[..., RunMeta]:
        """Return `run_meta` with all arguments that are known before the run; `ending`, the outcome,
        is left to give.
        """
        scenario = self._scenario
        return partial(
            run_meta,
            name=scenario.name,
            setup=scenario.setup(),
            parts=self._part_names(),
            faults=tuple(injected_faults.fault_meta(fault) for fault in scenario.faults),
            controller=self._kinematic,
            seed=scenario.seed,
            markers=scenario.markers,
            monitor=self._parts.estimator.monitor,
            dt=self._ticks_per_row * scenario.dt,
        )

    def _part_names(self) -> dict[str, str]:
        """Return the classes of the parts by their roles, for the metadata."""
        scenario = self._scenario
        controller = self._parts.controller
        estimator = self._parts.estimator.estimator
        own_parts = scenario.own_parts
        return {
            "plant": plant_name(scenario.plant),
            "solver": type(scenario.solver).__name__,
            "sensors": own_parts.get("sensors", SensorSuite.__name__),
            "estimator": own_parts.get("estimator", type(estimator).__name__),
            "controller": getattr(controller, "name", type(controller).__name__),
        }

    def _outcome(self, recorder: Recorder, wall_s: float, stopped_by_hand: bool) -> RunOutcome:
        """Sum up how the run ended, with the true quantities at its end and at its events."""
        kinematic = self._kinematic
        plant_state = self._parts.plant.state
        diverged = has_diverged(plant_state)
        if diverged:
            last_state = State(q=recorder.last("q"), v=recorder.last("v"))
        else:
            last_state = plant_state
        series = recorder.series()
        t = recorder.last("t")
        quantities = self._true_quantities(series, last_state, t, kinematic.state)
        # Each event with the goals that the phase had when it ended.
        events = zip(self._states_at_events, kinematic.events, kinematic.left, strict=False)
        at_events = [
            self._true_quantities(series, state, event.t, mission_state)
            for state, event, mission_state in events
        ]
        stopped: Literal["", "stopped", "diverged"] = ""
        if diverged:
            stopped = "diverged"
        elif stopped_by_hand:
            stopped = "stopped"
        return RunOutcome(
            q=recorder.last("q"),
            t=t,
            quantities=quantities,
            at_events=tuple(at_events),
            wall_s=wall_s,
            std=recorder.last("q_std") if "q_std" in recorder else None,
            stopped=stopped,
        )

    def _true_quantities(
        self,
        series: Mapping[str, Any],
        true_state: State,
        t: float,
        mission_state: MissionState,
    ) -> dict[str, float]:
        """Return the true quantities of all tasks [in their units] at t [s], and the energies [J]
        that the mission asks for; empty where they cannot be computed.
        """
        errors: dict[str, float] = computed_or(
            {},
            "true errors",
            lambda: self._kinematic.evaluate(self._true_estimate(true_state), t, mission_state),
        )
        energies = energy_used(series, mission_state, t)
        return errors | {name: value for name, value in energies.items() if name in errors}

    def _true_estimate(self, state: State) -> StateEstimate:
        """Return the estimate that ideal sensors give in this true state."""
        scenario = self._scenario
        suite = SensorSuite(
            scenario.robot,
            scenario.environment.seafloor,
            IDEAL_SENSORS,
            altimeter_frame=scenario.altimeter_frame,
        )
        readings = suite.read(state, 0.0)
        return PassThrough(scenario.robot, IDEAL_SENSORS)(readings, 0.0)


@contextmanager
def run_bar(
    scenario: Scenario, shown: bool, kinematic: KinematicController
) -> Iterator[Callable[[float], None]]:
    """Show a bar of the simulated time on terminals, with the conditions that the mission waits for.

    Yields the function to call with the time [s] of each tick.
    """
    with progress_bar(
        shown=shown, total=scenario.duration, delay=SILENT, bar_format="{elapsed} |{bar}| {desc}"
    ) as bar:

        def show_time(t: float) -> None:
            if bar.disable or round(t / scenario.dt) % _BAR_EVERY != 0:
                return
            phase = scenario.mission.all_phases[kinematic.state.phase]
            text = plain_line(f"{phase.name} {phase.title}: {kinematic.pending()}", _BAR_TEXT)
            bar.set_description_str(text.ljust(_BAR_TEXT), refresh=False)
            bar.update(t - bar.n)

        yield show_time
