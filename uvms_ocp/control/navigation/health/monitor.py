"""The health of all channels: what the filter may see before it runs, and what its outcome says of them after."""

from __future__ import annotations

import ctypes
import math
from operator import attrgetter

import numpy as np

from uvms_ocp.arguments import checked, late, trusted
from uvms_ocp.arrays import Array
from uvms_ocp.control.navigation.beam import BeamMount
from uvms_ocp.control.navigation.filter.memory import NUMBER
from uvms_ocp.control.navigation.health.channel_state import hear
from uvms_ocp.control.navigation.health.health_settings import health_memory, sizes_of
from uvms_ocp.control.navigation.health.health_tick import conclude, judge, take, vet
from uvms_ocp.control.navigation.health.reasons import Texts
from uvms_ocp.control.navigation.health.repeated import Repeated
from uvms_ocp.control.navigation.health.seat import Seat
from uvms_ocp.control.navigation.health.support import Support
from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.functions.kernels.binding import bind_kernels
from uvms_ocp.functions.kernels.layout import structure_of
from uvms_ocp.model.health import ChannelHealth, Trust
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import CHANNELS, SensorSpecs
from uvms_ocp.model.state import Command, Measurement, Readings

_readings = trusted(Readings)
_health = trusted(ChannelHealth)
_all = attrgetter(*CHANNELS)

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
        compiled: bool = True,
    ) -> None:
        """specs: the noise, rates and delays to expect. altimeter_frame: the one of the robot's description unless given.

        compiled: in C where there is a compiler; the verdicts are the same without. Raises `FrameNotFound` for an unknown
        altimeter frame.
        """
        specs, self.tuning = specs or SensorSpecs(), tuning or HealthTuning()
        frame = altimeter_frame or robot.description.altimeter
        present = {name: getattr(specs, name) for name in _present(robot, specs, frame)}
        self.memory = memory = health_memory(robot, present, self.tuning)
        """All that it knows, a `HealthMemory`."""
        structures = (type(memory), structure_of(Support), structure_of(Repeated))
        self._vet, self._judge, self._conclude, self._take, self._hear = bind_kernels(
            (vet, judge, conclude, take, hear), structures, compiled=compiled
        )
        shapes, self._texts = sizes_of(robot), Texts(robot.joint_names)
        self._seats = {name: Seat(memory.channels[NUMBER[name]], shapes[name], self._texts) for name in present}
        self._places = tuple(self._seats.get(name) for name in CHANNELS)
        self._beam = BeamMount(robot, frame, memory.now) if "altimeter_range" in present and frame else None
        self._joint_q, self._joint_v = robot.joint_q, robot.joint_v
        self._q, self._v = np.ctypeslib.as_array(memory.now.q), np.ctypeslib.as_array(memory.now.v)
        self._rates = np.ctypeslib.as_array(memory.encoders.rates)[: robot.n_joints]
        self._range = np.ctypeslib.as_array(memory.channels[NUMBER["altimeter_range"]].used_value)[:1]
        if self._beam is None:
            self._range[:] = math.nan
        self._health = tuple(_health(channel=name, trust=Trust.GOOD) for name in present)
        self.alarms: list[tuple[float, str]] = []
        """Time [s] and text of each change of a verdict; the text begins with the channel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of those that the robot has, in the order of `health`."""
        return tuple(self._seats)

    @property
    def health(self) -> tuple[ChannelHealth, ...]:
        """The verdicts of the last tick."""
        return self._health

    @property
    def velocity_exposed(self) -> bool:
        """What told the velocity has been found out in this tick."""
        return bool(self.memory.exposed)

    @property
    def adrift(self) -> bool:
        """Neither fixes nor a DVL have told for a second, or for another one: the velocity that was carried on means nothing."""
        return bool(self.memory.adrift)

    @late
    def trust(self, channel: str) -> Trust:
        """The verdict on a channel."""
        return Trust(self._seats[channel].memory.trust)

    def taken(self) -> dict[str, float | None]:
        """When [s] the last reading of each channel was taken that the estimate rests on; `None` before the first."""
        times = {name: seat.memory.taken for name, seat in self._seats.items()}
        return {name: None if math.isnan(t) else t for name, t in times.items()}

    @late
    def vet(self, readings: Readings, t: float, command: Command | None = None) -> Readings:
        """What the filter may see at time t [s]: in place of a refused reading the last one of its channel that was used.

        `command` has been acting since the last call.
        """
        fresh, strange = self._seat(readings)
        self._vet(self.memory, t, self._is_moved(command))
        self._use(fresh)
        if not self.memory.n_behind and not strange:
            return readings
        return _readings(**{name: seat.used for name, seat in self._seats.items()})

    @property
    def repeats(self) -> bool:
        """Whether `take` can be asked: the altimeter is not carried by the arm."""
        return self._beam is None or not self._beam.moves

    @late
    def take(
        self,
        readings: Readings,
        support: ctypes.Structure,
        repeated: ctypes.Structure,
        t: float,
        command: Command | None = None,
    ) -> tuple[Array, Array, float]:
        """`vet` and `conclude` at once, at time t [s], for who takes readings for the truth.

        Returns q (n_q,) [m, rad], v (n_v,) [m/s, rad/s] and the range of the altimeter [m], nan without one; `health` has the
        verdicts. support, repeated: a `Support` and a `Repeated`.
        """
        fresh, _ = self._seat(readings)
        if self._take(self.memory, support, repeated, t, self._is_moved(command)):
            self._tell(t)
        self._use(fresh)
        return self._q.copy(), self._v.copy(), self._range.item()

    def _seat(self, readings: Readings) -> tuple[list[Seat], bool]:
        """Channels with another reading than before, and whether one is given that is not to be, or none where one was."""
        fresh, strange = [], False
        for reading, seat in zip(_all(readings), self._places, strict=True):
            if seat is None:
                strange = strange or reading is not None
            elif reading is None:
                strange = strange or seat.used is not None
            elif reading is not seat.seen:
                seat.take(reading)
                fresh.append(seat)
        return fresh, strange

    def _is_moved(self, command: Command | None) -> bool:
        """Whether joints are, and how fast, for the kernels."""
        if command is None or command.brakes:
            return False
        self._rates[:] = command.v[self._joint_v]
        return True

    def _use(self, fresh: list[Seat]) -> None:
        """What the filter sees from now on."""
        behind = self.memory.n_behind
        for seat in fresh:
            if not behind or not seat.memory.behind:
                seat.used = seat.seen

    @late
    def hear(self, channel: str, t: float, nis: float, dof: int, accepted: bool) -> None:
        """The outcome of the filter's own gate on a reading, at time t [s].

        nis [-]: its normalised innovation squared, of dof [-] degrees of freedom. A channel whose readings the filter refuses is
        suspect and lost as one that is silent; the filter decides when it takes them again.
        """
        self._hear(self.memory, self._seats[channel].memory.number, nis, dof, accepted, t)

    @late
    def judge(self, measurement: Measurement, t: float) -> tuple[ChannelHealth, ...]:
        """The verdicts at time t [s], with what the filter made of the readings."""
        known = measurement.age < math.inf
        if known:
            self._note(measurement)
        if self._judge(self.memory, t, known):
            self._tell(t)
        return self._health

    @late
    def conclude(
        self, measurement: Measurement, support: ctypes.Structure, outcomes: ctypes.Array[ctypes.c_double], t: float
    ) -> tuple[ChannelHealth, ...]:
        """As `judge`, after all outcomes of the filter's gates, with the age that the support of the estimate gives it.

        support: a `Support`, which then tells the ages. outcomes (36,) [s, -, -, -]: `Gating.outcomes`. t [s]
        is the time of the tick.
        """
        self._note(measurement)
        if self._conclude(self.memory, support, outcomes, t):
            self._tell(t)
        return self._health

    def _note(self, measurement: Measurement) -> None:
        self._q[:], self._v[:] = measurement.q, measurement.v
        if self._beam is not None and self._beam.moves:
            self._beam.place(measurement.q[self._joint_q])

    def _tell(self, t: float) -> None:
        """Say what changed at time t [s]."""
        changed = {name: seat.memory for name, seat in self._seats.items() if seat.memory.changed}
        verdicts = {
            name: _health(channel=name, trust=Trust(c.trust), why=self._texts.of(name, c.complaint), since=t)
            for name, c in changed.items()
        }
        self._health = tuple(verdicts.get(verdict.channel, verdict) for verdict in self._health)
        self.alarms += [(t, _told(verdict)) for verdict in verdicts.values()]


def _present(robot: Robot, specs: SensorSpecs, altimeter_frame: str | None) -> list[str]:
    """Channels that the robot has."""
    names = CHANNELS if robot.n_vehicle else _JOINTS
    absent = () if altimeter_frame else ("altimeter_range",)
    return [name for name in names if getattr(specs, name) is not None and name not in absent]


def _told(verdict: ChannelHealth) -> str:
    word = verdict.trust.name.lower()
    return f"{verdict.channel} {word}: {verdict.why}" if verdict.why else f"{verdict.channel} {word} again"
