"""Monitor the health of all channels: screen readings before the filter, and judge every channel
after it.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np

from uvms_ocp.checks import checked_constructor, unchecked_constructor
from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, structure_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.estimation.estimator import JOINT_CHANNELS, AltimeterMount, PassThrough
from uvms_ocp.estimation.filter_memory import N_CHANNELS, NUMBER, ChannelIndex, numbers_of
from uvms_ocp.estimation.health import channel_setup, channel_state, plausibility, screening
from uvms_ocp.estimation.health.tuning import HealthTuning, Reason, ReasonTexts
from uvms_ocp.robot import signals
from uvms_ocp.robot.channels import OF_MOTION, rows_by_name, shape_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    ChannelHealth,
    Command,
    Reading,
    Readings,
    SensorSpec,
    SensorSpecs,
    StateEstimate,
    Trust,
)
from uvms_ocp.types import Array

_N_OUTCOME = 4  # numbers of an outcome
_LONGEST_UNOBSERVED = 1.0  # [s] for which a velocity may be carried on by itself

_health = unchecked_constructor(ChannelHealth)


class FallbackSensor(NamedTuple):
    """Channel that replaces another one in the estimate."""

    channel: str
    max_duration: float
    """[s] after which the estimate has drifted too far."""


class EstimateSupport(Layout):
    """Channels that support an estimate, and their age."""

    exact: bool
    """The estimator takes readings for the truth."""
    gating: bool
    """The estimator has gates of its own."""
    n: int
    """Channels that q and v rest on."""
    needed: Annotated[list[int], Sized("n_channels")]
    """(n_channels,) numbers of the channels that q and v rest on."""
    fallback: Annotated[list[int], Sized("n_channels")]
    """(n_channels,) number of the substitute of each channel, -1 for none."""
    max_duration: Annotated[Vector, Sized("n_channels")]
    """(n_channels,) [s] for which the substitute replaces the channel."""
    age: float
    """[s] of the least supported channel; inf before the first reading of any needed one."""
    oldest: int
    """Number of the least supported channel, -1 for none."""
    joint_age: float
    """[s] age of the joint positions alone."""
    echo: bool
    """The altitude is known."""


def fallback_sensors(*, gyro_from_attitude: bool) -> dict[str, FallbackSensor]:
    """Return the fallback of each channel, by the channel that is missing.

    Depth is replaced by the z of position and joint velocities by the change of joint positions,
    always: nobody needs them. Encoders and the altimeter are replaced by nothing. A DVL replaces
    the position for as long as a mission allows (`uvms_ocp.estimation.degraded_modes`).
    gyro_from_attitude: the estimator finds rates from attitudes alone.
    """
    if gyro_from_attitude:
        gyro = {"angular_velocity": FallbackSensor("attitude", math.inf)}
    else:
        gyro = {}
    return gyro | {
        "position": FallbackSensor("linear_velocity", math.inf),
        "linear_velocity": FallbackSensor("position", math.inf),
        # By then 0.01 rad at a drift of 1e-3 rad/s.
        "attitude": FallbackSensor("angular_velocity", 10.0),
    }


def supporting_channels(robot: Robot, specs: SensorSpecs, *, rates: bool) -> tuple[str, ...]:
    """Return the channels that q and v rest on. rates: joint velocities are not found from
    positions.

    The altitude has a state of its own: its range is nan without an echo.
    """
    channels = [*JOINT_CHANNELS]
    if robot.n_vehicle:
        channels = [*OF_MOTION, *channels]
    if rates:
        channels.append("joint_velocities")
    return tuple(name for name in channels if getattr(specs, name) is not None)


def support_of(
    needed: tuple[str, ...],
    fallback: Mapping[str, FallbackSensor],
    *,
    exact: bool,
    gating: bool,
    n_channels: int = N_CHANNELS,
) -> EstimateSupport:
    """Make the `EstimateSupport` of an estimator that takes readings for the truth (exact), or has
    gates (gating). n_channels: with those of a user's own.
    """
    support = structure_of(EstimateSupport, n_channels=n_channels)()
    support.exact = exact
    support.gating = gating
    support.n = len(needed)
    support.needed[: len(needed)] = [int(NUMBER[name]) for name in needed]
    support.fallback[:] = [-1] * n_channels
    for name, fallback_sensor in fallback.items():
        support.fallback[NUMBER[name]] = int(NUMBER[fallback_sensor.channel])
        support.max_duration[NUMBER[name]] = fallback_sensor.max_duration
    return support


def update_age(health: channel_state.HealthMemory, support: EstimateSupport) -> None:
    """Update the age of the least supported channel, and that of the joints.

    A channel without readings counts as old as its fallback, and ages from when that falls silent
    too or has replaced it for as long as it can.
    """
    joints = health.channels[ChannelIndex.JOINT_POSITIONS].taken
    if math.isnan(joints):
        support.joint_age = math.inf
    else:
        support.joint_age = health.t - min(joints, health.t)
    support.oldest = -1
    oldest = health.t
    for k in range(support.n):
        number = support.needed[k]
        supported_until = _supported_until(health, support, number)
        if math.isnan(supported_until):
            support.oldest = number
            support.age = math.inf
            return
        if supported_until < oldest:
            oldest = supported_until
            support.oldest = number
    support.age = health.t - oldest


def _supported_until(
    health: channel_state.HealthMemory, support: EstimateSupport, number: int
) -> float:
    """Return until when [s] readings support a channel, nan before its first one."""
    taken_at = health.channels[number].taken
    fallback = support.fallback[number]
    by = health.channels[fallback].taken if fallback >= 0 else math.nan
    if math.isnan(taken_at) or math.isnan(by):
        return taken_at
    return max(taken_at, min(by, taken_at + support.max_duration[number]))


def update_echo(health: channel_state.HealthMemory, support: EstimateSupport) -> None:
    """Update whether the altitude is supported: estimators predict it while the altimeter is
    suspect; a raw echo ages at once.
    """
    channel = health.channels[ChannelIndex.ALTIMETER_RANGE]
    old = support.exact and health.t - channel.taken > channel_state.LEAST_TO_SUSPECT
    support.echo = not channel.present or (not old and channel.trust != Trust.LOST)


class PassThroughMemory(Layout):
    """Channels that q and v of a pass-through are made of."""

    n: int
    """Number of channels of q, and of v."""
    of_q: Annotated[list[int], Sized(3)]
    """(n,) numbers of the channels of q, one after the other."""
    of_v: Annotated[list[int], Sized(3)]
    """(n,) numbers of the channels of v, one after the other."""


def pass_through_memory(estimator: PassThrough) -> PassThroughMemory:
    """Make the `PassThroughMemory` of an estimator."""
    memory = structure_of(PassThroughMemory)()
    n = len(estimator.q_channels)
    memory.n = n
    memory.of_q[:n] = [int(NUMBER[name]) for name in estimator.q_channels]
    memory.of_v[:n] = [int(NUMBER[name]) for name in estimator.v_channels]
    return memory


def repeat(health: channel_state.HealthMemory, pass_through: PassThroughMemory) -> None:
    """Copy the readings in use into `now`. A kernel."""
    at = 0
    there = 0
    for k in range(pass_through.n):
        channel = health.channels[pass_through.of_q[k]]
        for i in range(channel.size):
            health.now.q[at] = channel.used_value[i]
            at += 1
        channel_memory = health.channels[pass_through.of_v[k]]
        for i in range(channel_memory.size):
            health.now.v[there] = channel_memory.used_value[i]
            there += 1


class ChannelBuffer:
    """Buffer of a channel's readings, from Python to the kernels and back to the filter."""

    __slots__ = ("_scalar", "_shape", "_texts", "_value", "memory", "seen", "used")

    def __init__(
        self, memory: channel_state.ChannelMemory, shape: tuple[int, ...], texts: ReasonTexts
    ) -> None:
        """memory: a `ChannelMemory`. shape: of a right value."""
        self.memory = memory
        self._shape = shape
        self._texts = texts
        self._scalar = shape == ()
        self._value = np.ctypeslib.as_array(memory.value)[: memory.size]
        self.seen: Reading[Any] | None = None
        """Newest reading."""
        self.used: Reading[Any] | None = None
        """The last reading that was not refused, which the filter sees; it may state that there is
        nothing to read.
        """

    def ingest(self, reading: Reading[Any]) -> None:
        """Write a new reading into the memory of the kernels."""
        self.seen = reading
        memory = self.memory
        value = reading.value
        memory.stamp = reading.t
        memory.fresh = True
        if self._scalar and isinstance(value, float):
            self._value[0] = value
        elif value.__class__ is np.ndarray and value.shape == self._shape:
            self._value[:] = value
        else:
            self._ingest_array(np.asarray(value))

    def _ingest_array(self, value: Array) -> None:
        """Write a value of any shape; a wrong one is marked."""
        if value.shape == self._shape:
            self._value[:] = value
        else:
            self.memory.misshapen = self._texts.shape(value.shape, self._shape)


def screen(health: channel_state.HealthMemory, t: float, moving: bool) -> None:
    """Screen the fresh readings at time t [s]; moving: there was a command, and no brakes."""
    if health.started:
        health.dt = max(t - health.t, 0.0)
    else:
        health.dt = 0.0
    health.t = t
    health.started = True
    health.exposed = False
    plausibility.integrate_command(health.encoders, moving, health.dt)
    health.n_behind = 0
    for k in range(health.n):
        channel = health.channels[health.order[k]]
        if channel.fresh:
            _screen_newest(health, channel)
        if channel.behind:
            health.n_behind += 1
    # Whether neither fixes nor a DVL have observed the velocity for a while, since that was last
    # so.
    last = max(
        _last_observed(health.channels[ChannelIndex.POSITION]),
        _last_observed(health.channels[ChannelIndex.LINEAR_VELOCITY]),
    )
    health.velocity_unobserved = (
        last > -math.inf and health.t - max(last, health.unobserved_at) > _LONGEST_UNOBSERVED
    )
    health.unobserved_at = t if health.velocity_unobserved else health.unobserved_at


def _last_observed(channel: channel_state.ChannelMemory) -> float:
    """Return the time [s] of the last reading in use, -inf before the first and without the
    channel.
    """
    if not channel.present or math.isnan(channel.taken):
        return -math.inf
    return channel.taken


def judge(health: channel_state.HealthMemory, t: float, is_estimated: bool) -> int:
    """Update the trust in every channel at time t [s]; is_estimated: `now` is one. Returns how many
    verdicts changed.
    """
    health.t = t
    health.now.t = t
    if is_estimated:
        plausibility.remember(health.history, health.now)
    n = 0
    for k in range(health.n):
        if channel_state.update_trust(health, health.channels[health.order[k]]):
            n += 1
    channel_state.update_turn_dispute(health)
    if health.turns_disputed:
        channel_state.keep_undisputed_turns(health, health.now.v)
    return n


def finish(
    health: channel_state.HealthMemory, support: EstimateSupport, outcomes: Vector, t: float
) -> int:
    """Take the filter's outcomes (4 n_channels,), four numbers per channel, the support of its estimate
    `now`, and judge.

    t [s] is the time of the tick. Returns how many verdicts changed.
    """
    if support.gating:
        _update_all_outcomes(health, outcomes)
    return _update_all_trust(health, support, t)


def screen_tick(health: channel_state.HealthMemory) -> None:
    """Screen the fresh readings, with the inputs of `screen` in memory. A kernel."""
    screen(health, health.tick_t, health.moving)


def finish_tick(
    health: channel_state.HealthMemory, support: EstimateSupport, outcomes: Vector
) -> None:
    """Judge all channels, with the time of `finish` in memory, where the number of changed verdicts
    is left. A kernel.
    """
    health.n_changed = finish(health, support, outcomes, health.tick_t)


def screen_and_finish_tick(
    health: channel_state.HealthMemory, support: EstimateSupport, pass_through: PassThroughMemory
) -> None:
    """Screen the fresh readings, and judge all channels by those in use, taken for the truth. A
    kernel.
    """
    screen(health, health.tick_t, health.moving)
    repeat(health, pass_through)
    health.n_changed = _update_all_trust(health, support, health.tick_t)


def _update_all_trust(
    health: channel_state.HealthMemory, support: EstimateSupport, t: float
) -> int:
    update_age(health, support)
    n = judge(health, t, support.age < math.inf)
    update_echo(health, support)
    return n


def _screen_newest(
    health: channel_state.HealthMemory, channel: channel_state.ChannelMemory
) -> None:
    channel.fresh = False
    channel.behind = True
    if not channel.started or channel.stamp != channel.seen:
        channel.started = True
        channel.seen = channel.stamp
        _screen_new(health, channel)
    channel.misshapen = 0
    if not channel.behind:
        channel.used_value[: channel.size] = channel.value[: channel.size]


def _screen_new(health: channel_state.HealthMemory, channel: channel_state.ChannelMemory) -> None:
    slot = plausibility.slot_at(health.history, channel.stamp)
    barred = channel_state.is_excluded(channel, health.t)
    belief = health.belief
    screening.screen_reading(health, channel, slot)
    if not belief.used and belief.why.code != Reason.NONE:
        channel_state.reject(channel, belief.why, health.t)
    elif belief.used and not barred and screening.is_empty(channel):
        channel_state.accept_empty(channel)
    elif belief.used and not barred:
        channel_state.accept(channel, health.t)
    if belief.used and belief.why.code != Reason.NONE:
        channel_state.suspect(channel, belief.why, health.t)
    # Fixes are heard even where the estimate contradicts them, as it may err, and so is a DVL that
    # insists.
    is_compared = belief.used or (
        belief.sane
        and (barred or channel.number == ChannelIndex.POSITION or screening.is_persistent(channel))
    )
    if is_compared and slot >= 0 and not screening.is_empty(channel):
        screening.compare(health, channel, health.history.kept[slot])


def _update_all_outcomes(health: channel_state.HealthMemory, outcomes: Vector) -> None:
    """Use every outcome once."""
    for k in range(health.n):
        number = health.order[k]
        channel = health.channels[number]
        at = _N_OUTCOME * number
        if outcomes[at] > channel.compared_at:
            channel.compared_at = outcomes[at]
            channel_state.update_gate_outcome(
                health, number, outcomes[at + 1], outcomes[at + 2], outcomes[at + 3] > 0.0, health.t
            )


@checked_constructor
class HealthMonitor:
    """Monitor of the health of all channels. Holds their state: build one per run.

    Each tick: `screen` the readings, run the filter on the rest, and `judge`, with the outcomes of
    its gates `finish`.
    """

    def __init__(
        self,
        robot: Robot,
        specs: SensorSpecs | None = None,
        tuning: HealthTuning | None = None,
        altimeter_frame: str | None = None,
        compiled: bool = True,
    ) -> None:
        """specs: the noise, rates and delays to expect. altimeter_frame: the one of the robot's
        description unless given.

        compiled: in C where there is a compiler; the verdicts are the same without. Raises
        `FrameNotFound` for an unknown altimeter frame.
        """
        specs = specs or SensorSpecs()
        self.tuning = tuning or HealthTuning()
        frame = altimeter_frame or robot.description.altimeter
        present = _present(robot, specs, frame)
        rows = rows_by_name(specs.own)
        self.numbers = numbers = numbers_of(specs.own)
        """Index of each channel, the toolkit's and a user's own, in memory."""
        self.memory = memory = channel_setup.health_memory(robot, present, self.tuning, specs.own)
        """Memory of the kernels, a `HealthMemory`."""
        structures = (
            type(memory),
            structure_of(EstimateSupport, n_channels=len(numbers)),
            structure_of(PassThroughMemory),
        )
        kernels = (screen, judge, finish, screen_tick, finish_tick, screen_and_finish_tick)
        self._screen, self._judge, self._finish, *self.ticks = bind_kernels(
            kernels, structures, compiled=compiled
        )
        """`screen_tick`, `finish_tick` and `screen_and_finish_tick`."""
        self._units = {name: row.unit for name, row in rows.items()}
        self._texts = ReasonTexts(robot.joint_names, self._units)
        self._buffers = dict[str, ChannelBuffer]()
        for name in present:
            channel = memory.channels[numbers[name]]
            self._buffers[name] = ChannelBuffer(channel, shape_of(rows[name], robot), self._texts)
        self._own = tuple(channel.name for channel in specs.own)
        self._places = tuple(self._buffers.get(name) for name in rows)
        self._fresh: list[ChannelBuffer] = []
        """Channels with new readings among those that were taken in last."""
        self._strange = False
        """A channel was given that is not to be, or was missing where one was."""
        self._beam: AltimeterMount | None = None
        if "altimeter_range" in present and frame:
            self._beam = AltimeterMount(robot, frame, memory.now)
        self._joint_q = robot.joint_q
        self._joint_v = robot.joint_v
        self._q = np.ctypeslib.as_array(memory.now.q)
        self._v = np.ctypeslib.as_array(memory.now.v)
        self._rates = np.ctypeslib.as_array(memory.encoders.rates)[: robot.n_joints]
        if self._beam is None:
            memory.channels[NUMBER["altimeter_range"]].used_value[0] = math.nan
        self._health = tuple(_health(channel=name, trust=Trust.GOOD) for name in present)
        self.alarms: list[tuple[float, str]] = []
        """Time [s] and text of each change of a verdict; the text begins with the channel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that the robot has, in the order of `health`."""
        return tuple(self._buffers)

    @property
    def health(self) -> tuple[ChannelHealth, ...]:
        """Verdicts of the last tick."""
        return self._health

    @property
    def unexplained(self) -> Array:
        """Errors (n_v,) [m, rad] that q may have since readings were refused and came back
        elsewhere.
        """
        n_joints = len(self._rates)
        names = ["joint_positions"] * n_joints
        has_vehicle = len(self._v) > n_joints
        if has_vehicle:
            names = ["position"] * 3 + ["attitude"] * 3 + names
        return np.array([self.memory.channels[NUMBER[name]].unexplained for name in names])

    def screen(self, readings: Readings, t: float, command: Command | None = None) -> Readings:
        """Screen readings at time t [s]: a refused one is replaced by the last of its channel that
        was used.

        `command` has been acting since the last call.
        """
        self.take_in(readings)
        self._screen(self.memory, t, self._is_moved(command))
        return self.screened(readings)

    def take_in(self, readings: Readings) -> None:
        """Write new readings into the memory of the kernels."""
        self._fresh = []
        self._strange = False
        given = signals.readings_by_channel(readings, self._own)
        for reading, buffer in zip(given, self._places, strict=True):
            if buffer is None:
                self._strange = self._strange or reading is not None
            elif reading is None:
                self._strange = self._strange or buffer.used is not None
            elif reading is not buffer.seen:
                buffer.ingest(reading)
                self._fresh.append(buffer)

    def screened(self, readings: Readings) -> Readings:
        """Return the readings that were taken in last, with refused ones replaced, once kernels have
        screened them.
        """
        behind = self.memory.n_behind
        for buffer in self._fresh:
            if not behind or not buffer.memory.behind:
                buffer.used = buffer.seen
        if not behind and not self._strange:
            return readings
        used = {name: buffer.used for name, buffer in self._buffers.items()}
        return signals.readings_of(used)

    @property
    def repeats(self) -> bool:
        """True where `screen_and_finish_tick` can be used: the altimeter is not carried by the
        arm.
        """
        return self._beam is None or not self._beam.moves

    def _is_moved(self, command: Command | None) -> bool:
        """Write the commanded rates of the joints for the kernels; return whether there are any."""
        if command is None or command.brakes:
            return False
        self._rates[:] = command.v[self._joint_v]
        return True

    def judge(self, estimate: StateEstimate, t: float) -> tuple[ChannelHealth, ...]:
        """Judge all channels at time t [s], with the estimate that the filter made of the
        readings.
        """
        is_estimated = estimate.age < math.inf
        if is_estimated:
            self._note(estimate)
        if self._judge(self.memory, t, is_estimated):
            self.publish(t)
        return self._health

    def finish(
        self,
        estimate: StateEstimate,
        support: EstimateSupport,
        outcomes: ctypes.Array[ctypes.c_double],
        t: float,
    ) -> tuple[ChannelHealth, ...]:
        """Judge all channels after the filter's gates, and find the age of what supports the
        estimate.

        support: an `EstimateSupport`, which then has the ages. outcomes (4 n_channels,) [s, -, -, -]:
        `GatedEstimator.outcomes`. t [s] is the time of the tick.
        """
        self._note(estimate)
        if self._finish(self.memory, support, outcomes, t):
            self.publish(t)
        return self._health

    def _note(self, estimate: StateEstimate) -> None:
        self._q[:] = estimate.q
        self._v[:] = estimate.v
        if self._beam is not None and self._beam.moves:
            self._beam.place(estimate.q[self._joint_q])

    def publish(self, t: float) -> None:
        """Publish the verdicts that changed at time t [s], and log alarms."""
        verdicts = dict[str, ChannelHealth]()
        for name, buffer in self._buffers.items():
            channel = buffer.memory
            if not channel.changed:
                continue
            reason = self._texts.of(name, channel.complaint)
            verdict = _health(channel=name, trust=Trust(channel.trust), why=reason, since=t)
            verdicts[name] = verdict
            self.alarms.append((t, _describe(verdict, channel.shift, self._units[name])))
        self._health = tuple(verdicts.get(verdict.channel, verdict) for verdict in self._health)


def _present(
    robot: Robot, specs: SensorSpecs, altimeter_frame: str | None
) -> dict[str, SensorSpec]:
    """Return the sensors that the robot has, by channel."""
    sensors = specs.present
    if not robot.n_vehicle:
        rows = rows_by_name(specs.own)
        return {name: sensor for name, sensor in sensors.items() if rows[name].of_joints}
    if not altimeter_frame:
        sensors.pop("altimeter_range", None)
    return sensors


def _describe(verdict: ChannelHealth, shift: float, unit: str) -> str:
    word = verdict.trust.name.lower()
    if verdict.why:
        return f"{verdict.channel} {word}: {verdict.why}"
    elsewhere = ""
    if shift > 0.0:
        elsewhere = f", {shift:.2g} {unit} from where it was before"
    return f"{verdict.channel} {word} again{elsewhere}"
