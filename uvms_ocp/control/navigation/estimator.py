"""State estimation: the readings of the sensors in, what controllers see out."""

from __future__ import annotations

import math
from operator import attrgetter

import numpy as np

from uvms_ocp.arguments import checked, late, trusted
from uvms_ocp.arrays import Array
from uvms_ocp.control.navigation.beam import BeamMount
from uvms_ocp.control.navigation.channels import needed_channels
from uvms_ocp.control.navigation.filter.core import bound_tick
from uvms_ocp.control.navigation.filter.memory import CHANNELS, N_VEHICLE, NUMBER, Memory
from uvms_ocp.control.navigation.filter.settings import prepared
from uvms_ocp.control.navigation.filter.vehicle import doubt_velocity
from uvms_ocp.control.navigation.joint_chart import JointChart
from uvms_ocp.control.navigation.outcome import Outcome
from uvms_ocp.control.navigation.tuning import EstimatorTuning
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import SensorSpecs
from uvms_ocp.model.state import Command, Measurement, Reading, Readings
from uvms_ocp.shown.small_table import SmallTable, Tabled, rows_of

_measurement = trusted(Measurement)
_outcome = trusted(Outcome)
_readings = attrgetter(*CHANNELS)

_LATEST = 1e9  # [s] of any clock; thirty years


@checked
class Estimator(Tabled):
    """A callable ``(Readings, t, command) -> Measurement``. Holds its estimate: build one per run.

    Until a channel has its first reading its part of the estimate means nothing, and `Measurement.age` is inf. A reading
    that is late is fused at the time it was taken. One that is not finite, larger than 1e9 in the unit of its channel, of
    the future or older than the last of its channel is never used, nor is an altimeter's range below zero; only its nan says
    something, that there is no echo. One that contradicts the estimate by more than five standard deviations is not used
    until others agree with it for `EstimatorTuning.recovery`. The age is that of the last one that was used.

    The current is no part of the state: without a sensor of the velocity in water, or a model of thrust and drag, nothing
    that is read depends on it.
    """

    def __init__(
        self,
        robot: Robot,
        specs: SensorSpecs | None = None,
        tuning: EstimatorTuning | None = None,
        altimeter_frame: str | None = None,
        compiled: bool = True,
    ) -> None:
        """specs: the noise to expect. altimeter_frame: the one of the robot's description unless given.

        compiled: in C where there is a compiler; the numbers are the same without. Raises `FrameNotFound` for an unknown
        altimeter frame.
        """
        specs, tuning = specs or SensorSpecs(), tuning or EstimatorTuning()
        altimeter_frame = altimeter_frame or robot.description.altimeter
        frame = None if specs.altimeter_range is None or not robot.n_vehicle else altimeter_frame
        self._n_vehicle, self._response_time = robot.n_vehicle, tuning.response_time
        self.memory = memory = prepared(Memory(robot.n_joints), robot, specs, tuning)
        """All numbers of the filter, for who studies it."""
        for name in needed_channels(robot, specs, altimeter_frame):
            memory.needed[NUMBER[name]] = 1.0
        self._has_range = frame is not None
        self._beam = None if frame is None else BeamMount(robot, frame, memory)
        self._chart = JointChart(robot, memory)
        self._joints = self._chart.configuration()
        self.advance = bound_tick(memory, compiled=compiled)
        """The filter alone: from what `memory` has been given to what it tells."""
        self._seen: dict[str, Reading | None] = dict.fromkeys(CHANNELS)
        self._refused: frozenset[str] = frozenset()
        self._response = np.zeros(robot.n_v)
        self._t: float | None = None

    @late
    def __call__(self, readings: Readings, t: float, command: Command | None = None) -> Measurement:
        """The estimate at time t [s]; `command` has been acting since the last call.

        Raises `InvalidInput` for a time before that of the last call, or beyond 1e9 s.
        """
        dt = self._elapsed(t)
        if command is not None:
            self._follow(command, dt)
        self.memory.told[0] = command is not None
        self._take_in(readings)
        if self._beam is not None:
            self._beam.place(self._joints)
        self.advance()
        return self._told()

    def _table(self) -> SmallTable:
        known = {name: self.memory.used[NUMBER[name]] for name in CHANNELS if self.memory.needed[NUMBER[name]]}
        used = {name: f"used until {t:.4g} s" if math.isfinite(t) else "no reading yet" for name, t in known.items()}
        return SmallTable(title=type(self).__name__, rows=rows_of(used))

    @late
    def outcome(self, channel: str) -> Outcome | None:
        """What became of the newest reading of a channel that was compared with the estimate; `None` before the first.

        A channel's first reading is no news, and one that no sensor gives, of the wrong time or so late that its past is
        forgotten is not compared. Raises `NameNotFound` for an unknown channel.
        """
        t, squared, degrees, accepted = self.memory.outcome[_number(channel)].tolist()
        if math.isnan(t):
            return None
        return _outcome(t=t, squared=squared, degrees=int(degrees), accepted=bool(accepted))

    @property
    def outcomes(self) -> Array:
        """(9, 4) [s, -, -, -] of all channels, in the order of `filter.memory.Channel`; changed in place by every call.

        When the reading was taken, squared innovation, degrees of freedom, 1 if it was used; nan before the first.
        """
        return self.memory.outcome

    def used(self, channel: str) -> float:
        """Time [s] of the newest reading of a channel that was used, -inf before the first; an echo that is missing counts.

        Raises `NameNotFound` for an unknown channel.
        """
        return float(self.memory.used[_number(channel)])

    def refuse(self, channel: str, refused: bool = True) -> None:
        """Use no readings of a channel from now on, or again. Raises `NameNotFound` for an unknown channel."""
        _number(channel)
        self._refused = self._refused | {channel} if refused else self._refused - {channel}

    def doubt_velocity(self, *, rests: bool = False) -> None:
        """Take linear velocity and acceleration for unknown: what told them proved wrong. rests: and for zero, at a guess."""
        doubt_velocity(self.memory, rests=rests)

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation (n_v,) [m, rad] of the estimated q, by its own covariance: position in W, attitude in B, joints."""
        return self.memory.spread[6 - self._n_vehicle :].copy()

    def _elapsed(self, t: float) -> float:
        if not abs(t) <= _LATEST:
            raise InvalidInput(f"estimator called at t = {t} s; give a time of at most {_LATEST:g} s")
        dt = 0.0 if self._t is None else t - self._t
        if dt < 0:
            raise InvalidInput(f"estimator called at t = {t} s after t = {self._t} s; give increasing times")
        self._t = self.memory.now[0] = t
        return dt

    def _follow(self, command: Command, dt: float) -> None:
        """The velocity (n_v,) [m/s, rad/s] that the command has brought about, were there nothing else."""
        self._response = command.v + math.exp(-dt / self._response_time) * (self._response - command.v)
        self.memory.asked[6 - self._n_vehicle :] = self._response

    def _take_in(self, readings: Readings) -> None:
        memory, seen = self.memory, self._seen
        for name, reading in zip(CHANNELS, _readings(readings), strict=True):
            if reading is None or reading is seen[name] or name in self._refused:
                continue
            seen[name], c = reading, NUMBER[name]
            if c < N_VEHICLE:
                memory.value[c, : np.size(reading.value)] = reading.value
            else:
                memory.joint_value[c - N_VEHICLE] = self._chart.values(name, reading.value)
            memory.fresh[c], memory.stamp[c] = 1.0, reading.t

    def _told(self) -> Measurement:
        memory, v = self.memory, self.memory.joint_x[:, 1]
        q = self._joints = self._chart.configuration()
        if self._n_vehicle:
            q, v = np.concatenate([memory.x[:3], memory.turn, q]), np.concatenate([memory.twist, v])
        echo, echo_spread = memory.range.tolist() if self._has_range else (math.nan, math.nan)
        age, joint_age = memory.age.tolist()
        return _measurement(
            q=q,
            v=v.copy(),
            altimeter_range=echo,
            age=age,
            joint_age=joint_age,
            spread=self.spread,
            altimeter_spread=echo_spread,
        )


def _number(channel: str) -> int:
    if channel not in NUMBER:
        raise NameNotFound("channel", channel, CHANNELS)
    return NUMBER[channel]
