"""Effects of faults: on samples of sensors, on thrusters, joints and payload, and steps of the
current.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import limits
from uvms_ocp.sim.faults import Fault

Disturb = Callable[[Any, np.ndarray], Any]
"""Takes a value of a channel and an error (n,), and returns the value with the error."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Sample that a sensor takes at one time."""

    value: Any
    """Value in the form of the channel."""
    stamp: float
    """[s] Time at which the sensor says that it was taken."""
    extra_delay: float = 0.0
    """[s] Delay on top of the sensor's own."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FaultyChannel:
    """Quantity that a channel measures."""

    name: str
    disturb: Disturb
    """Function ``value, error (n,) -> value`` by which an error acts on the value."""
    n: int
    """Components of an error."""
    origin: Any = None
    """Value from which a stuck fault counts; None: zeros."""
    joints: tuple[limits.Joint, ...] = ()
    """Joints whose readings the components of the error act on, one by one, if any."""


class ChannelFaults:
    """All faults of one channel, in their order. Holds what they remember: build one per run."""

    def __init__(
        self, channel: FaultyChannel, faults: Sequence[Fault], seed: np.random.SeedSequence
    ) -> None:
        """Set the faults up. Raises `InvalidInput` for values or joints that the channel does not
        have.
        """
        streams = map(np.random.default_rng, seed.spawn(len(faults)))
        self._faults = []
        for fault, rng in zip(faults, streams, strict=True):
            self._faults.append(_channel_fault(channel, fault, rng))
        self.most_delay = float(sum(fault.values[0] for fault in faults if fault.kind == "late"))
        """[s] by which readings arrive later at most."""

    def __call__(self, value: Any, t: float) -> Sample | None:
        """Return the faulty value measured at time t [s]; `None` where it never arrives."""
        sample: Sample | None = Sample(value, t)
        for channel_fault in self._faults:
            if sample is not None:
                sample = channel_fault.changed(sample, t)
        return sample


@dataclass(kw_only=True, slots=True, eq=False)
class _ChannelFault:
    """A fault in one run, and the part of a channel that it is of: all, or the reading of one
    joint.
    """

    channel: FaultyChannel
    fault: Fault
    rng: np.random.Generator
    values: slice
    """Entries of the value."""
    errors: range
    """Components of an error."""
    last_value: Any = None
    """Value of the last sample that the fault left alone, or of the first."""

    def changed(self, sample: Sample, t: float) -> Sample | None:
        """Return a sample taken at time t [s] as the fault changes it, or None where it is lost."""
        active = self.fault.active(t)
        if not active or self.last_value is None:
            self.last_value = sample.value
        if active:
            return SAMPLE_EFFECTS[self.fault.kind](sample, self)
        return sample

    def with_value(self, sample: Sample, value: Any) -> Sample:
        """Return the sample with this value in the part that the fault is of."""
        if np.ndim(sample.value) == 0:
            return replace(sample, value=value)
        mixed = np.array(sample.value)
        mixed[self.values] = np.broadcast_to(value, mixed.shape)[self.values]
        return replace(sample, value=mixed)

    def disturbed(self, sample: Sample, error: np.ndarray) -> Sample:
        """Return the sample with an error (n,) of the channel."""
        return replace(sample, value=self.channel.disturb(sample.value, error))

    def error(self) -> np.ndarray:
        """Return the values of the fault as an error of the channel."""
        error = np.zeros(self.channel.n)
        error[self.errors.start : self.errors.stop] = self.fault.values
        return error


def _channel_fault(channel: FaultyChannel, fault: Fault, rng: np.random.Generator) -> _ChannelFault:
    """Find the part of a channel that a fault is of. Raises `InvalidInput` for one that the channel
    does not have, and for another number of values.
    """
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
        first_error = joint.idx_v - first.idx_v
        errors = range(first_error, first_error + joint.n_v)
        begin = joint.idx_q - first.idx_q
        if channel.name == "joint_positions":
            values = slice(begin, begin + joint.n_q)
        else:
            values = slice(errors.start, errors.stop)
    if fault.kind in ("bias", "drift", "stuck") and len(fault.values) not in (1, len(errors)):
        raise InvalidInput(f"{fault}: {len(fault.values)} values; give 1 or {len(errors)}")
    return _ChannelFault(channel=channel, fault=fault, rng=rng, values=values, errors=errors)


def _stuck(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    origin = channel_fault.channel.origin
    if origin is None and np.ndim(sample.value) == 0:
        origin = 0.0
    elif origin is None:
        origin = np.zeros_like(sample.value)
    return channel_fault.with_value(
        sample, channel_fault.channel.disturb(origin, channel_fault.error())
    )


def _spikes(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    (size, share) = channel_fault.fault.values
    rng = channel_fault.rng
    # All three are drawn for every reading, so that another share leaves the others where they
    # were.
    strikes = rng.random()
    sign = rng.choice((-1.0, 1.0))
    component = rng.choice(channel_fault.errors)
    if strikes >= share:
        return sample
    error = np.zeros(channel_fault.channel.n)
    error[component] = sign * size
    return channel_fault.disturbed(sample, error)


def _frozen(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    return channel_fault.with_value(sample, channel_fault.last_value)


def _lost(sample: Sample, channel_fault: _ChannelFault) -> None:
    return None


def _not_a_number(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    return channel_fault.with_value(sample, math.nan)


def _biased(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    return channel_fault.disturbed(sample, channel_fault.error())


def _drifting(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    elapsed = sample.stamp - channel_fault.fault.onset
    return channel_fault.disturbed(sample, channel_fault.error() * elapsed)


def _late(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    return replace(sample, extra_delay=sample.extra_delay + channel_fault.fault.values[0])


def _ahead(sample: Sample, channel_fault: _ChannelFault) -> Sample:
    return replace(sample, stamp=sample.stamp + channel_fault.fault.values[0])


SAMPLE_EFFECTS: dict[str, Callable[[Sample, _ChannelFault], Sample | None]] = {
    "frozen": _frozen,
    "lost": _lost,
    "nan": _not_a_number,
    "bias": _biased,
    "drift": _drifting,
    "stuck": _stuck,
    "spikes": _spikes,
    "late": _late,
    "ahead": _ahead,
}
"""Effects of active faults on a sample, by kind."""
