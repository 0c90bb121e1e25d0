"""Estimate the state of the robot from late and noisy readings, by an error-state Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import (
    checked,
    checked_constructor,
    checked_dataclass,
    checked_on_failure,
    unchecked_constructor,
)
from uvms_ocp.codegen import kernel_layout, kernels
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.estimation import (
    filter_memory as filtering,
    joint_filters,
    measurement_update,
    vehicle_model,
)
from uvms_ocp.estimation.filter_memory import NUMBER, ChannelIndex, Part
from uvms_ocp.estimation.own_measurements import (
    own_measurements,
    require_fusible,
    write_dependence,
)
from uvms_ocp.estimation.tuning import EstimatorTuning
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.robot import signals
from uvms_ocp.robot.channels import CHANNELS, TABLE
from uvms_ocp.robot.kinematics import STEEP
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    IDEAL_SENSORS,
    Command,
    Reading,
    Readings,
    SensorSpec,
    SensorSpecs,
    StateEstimate,
)
from uvms_ocp.types import Array, read_only

JOINT_CHANNELS = ("joint_positions",)

_LATEST = 1e10  # [s] of any clock; Unix time reaches it in 2286

_RATE = 100.0  # [Hz] at which the estimator is run
_SETTLED = 20.0  # [s] after which its covariance no longer changes


def advance_filter(filter: filtering.FilterMemory) -> None:
    """Run one tick: predict, fuse what is fresh, and write the outputs."""
    filter.dt = filter.now - filter.before if filter.started else 0.0
    filter.started = True
    filter.before = filter.now
    _hear_command(filter)
    if filter.floating:
        vehicle_model.predict(filter)
        measurement_update.fuse(filter)
        _write_vehicle_outputs(filter)
    joint_filters.predict_joints(filter)
    joint_filters.fuse_joints(filter)
    for j in range(filter.n_joints):
        filter.std[6 + j] = math.sqrt(max(filter.joint_P[j][0][0], 0.0))
    filter.age[0] = 0.0
    filter.age[1] = max(filter.now - filter.used[ChannelIndex.JOINT_POSITIONS], 0.0)
    for c in range(len(filter.needed)):
        if filter.needed[c] > 0.0:
            filter.age[0] = max(filter.now - filter.used[c], filter.age[0])
        filter.fresh[c] = 0.0


def _hear_command(filter: filtering.FilterMemory) -> None:
    """Take the command for followed with a lag, and joints that brakes lock for at rest."""
    if filter.has_command:
        remaining = math.exp(-filter.dt / filtering.RESPONSE_TIME)
        for i in range(len(filter.response)):
            filter.response[i] = filter.commanded[i] + remaining * (
                filter.response[i] - filter.commanded[i]
            )
    if filter.has_command and filter.braked:
        # Carried on as fast as before, nothing would agree with it again.
        for j in range(filter.n_joints):
            filter.joint_x[j][1] = 0.0


def _write_vehicle_outputs(filter: filtering.FilterMemory) -> None:
    R = kernel_layout.zeros(9)
    predicted = filter.predicted
    vehicle_model.rotation(filter.turn, R)
    vehicle_model.rotate_back(R, filter.x, Part.SPEED, filter.twist)
    for i in range(3):
        filter.twist[3 + i] = filter.x[Part.SPIN + i]
        filter.std[i] = math.sqrt(max(filter.P[Part.PLACE + i][Part.PLACE + i], 0.0))
        filter.std[3 + i] = math.sqrt(max(filter.P[Part.TURN + i][Part.TURN + i], 0.0))
    vehicle_model.predict_measurement(filter, ChannelIndex.ALTIMETER_RANGE, filtering.MAIN)
    has_floor = predicted.h[1] > STEEP and filter.now - filter.echo <= filter.echo_memory
    filter.range[0] = predicted.h[0] / predicted.h[1] if has_floor else math.nan
    if has_floor:
        filter.range[1] = math.sqrt(max(predicted.S[0][0], 0.0)) / predicted.h[1]
    else:
        filter.range[1] = math.nan


# Which channels an estimate needs, and how old they are.


def age_of(readings: Readings, channels: tuple[str, ...], t: float) -> float:
    """Return the age [s] at time t [s] of the oldest of the channels' readings; inf where one is
    missing.
    """
    return oldest_of(readings, channels, t)[0]


def oldest_of(readings: Readings, channels: tuple[str, ...], t: float) -> tuple[float, str]:
    """Return the age [s] at time t [s] of the oldest of the channels' readings, inf where one is
    missing, and which channel that is.
    """
    oldest_stamp = t
    oldest = ""
    for name in channels:
        reading = getattr(readings, name)
        if reading is None:
            return math.inf, name
        if reading.t < oldest_stamp:
            oldest_stamp = reading.t
            oldest = name
    return t - oldest_stamp, oldest


def needed_channels(
    robot: Robot, specs: SensorSpecs, altimeter_frame: str | None
) -> tuple[str, ...]:
    """Return the channels that the robot has and that no other replaces."""
    names = list[str]()
    for channel in TABLE:
        exists = getattr(specs, channel.name) is not None
        if channel.of_motion:
            exists = exists and robot.n_vehicle > 0
        elif channel.name == "altimeter_range":
            exists = exists and robot.n_vehicle > 0 and bool(altimeter_frame)
        if exists and channel.needed:
            names.append(channel.name)
    return tuple(names)


class AltimeterMount:
    """The altimeter in B: fixed to the vehicle, or carried by the arm, which a tick then has to
    look at.
    """

    __slots__ = ("_data", "_frame", "_memory", "_robot", "moves")

    def __init__(self, robot: Robot, frame: str, memory: Any) -> None:
        """frame: that of the altimeter. Raises `FrameNotFound`.

        memory: written to, its `beam_at` (3,) [m] the altimeter in B, and its `beam_up` (3,) the z
        axis of the altimeter there.
        """
        self._robot = robot
        self._frame = robot.frame_id(frame)
        self._memory = memory
        self._data = robot.model.createData()
        self.moves = robot.model.frames[self._frame].parentJoint > 1
        self._look(pin.neutral(robot.model)[robot.joint_q])

    def place(self, joints: Array) -> None:
        """Update the place of an altimeter that may have moved; `joints` (n_joint_q,) is that part
        of q [rad or m].
        """
        if self.moves:
            self._look(joints)

    def _look(self, joints: Array) -> None:
        model = self._robot.model
        memory = self._memory
        q = pin.neutral(self._robot.model)
        q[self._robot.joint_q] = joints
        pin.forwardKinematics(model, self._data, q)
        X_BS = pin.updateFramePlacement(model, self._data, self._frame)
        memory.beam_at[:] = X_BS.translation
        memory.beam_up[:] = X_BS.rotation[:, 2]


@checked_dataclass()
class GateOutcome:
    """Outcome of the chi-square gate on the newest reading of a channel."""

    t: float
    """[s] time at which the reading was taken."""
    squared: float
    """Innovation, normalised and squared: chi-squared with `degrees` where sensor and vehicle are
    as expected.
    """
    degrees: int
    """Degrees of freedom."""
    accepted: bool
    """True where the reading was used; for joints, where that of every joint was."""


class JointChart:
    """Displacements of the joints from an origin, which follows the estimate where q is no vector
    space.
    """

    __slots__ = ("_memory", "_origin", "_robot", "is_plain")

    def __init__(self, robot: Robot, memory: Any) -> None:
        self._robot = robot
        self._memory = memory
        self._origin = pin.neutral(robot.model)
        self.is_plain = all(joint.n_q == joint.n_v for joint in robot.joints)

    def values(self, channel: str, reading: Array) -> Array:
        """Return the values (n_joints,) of a reading (n_joint_q,) [rad or m] of joint positions, or
        (n_joints,) [rad/s or m/s] of velocities.
        """
        if self.is_plain or channel != "joint_positions":
            return reading
        if not np.isfinite(reading).all():
            return np.full(self._robot.n_joints, np.nan)
        q = self._origin.copy()
        q[self._robot.joint_q] = reading
        return np.asarray(pin.difference(self._robot.model, self._origin, q)[self._robot.joint_v])

    def configuration(self) -> Array:
        """Return the joint part of q [rad or m]."""
        displaced = self._memory.joint_x[:, 0]
        if self.is_plain:
            return displaced.copy()
        v = np.zeros(self._robot.n_v)
        v[self._robot.joint_v] = displaced
        self._origin = pin.integrate(self._robot.model, self._origin, v)
        clones = self._memory.joint_owner == ChannelIndex.JOINT_POSITIONS
        self._memory.joint_h[:, clones] -= displaced[:, None]
        self._memory.joint_x[:, 0] = 0.0
        return np.asarray(self._origin[self._robot.joint_q])


_outcome = unchecked_constructor(GateOutcome)


@checked
class Estimator(TableDisplay):
    """Error-state Kalman filter, a callable ``(Readings, t, command) -> StateEstimate``. Holds its
    estimate: build one per run.

    Until a channel has its first reading its part of the estimate means nothing, and
    `StateEstimate.age` is inf. A reading that is late is fused at the time it was taken. One that
    is not finite, larger than 1e9 in the unit of its channel, of the future or older than the last
    of its channel is never used, nor is an altimeter's range below zero; only its nan says
    something, that there is no echo. One that contradicts the estimate by more than five standard
    deviations is not used until others agree with it for a second. The age is that of the last one
    that was used.

    The current is no part of the state: without a sensor of the velocity in water, or a model of
    thrust and drag, nothing that is read depends on it.
    """

    def __init__(
        self,
        robot: Robot,
        specs: SensorSpecs | None = None,
        tuning: EstimatorTuning | None = None,
        altimeter_frame: str | None = None,
        compiled: bool = True,
    ) -> None:
        """specs: the noise to expect. altimeter_frame: the one of the robot's description unless
        given.

        compiled: in C where there is a compiler; the numbers are the same without. Raises
        `FrameNotFound` for an unknown altimeter frame.
        """
        specs = specs or SensorSpecs()
        tuning = tuning or EstimatorTuning()
        altimeter_frame = altimeter_frame or robot.description.altimeter
        frame = altimeter_frame
        if specs.altimeter_range is None or not robot.n_vehicle:
            frame = None
        self._n_vehicle = robot.n_vehicle
        own = specs.own
        require_fusible(robot, own)
        self._own = tuple(channel.name for channel in own)
        self._numbers = filtering.numbers_of(own)
        self.structure = filtering.filter_memory(
            robot.n_joints, own, own_measurements(robot, own) if own else None
        )
        """Memory of the kernels, a `FilterMemory`."""
        filtering.initialise(self.structure, robot, specs, tuning)
        self.memory = kernel_layout.arrays_of(self.structure)
        """All numbers of the filter, for who studies it: the arrays of a `FilterMemory`."""
        write_dependence(self.memory, robot, own)
        for name in needed_channels(robot, specs, altimeter_frame):
            self.memory.needed[NUMBER[name]] = 1.0
        self.has_range = frame is not None
        """There is an altimeter."""
        self._beam = None if frame is None else AltimeterMount(robot, frame, self.memory)
        self._chart = JointChart(robot, self.memory)
        self._joints = self._chart.configuration()
        (self.tick,) = kernels.bind_memory(self.structure, (advance_filter,), compiled=compiled)
        """Kernel of the filter alone, from the inputs in its memory to its outputs."""
        self.advance: Callable[[], None] = partial(self.tick, self.structure)
        """The kernel of the filter, bound to its memory."""
        self._seen: dict[str, Reading | None] = dict.fromkeys(self._numbers)
        self._refused: frozenset[str] = frozenset()
        self._t: float | None = None

    @checked_on_failure
    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        """Return the estimate at time t [s]; `command` has been acting since the last call.

        Raises `InvalidInput` for a time before that of the last call, or beyond 1e10 s.
        """
        self._require_later(t)
        self.structure.has_command = command is not None
        if command is not None:
            self.memory.commanded[6 - self._n_vehicle :] = command.v
            self.structure.braked = command.brakes
        self._take_in(readings)
        if self._beam is not None:
            self._beam.place(self._joints)
        self.advance()
        return self.estimate()

    def _table(self) -> SmallTable:
        values = dict[str, str]()
        for name in CHANNELS:
            if not self.memory.needed[NUMBER[name]]:
                continue
            t = self.memory.used[NUMBER[name]]
            values[name] = f"used until {t:.4g} s" if math.isfinite(t) else "no reading yet"
        return SmallTable(title=type(self).__name__, rows=rows_of(values))

    @checked_on_failure
    def outcome(self, channel: str) -> GateOutcome | None:
        """Return the gate's outcome for the newest reading of a channel; `None` before the first.

        A channel's first reading is no news, and one that no sensor gives, of the wrong time or so
        late that its past is forgotten is not compared. Raises `NameNotFound` for an unknown
        channel.
        """
        t, squared, degrees, accepted = self.memory.outcome[self._number(channel)].tolist()
        if math.isnan(t):
            return None
        return _outcome(t=t, squared=squared, degrees=int(degrees), accepted=bool(accepted))

    @property
    def outcomes(self) -> Array:
        """Outcomes (n_channels, 4) [s, -, -, -] of all channels, in the order of `ChannelIndex`, a
        user's own after these; changed in place by every call.

        When the reading was taken, squared innovation, degrees of freedom, 1 if it was used; nan
        before the first.
        """
        return self.memory.outcome

    def used(self, channel: str) -> float:
        """Return the time [s] of the newest reading of a channel that was used, -inf before the
        first; an echo that is missing counts.

        Raises `NameNotFound` for an unknown channel.
        """
        return float(self.memory.used[self._number(channel)])

    def refuse(self, channel: str, refused: bool = True) -> None:
        """Use no readings of a channel from now on, or again. Raises `NameNotFound` for an unknown
        channel.
        """
        self._number(channel)
        if refused:
            self._refused = self._refused | {channel}
        else:
            self._refused = self._refused - {channel}

    def inflate_velocity_variance(self, *, rests: bool = False) -> None:
        """Take linear velocity and acceleration for unknown, as their source proved wrong. rests:
        and for zero, at a guess.
        """
        vehicle_model.inflate_velocity_variance(self.structure, rests)

    @property
    def covariance(self) -> Array:
        """Covariance (MAIN, MAIN) [SI] of the vehicle's errors, in the order of `Part`."""
        upper = np.triu(self.memory.P[: filtering.MAIN, : filtering.MAIN])
        return np.asarray(upper + np.triu(upper, 1).T)

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (n_v,) [m, rad] of the estimated q: position in W, attitude in B,
        joints.
        """
        return self.std_in_memory.copy()

    @property
    def std_in_memory(self) -> np.ndarray:
        """View of `std` (n_v,) [m, rad] on the memory of the kernel."""
        return np.asarray(self.memory.std[6 - self._n_vehicle :])

    def _number(self, channel: str) -> int:
        if channel not in self._numbers:
            raise NameNotFound("channel", channel, tuple(self._numbers))
        return self._numbers[channel]

    def _require_later(self, t: float) -> None:
        """Take the time [s] of the tick. Raises `InvalidInput` as a call."""
        if not abs(t) <= _LATEST:
            raise InvalidInput(
                f"estimator called at t = {t} s; give a time of at most {_LATEST:g} s"
            )
        if self._t is not None and t < self._t:
            raise InvalidInput(
                f"estimator called at t = {t} s after t = {self._t} s; give increasing times"
            )
        self._t = self.structure.now = t

    def _take_in(self, readings: Readings) -> None:
        memory = self.memory
        last_readings = self._seen
        given = signals.readings_by_channel(readings, self._own)
        for name, reading in zip(self._numbers, given, strict=True):
            if reading is None or reading is last_readings[name] or name in self._refused:
                continue
            last_readings[name] = reading
            c = self._numbers[name]
            if c >= filtering.N_JOINT_CHANNELS:
                memory.value[c, : np.size(reading.value)] = reading.value
            else:
                values = self._chart.values(name, reading.value)
                memory.joint_value[c] = values
            memory.fresh[c] = 1.0
            memory.stamp[c] = reading.t

    @property
    def is_plain(self) -> bool:
        """True where the kernel alone is enough: q is a vector space but for the vehicle, and the
        altimeter is fixed to that.
        """
        is_altimeter_fixed = self._beam is None or not self._beam.moves
        return self._chart.is_plain and not self._refused and is_altimeter_fixed

    def estimate(self) -> StateEstimate:
        """Return the estimate that the kernel has left in memory."""
        memory = self.memory
        self._joints = self._chart.configuration()
        q = self._joints
        v = memory.joint_x[:, 1]
        if self._n_vehicle:
            q = np.concatenate([memory.x[Part.PLACE : Part.SPEED], memory.turn, q])
            v = np.concatenate([memory.twist, v])
        echo = math.nan
        echo_std = math.nan
        if self.has_range:
            echo, echo_std = memory.range.tolist()
        age, joint_age = memory.age.tolist()
        return signals.unchecked_estimate(
            q=q,
            v=v.copy(),
            altimeter_range=echo,
            age=age,
            joint_age=joint_age,
            std=self.std,
            altimeter_std=echo_std,
        )


@lru_cache(maxsize=16)
def std_at_rest(robot: Robot, specs: SensorSpecs) -> np.ndarray:
    """Compute the standard deviation (n_v,) [m, rad] of the estimated q of a robot at rest, once
    the filter has settled.

    The vehicle's position in W, its attitude in B, the joints. From the filter's own covariance,
    which rests on the noise, rates and delays of the sensors and on the motion that it expects;
    constant errors are added as squares. Kept for the next run of the same robot and sensors: it is
    not to be written to.
    """
    estimator = Estimator(robot, specs)
    truth = _truth(robot)
    for k in range(int(_SETTLED * _RATE)):
        t = k / _RATE
        readings = dict[str, Reading[Any] | None]()
        for name, value in truth.items():
            spec: SensorSpec | None = getattr(specs, name)
            if spec is None:
                continue
            stamp = _time_of_last_reading(spec, t)
            if stamp >= 0.0:
                readings[name] = signals.unchecked_reading(value=value, t=stamp)
        estimator(signals.readings_of(readings), t)
    return read_only(np.hypot(estimator.std, declared_bias(robot, specs)))


def _truth(robot: Robot) -> dict[str, Any]:
    """Return the reading of each channel of the robot at rest."""
    q = robot.configuration()
    joints = {
        "joint_positions": q[robot.joint_q],
        "joint_velocities": np.zeros(robot.n_v)[robot.joint_v],
    }
    if not robot.n_vehicle:
        return joints
    rates = {"linear_velocity": np.zeros(3), "angular_velocity": np.zeros(3)}
    return {**joints, **rates, "position": q[:3], "depth": float(q[2]), "attitude": q[3:7]}


def _time_of_last_reading(spec: SensorSpec, t: float) -> float:
    """Return the time [s] of the reading that is the last one at time t [s]; below 0 before the
    first one. Losses make readings rarer.
    """
    rate = min(spec.rate * (1.0 - spec.dropout), _RATE)
    if rate > 0.0:
        return math.floor((t - spec.delay) * rate + 1e-6) / rate
    return -math.inf


def declared_bias(robot: Robot, specs: SensorSpecs) -> np.ndarray:
    """Return the constant errors (n_v,) [m, rad] of position, attitude and joints that the sensors
    are said to have.
    """
    channels = [("joint_positions", robot.n_joints)]
    if robot.n_vehicle:
        channels = [("position", 3), ("attitude", 3), *channels]
    biases = list[np.ndarray]()
    for name, n in channels:
        spec: SensorSpec | None = getattr(specs, name)
        if spec is None:
            biases.append(np.zeros(n))
        else:
            biases.append(np.broadcast_to(spec.biases, (n,)))
    return np.concatenate(biases)


@checked_constructor
class PassThrough(TableDisplay):
    """Estimator that takes readings for the truth: for sensors without noise, which it repeats
    exactly.
    """

    def __init__(
        self, robot: Robot, specs: SensorSpecs = IDEAL_SENSORS, altimeter_frame: str | None = None
    ) -> None:
        """altimeter_frame: the one of the robot's description unless given.

        Raises `InvalidInput` where a channel that it needs is missing: it estimates nothing.
        """
        self.q_channels: tuple[str, ...] = ("joint_positions",)
        """Channels whose readings are q, one after the other."""
        self.v_channels: tuple[str, ...] = ("joint_velocities",)
        """Channels whose readings are v."""
        if robot.n_vehicle:
            self.q_channels = ("position", "attitude", "joint_positions")
            self.v_channels = ("linear_velocity", "angular_velocity", "joint_velocities")
        for name in (*self.q_channels, *self.v_channels):
            if getattr(specs, name) is None:
                raise InvalidInput(
                    f"sensor {name} is missing; add it, or use an Estimator instead of PassThrough"
                )
        frame = altimeter_frame or robot.description.altimeter
        self._needed = (*needed_channels(robot, specs, frame), "joint_velocities")

    def _table(self) -> SmallTable:
        rows = {"q from": ", ".join(self.q_channels), "v from": ", ".join(self.v_channels)}
        return SmallTable(title=type(self).__name__, rows=rows_of(rows))

    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        """Return the last readings at time t [s]; `command` is not read. Raises `InvalidInput`
        before the first ones.
        """
        age, oldest = oldest_of(readings, self._needed, t)
        if age == math.inf:
            raise InvalidInput(
                f"no reading of every channel yet at t = {t} s; use an Estimator for such sensors"
            )
        q = np.concatenate([getattr(readings, name).value for name in self.q_channels])
        v = np.concatenate([getattr(readings, name).value for name in self.v_channels])
        echo = readings.altimeter_range
        return signals.unchecked_estimate(
            q=q,
            v=v,
            altimeter_range=math.nan if echo is None else echo.value,
            age=age,
            oldest=oldest,
            joint_age=age_of(readings, JOINT_CHANNELS, t),
        )
