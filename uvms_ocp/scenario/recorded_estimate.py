"""Run the filter and the health monitor over a recording, and compare its readings with the filter's
predictions.

For a run with the sensors of the robot's file, the estimate equals that of the run to the last bit.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation import estimator, filter_memory
from uvms_ocp.estimation.health.channel_setup import sizes_of
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.identification.recording import Recording
from uvms_ocp.record.display import SmallTable, TableDisplay, cell
from uvms_ocp.record.meta_values import AlarmMeta
from uvms_ocp.record.record import Record, require_every_tick
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.report.summary import sensor_health
from uvms_ocp.robot import Command, Robot, SensorSpecs, StateEstimate
from uvms_ocp.robot.signals import (
    CHANNELS,
    Reading,
    Readings,
    robot_sensors,
    unchecked_reading,
    unchecked_readings,
)
from uvms_ocp.scenario.run_metadata import meta_without_mission
from uvms_ocp.sim import Fault, fault_effects, injected_faults, sensors
from uvms_ocp.types import Period

_Arrivals = Iterator[tuple[int, str, Any, float]]
"""Readings of a channel in order of arrival: tick, channel, value and when it was taken [s]."""
_EARLY = 1e-6  # share of a tick by which a reading may come after it and still belong to it


@checked_dataclass(eq=False, repr=False)
class RecordedEstimate(TableDisplay):
    """Estimate over a recording, and how well each channel agrees with it."""

    record: Record
    """The estimate and its standard deviations, in the series of a run, beside the truth where the
    recording has it; ``innovation`` (n, n_channels): squared innovation over its covariance and its
    degrees of freedom, NaN where nothing was compared.
    """
    channels: tuple[Mapping[str, Any], ...]
    """A row for each channel; `estimate_recording` describes its columns."""
    same: bool | None = None
    """True where the estimate equals the one that the run recorded, to the last bit; `None` for a
    recording without an estimate.
    """

    def _table(self) -> SmallTable:
        rows = []
        for channel in self.channels:
            rows.append(tuple(cell(value) for value in channel.values()))
        head = tuple(self.channels[0])
        return SmallTable(title=self.record.meta.scenario, head=head, rows=tuple(rows))


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

    recording: record of a run with noisy sensors, whose commands the filter gets too; or a
    recording by other software, without commands, whose newest readings the filter gets at every
    tick of dt [s]. specs: sensors to expect, by default those of the robot's file, at the rates
    that a recording by other software has. faults: faults of sensors, applied to the readings.
    folder: new folder, to which rows are written in place of memory.

    Columns of each channel: number of ``readings`` that arrived, their mean delay ``delay_s``, how
    many the filter ``compared`` with its prediction and how many of these it ``refused``; ``ratio``
    of the median size of innovations to the expected one, 1 where sensor, noise and motion are as
    expected; ``sigma`` [unit of the channel] that is expected, and ``proposed_sigma``, which would
    explain the innovations if the sensor caused all of them; then the columns of `sensor_health`.

    Raises `InvalidInput` for a record without readings, for channels that do not fit the robot, and
    for other faults.
    """
    expected = specs or robot_sensors(robot.description)
    run = None
    if isinstance(recording, Recording):
        title = f"estimate of {recording.name}"
        if specs is None:
            expected = _at_own_rates(expected, recording)
        arrivals, n_ticks, dt = _sent(recording, robot, expected, dt)
    else:
        run = recording
        title = f"estimate of {run.meta.scenario}"
        arrivals, n_ticks, dt = _recorded(run, robot)
    expected = replace(expected, **{name: None for name in CHANNELS if name not in arrivals})
    arrivals |= _faulty_arrivals(arrivals, robot, faults, dt)
    filtering = estimator.Estimator(robot, expected)
    guarded = GuardedEstimator(filtering, robot, expected)
    channels = guarded.monitor.channels
    recorder = Recorder(folder=None if folder is None else Path(folder))
    received = _ReceivedReadings(arrivals, channels)
    outcome_rows = [int(filter_memory.NUMBER[name]) for name in channels]
    compared_times = np.full(len(channels), -math.inf)  # [s] of the last readings compared
    for tick in range(n_ticks):
        t = tick * dt
        estimate = guarded(received.until(tick, t), t, _command_before(run, tick))
        sample_times, squared, degrees, accepted = filtering.outcomes[outcome_rows].T
        is_new = sample_times > compared_times
        compared_times = np.where(is_new, sample_times, compared_times)
        row = _estimate_columns(t, estimate)
        row["innovation"] = np.where(is_new, squared / np.maximum(degrees, 1.0), math.nan)
        row["refused"] = is_new & (accepted == 0.0)
        recorder.append(row)
    series = recorder.series()
    meta = meta_without_mission(
        robot,
        title,
        "recording",
        dt=dt,
        channels=channels,
        alarms=tuple(AlarmMeta(t=t, text=text) for t, text in guarded.monitor.alarms),
        faults=tuple(injected_faults.fault_meta(fault) for fault in faults),
        plant="recorded",
        completed=True,
    )
    if run is None:
        record = Record(series=series, meta=meta)
        is_same = None
    else:
        record = Record(series=series | {"q": run["q"], "v": run["v"]}, meta=meta)
        names = ("q_estimated", "v_estimated")
        is_same = all(np.array_equal(run[name], series[name]) for name in names)
    rows = []
    for k, health_row in enumerate(sensor_health(record)):
        name = channels[k]
        agreement = _agreement(
            series["innovation"][:, k],
            series["refused"][:, k],
            degrees[k],
            getattr(expected, name).sigma,
        )
        rows.append({"channel": name, **received.statistics(name), **agreement, **health_row})
    return RecordedEstimate(record=record, channels=tuple(rows), same=is_same)


def _command_before(run: Record | None, tick: int) -> Command | None:
    """Return the command that a run gave in the tick before this one; `None` for none."""
    if run is None or tick == 0:
        return None
    return Command(v=run.series["command"][tick - 1], brakes=bool(run.series["brakes"][tick - 1]))


def _estimate_columns(t: float, estimate: StateEstimate) -> dict[str, Any]:
    """Return the estimate of a tick in the columns of a record."""
    health = [channel_health.trust for channel_health in estimate.health]
    return {
        "t": t,
        "q_estimated": estimate.q,
        "v_estimated": estimate.v,
        "q_std": estimate.std,
        "altimeter_range": estimate.altimeter_range,
        "altimeter_std": estimate.altimeter_std,
        "health": np.array(health, dtype=np.int8),
    }


class _ReceivedReadings:
    """Newest readings of all channels in the course of a recording, and their delays."""

    def __init__(self, arrivals: Mapping[str, _Arrivals], channels: Sequence[str]) -> None:
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
        return unchecked_readings(**self._newest)

    def statistics(self, channel: str) -> dict[str, Any]:
        """Return how many readings of a channel arrived, and by how much late [s] on average."""
        n_readings = self._counts[channel]
        return {"readings": n_readings, "delay_s": self._delays[channel] / max(n_readings, 1)}


def _agreement(
    innovations: np.ndarray, refused: np.ndarray, n_degrees: float, sigma: float
) -> dict[str, Any]:
    """Compare the innovations of a channel with those that its specification predicts.

    innovations: (n,) squares over covariance and degrees of freedom, NaN where there is none.
    refused: (n,) True where the filter refused them. sigma: [unit of the channel] expected standard
    deviation.
    """
    compared = innovations[np.isfinite(innovations)]
    ratio = None
    proposed_sigma = None
    if compared.size:
        # The median of chi-squared over its degrees of freedom, by Wilson and Hilferty.
        expected_median = (1.0 - 2.0 / (9.0 * n_degrees)) ** 3
        ratio = math.sqrt(float(np.median(compared)) / expected_median)
        proposed_sigma = sigma * ratio
    return {
        "compared": len(compared),
        "refused": int(refused.sum()),
        "ratio": ratio,
        "sigma": sigma,
        "proposed_sigma": proposed_sigma,
    }


def _faulty_arrivals(
    arrivals: Mapping[str, _Arrivals], robot: Robot, faults: Sequence[Fault], dt: float
) -> dict[str, _Arrivals]:
    """Return the readings of those channels that faults change.

    Raises `InvalidInput` for faults of anything but sensors.
    """
    other_faults = [str(fault) for fault in faults if not fault.location.channel]
    if other_faults:
        raise InvalidInput(
            f"faults {', '.join(other_faults)} of a recording; give those of sensors"
        )
    sources = sensors.sources_of(robot, has_altimeter="altimeter_range" in arrivals)
    channel_sources = {name: sources[name] for name in arrivals}
    faulty = {}
    for name, effects in sensors.faults_of_channels(robot, faults, channel_sources).items():
        faulty[name] = _with_faults(arrivals[name], effects, dt)
    return faulty


def _recorded(record: Record, robot: Robot) -> tuple[dict[str, _Arrivals], int, float]:
    """Return the readings of a run by channel, how many ticks it has, and its period [s]."""
    meta = require_every_tick(record)
    if "brakes" not in record.series:
        raise InvalidInput(
            f"record of {meta.scenario} without all readings; record it anew, with noise and every"
            " tick"
        )
    arrivals = {}
    for name in CHANNELS:
        if f"measured_{name}" not in record.series:
            continue
        series = record[f"measured_{name}"]
        ticks = np.flatnonzero(np.isfinite(series[:, -1]))
        arrivals[name] = _arriving(name, ticks, series[ticks, :-1], series[ticks, -1], robot)
    return arrivals, len(record), meta.dt


def _sent(
    recording: Recording, robot: Robot, specs: SensorSpecs, dt: float
) -> tuple[dict[str, _Arrivals], int, float]:
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
        if getattr(specs, name, None) is not None:
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
        ticks = np.ceil(stamps / dt - _EARLY).astype(np.int64)
        if name.startswith("joint_"):
            values = channel.of(robot.joint_names, name).values
        else:
            values = channel.values
        arrivals[name] = _arriving(name, ticks, values, stamps, robot)
        n_ticks = max(n_ticks, int(ticks[-1]) + 1)
    return arrivals, n_ticks, dt


def _at_own_rates(specs: SensorSpecs, recording: Recording) -> SensorSpecs:
    """Return specifications with the rates at which channels were recorded, so that a channel which
    keeps its rate does not count as silent.
    """
    at_own_rates = {}
    for name, channel in recording.channels.items():
        spec = getattr(specs, name, None)
        if spec is not None:
            usual_interval = float(np.median(np.diff(channel.t)))  # [s]
            at_own_rates[name] = replace(spec, rate=1.0 / usual_interval)
    return replace(specs, **at_own_rates)


def _arriving(
    name: str, ticks: np.ndarray, values: np.ndarray, stamps: np.ndarray, robot: Robot
) -> _Arrivals:
    """Yield the readings of a channel: values (n, k) [unit of the channel] that arrive at ticks (n,)
    and were taken at stamps (n,) [s].
    """
    shape = sizes_of(robot)[name]
    if values.shape[1] != math.prod(shape):
        raise InvalidInput(
            f"{name} of {values.shape[1]} numbers; {robot.name} has {math.prod(shape)}: give the"
            " robot recorded"
        )
    return zip(ticks, repeat(name), values if shape else values[:, 0], stamps, strict=False)


def _with_faults(arrivals: _Arrivals, faults: fault_effects.ChannelFaults, dt: float) -> _Arrivals:
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
