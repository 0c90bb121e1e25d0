"""Run filter and health monitor over a recording: what they make of its readings, and how well
these agree with the filter.

Of a run whose sensors are as the robot's file says, the estimate is that of the run to the last
bit.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation import estimator, filter_memory
from uvms_ocp.estimation.health.channel_state import sizes_of
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.identification.recording import Recording
from uvms_ocp.record.display import SmallTable, TableDisplay, cell
from uvms_ocp.record.meta_values import AlarmMeta
from uvms_ocp.record.record import Record, require_every_tick
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.report.summary import sensor_health
from uvms_ocp.robot import Command, Robot, SensorSpecs
from uvms_ocp.robot.signals import (
    CHANNELS,
    Reading,
    robot_sensors,
    unchecked_reading,
    unchecked_readings,
)
from uvms_ocp.scenario.run_metadata import meta_without_mission
from uvms_ocp.sim import Fault, fault_effects, injected_faults, sensors
from uvms_ocp.types import Period

_Arrivals = Iterator[tuple[int, str, Any, float]]
"""Readings of a channel in order of arrival: tick, channel, value and when it was taken [s]."""
_EARLY = 1e-6  # of a tick


@checked_dataclass(eq=False, repr=False)
class RecordedEstimate(TableDisplay):
    """Estimate over a recording, and how well each channel agrees with it."""

    record: Record
    """The estimate and its standard deviations, as of a run, beside the truth where the recording
    has it; ``innovation`` (n, n_channels): squared, by its covariance and its degrees of freedom,
    NaN where nothing was compared.
    """
    channels: tuple[Mapping[str, Any], ...]
    """A row for each, see `estimate_recording`."""
    same: bool | None = None
    """The estimate equals that which the run recorded, to the last bit; `None` for a recording
    without an estimate.
    """

    def _table(self) -> SmallTable:
        rows = tuple(tuple(map(cell, row.values())) for row in self.channels)
        return SmallTable(title=self.record.meta.scenario, head=tuple(self.channels[0]), rows=rows)


@checked
def estimate_recording(
    recording: Record | Recording,
    robot: Robot,
    *,
    specs: SensorSpecs | None = None,
    dt: Period = 1 / 200,
    faults: tuple[Fault, ...] = (),
    folder: Path | str | None = None,
) -> RecordedEstimate:
    """Estimate the robot's motion from the readings of a recording, as the loop of `Scenario.run`
    does.

    recording: record of a run with noisy sensors, with its commands, or channels of others: of
    these the filter gets no commands and, at every tick of dt [s], the newest reading. specs: what
    to expect of the sensors, by default as the robot's file says. faults: of sensors, on top.
    folder: a new one, to which rows go in place of memory.

    Of each channel: ``readings`` that arrived, ``delay_s`` by which on average, how many the filter
    ``compared`` with its prediction and how many of these it ``refused``; ``ratio`` of the size of
    innovations to the size expected, by medians, 1 where sensor, noise and motion are as expected;
    ``sigma`` [unit of the channel] that is expected, and ``proposed_sigma``, which would explain
    the innovations were all the sensor's; then the columns of `sensor_health`.

    Raises `InvalidInput` for a record without readings, for channels that do not fit the robot, and
    for other faults.
    """
    expected = specs or robot_sensors(robot.description)
    run = recording if isinstance(recording, Record) else None
    if isinstance(recording, Recording):
        arrivals, n, dt = _sent(recording, robot, expected, dt)
    else:
        arrivals, n, dt = _recorded(recording, robot)
    expected = replace(expected, **{name: None for name in CHANNELS if name not in arrivals})
    others = [str(fault) for fault in faults if not fault.location.channel]
    if others:
        raise InvalidInput(f"faults {', '.join(others)} of a recording; give those of sensors")
    sources = sensors.sources_of(robot, has_altimeter="altimeter_range" in arrivals)
    struck = sensors.faults_of_channels(robot, faults, {name: sources[name] for name in arrivals})
    arrivals |= {
        name: _struck(arrivals[name], channel_faults, dt) for name, channel_faults in struck.items()
    }
    filtering = estimator.Estimator(robot, expected)
    guarded = GuardedEstimator(filtering, robot, expected)
    recorder = Recorder(folder=None if folder is None else Path(folder))
    channels = guarded.monitor.channels
    command = None
    last_readings = dict[str, Reading[Any]]()
    count = dict.fromkeys(channels, 0)
    late = dict.fromkeys(channels, 0.0)
    numbers = [int(filter_memory.NUMBER[name]) for name in channels]
    compared = np.full(len(channels), -math.inf)
    stream = heapq.merge(*arrivals.values(), key=itemgetter(0))
    arrived = next(stream, None)
    for k in range(n):
        t = k * dt
        while arrived is not None and arrived[0] <= k:
            _, name, value, stamp = arrived
            last_readings[name] = unchecked_reading(value=value, t=stamp)
            count[name] = count[name] + 1
            late[name] = late[name] + t - stamp
            arrived = next(stream, None)
        estimate = guarded(unchecked_readings(**last_readings), t, command)
        sample_times, squared, degrees, accepted = filtering.outcomes[numbers].T
        new = sample_times > compared
        compared = np.where(new, sample_times, compared)
        row: dict[str, Any] = {
            "t": t,
            "q_estimated": estimate.q,
            "v_estimated": estimate.v,
            "q_std": estimate.std,
        }
        row |= {
            "altimeter_range": estimate.altimeter_range,
            "altimeter_std": estimate.altimeter_std,
        }
        row |= {
            "health": np.array(
                [channel_health.trust for channel_health in estimate.health], dtype=np.int8
            )
        }
        row |= {
            "innovation": np.where(new, squared / np.maximum(degrees, 1.0), math.nan),
            "refused": new & (accepted == 0.0),
        }
        recorder.append(row)
        if run is not None:
            command = Command(v=run.series["command"][k], brakes=bool(run.series["brakes"][k]))
    series = recorder.series()
    title = (
        "estimate of"
        f" {recording.name if isinstance(recording, Recording) else recording.meta.scenario}"
    )
    alarms = tuple(AlarmMeta(t=t, text=text) for t, text in guarded.monitor.alarms)
    fields: dict[str, Any] = {
        "dt": dt,
        "channels": channels,
        "alarms": alarms,
        "faults": tuple(map(injected_faults.fault_meta, faults)),
    }
    fields |= {"plant": "recorded", "completed": True}
    meta = meta_without_mission(robot, title, "recording", **fields)
    record = Record(
        series=series if run is None else series | {"q": run["q"], "v": run["v"]}, meta=meta
    )
    rows = []
    of_channels = zip(
        channels,
        degrees,
        sensor_health(record),
        series["innovation"].T,
        series["refused"].T,
        strict=True,
    )
    for name, freedom, health, squared, refused in of_channels:
        finite = squared[np.isfinite(squared)]
        sigma = getattr(expected, name).sigma
        # The median of chi-squared over its degrees of freedom, by Wilson and Hilferty.
        if finite.size:
            ratio = math.sqrt(float(np.median(finite)) / (1.0 - 2.0 / (9.0 * freedom)) ** 3)
        else:
            ratio = None
        arrival_entries = {
            "channel": name,
            "readings": count[name],
            "delay_s": late[name] / max(count[name], 1),
        }
        filter_entries = {
            "compared": len(finite),
            "refused": int(refused.sum()),
            "ratio": ratio,
            "sigma": sigma,
        }
        rows.append(
            arrival_entries
            | filter_entries
            | {"proposed_sigma": None if ratio is None else sigma * ratio}
            | health
        )
    if run is None:
        is_same = None
    else:
        is_same = all(
            np.array_equal(run[name], series[name]) for name in ("q_estimated", "v_estimated")
        )
    return RecordedEstimate(record=record, channels=tuple(rows), same=is_same)


def _recorded(record: Record, robot: Robot) -> tuple[dict[str, _Arrivals], int, float]:
    """Readings of a run by channel, how many ticks it has, and its period [s]."""
    meta = require_every_tick(record)
    if "brakes" not in record.series:
        raise InvalidInput(
            f"record of {meta.scenario} without all readings; record it anew, with noise and every"
            " tick"
        )
    arrivals = {}
    for name in [name for name in CHANNELS if f"measured_{name}" in record.series]:
        series = record[f"measured_{name}"]
        ticks = np.flatnonzero(np.isfinite(series[:, -1]))
        arrivals[name] = _arriving(name, ticks, series[ticks, :-1], series[ticks, -1], robot)
    return arrivals, len(record), meta.dt


def _sent(
    recording: Recording, robot: Robot, specs: SensorSpecs, dt: float
) -> tuple[dict[str, _Arrivals], int, float]:
    """Readings of a recording of others, from the first one on, as `_recorded`."""
    if recording.at_once:
        raise InvalidInput(
            f"{recording.name} is of a run, as a table for others; give its record.npz, which has"
            " the readings"
        )
    channels = {
        name: channel
        for name, channel in recording.channels.items()
        if getattr(specs, name, None) is not None
    }
    if not {"attitude", "joint_positions"} & channels.keys():
        raise InvalidInput(
            f"{recording.name} has channels {', '.join(recording.channels)}; an estimate needs"
            " attitude or joints"
        )
    begin = min(channel.undelayed_t[0] for channel in channels.values())
    arrivals = {}
    n = 0
    for name, channel in channels.items():
        stamps = channel.undelayed_t - begin
        ticks = np.ceil(stamps / dt - _EARLY).astype(np.int64)
        if name.startswith("joint_"):
            values = channel.of(robot.joint_names, name).values
        else:
            values = channel.values
        arrivals[name] = _arriving(name, ticks, values, stamps, robot)
        n = max(n, int(ticks[-1]) + 1)
    return arrivals, n, dt


def _arriving(
    name: str, ticks: np.ndarray, values: np.ndarray, stamps: np.ndarray, robot: Robot
) -> _Arrivals:
    shape = sizes_of(robot)[name]
    if values.shape[1] != math.prod(shape):
        raise InvalidInput(
            f"{name} of {values.shape[1]} numbers; {robot.name} has {math.prod(shape)}: give the"
            " robot recorded"
        )
    return zip(ticks, repeat(name), values if shape else values[:, 0], stamps, strict=False)


def _struck(arrivals: _Arrivals, faults: fault_effects.ChannelFaults, dt: float) -> _Arrivals:
    """Readings as faults change them, without those that a newer one has overtaken."""
    samples = list[tuple[int, str, Any, float, float]]()
    newest = -math.inf
    for tick, name, value, sample_time in arrivals:
        sample = faults(value, sample_time)
        if sample is not None:
            samples.append(
                (
                    tick + math.ceil(sample.extra_delay / dt - _EARLY),
                    name,
                    sample.value,
                    sample.stamp,
                    sample_time,
                )
            )
    for tick, name, value, stamp, sample_time in sorted(samples, key=itemgetter(0)):
        if sample_time > newest:
            newest = sample_time
            yield tick, name, value, stamp
