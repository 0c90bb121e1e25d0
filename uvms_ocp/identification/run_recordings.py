"""Turn records of runs into recordings: measurements of the robot, commands of its thrusters, and
the truth of torque and current, which no sensor measures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from uvms_ocp.identification import recording as recordings
from uvms_ocp.record import run_meta
from uvms_ocp.record.record import Record, require_every_tick
from uvms_ocp.robot.spatial import continuous_quaternions

_TRUTH = {"joint_torques": "torque", "current": "current"}
"""Channels that are whole series."""
_MEASURED = tuple(
    f"measured_{name}" for name in ("position", "attitude", "linear_velocity", "angular_velocity")
)
_POSE = 7
_TWIST = 6

SERIES_READ = (
    "q_estimated",
    "v_estimated",
    "asked_thrust",
    "thrust",
    "wrench",
    "unreachable",
    "contact",
    *_MEASURED,
    *_TRUTH.values(),
)
"""Series that a recording is made of, a quarter of a record."""


def run_recording(record: Record, name: str) -> recordings.Recording:
    """Build the recording of a run. Raises InvalidInput for a plan, which nobody has measured, and
    for fewer rows than ticks.
    """
    meta = require_every_tick(record)
    rows = dict(_estimated_rows(record, run_meta.is_floating(record.series, meta)))
    for key, series in _TRUTH.items():
        if series in record.series:
            rows[key] = record[series]
    channels = dict(_measured(record))
    t = record["t"]
    for key, values in rows.items():
        if values.size and key not in channels:
            channels[key] = _channel(t, values)
    for key, values in _asked(record):
        commands = _channel(t, values)  # a run begins with thrusters at rest
        channels[key] = replace(
            commands,
            t=np.r_[commands.t[0] - meta.dt, commands.t],
            values=np.vstack([0.0 * commands.values[:1], commands.values]),
        )
    column_names = {
        "joint_positions": meta.joints,
        "joint_velocities": meta.joints,
        "thrust": meta.thrusters,
    }
    for key, names in column_names.items():
        if key in channels:
            channels[key] = _with_names(channels[key], names)
    return recordings.Recording(
        name=name,
        channels=channels,
        issues_in_file=tuple(_spoiled(record)),
        stated=recordings.stated_by_format(channels, recordings.ASPECTS),
        at_once=True,
    )


def _estimated_rows(record: Record, floating: bool) -> Iterator[tuple[str, np.ndarray]]:
    """Yield channels with their values at every tick, as the estimator has them."""
    q = record["q_estimated"]
    v = record["v_estimated"]
    if not floating:
        yield "joint_positions", q
        yield "joint_velocities", v
        return
    yield "position", q[:, :3]
    yield "attitude", continuous_quaternions(q[:, 3:_POSE])
    yield "linear_velocity", v[:, :3]
    yield "angular_velocity", v[:, 3:_TWIST]
    yield "joint_positions", q[:, _POSE:]
    yield "joint_velocities", v[:, _TWIST:]


def _measured(record: Record) -> Iterator[tuple[str, recordings.Channel]]:
    """Yield the readings of sensors: an estimate between slow readings is late, which a fit would
    take for less added mass.
    """
    for name in _MEASURED:
        if name not in record.series:
            continue
        channel = name.removeprefix("measured_")
        readings = record[name][:, :-1]
        t = record[name][:, -1]  # [s] when each was measured
        is_reading = np.isfinite(record[name]).all(axis=1)
        sample_times = np.where(is_reading, t, -np.inf)
        # Clocks that fail give times again.
        is_new = sample_times > np.r_[-np.inf, np.maximum.accumulate(sample_times)[:-1]]
        if is_new.sum() < 2:
            continue
        values = readings[is_new]
        if channel == "attitude":
            values = continuous_quaternions(values)
        yield channel, recordings.Channel(t=t[is_new], values=values)


def _with_names(channel: recordings.Channel, names: tuple[str, ...]) -> recordings.Channel:
    """Name its columns where there is one for each: not for joints that turn without end."""
    if len(names) == channel.values.shape[1]:
        return replace(channel, columns=names)
    return channel


def _asked(record: Record) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the commanded thrust, and the commanded wrench less the part that thrusters cannot
    give.
    """
    series = record.series
    for name in ("asked_thrust", "thrust"):
        if name in series and series[name].size:
            yield "thrust", series[name]
            break
    if "wrench" in series:
        yield "wrench", series["wrench"] - series.get("unreachable", 0.0)


def _spoiled(record: Record) -> Iterator[tuple[str, str]]:
    """Yield channels and the doubts that the record itself has of them."""
    t = record["t"]
    series = record.series
    if "thrust" in series and "asked_thrust" not in series:
        yield (
            "thrust",
            (
                "as thrusters gave it, not as it was asked of them: lag and dead zone are in it,"
                " run it anew"
            ),
        )
    for fault in record.run_meta.faults:
        if fault.t <= t[-1]:
            yield (
                fault.target,
                f"{fault.text}, a fault of this run: a fit takes vehicle and sensors for sound",
            )
    if "contact" not in series:
        return
    touches = (series["contact"] != 0.0).any(axis=1)
    if touches.any():
        yield (
            "position",
            (
                f"on the floor at {t[np.argmax(touches)]:.2f} s first: a fit knows no floor that"
                " pushes"
            ),
        )


def _channel(t: np.ndarray, values: np.ndarray) -> recordings.Channel:
    """Make a channel of the ticks (n,) [s] whose values (n, k) are all finite."""
    finite = np.isfinite(values).all(axis=1)
    if finite.all():
        return recordings.Channel(t=t, values=values)
    return recordings.Channel(t=t[finite], values=values[finite])
