"""Read recordings of other software by a mapping of their columns: times to seconds, values to the
unit, the axes and the frame of their channel, without what is missing or repeated.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import file_kinds, recording as recordings, tables
from uvms_ocp.identification.channel_mapping import (
    ChannelMapping,
    RecordingMapping,
    require_meaning,
    stated_aspects,
    units_of,
)
from uvms_ocp.identification.clock_segments import continued as continued_clocks
from uvms_ocp.identification.euler_orders import quaternions_of_angles
from uvms_ocp.identification.interleaved_series import numbers_of_series
from uvms_ocp.identification.joined_commands import joined_parts
from uvms_ocp.identification.mapping_doubts import (
    LARGEST_ANGLE,
    channel_doubts,
    joined_names,
    pressure_remarks,
    time_doubts,
)
from uvms_ocp.identification.message_columns import TopicColumns, message_rows
from uvms_ocp.identification.messages import topics_of
from uvms_ocp.identification.pressure_units import PRESSURE_UNITS
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.sample_times import (
    even_send_times,
    pass_midnight,
    without_echoes,
)
from uvms_ocp.identification.text_tables import TextFormat
from uvms_ocp.robot.spatial import continuous_quaternions

_DOWN = np.diag([1.0, -1.0, -1.0])  # from axes with z down to axes with z up, and back
_FOREIGN_SHARE = 0.5  # share of rows without any cell from which on they are of other channels
_UNIX_TIME = {"ns": 1e17, "us": 1e14, "ms": 1e11}
"""Smallest time since 1970 in each unit: read as seconds it would be some thousand years."""


@checked
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
        require_meaning(key, channel_mapping)
    name = name or source.name.partition(".")[0]
    source_rows = _rows_of_sources(source, _sources(mapping), mapping, name)
    pass_midnight(source_rows.values())
    clocks = continued_clocks({label: table.values[:, 0] for label, table in source_rows.items()})
    for label, t in clocks.times.items():
        values = np.column_stack([t, source_rows[label].values[:, 1:]])
        source_rows[label] = replace(source_rows[label], values=values)
    rows = _with_joined_parts(mapping, source_rows)
    channels = {}
    for key, channel_mapping in mapping.channels.items():
        channels[key] = _samples(key, channel_mapping, rows[key])
    channels_in_body = dict(channels)
    for key, channel_mapping in mapping.channels.items():
        if channel_mapping.frame == "W":
            channels_in_body[key] = replace(channels[key], values=_in_body(key, channels))
    start = min(channel.t[0] for channel in channels_in_body.values())
    issues = list(time_doubts(mapping))
    notes: list[str] = []
    if clocks.wraps:
        notes.append(f"a counter of times began anew {clocks.wraps} times, and goes on here")
    if clocks.boots:
        first_key = next(iter(mapping.channels))
        issues.append(
            (
                first_key,
                (
                    f"times go back by up to {clocks.back:.3g} s in the file, {clocks.boots} times:"
                    " boots, or a clock that was set? What follows each is a part of its own"
                ),
            )
        )
    for key, channel_mapping in mapping.channels.items():
        issues.extend(channel_doubts(key, channel_mapping, rows[key]))
    for table in rows.values():
        notes += [table.layout, *table.notes]
    return recordings.Recording(
        name=name,
        channels={
            key: replace(channel, t=channel.t - start) for key, channel in channels_in_body.items()
        },
        issues_in_file=tuple(issues),
        layout=tuple(note for note in dict.fromkeys(notes) if note),
        stated=_stated(mapping, rows),
    )


def _stated(
    mapping: RecordingMapping, rows: Mapping[str, tables.TableColumns]
) -> dict[str, dict[str, str]]:
    """Return what the mapping, and units in the file, state of each channel."""
    stated = {}
    for key, channel_mapping in mapping.channels.items():
        aspects = stated_aspects(key, channel_mapping)
        if "unit" not in aspects and rows[key].stated_unit:
            aspects["unit"] = f"{rows[key].stated_unit}, as the file says"
        if channel_mapping.topic and channel_mapping.time:
            aspects.setdefault("time", f"{channel_mapping.time} of the message")
        stated[key] = aspects
    return stated


def _in_body(key: str, channels: Mapping[str, recordings.Channel]) -> np.ndarray:
    """Turn the values of a channel from W to B. Raises InvalidInput without an attitude."""
    if "attitude" not in channels:
        raise InvalidInput(
            f"{key}: frame: W given, which needs the attitude; give that channel too"
        )
    R = rotations(channels["attitude"], channels[key].undelayed_t)
    vectors = channels[key].values.reshape(len(R), -1, 3)
    return np.einsum("nji,nkj->nki", R, vectors).reshape(len(R), -1)


class _Source(NamedTuple):
    """Source of a channel, or of a part of one."""

    key: str
    """Name of the channel."""
    mapping: ChannelMapping
    """Mapping of it, or of the part by itself."""


def _sources(mapping: RecordingMapping) -> dict[str, _Source]:
    """Return the sources of all channels by a name for each in messages: that of the channel, or of
    its part.
    """
    sources = {}
    for key, channel in mapping.channels.items():
        if not channel.parts:
            sources[key] = _Source(key, channel)
        for number, part in enumerate(channel.mappings_of_parts()):
            if isinstance(part, ChannelMapping):
                sources[_name_of_part(key, number)] = _Source(key, part)
    return sources


def _name_of_part(key: str, number: int) -> str:
    """Name a part of a channel, number from 0, in messages."""
    return f"{key}: part {number + 1}"


def _with_joined_parts(
    mapping: RecordingMapping, rows: Mapping[str, tables.TableColumns]
) -> dict[str, tables.TableColumns]:
    """Return the rows of all channels, of those that come in parts joined; rows: by the names of
    `_sources`.
    """
    rows_of_channels = {}
    for key, channel in mapping.channels.items():
        if not channel.parts:
            rows_of_channels[key] = rows[key]
            continue
        parts: list[tables.TableColumns | float] = []
        for number, part in enumerate(channel.mappings_of_parts()):
            if isinstance(part, ChannelMapping):
                parts.append(rows[_name_of_part(key, number)])
            else:
                parts.append(part)
        rows_of_channels[key] = joined_parts(key, parts, channel.part_names)
    return rows_of_channels


def _rows_of_sources(
    source: Path, sources: Mapping[str, _Source], mapping: RecordingMapping, name: str
) -> dict[str, tables.TableColumns]:
    """Read times [s] and values (n, 1 + k) [unit of the channel] of sources, by their names; from a file
    of messages all at once.
    """
    rows_by_source: dict[str, tables.TableColumns] = {}
    by_path: dict[Path, dict[str, TopicColumns]] = defaultdict(dict)
    known_topics = cache(topics_of)  # which may read all of a file
    for label, (key, channel) in sources.items():
        path = source
        if channel.file:
            path = source / channel.file.replace("{name}", name)
        if file_kinds.holds_messages(path):
            # Messages that name no type are of the topic "".
            if not channel.topic and "" not in known_topics(path):
                raise InvalidInput(
                    f"{path}: {label} has no topic; give one of {', '.join(known_topics(path))}"
                )
            time = ""
            if isinstance(channel.time, str):
                time = channel.time
            unit = recordings.SECONDS[channel.time_unit or "s"]
            by_path[path][label] = TopicColumns(
                topic=channel.topic,
                columns=channel.fields,
                time=time,
                unit=unit,
                rows=tuple(channel.rows.items()),
            )
        else:
            table = _table_rows(label, channel, path, mapping.table)
            rows_by_source[label] = _in_unit(key, channel, _chosen(label, channel, table))
    definitions = Path(mapping.messages) if mapping.messages else None
    for path, topics in by_path.items():
        for label, rows in message_rows(path, topics, definitions).items():
            key, channel = sources[label]
            has_seconds = channel.time_unit and isinstance(channel.time, str)
            if not has_seconds:
                rows = _in_seconds(channel, rows)
            rows_by_source[label] = _in_unit(key, channel, rows)
    return rows_by_source


def _in_seconds(mapping: ChannelMapping, rows: tables.TableColumns) -> tables.TableColumns:
    """Convert the times in the first column to seconds: from the unit of the mapping or the file, else
    from the unit that their size tells; or make even ones for a period.
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
        unit = _unix_unit(largest)
        if unit != "s":
            note = f"times in {unit}"
            if layout:
                layout = f"{layout}, {note}"
            else:
                layout = note
    seconds = recordings.SECONDS[unit] * times
    return replace(rows, values=np.column_stack([seconds, rows.values[:, 1:]]), layout=layout)


def _unix_unit(largest: float) -> str:
    """Return the unit in which the largest time is of the size of one since 1970; else s."""
    for unit, smallest in _UNIX_TIME.items():
        if largest >= smallest:
            return unit
    return "s"


def _table_rows(
    key: str, mapping: ChannelMapping, path: Path, text_format: TextFormat | None
) -> tables.TableColumns:
    """Read the columns of one channel from a table: times [s], values, and those by which rows are
    chosen.
    """
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
    words = [None] * len(times) + list(mapping.words)
    table = tables.read_table(path, [*times, *named], text_format, words)
    if isinstance(mapping.time, tuple):
        seconds = table.values[:, :2] @ [1.0, 1e-9]
        values = np.column_stack([seconds, table.values[:, 2:]])
        table = replace(table, values=values, units=("s", *table.units[2:]))
    table = _in_seconds(mapping, table)
    layout = ""
    if table.layout:
        layout = f"{path.name}: {table.layout}"
    return replace(table, layout=layout)


def _chosen(key: str, mapping: ChannelMapping, table: tables.TableColumns) -> tables.TableColumns:
    """Return the rows of a table that are of a channel. Raises InvalidInput where there are none."""
    values = _rows_with(mapping, table.values)
    if not len(values) and len(table.values):
        raise InvalidInput(
            f"{key}: no row has {mapping.rows}; leave rows out, or give values that there are"
        )
    return replace(table, values=values, units=table.units[: values.shape[1]])


def _in_unit(key: str, mapping: ChannelMapping, table: tables.TableColumns) -> tables.TableColumns:
    """Return the rows of a channel with sentinels as NaN, signs and constants, in its unit.

    Where most rows have no cell at all, a file has those of other channels between them.
    """
    values = table.values
    is_empty = ~np.isfinite(values[:, 1:]).any(axis=1)
    if _FOREIGN_SHARE * len(is_empty) < is_empty.sum() < len(is_empty):  # rows of other channels
        values = values[~is_empty]
    times = values[:, 0]
    numbers = values[:, 1:]
    for missing in mapping.missing:
        numbers = np.where(np.isclose(numbers, missing, rtol=1e-12), np.nan, numbers)
    file_units = table.units[1 : values.shape[1]]
    factors, notes, remarks = _factors(key, mapping, file_units)
    numbers = _with_constants(mapping, numbers * factors)
    if key == "position":
        remarks = [*pressure_remarks(mapping, file_units, numbers), *remarks]
    if key == "attitude" and not mapping.has_angles and mapping.lost == "never":
        # Zeros: its sender knows no attitude.
        norms = np.linalg.norm(numbers, axis=1, keepdims=True)
        numbers = np.where(norms > 0.0, numbers, np.nan)
    numbers = (numbers + np.asarray(mapping.offset)) * np.asarray(mapping.scale)
    known_units = dict.fromkeys(recordings.unit_named(unit) for unit in file_units)
    allowed_units = units_of(key, mapping.format)
    stated_units = [unit for unit in known_units if unit in allowed_units]
    return replace(
        table,
        values=np.column_stack([times, numbers]),
        units=(),
        stated_unit=", ".join(stated_units),
        notes=notes,
        remarks=(*table.remarks, *remarks),
    )


def _rows_with(mapping: ChannelMapping, values: np.ndarray) -> np.ndarray:
    """Return the rows that have the values of ``rows``, without the columns of these, the last."""
    n_conditions = len(mapping.rows)
    if n_conditions == 0:
        return values
    # A word reads as 1.
    expected = [1.0 if isinstance(value, str) else value for value in mapping.rows.values()]
    is_chosen = (values[:, -n_conditions:] == expected).all(axis=1)
    return values[is_chosen, :-n_conditions]


def _with_constants(mapping: ChannelMapping, numbers: np.ndarray) -> np.ndarray:
    """Place measured numbers (n, k), with their signs, and constants in the order of the
    mapping.
    """
    has_signs = any(str(name).startswith("-") for name in mapping.columns)
    if len(mapping.fields) == len(mapping.columns) and not has_signs:
        return numbers
    measured = iter(numbers.T)
    columns = list[np.ndarray]()
    for name in mapping.columns:
        if not isinstance(name, str):
            columns.append(np.full(len(numbers), name))
        elif name.startswith("-"):
            columns.append(-next(measured))
        else:
            columns.append(next(measured))
    return np.column_stack(columns)


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
    if key == "position":  # of which more is said
        foreign_units = [unit for unit in foreign_units if unit not in PRESSURE_UNITS]
    converted_units = sorted({unit for unit in units if factors.get(unit, 1.0) != 1.0})
    notes: tuple[str, ...] = ()
    if converted_units:
        notes = (f"{key}: in {', '.join(converted_units)}, as the file says",)
    remarks = list[str]()
    if foreign_units and factors:
        plain = " or ".join(unit for unit, factor in factors.items() if factor == 1.0)
        remarks.append(
            f"in {', '.join(foreign_units)} as the file says, and taken for {plain}: give its unit,"
            " or a scale"
        )
    return np.array([factors.get(unit, 1.0) for unit in units]), notes, remarks


def _samples(key: str, mapping: ChannelMapping, table: tables.TableColumns) -> recordings.Channel:
    """Make the channel of the rows that are whole, without repeated ones."""
    rows = table.values
    finite = np.isfinite(rows)
    if len(rows) > 1 and not finite.all(axis=1).any():
        columns = joined_names(mapping, ~finite.any(axis=0)) or "one column or another"
        raise InvalidInput(f"{key}: NaN in every row ({columns}); leave the channel out")
    rows = rows[finite.all(axis=1)]
    if mapping.lost == "all zero":
        rows = rows[(rows[:, 1:] != 0.0).any(axis=1)]
    n_missing = len(finite) - len(rows)
    if len(rows) < 2:
        raise InvalidInput(f"fewer than two samples of {key}; leave the channel out")
    back = float((np.maximum.accumulate(rows[:, 0]) - rows[:, 0]).max())
    if mapping.series is not None:
        rows = _of_series(key, mapping, rows)
    n_valid = len(rows)
    rows = without_echoes(rows)
    times = rows[:, 0]
    if mapping.sent_every is None:
        send_times = times
    else:
        send_times = even_send_times(times, mapping.sent_every)
    t, first = np.unique(send_times, return_index=True)
    if len(t) < 2:
        raise InvalidInput(
            f"{key}: all {n_valid} samples have the time {t[0]:g} s; give as time another column or"
            " field that rises, or the period [s] of rows"
        )
    return recordings.Channel(
        t=t,
        values=_converted(key, mapping, rows[first, 1:]),
        delay=mapping.delay,
        back=back,
        repeated=len(times) - len(t),
        echoes=n_valid - len(times),
        missing=n_missing,
        constants=tuple(
            k for k, name in enumerate(mapping.columns_of_parts) if not isinstance(name, str)
        ),
        columns=mapping.part_names,
    )


def _of_series(key: str, mapping: ChannelMapping, rows: np.ndarray) -> np.ndarray:
    """Return the rows (n, 1 + k) of one of several series that alternate in a channel. Raises
    InvalidInput where they are not told apart, or where there is no such series.
    """
    numbers = numbers_of_series(_converted(key, mapping, rows[:, 1:]))
    if numbers is None:
        raise InvalidInput(
            f"{key}: series: {mapping.series} given; its samples are not two series that are far"
            " apart: leave it out, or give rows that tell senders apart"
        )
    if mapping.series not in numbers:
        raise InvalidInput(f"{key}: series: {mapping.series} given; allowed: 1 to {numbers.max()}")
    return rows[numbers == mapping.series]


def _converted(key: str, mapping: ChannelMapping, values: np.ndarray) -> np.ndarray:
    """Turn values to axes with z up and forward-left-up, and attitudes to quaternions."""
    if key == "attitude":
        return continuous_quaternions(_quaternions(mapping, values))
    frame = mapping.frame or recordings.CHANNEL_KINDS[key].frame
    has_z_down = (frame == "W" and mapping.world == "NED") or (
        frame == "B" and mapping.body == "FRD"
    )
    if has_z_down:
        return values * np.tile(np.diag(_DOWN), values.shape[1] // 3)
    return values


def _quaternions(mapping: ChannelMapping, values: np.ndarray) -> np.ndarray:
    """Convert values to attitudes (n, 4) of B in W."""
    from scipy.spatial.transform import Rotation

    width = 3 if mapping.has_angles else 4
    if values.shape[1] != width:
        raise InvalidInput(
            f"attitude: {values.shape[1]} columns given; allowed: 4, or 3 with format: rpy"
        )
    if width == 3 and np.abs(values[:, :2]).max() > LARGEST_ANGLE:
        extreme = float(values.flat[np.argmax(np.abs(values))])
        is_extreme = (values == extreme).any(axis=1)
        next_largest = np.abs(values[values != extreme]).max(initial=0.0)
        raw = extreme / units_of("attitude", "rpy")[mapping.unit or "rad"]
        if is_extreme.sum() > 1 and abs(extreme) > 2.0 * next_largest:
            raise InvalidInput(
                f"attitude: {raw:.10g} in {is_extreme.sum()} of {len(values)} rows: give missing:"
                f" [{raw:.10g}]"
            )
        raise InvalidInput(
            f"attitude: angles up to {np.abs(values).max():.4g} rad given; in deg? give its unit"
        )
    if width == 3:
        R = Rotation.from_quat(quaternions_of_angles(values, mapping.format or "rpy"))
    else:
        R = Rotation.from_quat(values, scalar_first=mapping.format == "quaternion wxyz")
    world = Rotation.from_matrix(_DOWN if mapping.world == "NED" else np.eye(3))
    body = Rotation.from_matrix(_DOWN if mapping.body == "FRD" else np.eye(3))
    return np.asarray((world * R * body).as_quat())
