"""Read recordings from files: ours, records of runs, and others by a mapping of their columns.

The mapping is a YAML file, or the same as a value:

    channels:
      linear_velocity:
        file: navigation_{name}.csv.gz
        time: header.stamp
        time_unit: ns
        columns: [velocity.x, velocity.y, velocity.z]
        body: FRD

Messages of MCAP files and rosbag2 folders have a topic, and fields by their paths; without a time
they count as measured when they were logged:

      attitude:
        topic: /odometry time: header.stamp columns: [pose.pose.orientation.x,
        pose.pose.orientation.y, pose.pose.orientation.z, pose.pose.orientation.w]
      joint_positions:
        topic: /joint_states
        columns: ["position[shoulder]", "position[elbow]"]

What a table of text looks like is found, or given (``table: {delimiter: tab}``). Frames: ``world:
NED`` and ``body: FRD`` are turned to W with z up and B forward-left-up. A world with z up is taken
as it is: where it has its x axis changes no fit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.identification import file_kinds, recording as recordings, tables
from uvms_ocp.identification.messages import TopicColumns, message_rows, topics_of
from uvms_ocp.identification.text_tables import TextFormat
from uvms_ocp.model_errors import FileModel, one_line_errors
from uvms_ocp.record import output, run_meta, yaml_file
from uvms_ocp.record.record import Record, require_every_tick
from uvms_ocp.record.row_files import META
from uvms_ocp.robot.spatial import continuous_quaternions

# [s]; the latter on each side
_DAY = 86_400.0
_AROUND_MIDNIGHT = 600.0
_DOWN = np.diag([1.0, -1.0, -1.0])  # from axes with z down to axes with z up, and back
UNITS: Mapping[str, Mapping[str, float]] = recordings.CHANNEL_TABLE["units"]
"""Factors of the units that values of a channel may be given in, by the unit of the channel."""
_OF_CHANNEL = recordings.CHANNEL_TABLE["of_channel"]
_FOREIGN = 0.5  # of all rows, above which those without any cell are of other channels
_LARGEST_ANGLE = (
    2.5 * np.pi
)  # [rad] of roll, pitch and yaw as files have them, unless yaw is unwound
# of the usual interval, within which a message that says the same again is the same message
_AT_ONCE = 0.05
_Numbers = float | tuple[float, ...]

_UNIX_TIME = {"ns": 1e17, "us": 1e14, "ms": 1e11}
"""Least number of a time since 1970 in each unit: read as seconds it would be some thousand
years.
"""

_TRUTH = {"joint_torques": "torque", "current": "current"}
"""Channels that are whole series."""
_MEASURED = tuple(
    f"measured_{name}" for name in ("position", "attitude", "linear_velocity", "angular_velocity")
)
_POSE = 7
_TWIST = 6

_OWN_MEMBER = b"__meta__.npy"
_READ = (
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
_RECORDS: Mapping[str, Callable[[Path], Record]] = {
    ".npz": partial(Record.load, only=_READ),
    ".mcap": Record.from_mcap,
    ".parquet": Record.from_parquet,
}


# When messages were sent that arrived late, in bursts or with gaps.


def even_send_times(arrived: np.ndarray, period: float) -> np.ndarray:
    """Times (n,) [s] at which messages were sent every `period` [s], from when they arrived (n,)
    [s].

    A message was sent no later than it arrived, and at least a period before the next one: of all
    these bounds the least. Where messages are lost, the times after the gap are right again as soon
    as one comes without delay. What all messages are late by stays. Raises InvalidInput for a
    period that is not positive.
    """
    if not period > 0.0:
        raise InvalidInput(f"period = {period} s given; allowed: more than 0")
    since = period * np.arange(len(arrived))
    return np.asarray(np.minimum.accumulate((arrived - since)[::-1])[::-1] + since)


# How the columns of foreign files become channels: a YAML file, or the same as a value.


class ChannelMapping(FileModel, allow_inf_nan=False, use_attribute_docstrings=True):
    """Source of one channel: topic or columns, units and frame."""

    file: str = ""
    """in the folder of the recording, {name} for its name; empty: the file itself"""
    topic: str = ""
    """of the messages, in MCAP files, bags, logs of MAVLink; `type` of JSON lines"""
    time: str | Annotated[float, Field(gt=0.0, strict=True)] | tuple[str, str] = ""
    """column or field of the times; of messages, empty for when they were logged; a number is the
    period of rows that have none; two columns of a table are whole seconds and nanoseconds
    """
    time_unit: Literal["s", "ms", "us", "ns", "min", "h", "d"] | None = None
    """of times that are plain numbers, default: as a header says, or s; stamps and ISO 8601 need
    none
    """
    columns: tuple[str | float, ...] = Field(min_length=1)
    """in the order that the channel has; -name for the opposite, a number for what is not measured;
    of messages, paths such as position.x, actuators[3]; of tables also places, #1
    """
    rows: dict[str, float | str] = Field(default={})
    """only rows or messages that have these values, such as {instance: 0, valid: 1, sensor:
    left}
    """
    missing: tuple[float, ...] = ()
    """values that stand where nothing was measured"""
    format: Literal["rpy", "quaternion xyzw", "quaternion wxyz"] | None = None
    """of an attitude; default: quaternion xyzw"""
    unit: str | None = None
    """of the values; default: as a header says, or that of the channel"""
    offset: _Numbers = 0.0
    """added to the values, of all columns or of each [unit of the channel]"""
    scale: _Numbers = 1.0
    """factor of the values then, of all columns or of each [-]"""
    frame: Literal["W", "B"] | None = None
    """of a velocity or a force; W is turned by the attitude; default: B"""
    world: Literal["z up", "NED"] | None = None
    """axes of W; default: z up"""
    body: Literal["FLU", "FRD"] | None = None
    """axes of B; default: FLU"""
    delay: float = 0.0
    """by which times are known to be late [s]"""
    sent_every: Annotated[float, Field(gt=0.0)] | None = None
    """period [s] of what was sent evenly but arrived in bursts"""
    lost: Literal["never", "all zero"] = "never"
    """how samples look that are none"""

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the columns or fields that are measured, without their signs."""
        return tuple(column.removeprefix("-") for column in self.columns if isinstance(column, str))

    @property
    def words(self) -> tuple[str | None, ...]:
        """For each column, then each row: the word that reads as 1 (every other word as 0); None
        where numbers are read.
        """
        return (
            *(None for _ in self.fields),
            *(row if isinstance(row, str) else None for row in self.rows.values()),
        )


@one_line_errors
class RecordingMapping(FileModel, use_attribute_docstrings=True):
    """Mapping of all channels of a recording, by the names of `CHANNEL_KINDS`."""

    channels: dict[str, ChannelMapping] = Field(min_length=1)
    table: TextFormat | None = None
    """what is known of tables of text"""
    messages: str = ""
    """folder with PACKAGE/msg/NAME.msg that a bag of ROS 2 lacks"""


def read_mapping(path: Path | str) -> RecordingMapping:
    """Read a mapping from its YAML file, beside which its folder of messages is.

    Raises InvalidInput in one line for what is none, NameNotFound for a channel that there is not.
    """
    path = Path(path)
    mapping = yaml_file.read_yaml_as(path, RecordingMapping)
    for key, channel in mapping.channels.items():
        _require_meaning(key, channel)
    if mapping.messages:
        return mapping.model_copy(update={"messages": str(path.parent / mapping.messages)})
    return mapping


def _require_meaning(key: str, mapping: ChannelMapping) -> None:
    """Check that every key has a meaning for its channel: none is ignored.

    Raises NameNotFound for no channel, InvalidInput for a key without meaning.
    """
    require_known("channel", key, recordings.CHANNEL_KINDS)
    for name in ("format", "frame", "world", "body"):
        if getattr(mapping, name) is not None and name not in frames_of(key, mapping.frame):
            raise InvalidInput(
                f"{key}: {name}: {getattr(mapping, name)} given, which means nothing of it; leave"
                " it out"
            )
    if mapping.unit is not None and mapping.unit not in (allowed := units_of(key, mapping.format)):
        raise InvalidInput(
            f"{key}: unit {mapping.unit!r} given; allowed:"
            f" {', '.join(allowed) or 'none, it has no unit'}"
        )
    for name in ("offset", "scale"):
        values = getattr(mapping, name)
        if isinstance(values, tuple) and len(values) != len(mapping.columns):
            raise InvalidInput(
                f"{key}: {len(values)} numbers of {name} given; allowed: one, or one for each column"
            )
    if mapping.format == "rpy":
        width = 3
    else:
        width = len(recordings.CHANNEL_KINDS[key].columns)
    arrays = (
        any("." in column or "[" in column for column in mapping.fields) or mapping.topic
    )  # which may have all of them
    if width and (len(mapping.columns) > width or (len(mapping.columns) < width and not arrays)):
        constant = ""
        if len(mapping.columns) < width:
            constant = "; a number may stand for one that is not measured, such as 0.0"
        raise InvalidInput(
            f"{key}: {len(mapping.columns)} columns given; allowed: {width}{constant}"
        )


def frames_of(key: str, frame: str | None) -> tuple[str, ...]:
    """Return the keys about axes that have a meaning for a channel in a frame."""
    if key == "attitude":
        return "format", "world", "body"
    by_frame = {"B": ("frame", "world") if frame == "W" else ("frame", "body"), "W": ("world",)}
    return by_frame.get(recordings.CHANNEL_KINDS[key].frame, ())


def units_of(key: str, form: str | None) -> dict[str, float]:
    """Return the units that a channel may have, an attitude in a form, and their factors."""
    if key != "attitude" or form == "rpy":
        bases = _OF_CHANNEL.get(key, (recordings.CHANNEL_KINDS[key].unit,))
    else:
        bases = ()
    return {unit: factor for base in bases for unit, factor in UNITS[base].items()}


def mapped_recording(
    source: Path | str, mapping: RecordingMapping, name: str = ""
) -> recordings.Recording:
    """Read a recording from a file, or from files in a folder whose names have the name of the
    recording in them.

    Times begin with the first sample of any channel. Rows with NaN are left out, and a doubt says
    how many. Raises NameNotFound, NotInstalled and InvalidInput.
    """
    source = Path(source)
    for key, channel_mapping in mapping.channels.items():
        _require_meaning(key, channel_mapping)
    name = name or source.name.partition(".")[0]
    rows = _mapped_rows(source, mapping, name)
    _pass_midnight(rows.values())
    channels = {
        key: _samples(key, channel_mapping, rows[key])
        for key, channel_mapping in mapping.channels.items()
    }
    in_world = [
        key for key, channel_mapping in mapping.channels.items() if channel_mapping.frame == "W"
    ]
    channels_in_body = channels | {
        key: replace(channels[key], values=_in_body(key, channels)) for key in in_world
    }
    start = min(channel.t[0] for channel in channels_in_body.values())
    texts = [text for table in rows.values() for text in (table.layout, *table.notes)]
    return recordings.Recording(
        name=name,
        channels={
            key: replace(channel, t=channel.t - start) for key, channel in channels_in_body.items()
        },
        issues_in_file=tuple(
            doubt
            for key, channel_mapping in mapping.channels.items()
            for doubt in _unknown(key, channel_mapping, rows[key])
        ),
        layout=tuple(filter(None, dict.fromkeys(texts))),
    )


def _in_body(key: str, read: Mapping[str, recordings.Channel]) -> np.ndarray:
    """Turn values of a channel in W to B."""
    if "attitude" not in read:
        raise InvalidInput(
            f"{key}: frame: W given, which needs the attitude; give that channel too"
        )
    R = recordings.rotations(read["attitude"], read[key].undelayed_t)
    return np.einsum("nji,nkj->nki", R, read[key].values.reshape(len(R), -1, 3)).reshape(len(R), -1)


def _mapped_rows(
    source: Path, mapping: RecordingMapping, name: str
) -> dict[str, tables.TableColumns]:
    """Read times [s] and values [as they are] (n, 1 + k) of every channel; from a file of messages
    all at once.
    """
    tables_by_key: dict[str, tables.TableColumns] = {}
    by_path: dict[Path, dict[str, TopicColumns]] = defaultdict(dict)
    known_topics = cache(topics_of)  # which may read all of a file
    for key, channel in mapping.channels.items():
        if channel.file:
            path = source / channel.file.replace("{name}", name)
        else:
            path = source
        if file_kinds.holds_messages(path):
            # Messages that name no type are of the topic "".
            if not channel.topic and "" not in known_topics(path):
                raise InvalidInput(
                    f"{path}: {key} has no topic; give one of {', '.join(known_topics(path))}"
                )
            time = channel.time if isinstance(channel.time, str) else ""
            unit = recordings.SECONDS[channel.time_unit or "s"]
            columns = (*channel.fields, *channel.rows)
            by_path[path][key] = TopicColumns(
                topic=channel.topic, columns=columns, time=time, unit=unit, words=channel.words
            )
        else:
            tables_by_key[key] = _chosen(
                key, channel, _table_rows(key, channel, path, mapping.table)
            )
    definitions = Path(mapping.messages) if mapping.messages else None
    for path, topics in by_path.items():
        for key, rows in message_rows(path, topics, definitions).items():
            channel = mapping.channels[key]
            in_seconds = channel.time_unit and isinstance(channel.time, str)
            tables_by_key[key] = _chosen(
                key, channel, rows if in_seconds else _in_seconds(channel, rows)
            )
    return tables_by_key


def _in_seconds(mapping: ChannelMapping, rows: tables.TableColumns) -> tables.TableColumns:
    """Convert times, in the first column, to seconds: of a unit that is given or said, or whose
    size tells it; or even ones.
    """
    times = rows.values[:, 0]
    time_unit = rows.units[0]
    if isinstance(mapping.time, float):
        times = mapping.time * np.arange(len(times))
        time_unit = "s"
    unit = mapping.time_unit or recordings.unit_named(time_unit)
    layout = rows.layout
    if unit not in recordings.SECONDS:
        largest = np.abs(times).max(initial=0.0, where=np.isfinite(times))
        unit = next((name for name, smallest in _UNIX_TIME.items() if largest >= smallest), "s")
        if unit != "s":
            layout = ", ".join(filter(None, (layout, f"times in {unit}")))
    return replace(
        rows,
        values=np.column_stack([recordings.SECONDS[unit] * times, rows.values[:, 1:]]),
        layout=layout,
    )


def _table_rows(
    key: str, mapping: ChannelMapping, path: Path, text_format: TextFormat | None
) -> tables.TableColumns:
    named = (*mapping.fields, *mapping.rows)
    if mapping.topic or not mapping.time or not named:
        raise InvalidInput(
            f"{path}: {key} is in a table; give its time, a column or the period [s] of its rows,"
            " and no topic"
        )
    # a period stands for as many times as there are rows of another column
    times: tuple[str, ...]
    if isinstance(mapping.time, tuple):
        times = mapping.time
    elif isinstance(mapping.time, str):
        times = (mapping.time,)
    else:
        times = (named[0],)
    table = tables.read_table(
        path, [*times, *named], text_format, (*(None for _ in times), *mapping.words)
    )
    if isinstance(mapping.time, tuple):
        both = table.values[:, :2] @ [1.0, 1e-9]
        table = replace(
            table,
            values=np.column_stack([both, table.values[:, 2:]]),
            units=("s", *table.units[2:]),
        )
    table = _in_seconds(mapping, table)
    return replace(table, layout=f"{path.name}: {table.layout}" if table.layout else "")


def _chosen(key: str, mapping: ChannelMapping, table: tables.TableColumns) -> tables.TableColumns:
    """Choose the rows of a channel, with sentinels as NaN, signs and constants, in its unit.

    Where most rows have no cell at all, a file has those of other channels between them.
    """
    n = len(mapping.rows)
    values = table.values[:, : table.values.shape[1] - n]
    which = table.values[:, table.values.shape[1] - n :]
    if n:
        row_values = [
            1.0 if isinstance(number, str) else number for number in mapping.rows.values()
        ]
        values = values[(which == row_values).all(axis=1)]
    if not len(values) and len(table.values):
        raise InvalidInput(
            f"{key}: no row has {mapping.rows}; leave rows out, or give values that there are"
        )
    empty = ~np.isfinite(values[:, 1:]).any(axis=1)
    if _FOREIGN * len(empty) < empty.sum() < len(empty):  # rows of other channels
        values = values[~empty]
    for missing in mapping.missing:
        values = np.hstack(
            [
                values[:, :1],
                np.where(np.isclose(values[:, 1:], missing, rtol=1e-12), np.nan, values[:, 1:]),
            ]
        )
    factors, notes, remarks = _factors(key, mapping, table.units[1 : values.shape[1]])
    numbers = values[:, 1:] * factors
    if len(mapping.fields) < len(mapping.columns) or any(
        str(name).startswith("-") for name in mapping.columns
    ):
        measured = iter(numbers.T)
        columns = list[np.ndarray]()
        for name in mapping.columns:
            if not isinstance(name, str):
                columns.append(np.full(len(values), name))
            elif name[:1] == "-":
                columns.append(-next(measured))
            else:
                columns.append(next(measured))
        numbers = np.column_stack(columns)
    if (
        key == "attitude" and mapping.format != "rpy" and mapping.lost == "never"
    ):  # zeros: its sender knows no attitude
        numbers = np.where(np.linalg.norm(numbers, axis=1, keepdims=True) > 0.0, numbers, np.nan)
    converted = np.column_stack(
        [values[:, 0], (numbers + np.asarray(mapping.offset)) * np.asarray(mapping.scale)]
    )
    return replace(
        table, values=converted, units=(), notes=notes, remarks=(*table.remarks, *remarks)
    )


def _factors(
    key: str, mapping: ChannelMapping, file_units: Sequence[str]
) -> tuple[np.ndarray, tuple[str, ...], list[str]]:
    """Return factors (k,) of columns to the unit of the channel, as the mapping or the file has
    them, notes of the file's units, and remarks about them.
    """
    factors = units_of(key, mapping.format)
    if mapping.unit is not None or mapping.scale != 1.0:
        return np.full(len(file_units), factors.get(mapping.unit or "", 1.0)), (), []
    units = [recordings.unit_named(unit) or unit.strip() for unit in file_units]
    foreign_units = sorted({unit for unit in units if unit and unit not in factors})
    converted_units = sorted({unit for unit in units if factors.get(unit, 1.0) != 1.0})
    notes: tuple[str, ...] = ()
    if converted_units:
        notes = (f"{key}: in {', '.join(converted_units)}, as the file says",)
    plain = " or ".join(unit for unit, factor in factors.items() if factor == 1.0)
    doubtful = (
        f"in {', '.join(foreign_units)} as the file says, and taken for {plain}: give its unit, or"
        " a scale"
    )
    remarks = [doubtful] if foreign_units and factors else []
    return np.array([factors.get(unit, 1.0) for unit in units]), notes, remarks


def _unknown(
    key: str, mapping: ChannelMapping, table: tables.TableColumns
) -> Iterator[tuple[str, str]]:
    """Yield doubts about columns that stand twice, rows that are no numbers, and units that cannot
    be.
    """
    rows = table.values
    yield from ((key, remark) for remark in table.remarks)
    twice = sorted({name for name in mapping.fields if mapping.fields.count(name) > 1})
    if twice:
        yield (
            key,
            (
                f"{', '.join(twice)} stands for more than one of its axes: give a number for what"
                " is not measured"
            ),
        )
    open_cells = ~np.isfinite(rows)
    n = int(open_cells.any(axis=1).sum())
    if n:
        text = (
            f"{n} of {len(rows)} rows have NaN ({_named(mapping, open_cells.any(axis=0))}) and are"
            " left out"
        )
        command = recordings.CHANNEL_KINDS[key].command
        if command:
            text += ", and a fit takes the command before them for what was asked"
        yield key, text
    geographic = [
        name
        for name in mapping.fields
        if name.rpartition(".")[2].lower().startswith(("lat", "lon", "lng"))
    ]
    if key == "position" and geographic:
        yield (
            key,
            (
                f"{', '.join(geographic)} are degrees on the globe: give metres east and north of a"
                " point"
            ),
        )
    if (
        key == "attitude"
        and mapping.format == "rpy"
        and mapping.unit is None
        and _like_degrees(rows)
    ):
        yield (
            key,
            (
                f"yaw up to {np.nanmax(np.abs(rows[:, 3])):.4g} rad: in deg? give its unit, deg, or"
                " rad where it is so"
            ),
        )


def _like_degrees(rows: np.ndarray) -> bool:
    """Judge yaw of rows (n, 4): one that is unwound begins within a turn, and no vehicle turns in a
    second by half of one.
    """
    t, yaw = rows[np.isfinite(rows).all(axis=1)][:, [0, 3]].T
    if len(yaw) < 2 or np.abs(yaw).max() < _LARGEST_ANGLE:
        return False
    rates = np.abs(np.diff(yaw)) / np.maximum(np.diff(t), 1e-9)
    return bool(abs(yaw[0]) > _LARGEST_ANGLE or np.percentile(rates, 90.0) > np.pi)


def _named(mapping: ChannelMapping, chosen: np.ndarray) -> str:
    """Join the names of time and columns where chosen (1 + k,) is true; a path to an array stands
    for all of its columns.
    """
    names = [str(mapping.time or "time"), *map(str, mapping.columns)]
    if len(names) != len(chosen):
        return ", ".join(names[1:])
    return ", ".join(name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen)


def _samples(key: str, mapping: ChannelMapping, table: tables.TableColumns) -> recordings.Channel:
    rows = table.values
    finite = np.isfinite(rows)
    if len(rows) > 1 and not finite.all(axis=1).any():
        columns = _named(mapping, ~finite.any(axis=0)) or "one column or another"
        raise InvalidInput(f"{key}: NaN in every row ({columns}); leave the channel out")
    rows = rows[finite.all(axis=1)]
    if mapping.lost == "all zero":
        rows = rows[(rows[:, 1:] != 0.0).any(axis=1)]
    if len(rows) < 2:
        raise InvalidInput(f"fewer than two samples of {key}; leave the channel out")
    back = float((np.maximum.accumulate(rows[:, 0]) - rows[:, 0]).max())
    n = len(rows)
    rows = _without_echoes(rows)
    times = rows[:, 0]
    t, first = np.unique(
        times if mapping.sent_every is None else even_send_times(times, mapping.sent_every),
        return_index=True,
    )
    return recordings.Channel(
        t=t,
        values=_converted(key, mapping, rows[first, 1:]),
        delay=mapping.delay,
        back=back,
        repeated=len(times) - len(t),
        echoes=n - len(times),
        missing=len(finite) - n,
        constants=tuple(k for k, name in enumerate(mapping.columns) if not isinstance(name, str)),
    )


def _pass_midnight(tables_read: Iterable[tables.TableColumns]) -> None:
    """Let times of day [s] go on from one day to the next, in all channels where those of any do;
    other times stay.

    All are then within half a day, from middle to middle, of the first that does.
    """
    columns = [table.values[:, 0] for table in tables_read]
    times = [t for t in columns if np.isfinite(t).any() and not ((t < 0.0) | (t >= _DAY)).any()]
    going_on = [
        np.unwrap(t[np.isfinite(t)], _DAY - 2.0 * _AROUND_MIDNIGHT, period=_DAY) for t in times
    ]
    middles = [0.5 * (t.min() + t.max()) for t in going_on]
    passing = [
        middle
        for middle, t in zip(middles, going_on, strict=True)
        if t.min() < 0.0 or t.max() >= _DAY
    ]
    if not passing:
        return
    for column, t, middle in zip(times, going_on, middles, strict=True):
        column[np.isfinite(column)] = t + _DAY * np.round((passing[0] - middle) / _DAY)


def _without_echoes(rows: np.ndarray) -> np.ndarray:
    """Drop rows (n, 1 + k) that repeat the one before at nearly the same time, as republished
    topics do.
    """
    steps = np.diff(rows[:, 0])
    same = (np.diff(rows[:, 1:], axis=0) == 0.0).all(axis=1)
    if (~same).sum() < 2:
        return rows
    echo = (
        same
        & (steps >= 0.0)
        & (steps < _AT_ONCE * float(np.median(np.diff(rows[np.r_[True, ~same], 0]))))
    )
    return rows[np.r_[True, ~echo]]


def _converted(key: str, mapping: ChannelMapping, values: np.ndarray) -> np.ndarray:
    if key == "attitude":
        return continuous_quaternions(_quaternions(mapping, values))
    turned = {"W": mapping.world == "NED", "B": mapping.body == "FRD"}.get(
        mapping.frame or recordings.CHANNEL_KINDS[key].frame, False
    )
    if turned:
        return values * np.tile(np.diag(_DOWN), values.shape[1] // 3)
    return values


def _quaternions(mapping: ChannelMapping, values: np.ndarray) -> np.ndarray:
    """Convert values to attitudes (n, 4) of B in W."""
    from scipy.spatial.transform import Rotation

    width = 3 if mapping.format == "rpy" else 4
    if values.shape[1] != width:
        raise InvalidInput(
            f"attitude: {values.shape[1]} columns given; allowed: 4, or 3 with format: rpy"
        )
    if width == 3 and np.abs(values[:, :2]).max() > _LARGEST_ANGLE:
        extreme = float(values.flat[np.argmax(np.abs(values))])
        is_extreme = (values == extreme).any(axis=1)
        others = np.abs(values[values != extreme]).max(initial=0.0)
        raw = extreme / units_of("attitude", "rpy")[mapping.unit or "rad"]
        if is_extreme.sum() > 1 and abs(extreme) > 2.0 * others:
            raise InvalidInput(
                f"attitude: {raw:.10g} in {is_extreme.sum()} of {len(values)} rows: give missing:"
                f" [{raw:.10g}]"
            )
        raise InvalidInput(
            f"attitude: angles up to {np.abs(values).max():.4g} rad given; in deg? give its unit"
        )
    w_first = mapping.format == "quaternion wxyz"
    if width == 3:
        R = Rotation.from_euler("xyz", values)
    else:
        R = Rotation.from_quat(values, scalar_first=w_first)
    world = Rotation.from_matrix(_DOWN if mapping.world == "NED" else np.eye(3))
    body = Rotation.from_matrix(_DOWN if mapping.body == "FRD" else np.eye(3))
    return np.asarray((world * R * body).as_quat())


# Records of the toolkit's own runs as recordings: what the robot measured, what was asked of its
# thrusters, and the truth of what no sensor tells: torque as joints gave it, and the current.


def run_recording(record: Record, name: str) -> recordings.Recording:
    """Build the recording of a run. Raises InvalidInput for a plan, which nobody has measured, and
    for fewer rows than ticks.
    """
    meta = require_every_tick(record)
    rows = dict(_estimated_rows(record, run_meta.is_floating(record.series, meta)))
    rows |= {
        channel: record[series] for channel, series in _TRUTH.items() if series in record.series
    }
    channels = dict(_measured(record))
    t = record["t"]
    channels |= {
        key: _channel(t, values)
        for key, values in rows.items()
        if values.size and key not in channels
    }
    for key, values in _asked(record):
        commands = _channel(t, values)  # a run begins with thrusters at rest
        channels[key] = replace(
            commands,
            t=np.r_[commands.t[0] - meta.dt, commands.t],
            values=np.vstack([0.0 * commands.values[:1], commands.values]),
        )
    named = {
        "joint_positions": meta.joints,
        "joint_velocities": meta.joints,
        "thrust": meta.thrusters,
    }
    channels = {key: _with_names(channel, named.get(key, ())) for key, channel in channels.items()}
    return recordings.Recording(
        name=name, channels=channels, issues_in_file=tuple(_spoiled(record)), at_once=True
    )


def _estimated_rows(record: Record, floating: bool) -> Iterator[tuple[str, np.ndarray]]:
    q = record["q_estimated"]
    v = record["v_estimated"]
    if floating:
        yield "position", q[:, :3]
        yield "attitude", continuous_quaternions(q[:, 3:_POSE])
        yield "linear_velocity", v[:, :3]
        yield "angular_velocity", v[:, 3:_TWIST]
    yield "joint_positions", q[:, _POSE if floating else 0 :]
    yield "joint_velocities", v[:, _TWIST if floating else 0 :]


def _measured(record: Record) -> Iterator[tuple[str, recordings.Channel]]:
    """Yield what sensors read: an estimate between slow readings is late, and a fit would take that
    for less added mass.
    """
    for name in _MEASURED:
        if name not in record.series:
            continue
        channel = name.removeprefix("measured_")
        (values, t) = np.split(record[name], [-1], axis=1)
        sample_times = np.where(np.isfinite(record[name]).all(axis=1), t[:, 0], -np.inf)
        # Clocks that fail give times again.
        fresh = sample_times > np.r_[-np.inf, np.maximum.accumulate(sample_times)[:-1]]
        if fresh.sum() > 1:
            if channel == "attitude":
                readings = continuous_quaternions(values[fresh])
            else:
                readings = values[fresh]
            yield channel, recordings.Channel(t=t[fresh, 0], values=readings)


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
    if "contact" in series and (touches := (series["contact"] != 0.0).any(axis=1)).any():
        yield (
            "position",
            (
                f"on the floor at {t[np.argmax(touches)]:.2f} s first: a fit knows no floor that"
                " pushes"
            ),
        )


def _channel(t: np.ndarray, values: np.ndarray) -> recordings.Channel:
    finite = np.isfinite(values).all(axis=1)
    if finite.all():
        return recordings.Channel(t=t, values=values)
    return recordings.Channel(t=t[finite], values=values[finite])


# A recording of any file: one of ours, a record of a run, or one of others with a mapping.


def read_recording(
    path: Path | str, mapping: RecordingMapping | None = None
) -> recordings.Recording:
    """Read the recording of a file or a folder; mapping: for files of other software.

    Raises InvalidInput for one that needs a mapping, NameNotFound and NotInstalled.
    """
    path = Path(path)
    tables.require_there(path)
    if mapping is not None and path.is_dir():
        return mapped_recording(path, mapping)
    try:
        return _own(path)
    except InvalidInput:
        if mapping is None or _is_own_archive(path):
            raise
    return mapped_recording(path, mapping)


def _is_own_archive(path: Path) -> bool:
    """Recognise a record of ours, also a damaged one, by the first array in it."""
    with path.open("rb") as file:
        return path.suffix == ".npz" and _OWN_MEMBER in file.read(64)


def _own(path: Path) -> recordings.Recording:
    if path.is_dir():
        if any(
            (path / name).is_file() for name in (output.RECORD, META)
        ):  # results of a run, or its rows
            return _of_record(path)
        raise _needs_mapping(path)
    kind = file_kinds.kind_of(path)
    if path.suffix == ".npz" or kind == "mcap":
        return _of_record(path)
    if file_kinds.holds_messages(path):
        raise _needs_mapping(path)
    if kind != "parquet" or tables.is_stored(tables.column_names(path)):
        return tables.stored_recording(path)
    return _of_record(path)


def _of_record(path: Path) -> recordings.Recording:
    try:
        record = _RECORDS.get(path.suffix, Record.load)(path)
    except InvalidInput:
        if file_kinds.holds_messages(path):
            raise _needs_mapping(path) from None
        raise
    return run_recording(
        record, path.parent.name if path.stem == "record" else path.name.partition(".")[0]
    )


def _needs_mapping(path: Path) -> InvalidInput:
    return InvalidInput(
        f"{path}: no record of ours; give a mapping of its topics: {', '.join(topics_of(path))}"
    )
