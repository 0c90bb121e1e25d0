"""Simulated sensors: readings of the true state, with rate, noise, bias, delay and drop-outs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from operator import add
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_constructor
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.kernel_layout import CallbackBinding, assign, structure_of, view
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.fallbacks import beam_function
from uvms_ocp.estimation.filter_memory import ChannelIndex, numbers_of
from uvms_ocp.robot import Robot, roles, signals, spatial
from uvms_ocp.robot.channels import (
    CHANNEL_OF,
    TABLE,
    Channel,
    rows_by_name,
    shape_of,
    start_of,
)
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.kinematics import AltimeterBeam
from uvms_ocp.robot.measurement import measurement_function
from uvms_ocp.robot.robot import require_normalized
from uvms_ocp.robot.signals import Reading, Readings, SensorSpec, SensorSpecs, State
from uvms_ocp.sim import sampling
from uvms_ocp.sim.fault_effects import ChannelFaults, FaultyChannel
from uvms_ocp.sim.faults import Fault
from uvms_ocp.sim.sampling import ChannelSampler, SensorsMemory
from uvms_ocp.sim.seafloor import FlatSeafloor, Seafloor
from uvms_ocp.types import Count, Shape

_IDEAL = SensorSpec()
NO_ACCELERATION = (
    "specific_force needs the acceleration of the true state; give State(a=...), as plants do"
)
"""What is said of a state without the acceleration that an accelerometer reads."""
# [Hz] of ticks, and readings, for which those under way have room
_QUICKEST = 2000.0
_MOST = 20_000

Disturb = Callable[[Any, np.ndarray], Any]


@checked_constructor
class Altimeter:
    """Range along -z of a frame of the robot to the seafloor, without noise. Holds working memory:
    not for two threads.
    """

    def __init__(self, robot: Robot, seafloor: Seafloor, frame: str = "altimeter") -> None:
        """frame: that of the sensor. Raises `FrameNotFound` for an unknown one."""
        self.robot = robot
        self._seafloor = seafloor
        self._beam = AltimeterBeam(robot, frame)

    def measure(self, q: Annotated[np.ndarray, Shape("self.robot.n_q")]) -> float:
        """Return the range [m] at configuration q (n_q,) [m, rad]; nan without an echo."""
        require_normalized(self.robot.model, q)
        return self._range(q)

    def _range(self, q: np.ndarray) -> float:
        """Measure the range at a configuration of the simulation, which is known to fit."""
        beam = self._beam.at(q)
        return self._seafloor.range_along(beam.origin, beam.direction)


@checked_constructor
class SensorSuite:
    """All sensors of a robot. Holds their last readings: build one per run and read it at
    increasing times.

    Every channel has its own random stream, so that changing one leaves the noise of the others as
    it was.
    """

    def __init__(
        self,
        robot: Robot,
        seafloor: Seafloor,
        specs: SensorSpecs | None = None,
        seed: Count = 0,
        altimeter_frame: str | None = None,
        faults: tuple[Fault, ...] = (),
    ) -> None:
        """altimeter_frame: the one of the robot's description unless given.

        faults: those of other things than sensors are left out. Raises `InvalidInput` for a bias of
        the wrong length or a fault of a sensor that there is not, and `FrameNotFound` for an
        unknown altimeter frame.
        """
        specs = specs or SensorSpecs()
        if specs.altimeter_range is not None:
            frame = altimeter_frame or robot.description.altimeter
        else:
            frame = None
        rows = rows_by_name(specs.own)
        numbers = numbers_of(specs.own)
        sources = sources_of(robot, has_altimeter=frame is not None, own=specs.own)
        has_log = robot.n_vehicle and robot.description.dvl
        if has_log:
            X_BD = robot.model.frames[robot.frame_id(roles.DVL)].placement
            R_BD = X_BD.rotation.copy()
            turned = sources["linear_velocity"]._replace(
                turn=R_BD, disturb=lambda value, error: value + R_BD @ error
            )
            sources["linear_velocity"] = turned
        present = {name: spec for name, spec in specs.present.items() if name in sources}
        seeds = np.random.SeedSequence(seed).spawn(len(rows))
        streams = dict(zip(rows, seeds, strict=True))
        present_sources = {name: sources[name] for name in present}
        faults_by_channel = faults_of_channels(robot, faults, present_sources, seed)
        self.memory: SensorsMemory
        """Memory of the kernels."""
        self.memory, (self._read,) = make_memory(
            _structure(robot, frame, specs, present, faults_by_channel), (sampling.read_sensors,)
        )
        memory = self.memory
        self._bindings = list[CallbackBinding]()
        assign(
            memory,
            gravity=robot.model.gravity.linear,
            n=len(present),
            order=[numbers[name] for name in present],
        )
        if has_log:
            assign(memory, carried=specs.linear_velocity != _IDEAL, log_at=X_BD.translation)
        for sampler in memory.channels:
            sampler.newest = -math.inf
        self._truth = tuple(map(view, (memory.q, memory.v, memory.a)))
        if frame is not None:
            self._look_at(Altimeter(robot, seafloor, frame), seafloor)
        self._channels = list[_Channel]()
        for name, spec in present.items():
            sampler = memory.channels[numbers[name]]
            sampler.number = numbers[name]
            channel = _Channel(sampler, rows[name], spec, sources[name], streams[name])
            self._channels.append(channel)
            self._bindings += channel.ask_python(faults_by_channel.get(name))
        self.is_ideal = not faults_by_channel and all(spec == _IDEAL for spec in present.values())
        """Every channel tells the truth, at every tick."""
        self._readings: dict[str, Reading[Any] | None] = {}
        self._drawn = 0

    @property
    def reads_acceleration(self) -> bool:
        """There is an accelerometer."""
        return bool(self.memory.channels[ChannelIndex.SPECIFIC_FORCE].present)

    def read(self, state: State, t: float) -> Readings:
        """Return the last reading of every channel at time t [s], the time of the true `state`.

        Raises `InvalidInput` for a state without the acceleration that an accelerometer needs, and
        where more readings are under way than fit.
        """
        q, v, a = self._truth
        q[:] = state.q
        v[:] = state.v
        if state.a is not None:
            a[:] = state.a
        elif self.reads_acceleration:
            raise InvalidInput(NO_ACCELERATION)
        self.draw_ahead(1)
        self._read(self.memory, t)
        self.check()
        return self.latest()

    def latest(self) -> Readings:
        """Return the last reading of every channel, once kernels have read them at a tick."""
        readings = self._readings
        for channel in self._channels:
            if channel.memory.fresh:
                readings[channel.name] = channel.reading()
        return signals.readings_of(readings)

    def draw_ahead(self, n: int) -> None:
        """Have errors for so many ticks, at most `uvms_ocp.sim.sampling.N_DRAWN`, ready for the
        kernels.
        """
        if self._drawn < n:
            self._drawn = sampling.N_DRAWN
            for channel in self._channels:
                channel.draw()
        self._drawn -= n

    def check(self) -> None:
        """Raise what was raised as kernels asked Python, and `InvalidInput` where more readings are
        under way than fit.
        """
        for binding in self._bindings:
            binding.check()
        if self.memory.crowded:
            problem = (
                f"more than {len(self.memory.channels[0].arrival)} readings of one sensor under way"
            )
            raise InvalidInput(f"{problem}; give sensors shorter delays, or rates of their own")

    def _look_at(self, altimeter: Altimeter, seafloor: Seafloor) -> None:
        memory = self.memory
        q = self._truth[0]
        if type(seafloor) is FlatSeafloor:
            memory.flat = True
            memory.floor = seafloor.z
            return

        def find() -> None:
            memory.range = altimeter._range(q)

        self._bindings.append(CallbackBinding(memory.find_range, find))


class Source(NamedTuple):
    """Measurand of a channel: a part of the true state, and how an error acts on it."""

    of_velocity: bool
    first: int
    """Index at which the part begins in q or v."""
    size: int
    n_errors: int
    """Components of an error."""
    disturb: Disturb = add
    disturbance: sampling.Disturbance = sampling.Disturbance.ADDED
    turn: np.ndarray | None = None
    """(3, 3) rotation into B of the axes that errors are along."""


def sources_of(
    robot: Robot, *, has_altimeter: bool, own: Sequence[Channel] = ()
) -> dict[str, Source]:
    """Return what each channel of a robot measures, the toolkit's and a user's own, by name."""
    sources = dict[str, Source]()
    for channel in (*TABLE, *own):
        exists = channel.of_joints or robot.n_vehicle > 0
        if channel.name == "altimeter_range":
            exists = has_altimeter
        if exists:
            sources[channel.name] = _source(robot, channel)
    return sources


def _source(robot: Robot, channel: Channel) -> Source:
    n_errors = channel.rows
    if channel.of_joints:
        n_errors = robot.n_joints
    shape = shape_of(channel, robot)
    of_velocity = channel.orders < 2
    source = Source(of_velocity, start_of(channel, robot), math.prod(shape), n_errors)
    if shape == ():
        return source._replace(disturb=_add_scalar)
    if channel.name == "attitude":
        turn = BufferedFunction(_turn_function())
        return source._replace(
            disturb=lambda value, error: turn(value, error)[0],
            disturbance=sampling.Disturbance.TURNED,
        )
    is_curved = any(joint.n_q != joint.n_v for joint in robot.joints)
    if channel.name == "joint_positions" and is_curved:
        return source._replace(
            disturb=_joint_disturbance(robot), disturbance=sampling.Disturbance.ASKED
        )
    return source


def _structure(
    robot: Robot,
    frame: str | None,
    specs: SensorSpecs,
    present: Mapping[str, SensorSpec],
    faults_by_channel: Mapping[str, ChannelFaults],
) -> type[SensorsMemory]:
    n_room = 1  # readings of one sensor that are under way
    for name, spec in present.items():
        delay = spec.delay
        if name in faults_by_channel:
            delay = spec.delay + faults_by_channel[name].most_delay
        rate = min(spec.rate, _QUICKEST)
        n_room = max(n_room, 2 + min(_MOST, math.ceil(delay * rate)))
    return structure_of(
        SensorsMemory,
        dimensions_of(robot, specs.own),
        n_room=n_room,
        turn=_turn_function(),
        look=beam_function(robot, frame),
        measure=measurement_function(robot, specs.own),
    )


def faults_of_channels(
    robot: Robot, faults: Sequence[Fault], sources: Mapping[str, Source], seed: int = 0
) -> dict[str, ChannelFaults]:
    """Return the faults of sensors by channel, fresh for a run. sources: of the channels that there
    are, of `sources_of`.

    Raises `InvalidInput` for a fault of another channel; those of other things than sensors are
    left out.
    """
    by_channel: dict[str, list[Fault]] = {}
    for fault in faults:
        channel = fault.location.channel
        if channel and channel not in sources:
            raise InvalidInput(
                f"{fault}: there is no sensor {channel}; there are {', '.join(sources)}"
            )
        if channel:
            by_channel.setdefault(channel, []).append(fault)
    faults_by_channel = dict[str, ChannelFaults]()
    for name, channel_faults in by_channel.items():
        stream = np.random.SeedSequence([seed, int.from_bytes(name.encode(), "big")])
        faulty_channel = _faulty_channel(robot, name, sources[name])
        faults_by_channel[name] = ChannelFaults(faulty_channel, channel_faults, stream)
    return faults_by_channel


def _faulty_channel(robot: Robot, name: str, source: Source) -> FaultyChannel:
    """Describe a channel as its faults need it."""
    neutral = pin.neutral(robot.model)
    origins = {
        "attitude": np.array([0.0, 0.0, 0.0, 1.0]),
        "joint_positions": neutral[robot.joint_q],
    }
    is_of_joints = name in CHANNEL_OF and CHANNEL_OF[name].of_joints
    joints = robot.joints if is_of_joints else ()
    return FaultyChannel(
        name=name,
        disturb=source.disturb,
        n=source.n_errors,
        origin=origins.get(name),
        joints=joints,
    )


def _add_scalar(value: float, error: np.ndarray) -> float:
    return value + float(error[0])


@lru_cache(maxsize=1)
def _turn_function() -> ca.Function:
    quaternion = ca.SX.sym("quaternion", 4)
    error = ca.SX.sym("error", 3)
    turned = spatial.quaternion_multiply(quaternion, spatial.quaternion_exp(error))
    return ca.Function("turn", [quaternion, error], [ca.densify(turned)])


def _joint_disturbance(robot: Robot) -> Disturb:
    """Return how an error acts on joints whose configuration is not a vector space (cos, sin): they
    move along their manifold.
    """
    model = robot.model
    q = pin.neutral(robot.model)
    v = np.zeros(robot.n_v)

    def disturb(joints: np.ndarray, error: np.ndarray) -> np.ndarray:
        q[robot.joint_q] = joints
        v[robot.joint_v] = error
        return pin.integrate(model, q, v)[robot.joint_q]

    return disturb


class _Channel:
    """One sensor, between its memory, its random streams, and what Python does of it."""

    __slots__ = (
        "_errors",
        "_losses",
        "_lost",
        "_noise",
        "_scalar",
        "_source",
        "_spec",
        "_value",
        "memory",
        "name",
    )

    def __init__(
        self,
        memory: ChannelSampler,
        row: Channel,
        spec: SensorSpec,
        source: Source,
        stream: np.random.SeedSequence,
    ) -> None:
        n = source.n_errors
        if len(spec.biases) not in (1, n):
            raise InvalidInput(
                f"bias of {row.name} has {len(spec.biases)} entries; give a number or {n} numbers"
            )
        self.memory = memory
        self.name = row.name
        self._scalar = row.size == 1
        self._spec = spec
        self._source = source
        assign(
            memory,
            present=True,
            n_used=sampling.N_DRAWN,
            due=-math.inf,
            of_velocity=source.of_velocity,
            first=source.first,
            size=source.size,
            disturbance=source.disturbance,
            exact=spec.exact,
            rate=spec.rate,
            delay=spec.delay,
            dropout=spec.dropout,
        )
        # Two streams, so that drop-outs leave the noise of the other readings as it was.
        self._noise, self._lost = (np.random.default_rng(child) for child in stream.spawn(2))
        self._errors = view(memory.errors)[:, :n]
        self._losses = view(memory.losses)
        self._value = view(memory.value)[: source.size]

    def draw(self) -> None:
        """Draw errors and losses in place of those that were used."""
        memory = self.memory
        n_used = memory.n_used
        if not memory.exact:
            noise = self._noise.standard_normal((n_used, self._errors.shape[1]))
            error = noise * self._spec.sigma + np.array(self._spec.biases)
            if self._source.turn is not None:
                error = error @ self._source.turn.T
            _replace_used(self._errors, error)
        if memory.dropout > 0.0:
            _replace_used(self._losses, self._lost.random(n_used))
        memory.n_used = 0

    def ask_python(self, faults: ChannelFaults | None) -> Iterator[CallbackBinding]:
        """Answer the kernels what they cannot know: how errors act on joints that are no vector
        space, and what faults do.
        """
        memory = self.memory
        sample = view(memory.sample)[: memory.size]
        error = view(memory.error)[: self._errors.shape[1]]

        def bend() -> None:
            sample[:] = self._source.disturb(sample.copy(), error)

        def strike() -> None:
            faulty_sample = None
            if faults is not None:
                if self._scalar:
                    value = sample.item()
                else:
                    value = sample.copy()
                faulty_sample = faults(value, memory.stamped)
            memory.lost = faulty_sample is None
            if faulty_sample is not None:
                sample[:] = faulty_sample.value
                memory.stamped = faulty_sample.stamp
                memory.extra_delay = faulty_sample.extra_delay

        if memory.disturbance == sampling.Disturbance.ASKED:
            yield CallbackBinding(memory.disturb, bend)
        if faults is not None:
            memory.faulty = True
            yield CallbackBinding(memory.strike, strike)

    def reading(self) -> Reading[Any]:
        """Return the reading that arrived last."""
        if self._scalar:
            value = self._value.item()
        else:
            value = self._value.copy()
        return signals.unchecked_reading(value=value, t=self.memory.stamp)


def _replace_used(numbers: np.ndarray, drawn: np.ndarray) -> None:
    """Drop the first numbers, which were used, and put as many that were drawn behind the rest."""
    n_left = len(numbers) - len(drawn)
    numbers[:n_left] = numbers[len(drawn) :].copy()
    numbers[n_left:] = drawn
