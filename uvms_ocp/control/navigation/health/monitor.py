"""The health of all channels: what the filter may see before it runs, and what its outcome says of them after."""

from __future__ import annotations

import math
from typing import Any

from uvms_ocp.arguments import checked, late, trusted
from uvms_ocp.control.navigation.health.channel_state import ChannelState
from uvms_ocp.control.navigation.health.cross_checks import CrossChecks, blamed, is_contested
from uvms_ocp.control.navigation.health.history import History
from uvms_ocp.control.navigation.health.reading_checks import ReadingChecks, is_empty
from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.model.health import ChannelHealth, Trust
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import CHANNELS, SensorSpecs
from uvms_ocp.model.state import Command, Measurement, Reading, Readings

_readings = trusted(Readings)

_FIX = "position"
_JOINTS = ("joint_positions", "joint_velocities")


@checked
class HealthMonitor:
    """Judges every channel. Holds what it has seen: build one per run.

    Each tick: `vet` the readings, run the filter on what is left, tell the outcomes of its own gates by `hear`, and `judge`.
    """

    def __init__(
        self,
        robot: Robot,
        specs: SensorSpecs | None = None,
        tuning: HealthTuning | None = None,
        altimeter_frame: str | None = None,
    ) -> None:
        """specs: the noise, rates and delays to expect. altimeter_frame: the one of the robot's description unless given.

        Raises `FrameNotFound` for an unknown altimeter frame.
        """
        specs, self.tuning = specs or SensorSpecs(), tuning or HealthTuning()
        frame = altimeter_frame or robot.description.altimeter
        present = {name: getattr(specs, name) for name in _present(robot, specs, frame)}
        self._states = {name: ChannelState(name, spec, self.tuning) for name, spec in present.items()}
        self._checks = ReadingChecks(robot, present, self._states, self.tuning, frame)
        self._cross = CrossChecks(present)
        self._history = History(max((spec.delay for spec in present.values()), default=0.0) + self.tuning.too_late)
        self._t: float | None = None
        self._dt = 0.0
        self._health = tuple(state.verdict for state in self._states.values())
        self.velocity_exposed = False
        """What told the velocity has been found out in this tick."""
        self.alarms: list[tuple[float, str]] = []
        """Time [s] and text of each change of a verdict; the text begins with the channel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of those that the robot has, in the order of `health`."""
        return tuple(self._states)

    @property
    def health(self) -> tuple[ChannelHealth, ...]:
        """The verdicts of the last tick."""
        return self._health

    @late
    def trust(self, channel: str) -> Trust:
        """The verdict on a channel."""
        return self._states[channel].verdict.trust

    def taken(self) -> dict[str, float | None]:
        """When [s] the last reading of each channel was taken that the estimate rests on; `None` before the first."""
        return {name: state.taken for name, state in self._states.items()}

    @late
    def vet(self, readings: Readings, t: float, command: Command | None = None) -> Readings:
        """What the filter may see at time t [s]: in place of a refused reading the last one of its channel that was used.

        `command` has been acting since the last call.
        """
        self._dt, self._t = 0.0 if self._t is None else max(t - self._t, 0.0), t
        self._checks.begin(command, self._dt)
        self.velocity_exposed = False
        return _readings(**{name: self._vetted(name, getattr(readings, name), t) for name in self._states})

    @late
    def hear(self, channel: str, t: float, nis: float, dof: int, accepted: bool) -> None:
        """The outcome of the filter's own gate on a reading, at time t [s].

        nis [-]: its normalised innovation squared, of dof [-] degrees of freedom. A channel whose readings the filter refuses is
        suspect and lost as one that is silent; the filter decides when it takes them again.
        """
        why = None if accepted else f"{math.sqrt(nis / dof):.3g} times the innovation expected"
        self._states[channel].gate(why, t)

    @late
    def judge(self, measurement: Measurement, t: float) -> tuple[ChannelHealth, ...]:
        """The verdicts at time t [s], with what the filter made of the readings."""
        if measurement.age < math.inf:
            self._history.add(t, measurement.q, measurement.v)
        changed = [
            name
            for name, state in self._states.items()
            if state.judge(t, self._period(name), contested=is_contested(name, self._states))
        ]
        if changed:
            self._health = tuple(state.verdict for state in self._states.values())
            self.alarms += [(t, _told(self._states[name].verdict)) for name in changed]
        return self._health

    def _vetted(self, name: str, reading: Reading[Any] | None, t: float) -> Reading[Any] | None:
        state = self._states[name]
        if reading is None or not state.is_new(reading):
            return state.used
        belief, barred = self._checks.belief(name, reading, t, self._history), state.is_barred(t)
        if not belief.used:
            state.refuse(belief.why or "", t)
        elif not barred and is_empty(name, reading):
            state.pass_empty(reading)
        elif not barred:
            state.use(reading, t)
        if belief.why and belief.used:
            state.doubt(belief.why, t)
        if belief.used or (belief.sane and (barred or name == _FIX)):
            self._compare(name, reading, t)
        return state.used

    def _compare(self, name: str, reading: Reading[Any], t: float) -> None:
        """With what other channels tell of the same; fixes are heard even where the estimate contradicts them: it may err."""
        estimate = self._history.at(reading.t) if name not in _JOINTS else None
        if estimate is None or is_empty(name, reading):
            return
        for quarrel in self._cross.hear(name, reading, estimate):
            guilty = blamed(quarrel, self._states, t)
            if not quarrel.bars:
                for accused in guilty:
                    self._states[accused].doubt(quarrel.why, t)
            elif guilty == (quarrel.likely,):  # else fixes jumped, for which they have been refused
                self.velocity_exposed |= self._states[quarrel.likely].bar(quarrel.why, t)

    def _period(self, name: str) -> float:
        """[s] between two readings, as the ticks allow."""
        return max(1.0 / self._states[name].spec.rate, self._dt)


def _present(robot: Robot, specs: SensorSpecs, altimeter_frame: str | None) -> list[str]:
    """Channels that the robot has."""
    names = CHANNELS if robot.n_vehicle else _JOINTS
    absent = () if altimeter_frame else ("altimeter_range",)
    return [name for name in names if getattr(specs, name) is not None and name not in absent]


def _told(verdict: ChannelHealth) -> str:
    word = verdict.trust.name.lower()
    return f"{verdict.channel} {word}: {verdict.why}" if verdict.why else f"{verdict.channel} {word} again"
