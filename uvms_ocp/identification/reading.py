"""Read recordings from files: ours, records of runs, and others by a mapping of their columns.

The mapping is a YAML file, or the same as a value:

    channels:
      linear_velocity:
        file: navigation_{name}.csv.gz
        time: header.stamp
        time_unit: ns
        columns: [velocity.x, velocity.y, velocity.z]
        body: FRD

Messages of MCAP files and rosbag2 folders have a topic, and fields by their paths; without a time they count as measured when
they were logged:

      attitude:
        topic: /odometry
        time: header.stamp
        columns: [pose.pose.orientation.x, pose.pose.orientation.y, pose.pose.orientation.z, pose.pose.orientation.w]
      joint_positions:
        topic: /joint_states
        columns: ["position[shoulder]", "position[elbow]"]

Frames: ``world: NED`` and ``body: FRD`` are turned to W with z up and B forward-left-up. A world with z up is taken as it is:
where it has its x axis changes no fit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.messages import TopicColumns, holds_messages, message_rows, topics_of
from uvms_ocp.identification.recording import CHANNEL_KINDS, Channel, Recording, continuous_quaternions
from uvms_ocp.identification.tables import column_names, is_stored, read_columns, require_there, stored_recording
from uvms_ocp.model_errors import one_line_errors
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import is_floating
from uvms_ocp.record.untrusted import read_yaml_as
from uvms_ocp.robot.spatial import matrix_to_quaternion, quaternion_to_matrix, rpy_to_matrix

# When messages were sent that arrived late, in bursts or with gaps.


def even_send_times(arrived: np.ndarray, period: float) -> np.ndarray:
    """Times (n,) [s] at which messages were sent every `period` [s], from when they arrived (n,) [s].

    A message was sent no later than it arrived, and at least a period before the next one: of all these bounds the least. Where
    messages are lost, the times after the gap are right again as soon as one comes without delay. What all messages are
    late by stays. Raises InvalidInput for a period that is not positive.
    """
    if not period > 0.0:
        raise InvalidInput(f"period = {period} s given; allowed: more than 0")
    since = period * np.arange(len(arrived))
    return np.asarray(np.minimum.accumulate((arrived - since)[::-1])[::-1] + since)


# How the columns of foreign files become channels: a YAML file, or the same as a value.

_DOWN = np.diag([1.0, -1.0, -1.0])  # from axes with z down to axes with z up, and back
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_FOREIGN = 0.5  # of all rows, above which those without any cell are of other channels
_LARGEST_ANGLE = 2.5 * np.pi  # [rad] of roll, pitch and yaw as files have them, unless yaw is unwound


class ChannelMapping(BaseModel):
    """Source of one channel: topic or columns, units and frame."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    file: str = Field(
        default="", description="in the folder of the recording, {name} for its name; empty: the file itself"
    )
    topic: str = Field(default="", description="of the messages, in MCAP files and rosbag2 folders")
    time: str = Field(
        default="", description="column or field of the times; of messages, empty for when they were logged"
    )
    time_unit: Literal["s", "ms", "us", "ns"] = Field(
        default="s", description="of times that are plain numbers; stamps of seconds and nanoseconds need none"
    )
    columns: tuple[str, ...] = Field(
        min_length=1,
        description="in the order that the channel has; of messages, paths such as position.x, actuators[3]",
    )
    format: Literal["as it is", "rpy", "quaternion xyzw", "quaternion wxyz"] = Field(
        default="as it is", description="of an attitude"
    )
    unit: Literal["as it is", "deg"] = Field(default="as it is", description="deg for angles and rates in degrees")
    scale: float = Field(default=1.0, description="factor of the values [-]")
    world: Literal["z up", "NED"] = "z up"
    body: Literal["FLU", "FRD"] = "FLU"
    delay: float = Field(default=0.0, description="by which times are known to be late [s]")
    sent_every: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="period [s] of what was sent evenly but arrived in bursts"
    )
    lost: Literal["never", "all zero"] = Field(default="never", description="how samples look that are none")


@one_line_errors
class RecordingMapping(BaseModel):
    """Mapping of all channels of a recording, by the names of `CHANNEL_KINDS`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    channels: dict[str, ChannelMapping] = Field(min_length=1)


def read_mapping(path: Path) -> RecordingMapping:
    """A mapping from its YAML file. Raises InvalidInput in one line for what is none."""
    return read_yaml_as(path, RecordingMapping)


def mapped_recording(source: Path, mapping: RecordingMapping, name: str = "") -> Recording:
    """A recording of a file, or of files in a folder whose names have the name of the recording in them.

    Times begin with the first sample of any channel. Rows with NaN are left out, and a doubt says how many.
    Raises NameNotFound, NotInstalled and InvalidInput.
    """
    name = name or source.name.partition(".")[0]
    rows = _mapped_rows(source, mapping, name)
    found = {key: _samples(key, one, rows[key]) for key, one in mapping.channels.items()}
    start = min(channel.t[0] for channel in found.values())
    return Recording(
        name=name,
        channels={key: replace(one, t=one.t - start) for key, one in found.items()},
        issues_in_file=tuple(doubt for key, one in mapping.channels.items() for doubt in _unknown(key, one, rows[key])),
    )


def _mapped_rows(source: Path, mapping: RecordingMapping, name: str) -> dict[str, np.ndarray]:
    """Times [s] and values [as they are] (n, 1 + k) of every channel; of a file of messages all at once."""
    found: dict[str, np.ndarray] = {}
    by_path: dict[Path, dict[str, TopicColumns]] = defaultdict(dict)
    for key, one in mapping.channels.items():
        path = source / one.file.replace("{name}", name) if one.file else source
        if holds_messages(path):
            by_path[path][key] = _wanted(key, one, path)
        else:
            found[key] = _table_rows(key, one, path)
    for path, wanted in by_path.items():
        found |= message_rows(path, wanted)
    return found


def _wanted(key: str, one: ChannelMapping, path: Path) -> TopicColumns:
    if not one.topic:
        raise InvalidInput(f"{path}: {key} has no topic; give one of {', '.join(topics_of(path))}")
    return TopicColumns(topic=one.topic, columns=one.columns, time=one.time, unit=_UNITS[one.time_unit])


def _table_rows(key: str, one: ChannelMapping, path: Path) -> np.ndarray:
    if one.topic or not one.time:
        raise InvalidInput(f"{path}: {key} is in a table; give its time, and no topic")
    return read_columns(path, [one.time, *one.columns]) * [_UNITS[one.time_unit], *np.ones(len(one.columns))]


def _unknown(key: str, one: ChannelMapping, rows: np.ndarray) -> Iterator[tuple[str, str]]:
    """Rows that are no numbers; where most have no cell at all, a file has the rows of other channels between them."""
    open_cells = ~np.isfinite(rows)
    empty, lost = open_cells[:, 1:].all(axis=1), open_cells.any(axis=1)
    foreign = empty if empty.mean() > _FOREIGN else np.zeros(len(rows), dtype=bool)
    n, m = int((lost & ~foreign).sum()), int((~foreign).sum())
    if n:
        text = f"{n} of {m} rows have NaN ({_named(one, open_cells[~foreign].any(axis=0))}) and are left out"
        command = key in CHANNEL_KINDS and CHANNEL_KINDS[key].command
        yield key, text + (", and a fit takes the command before them for what was asked" if command else "")


def _named(one: ChannelMapping, chosen: np.ndarray) -> str:
    """Names of the chosen ones of its time and columns (1 + k,)."""
    return ", ".join(name for name, each in zip((one.time, *one.columns), chosen, strict=True) if each)


def _samples(key: str, one: ChannelMapping, rows: np.ndarray) -> Channel:
    known = np.isfinite(rows)
    if len(rows) > 1 and not known.all(axis=1).any():
        columns = _named(one, ~known.any(axis=0)) or "one column or another"
        raise InvalidInput(f"{key}: NaN in every row ({columns}); leave the channel out")
    rows = rows[known.all(axis=1)]
    if one.lost == "all zero":
        rows = rows[(rows[:, 1:] != 0.0).any(axis=1)]
    if len(rows) < 2:
        raise InvalidInput(f"fewer than two samples of {key}; leave the channel out")
    given = rows[:, 0]
    t, first = np.unique(given if one.sent_every is None else even_send_times(given, one.sent_every), return_index=True)
    return Channel(
        t=t,
        values=_converted(key, one, rows[first, 1:]),
        delay=one.delay,
        back=float((np.maximum.accumulate(given) - given).max()),
        repeated=len(given) - len(t),
    )


def _converted(key: str, one: ChannelMapping, values: np.ndarray) -> np.ndarray:
    values = values * one.scale * (np.pi / 180.0 if one.unit == "deg" else 1.0)
    if key == "attitude":
        return _quaternions(one, values)
    turned = {"W": one.world == "NED", "B": one.body == "FRD"}.get(
        CHANNEL_KINDS[key].frame if key in CHANNEL_KINDS else "", False
    )
    return values * np.tile(np.diag(_DOWN), values.shape[1] // 3) if turned else values


def _quaternions(one: ChannelMapping, values: np.ndarray) -> np.ndarray:
    world, body = (_DOWN if z_down else np.eye(3) for z_down in (one.world == "NED", one.body == "FRD"))
    return continuous_quaternions(np.array([matrix_to_quaternion(world @ R @ body) for R in _rotations(one, values)]))


def _rotations(one: ChannelMapping, values: np.ndarray) -> list[np.ndarray]:
    if one.format == "rpy":
        if values.shape[1] != 3 or np.abs(values[:, :2]).max() > _LARGEST_ANGLE:
            largest = np.abs(values).max()
            raise InvalidInput(
                f"attitude: {values.shape[1]} angles up to {largest:.4g} rad given; in deg? give its unit"
            )
        return [rpy_to_matrix(rpy) for rpy in values]
    if values.shape[1] != 4:
        raise InvalidInput(f"attitude: {values.shape[1]} columns given; allowed: 4, or format: rpy")
    xyzw = values[:, [1, 2, 3, 0]] if one.format == "quaternion wxyz" else values
    return [quaternion_to_matrix(quaternion / np.linalg.norm(quaternion)) for quaternion in xyzw]


# Records of the toolkit's own runs as recordings: what the robot measured, what was asked of its thrusters, and the truth of
# what no sensor tells: torque as joints gave it, and the current.

_TRUTH = {"joint_torques": "torque", "current": "current"}
"""Channels that are whole series."""
_POSE, _TWIST = 7, 6


def run_recording(record: Record, name: str) -> Recording:
    """Channels of a run. Raises InvalidInput for the record of a plan, which nobody has measured."""
    meta = record.run_meta
    rows = dict(_estimated_rows(record, is_floating(record.series, meta)))
    rows |= {channel: record[series] for channel, series in _TRUTH.items() if series in record.series}
    channels = {key: _channel(record["t"], values) for key, values in rows.items() if values.size}
    for key, values in _asked(record):
        channels[key] = _from_nothing(_channel(record["t"], values), meta.dt)
    named = {"joint_positions": meta.joints, "joint_velocities": meta.joints, "thrust": meta.thrusters}
    channels = {key: _with_names(one, named.get(key, ())) for key, one in channels.items()}
    return Recording(name=name, channels=channels, issues_in_file=tuple(_spoiled(record)), at_once=True)


def _estimated_rows(record: Record, floating: bool) -> Iterator[tuple[str, np.ndarray]]:
    q, v = record["q_estimated"], record["v_estimated"]
    if floating:
        yield "position", q[:, :3]
        yield "attitude", continuous_quaternions(q[:, 3:_POSE])
        yield "linear_velocity", v[:, :3]
        yield "angular_velocity", v[:, 3:_TWIST]
    yield "joint_positions", q[:, _POSE if floating else 0 :]
    yield "joint_velocities", v[:, _TWIST if floating else 0 :]


def _with_names(channel: Channel, names: tuple[str, ...]) -> Channel:
    """Name its columns where there is one for each: not for joints that turn without end."""
    return replace(channel, columns=names) if len(names) == channel.values.shape[1] else channel


def _asked(record: Record) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the commanded thrust, and the commanded wrench without what thrusters cannot give of it."""
    found = record.series
    for name in ("asked_thrust", "thrust"):
        if name in found and found[name].size:
            yield "thrust", found[name]
            break
    if "wrench" in found:
        yield "wrench", found["wrench"] - found.get("unreachable", 0.0)


def _from_nothing(channel: Channel, dt: float) -> Channel:
    """A run begins with thrusters at rest; dt [s]."""
    t, values = channel.t, channel.values
    return replace(channel, t=np.r_[t[0] - dt, t], values=np.vstack([np.zeros_like(values[:1]), values]))


def _spoiled(record: Record) -> Iterator[tuple[str, str]]:
    """Channels and what the record itself says against them."""
    t, found = record["t"], record.series
    if "thrust" in found and "asked_thrust" not in found:
        yield "thrust", "as thrusters gave it, not as it was asked of them: lag and dead zone are in it, run it anew"
    for fault in record.run_meta.faults:
        if fault.t <= t[-1]:
            yield fault.target, f"{fault.text}, a fault of this run: a fit takes vehicle and sensors for sound"
    if "contact" in found and (touches := (found["contact"] != 0.0).any(axis=1)).any():
        yield "position", f"on the floor at {t[np.argmax(touches)]:.2f} s first: a fit knows no floor that pushes"


def _channel(t: np.ndarray, values: np.ndarray) -> Channel:
    known = np.isfinite(values).all(axis=1)
    return Channel(t=t[known], values=values[known])


# A recording of any file: one of ours, a record of a run, or one of others with a mapping.

_OWN_ALONE = ".npz"  # files of others do not end so
_RECORDS = {_OWN_ALONE: Record.load, ".mcap": Record.from_mcap, ".parquet": Record.from_parquet}


def read_recording(path: Path, mapping: RecordingMapping | None = None) -> Recording:
    """The recording of a file or a folder; mapping: for what is none of ours.

    Raises InvalidInput for one that needs a mapping, NameNotFound and NotInstalled.
    """
    require_there(path)
    if mapping is not None and path.is_dir():
        return mapped_recording(path, mapping)
    try:
        return _own(path)
    except InvalidInput:
        if mapping is None or path.suffix == _OWN_ALONE:
            raise
    return mapped_recording(path, mapping)


def _own(path: Path) -> Recording:
    if path.suffix == _OWN_ALONE or (holds_messages(path) and path.is_file()):
        return _of_record(path)
    if holds_messages(path):
        raise _needs_mapping(path)
    return stored_recording(path) if path.suffix != ".parquet" or is_stored(column_names(path)) else _of_record(path)


def _of_record(path: Path) -> Recording:
    try:
        record = _RECORDS[path.suffix](path)
    except InvalidInput:
        if holds_messages(path):
            raise _needs_mapping(path) from None
        raise
    return run_recording(record, path.parent.name if path.stem == "record" else path.name.partition(".")[0])


def _needs_mapping(path: Path) -> InvalidInput:
    return InvalidInput(f"{path}: no record of ours; give a mapping of its topics: {', '.join(topics_of(path))}")
