"""A run of a scenario that somebody steps by hand, looks into, and takes the record of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.robot.signals import SAME_TIME, Command, Readings, State, StateEstimate
from uvms_ocp.scenario.part_factories import MissionController
from uvms_ocp.scenario.scenario_run import RunParts, ScenarioRun
from uvms_ocp.sim.loop import Loop, has_diverged
from uvms_ocp.types import Finite

if TYPE_CHECKING:
    from uvms_ocp.scenario.scenario import Scenario


class SteppedRun:
    """Ticks of one run, in the hands of the caller: `Scenario.simulation` makes it.

    Between two steps its parts may be looked at, and the plant's state, the newest readings,
    estimate and command. To change something on the way, give the scenario a part of your own.
    """

    def __init__(self, scenario: Scenario, parts: RunParts) -> None:
        self._scenario = scenario
        self._parts = parts
        self._run = ScenarioRun(scenario, parts)
        self._loop = Loop(
            plant=parts.plant,
            sensors=parts.sensors,
            estimator=parts.estimator,
            controller=parts.controller,
            dt=scenario.dt,
            recorder=Recorder(),
            kept_readings=self._run.reading_sizes(),
        )

        self._t = 0.0
        self._readings: Readings | None = None
        self._estimate: StateEstimate | None = None
        self._command: Command | None = None

    def __repr__(self) -> str:
        end = ", finished" if self.finished else ""
        return f"SteppedRun of {self._scenario.name} at t = {self.t:g} s{end}"

    @property
    def t(self) -> float:
        """Time [s] of the newest tick; 0 before the first."""
        return self._t

    @property
    def state(self) -> State:
        """True state, a control period after the newest tick."""
        return self._loop.state()

    @property
    def readings(self) -> Readings | None:
        """Newest reading of every channel at the newest tick; `None` before the first."""
        return self._readings

    @property
    def estimate(self) -> StateEstimate | None:
        """Estimate at the newest tick; `None` before the first."""
        return self._estimate

    @property
    def command(self) -> Command | None:
        """Command of the newest tick; `None` before the first."""
        return self._command

    @property
    def controller(self) -> MissionController:
        """Controller of the run, whose ``kinematic.state`` tells the phase, and
        ``kinematic.pending()`` what the mission waits for.
        """
        return self._parts.controller

    @property
    def finished(self) -> bool:
        """True where the mission is complete, or the plant's motion has grown beyond what a record
        holds.
        """
        is_complete = self.command is not None and self.command.finished
        return is_complete or has_diverged(self.state)

    def step(self) -> Command:
        """Take the next tick, from readings to the motion of the plant; return its command.

        Raises `InvalidInput` where the run is finished.
        """
        if self.finished:
            raise InvalidInput(f"the run is finished at t = {self.t:g} s; begin another simulation")
        loop = self._loop
        loop.advance(1)
        self._t = loop.t
        self._readings = loop.readings()
        self._estimate = loop.estimate()
        self._command = command = loop.command()
        self._run.look(loop.state())
        if not command.finished:
            loop.move()
        return command

    @checked
    def run(self, until: Finite | None = None) -> Record:
        """Step up to the tick at a time [s], by default that of the scenario's duration, or until
        the run is finished; return the record so far.

        Raises `InvalidInput` for a time that has passed.
        """
        end = self._scenario.duration if until is None else until
        if until is not None and until < self.t - SAME_TIME:
            raise InvalidInput(f"until = {until:g} s has passed, it is t = {self.t:g} s")
        dt = self._scenario.dt
        while not self.finished and (self.command is None or self.t + dt <= end + SAME_TIME):
            self.step()
        return self.record

    @property
    def record(self) -> Record:
        """Record of the ticks so far, as `Scenario.run` would end here. Raises `InvalidInput`
        before the first tick.
        """
        if self.command is None:
            raise InvalidInput("no tick yet; take a step first")
        is_over = self.finished or self.t + self._scenario.dt > self._scenario.duration + SAME_TIME
        return self._run.record_of(self._loop.recorder, stopped_by_hand=not is_over)
