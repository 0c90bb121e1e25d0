"""Effects of faults: on samples of sensors, on thrusters, joints and payload, and steps of the
current.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import assembly, description, limits
from uvms_ocp.robot.robot import Robot
from uvms_ocp.sim.currents import Current, cosine_slope, cosine_step
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults import Fault
from uvms_ocp.sim.seafloor import Seafloor, ground_at

# What faults make of the samples of one sensor: another value, another time stamp, a later arrival,
# or nothing.

Disturb = Callable[[Any, np.ndarray], Any]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Sample that a sensor takes at one time."""

    value: Any
    stamp: float
    """[s] at which the sensor says that it was taken."""
    extra_delay: float = 0.0
    """[s] on top of the sensor's own."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FaultyChannel:
    """Quantity that a channel measures."""

    name: str
    disturb: Disturb
    """(value, error (n,)) -> value: how an error acts on it."""
    n: int
    """Components of an error."""
    origin: Any = None
    """Value from which a stuck fault counts; None: zeros."""
    joints: tuple[limits.Joint, ...] = ()
    """Whose readings its parts are, one by one, if any."""


class ChannelFaults:
    """All faults of one channel, in their order. Holds what they remember: build one per run."""

    def __init__(
        self, channel: FaultyChannel, faults: Sequence[Fault], seed: np.random.SeedSequence
    ) -> None:
        """Raises `InvalidInput` for values or joints that the channel does not have."""
        streams = map(np.random.default_rng, seed.spawn(len(faults)))
        self._struck = [
            _struck(channel, fault, rng) for fault, rng in zip(faults, streams, strict=True)
        ]
        self.most_delay = float(sum(fault.values[0] for fault in faults if fault.kind == "late"))
        """[s] by which readings arrive later at most."""

    def __call__(self, value: Any, t: float) -> Sample | None:
        """Return the faulty value measured at time t [s]; `None` where it never arrives."""
        sample: Sample | None = Sample(value, t)
        for struck in self._struck:
            if sample is not None:
                sample = struck.changed(sample, t)
        return sample


@dataclass(kw_only=True, slots=True, eq=False)
class _Struck:
    """A part of a channel, all of it or the reading of one joint, with its fault in one run."""

    channel: FaultyChannel
    fault: Fault
    rng: np.random.Generator
    values: slice
    """Entries of the value."""
    errors: range
    """Components of an error."""
    held: Any = None
    """Value of the last sample that the fault left alone, or of the first."""

    def changed(self, sample: Sample, t: float) -> Sample | None:
        """Return a sample taken at time t [s] as the fault changes it, or None where it is lost."""
        active = self.fault.active(t)
        if not active or self.held is None:
            self.held = sample.value
        if active:
            return _EFFECTS[self.fault.kind](sample, self)
        return sample

    def with_value(self, sample: Sample, value: Any) -> Sample:
        """The sample with this value in the part that is struck."""
        if np.ndim(sample.value) == 0:
            return replace(sample, value=value)
        mixed = np.array(sample.value)
        mixed[self.values] = np.broadcast_to(value, mixed.shape)[self.values]
        return replace(sample, value=mixed)

    def disturbed(self, sample: Sample, error: np.ndarray) -> Sample:
        """The sample with an error (n,) of the channel."""
        return replace(sample, value=self.channel.disturb(sample.value, error))

    def error(self) -> np.ndarray:
        """The values of the fault as an error of the channel."""
        error = np.zeros(self.channel.n)
        error[self.errors.start : self.errors.stop] = self.fault.values
        return error


def _struck(channel: FaultyChannel, fault: Fault, rng: np.random.Generator) -> _Struck:
    number = fault.location.number
    if number > len(channel.joints):
        raise InvalidInput(
            f"{fault}: the robot has {len(channel.joints)} joints; give one of them, from 1"
        )
    values = slice(None)
    errors = range(channel.n)
    if number:
        first = channel.joints[0]
        joint = channel.joints[number - 1]
        errors = range(joint.idx_v - first.idx_v, joint.idx_v - first.idx_v + joint.n_v)
        begin = joint.idx_q - first.idx_q
        if channel.name == "joint_positions":
            values = slice(begin, begin + joint.n_q)
        else:
            values = slice(errors.start, errors.stop)
    if fault.kind in ("bias", "drift", "stuck") and len(fault.values) not in (1, len(errors)):
        raise InvalidInput(f"{fault}: {len(fault.values)} values; give 1 or {len(errors)}")
    return _Struck(channel=channel, fault=fault, rng=rng, values=values, errors=errors)


def _stuck(sample: Sample, struck: _Struck) -> Sample:
    if np.ndim(sample.value) == 0:
        zero = 0.0
    else:
        zero = np.zeros_like(sample.value)
    origin = zero if struck.channel.origin is None else struck.channel.origin
    return struck.with_value(sample, struck.channel.disturb(origin, struck.error()))


def _spikes(sample: Sample, struck: _Struck) -> Sample:
    (size, share) = struck.fault.values
    rng = struck.rng
    # All three are drawn for every reading, so that another share leaves the others where they
    # were.
    strikes = rng.random()
    sign = rng.choice((-1.0, 1.0))
    component = rng.choice(struck.errors)
    if strikes >= share:
        return sample
    error = np.zeros(struck.channel.n)
    error[component] = sign * size
    return struck.disturbed(sample, error)


_EFFECTS: Mapping[str, Callable[[Sample, _Struck], Sample | None]] = {
    "frozen": lambda sample, struck: struck.with_value(sample, struck.held),
    "lost": lambda sample, struck: None,
    "nan": lambda sample, struck: struck.with_value(sample, math.nan),
    "bias": lambda sample, struck: struck.disturbed(sample, struck.error()),
    "drift": lambda sample, struck: struck.disturbed(
        sample, struck.error() * (sample.stamp - struck.fault.onset)
    ),
    "stuck": _stuck,
    "spikes": _spikes,
    "late": lambda sample, struck: replace(
        sample, extra_delay=sample.extra_delay + struck.fault.values[0]
    ),
    "ahead": lambda sample, struck: replace(sample, stamp=sample.stamp + struck.fault.values[0]),
}
"""Effects of active faults on a sample, by kind."""


# In what condition thrusters are: which are dead, stuck, weak or reversed.

_SHARES = {"dead": 0.0, "stuck": 0.0, "reversed": -1.0}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterCondition:
    """Faults of all thrusters of a robot. Their steady thrust is ``share sound + offset``, for that
    of sound ones.
    """

    share: np.ndarray
    """(n,) 1 sound, less weak, negative reversed, 0 dead or stuck."""
    offset: np.ndarray
    """(n,) [N] thrust at which they are stuck."""
    dead: np.ndarray
    """(n,) whether they give nothing."""


def condition_of(faults: Sequence[Fault], thrust: np.ndarray) -> ThrusterCondition:
    """Compute the state of the thrusters under these faults, thrust (n,) [N] now."""
    share = np.ones(len(thrust))
    offset = np.zeros(len(thrust))
    dead = np.zeros(len(thrust), dtype=bool)
    for fault in faults:
        if fault.location.family == "thruster":
            k = fault.location.number - 1
            if fault.kind == "stuck":
                offset[k] = fault.values[0] if fault.values else thrust[k]
            dead[k] |= fault.kind == "dead"
            share[k] *= fault.values[0] if fault.kind == "weak" else _SHARES[fault.kind]
    return ThrusterCondition(share=share, offset=np.where(dead, 0.0, offset), dead=dead)


# Faults of the machine itself: which joints cannot move, what the tool carries, and whether a robot
# can have them at all.

_NEED_WATER = {
    "thruster": "has no thrusters",
    "current": "feels no current",
    "payload": "has no mass",
}
"""Part that the kinematic plant lacks, by the family of a fault's target."""


def active_of(faults: Sequence[Fault], t: float) -> tuple[Fault, ...]:
    """Return the faults that are there at time t [s]."""
    return tuple(fault for fault in faults if fault.active(t))


def jammed_axes(robot: Robot, faults: Sequence[Fault]) -> tuple[int, ...]:
    """Entries of v of the joints that cannot move."""
    joints = [
        robot.joints[fault.location.number - 1]
        for fault in faults
        if fault.location.family == "joint"
    ]
    return tuple(sorted({axis for joint in joints for axis in range(joint.v.start, joint.v.stop)}))


def payloads(faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """Return the faults that put something into the tool."""
    return tuple(fault for fault in faults if fault.location.family == "payload")


def loaded(robot: Robot, carried: Sequence[Fault]) -> Robot:
    """The robot with these payloads: point masses at the origins of its tools' frames, of the first
    without a number.
    """
    bodies = []
    for k, fault in enumerate(carried, start=1):
        mass, volume, *_ = *fault.values, 0.0
        where: Any = {
            "link": robot.tools[max(fault.location.number, 1) - 1],
            "position": (0.0, 0.0, 0.0),
        }
        bodies.append(description.TrimBody(name=f"payload {k}", mass=mass, volume=volume, **where))
    return assembly.with_trim(robot, bodies)


def joined_velocity(
    before: np.ndarray, after: np.ndarray, v: np.ndarray, locked: tuple[int, ...] = ()
) -> np.ndarray:
    """Velocity (n_v,) [m/s, rad/s] once the robot has taken hold of something at rest: ``after
    v_next = before v``.

    The momentum of the robot is then that of robot and load. before, after: mass matrices (n_v,
    n_v) [kg, kg m, kg m2]; v (n_v,) [m/s, rad/s]. locked: entries that are and stay at 0.
    """
    import scipy.linalg  # a tenth of a second, for the few that take hold of something

    free = [i for i in range(len(v)) if i not in locked]
    joined = np.zeros(len(v))
    joined[free] = scipy.linalg.solve(after[np.ix_(free, free)], (before @ v)[free], assume_a="pos")
    return joined


def require_possible(faults: Sequence[Fault], robot: Robot, *, kinematic: bool) -> None:
    """Raise `InvalidInput`, in one line, for a fault of what this robot or plant does not have.
    Sensors look at theirs.
    """
    there = {
        "thruster": len(robot.description.thrusters),
        "joint": len(robot.joints),
        "payload": len(robot.tools),
    }
    for fault in faults:
        family, number = fault.location.family, fault.location.number
        if kinematic and family in _NEED_WATER:
            raise InvalidInput(
                f"{fault}: the kinematic plant {_NEED_WATER[family]}; use the dynamic plant"
            )
        if family == "payload" and not robot.tools:
            raise InvalidInput(
                f"{fault}: the robot has no frame 'tool' to carry it; leave the fault out"
            )
        if number > there.get(family, number):
            part = {"payload": "tool"}.get(family, family)
            raise InvalidInput(
                f"{fault}: the robot has {there[family]} {part}s; give one of them, from 1"
            )


# Currents that set in while the robot is under way, on top of what flows there anyway.

RISE = 2.0
"""[s] from nothing to the whole step, and back at its end."""
LAYER = 2.0
"""[m] above the floor over which the vertical part grows from 0 (assumed): no water flows through
the floor.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SteppedCurrent(Current):
    """A current with steps on top, each a cosine in time; their vertical part is a cosine in the
    height above the floor.

    The horizontal outflow that the vertical part would bring about above the floor is neglected.
    """

    base: Current
    """Current without the faults."""
    seafloor: Seafloor
    """Through which nothing flows."""
    faults: tuple[Fault, ...]
    """Steps of the current."""

    def velocity(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base = self.base.velocity(p_W, t)
        step = self._step(t)
        if step.any():
            return base + self._shape(p_W, step)
        return base

    def rate(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base = self.base.rate(p_W, t)
        slope = self._sum(t, lambda elapsed: cosine_slope(elapsed / RISE) / RISE)
        if slope.any():
            return base + self._shape(p_W, slope)
        return base

    def gradient(self, p_W: np.ndarray, t: float) -> np.ndarray:
        base = self.base.gradient(p_W, t)
        vertical = self._step(t)[2]
        if not vertical:
            return base
        added = np.zeros((len(p_W), 3, 3))
        # (n, 3) [1/m] gradient of the share of the vertical part that is left at points p_W (n, 3).
        floor, normals = ground_at(self.seafloor, p_W[:, :2])
        slopes = [cosine_slope(height / LAYER) / LAYER for height in (p_W[:, 2] - floor).tolist()]
        added[:, 2] = vertical * (np.array(slopes)[:, None] * normals / normals[:, 2:])
        return base + added

    def _step(self, t: float) -> np.ndarray:
        """(3,) [m/s] of all steps together, far above the floor."""
        return self._sum(t, lambda elapsed: cosine_step(elapsed / RISE))

    def _sum(self, t: float, growth: Callable[[float], float]) -> np.ndarray:
        """(3,) over all steps, by how each has grown since its onset, and since its end."""
        parts = [
            (growth(t - fault.onset) - growth(t - fault.end)) * np.array(fault.values)
            for fault in self.faults
        ]
        return np.asarray(np.sum(parts, axis=0))

    def _shape(self, p_W: np.ndarray, step: np.ndarray) -> np.ndarray:
        """(n, 3): a step at points p_W (n, 3), less its vertical part near the floor."""
        field = np.tile(step, (len(p_W), 1))
        if step[2]:
            heights = p_W[:, 2] - ground_at(self.seafloor, p_W[:, :2])[0]
            field[:, 2] *= [cosine_step(height / LAYER) for height in heights.tolist()]
        return field


def with_steps(environment: Environment, faults: Sequence[Fault]) -> Environment:
    """The environment with the steps of its current that are among the faults."""
    current_faults = tuple(fault for fault in faults if fault.location.family == "current")
    if not current_faults:
        return environment
    return replace(
        environment,
        current=SteppedCurrent(
            base=environment.current, seafloor=environment.seafloor, faults=current_faults
        ),
    )
