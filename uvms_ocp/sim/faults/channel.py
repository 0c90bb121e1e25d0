"""What faults make of the samples of one sensor: another value, another time stamp, a later arrival, or nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.limits import Joint
from uvms_ocp.sim.faults.fault import Fault

Disturb = Callable[[Any, np.ndarray], Any]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """What a sensor takes at one time."""

    value: Any
    stamp: float
    """[s] at which the sensor says that it was taken."""
    extra_delay: float = 0.0
    """[s] on top of the sensor's own."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Channel:
    """What a channel measures."""

    name: str
    disturb: Disturb
    """(value, error (n,)) -> value: how an error acts on it."""
    n: int
    """[-] components of an error."""
    origin: Any = None
    """Value from which `stuck` counts; zeros unless given."""
    joints: tuple[Joint, ...] = ()
    """Whose readings its parts are, one by one, if any."""


Effect = Callable[[Sample, bool], Sample | None]
"""A sample and whether the fault is there, to what is left of it."""


class ChannelFaults:
    """All faults of one channel, in their order. Holds what they remember: build one per run."""

    def __init__(self, channel: Channel, faults: Sequence[Fault], seed: np.random.SeedSequence) -> None:
        """Raises `InvalidInput` for values or joints that the channel does not have."""
        streams = seed.spawn(len(faults))
        self._effects = [
            (fault, _EFFECTS[fault.kind](fault, _part(channel, fault), np.random.default_rng(stream)))
            for fault, stream in zip(faults, streams, strict=True)
        ]

    def __call__(self, value: Any, t: float) -> Sample | None:
        """What becomes of a value that was measured at time t [s]; `None` where it never arrives."""
        sample: Sample | None = Sample(value, t)
        for fault, effect in self._effects:
            if sample is not None:
                sample = effect(sample, fault.active(t))
        return sample


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Part:
    """The part of a channel that a fault strikes: all, or the reading of one joint."""

    channel: Channel
    values: slice
    """Of the value."""
    errors: range
    """Of the components of an error."""

    def error(self, entries: float | np.ndarray) -> np.ndarray:
        error = np.zeros(self.channel.n)
        error[self.errors.start : self.errors.stop] = entries
        return error

    def put(self, value: Any, part: Any) -> Any:
        """A value whose part is that of another."""
        if np.ndim(value) == 0:
            return part
        mixed = np.array(value)
        mixed[self.values] = np.broadcast_to(part, mixed.shape)[self.values]
        return mixed


def _part(channel: Channel, fault: Fault) -> _Part:
    number = fault.strikes.number
    if number > len(channel.joints):
        raise InvalidInput(f"{fault}: the robot has {len(channel.joints)} joints; give one of them, from 1")
    if not number:
        part = _Part(channel=channel, values=slice(None), errors=range(channel.n))
    else:
        first, joint = channel.joints[0], channel.joints[number - 1]
        errors = range(joint.idx_v - first.idx_v, joint.idx_v - first.idx_v + joint.n_v)
        begin = joint.idx_q - first.idx_q
        turned = slice(begin, begin + joint.n_q)
        values = turned if channel.name == "joint_positions" else slice(errors.start, errors.stop)
        part = _Part(channel=channel, values=values, errors=errors)
    if fault.kind in ("bias", "stuck") and len(fault.values) not in (1, len(part.errors)):
        raise InvalidInput(f"{fault}: {len(fault.values)} values; give 1 or {len(part.errors)}")
    return part


Make = Callable[[Fault, _Part, np.random.Generator], Effect]


def _frozen(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    held: Any = None

    def effect(sample: Sample, active: bool) -> Sample:
        nonlocal held
        if not active or held is None:
            held = sample.value
        return replace(sample, value=part.put(sample.value, held)) if active else sample

    return effect


def _lost(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    return lambda sample, active: None if active else sample


def _nan(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    return _while_active(lambda sample: replace(sample, value=part.put(sample.value, math.nan)))


def _bias(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    error, disturb = part.error(np.array(fault.values)), part.channel.disturb
    return _while_active(lambda sample: replace(sample, value=disturb(sample.value, error)))


def _stuck(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    error, channel = part.error(np.array(fault.values)), part.channel

    def effect(sample: Sample) -> Sample:
        zero = 0.0 if np.ndim(sample.value) == 0 else np.zeros_like(sample.value)
        value = channel.disturb(zero if channel.origin is None else channel.origin, error)
        return replace(sample, value=part.put(sample.value, value))

    return _while_active(effect)


def _spikes(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    size, share = fault.values

    def effect(sample: Sample) -> Sample:
        # All three are drawn for every reading, so that another share leaves the others where they were.
        strikes, sign, component = rng.random(), rng.choice((-1.0, 1.0)), rng.choice(part.errors)
        if strikes >= share:
            return sample
        error = np.zeros(part.channel.n)
        error[component] = sign * size
        return replace(sample, value=part.channel.disturb(sample.value, error))

    return _while_active(effect)


def _late(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    (delay,) = fault.values
    return _while_active(lambda sample: replace(sample, extra_delay=sample.extra_delay + delay))


def _ahead(fault: Fault, part: _Part, rng: np.random.Generator) -> Effect:
    (ahead,) = fault.values
    return _while_active(lambda sample: replace(sample, stamp=sample.stamp + ahead))


def _while_active(change: Callable[[Sample], Sample]) -> Effect:
    return lambda sample, active: change(sample) if active else sample


_EFFECTS: Mapping[str, Make] = {
    "frozen": _frozen,
    "lost": _lost,
    "nan": _nan,
    "bias": _bias,
    "stuck": _stuck,
    "spikes": _spikes,
    "late": _late,
    "ahead": _ahead,
}
