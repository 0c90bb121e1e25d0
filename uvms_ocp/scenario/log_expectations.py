"""Expect of sensors what a log by other software shows of them: their rates, delays and noise, and of
its vehicle how it moves.

The noise is measured first, by differences of samples, which show what is white. What is not, such as
the slow errors of an attitude, shows in innovations: over a part of the log, the noise of the channel
whose innovations are largest is raised, pass by pass, until all are of the expected size. Rates that
innovations show to change less, or more, than expected say how the vehicle moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uvms_ocp.estimation import EstimatorTuning
from uvms_ocp.identification.measured_noise import measured_noise
from uvms_ocp.identification.recording import Recording
from uvms_ocp.robot import Robot, SensorSpecs
from uvms_ocp.robot.signals import with_sensors
from uvms_ocp.scenario.recorded_filter import RecordedFilter
from uvms_ocp.scenario.recorded_readings import readings_of_log

_PART = 60.0  # [s] of a log over which innovations are looked at
_PASSES = 12
_LARGE = 1.25  # ratio of innovations to expected ones above which expectations are raised
_SMALL = 0.8  # ratio below which a vehicle is calmer than expected
_HASTE = 1.5  # power of the ratio by which noise is raised: with 1 it takes twice as many passes
_MOST_CHANGED = 4.0  # factor of one pass
_MOTION = {"angular_velocity": "angular_jerk", "linear_velocity": "jerk"}
"""Channels of rates, and the tuning that says how these are expected to change."""
_CALMEST = 0.1  # share of the usual tuning
_WILDEST = 100.0  # times the usual tuning
_SMALLEST_NOISE = 1e-5  # [unit of the channel] below which a filter takes a sensor for exact


@dataclass(frozen=True, kw_only=True, slots=True)
class LogExpectations:
    """What the filter expects of a log."""

    specs: SensorSpecs
    """Rates, delays and noise of the sensors."""
    tuning: EstimatorTuning
    """How the vehicle is expected to move."""


def expectations_of_log(
    recording: Recording, robot: Robot, specs: SensorSpecs, dt: float
) -> LogExpectations:
    """Take from a log what it tells of its sensors, and what it does not tell from specs; dt: [s]
    period of the filter.
    """
    measured = {}
    for name, channel in recording.channels.items():
        spec = specs.present.get(name)
        if spec is None:
            continue
        usual_interval = float(np.median(np.diff(channel.t)))  # [s]
        spec = replace(spec, rate=1.0 / usual_interval, delay=max(channel.delay, 0.0))
        noise = measured_noise(name, channel)
        if noise is not None:
            spec = replace(spec, sigma=max(noise, _SMALLEST_NOISE))
        measured[name] = spec
    absent = dict.fromkeys(name for name in specs.present if name not in measured)
    expected_specs = with_sensors(specs, {**measured, **absent})
    expected = LogExpectations(specs=expected_specs, tuning=EstimatorTuning())
    part = _part(recording)
    for _ in range(_PASSES):
        ratios = _ratios(part, robot, expected, dt)
        corrected = _corrected(expected, ratios)
        if corrected is None:
            break
        expected = corrected
    return expected


def _part(recording: Recording) -> Recording:
    """Cut out of the middle of a recording what innovations are looked at in."""
    begin, end = recording.span
    middle = 0.5 * (begin + end)
    channels = {}
    for name, channel in recording.channels.items():
        is_inside = np.abs(channel.undelayed_t - middle) <= 0.5 * _PART
        if is_inside.sum() < 2:
            return recording
        channels[name] = replace(channel, t=channel.t[is_inside], values=channel.values[is_inside])
    return replace(recording, channels=channels)


def _ratios(
    recording: Recording, robot: Robot, expected: LogExpectations, dt: float
) -> dict[str, float]:
    """Compute the ratios of innovations to those expected, of channels that were compared."""
    arrivals, n_ticks, dt = readings_of_log(recording, robot, expected.specs, dt)
    filtering = RecordedFilter(robot, expected.specs, arrivals, expected.tuning)
    ticks = [filtering.advance(tick, tick * dt) for tick in range(n_ticks)]
    innovations = np.array([tick.innovation for tick in ticks])
    refused = np.array([tick.refused for tick in ticks])
    ratios = {}
    row: Mapping[str, Any]
    for row in filtering.agreement(innovations, refused):
        if row["ratio"] is not None:
            ratios[row["channel"]] = row["ratio"]
    return ratios


def _corrected(expected: LogExpectations, ratios: Mapping[str, float]) -> LogExpectations | None:
    """Return expectations that agree better with the ratios of innovations; `None` where all agree.

    A sensor of a rate whose white noise is known surprises by motion: slow errors of it show in poses
    alone. What is left is an error of the channel that surprises most.
    """
    for channel, name in _MOTION.items():
        usual = getattr(EstimatorTuning(), name)
        size = getattr(expected.tuning, name)
        ratio = ratios.get(channel, 1.0)
        is_calmer = ratio < _SMALL and size > _CALMEST * usual
        is_wilder = ratio > _LARGE and size < _WILDEST * usual
        if is_calmer or is_wilder:
            factor = np.clip(ratio**2, 1.0 / _MOST_CHANGED, _MOST_CHANGED)
            changed = float(np.clip(factor * size, _CALMEST * usual, _WILDEST * usual))
            return replace(expected, tuning=replace(expected.tuning, **{name: changed}))
    worst = max(ratios, key=lambda name: ratios[name], default="")
    if not worst or ratios[worst] <= _LARGE:
        return None
    factor = min(ratios[worst] ** _HASTE, _MOST_CHANGED)
    spec = expected.specs.present[worst]
    raised = replace(spec, sigma=factor * spec.sigma)
    return replace(expected, specs=with_sensors(expected.specs, {worst: raised}))
