"""Readings of a recording as they arrived: of a run at the ticks that it has recorded, of other software at
the times of its log, and as faults of sensors change them.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import repeat
from operator import itemgetter
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.recording import Recording
from uvms_ocp.record.record import Record, require_every_tick
from uvms_ocp.robot import Robot, SensorSpecs
from uvms_ocp.robot.channels import CHANNEL_OF, Channel, rows_by_name, shape_of
from uvms_ocp.robot.signals import (
    Reading,
    Readings,
    readings_of,
    unchecked_reading,
)
from uvms_ocp.sim import Fault, fault_effects, sensors

Arrivals = Iterator[tuple[int, str, Any, float]]
"""Readings of a channel in order of arrival: tick, channel, value and when it was taken [s]."""
_DIGITS = 9  # of times [s], whose sums are rounded
_EARLY = 1e-6  # share of a tick by which a reading may come after it and still belong to it


class ReceivedReadings:
    """Newest readings of all channels in the course of a recording, and their delays."""

    def __init__(self, arrivals: Mapping[str, Arrivals], channels: Sequence[str]) -> None:
        self._stream = heapq.merge(*arrivals.values(), key=itemgetter(0))
        self._next = next(self._stream, None)
        self._newest = dict[str, Reading[Any]]()
        self._counts = dict.fromkeys(channels, 0)
        self._delays = dict.fromkeys(channels, 0.0)  # [s] sums

    def until(self, tick: int, t: float) -> Readings:
        """Return the newest readings that arrived until a tick, at t [s]."""
        while self._next is not None and self._next[0] <= tick:
            _, name, value, stamp = self._next
            self._newest[name] = unchecked_reading(value=value, t=stamp)
            self._counts[name] += 1
            self._delays[name] = self._delays[name] + t - stamp
            self._next = next(self._stream, None)
        return readings_of(self._newest)

    def statistics(self, channel: str) -> dict[str, Any]:
        """Return how many readings of a channel arrived, and by how much late [s] on average."""
        n_readings = self._counts[channel]
        mean_delay = self._delays[channel] / max(n_readings, 1)
        return {"readings": n_readings, "delay_s": round(mean_delay, _DIGITS)}


def readings_of_run(
    record: Record, robot: Robot, own: Sequence[Channel] = ()
) -> tuple[dict[str, Arrivals], int, float]:
    """Return the readings of a run by channel, the toolkit's and a user's own, how many ticks it has,
    and its period [s].
    """
    meta = require_every_tick(record)
    if "brakes" not in record.series:
        raise InvalidInput(
            f"record of {meta.scenario} without all readings; record it anew, with noise and every"
            " tick"
        )
    arrivals = {}
    for name, row in rows_by_name(own).items():
        if f"measured_{name}" not in record.series:
            continue
        series = record[f"measured_{name}"]
        ticks = np.flatnonzero(np.isfinite(series[:, -1]))
        arrivals[name] = _arriving(row, ticks, series[ticks, :-1], series[ticks, -1], robot)
    return arrivals, len(record), meta.dt


def readings_of_log(
    recording: Recording, robot: Robot, specs: SensorSpecs, dt: float
) -> tuple[dict[str, Arrivals], int, float]:
    """Return the readings of a recording by other software by channel, at times since the first of
    them, with the number of ticks and their period [s].
    """
    if recording.at_once:
        raise InvalidInput(
            f"{recording.name} is of a run, as a table for others; give its record.npz, which has"
            " the readings"
        )
    channels = {}
    for name, channel in recording.channels.items():
        if name in CHANNEL_OF and getattr(specs, name) is not None:
            channels[name] = channel
    if not {"attitude", "joint_positions"} & channels.keys():
        raise InvalidInput(
            f"{recording.name} has channels {', '.join(recording.channels)}; an estimate needs"
            " attitude or joints"
        )
    begin = min(channel.undelayed_t[0] for channel in channels.values())
    arrivals = {}
    n_ticks = 0
    for name, channel in channels.items():
        stamps = channel.undelayed_t - begin
        arrival_times = stamps + max(channel.delay, 0.0)
        ticks = np.ceil(arrival_times / dt - _EARLY).astype(np.int64)
        if name.startswith("joint_"):
            values = channel.of(robot.joint_names, name).values
        else:
            values = channel.values
        arrivals[name] = _arriving(CHANNEL_OF[name], ticks, values, stamps, robot)
        n_ticks = max(n_ticks, int(ticks[-1]) + 1)
    return arrivals, n_ticks, dt


def faulty_readings(
    arrivals: Mapping[str, Arrivals],
    robot: Robot,
    faults: Sequence[Fault],
    dt: float,
    own: Sequence[Channel] = (),
) -> dict[str, Arrivals]:
    """Return the readings of those channels that faults change. own: a user's own channels.

    Raises `InvalidInput` for faults of anything but sensors.
    """
    other_faults = [str(fault) for fault in faults if not fault.location.channel]
    if other_faults:
        raise InvalidInput(
            f"faults {', '.join(other_faults)} of a recording; give those of sensors"
        )
    sources = sensors.sources_of(robot, has_altimeter="altimeter_range" in arrivals, own=own)
    channel_sources = {name: sources[name] for name in arrivals}
    faulty = {}
    for name, effects in sensors.faults_of_channels(robot, faults, channel_sources).items():
        faulty[name] = _with_faults(arrivals[name], effects, dt)
    return faulty


def _arriving(
    row: Channel, ticks: np.ndarray, values: np.ndarray, stamps: np.ndarray, robot: Robot
) -> Arrivals:
    """Yield the readings of a channel: values (n, k) [unit of the channel] that arrive at ticks (n,)
    and were taken at stamps (n,) [s].
    """
    shape = shape_of(row, robot)
    if values.shape[1] != math.prod(shape):
        raise InvalidInput(
            f"{row.name} of {values.shape[1]} numbers; {robot.name} has {math.prod(shape)}: give the"
            " robot recorded"
        )
    return zip(ticks, repeat(row.name), values if shape else values[:, 0], stamps, strict=False)


def _with_faults(arrivals: Arrivals, faults: fault_effects.ChannelFaults, dt: float) -> Arrivals:
    """Yield readings as faults change them, without those that a newer reading has overtaken."""
    samples = list[tuple[int, str, Any, float, float]]()
    for tick, name, value, sample_time in arrivals:
        sample = faults(value, sample_time)
        if sample is not None:
            delayed_tick = tick + math.ceil(sample.extra_delay / dt - _EARLY)
            samples.append((delayed_tick, name, sample.value, sample.stamp, sample_time))
    newest = -math.inf
    for tick, name, value, stamp, sample_time in sorted(samples, key=itemgetter(0)):
        if sample_time > newest:
            newest = sample_time
            yield tick, name, value, stamp
