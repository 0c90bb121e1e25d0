"""Read recordings of other software by a mapping of their columns: times to seconds, values to the
unit, the axes and the frame of their channel, without what is missing or repeated.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import file_kinds, recording as recordings, tables
from uvms_ocp.identification.channel_mapping import (
    ChannelMapping,
    RecordingMapping,
    require_meaning,
    units_of,
)
from uvms_ocp.identification.clock_segments import continued as continued_clocks
from uvms_ocp.identification.messages import TopicColumns, message_rows, topics_of
from uvms_ocp.identification.pressure_units import (
    PRESSURE,
    PRESSURE_UNITS,
    likely_unit,
    read_in,
    told_by_name,
    unit_by_size,
)
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.text_tables import TextFormat
from uvms_ocp.robot.spatial import continuous_quaternions

_DAY = 86_400.0  # [s]
_AROUND_MIDNIGHT = 600.0  # [s] on each side, within which times of day go on to the next day
_DOWN = np.diag([1.0, -1.0, -1.0])  # from axes with z down to axes with z up, and back
_FOREIGN = 0.5  # of all rows, above which those without any cell are of other channels
# [rad] of roll, pitch and yaw as files have them, unless yaw is unwound
_LARGEST_ANGLE = 2.5 * np.pi
# of the usual interval, within which a message that says the same again is the same message
_AT_ONCE = 0.05
_FEW = 10  # samples that tell no rate
_EVENLY = 0.98  # of all intervals that are the usual one, of what is sent evenly
_ABOVE = 0.5  # [m] above the surface, that no depth is throughout
_NORM_ERROR = 0.05  # of a quaternion, beyond what few digits make of it
_OFTEN = 0.01  # of all samples, from which on such norms are no outliers
_UNIX_TIME = {"ns": 1e17, "us": 1e14, "ms": 1e11}
"""Least number of a time since 1970 in each unit: read as seconds it would be some thousand
years.
"""


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
    rows = _mapped_rows(source, mapping, name)
    _pass_midnight(rows.values())
    clocks = continued_clocks({key: table.values[:, 0] for key, table in rows.items()})
    for key, t in clocks.times.items():
        rows[key] = replace(rows[key], values=np.column_stack([t, rows[key].values[:, 1:]]))
    channels = {}
    for key, channel_mapping in mapping.channels.items():
        channels[key] = _samples(key, channel_mapping, rows[key])
    channels_in_body = dict(channels)
    for key, channel_mapping in mapping.channels.items():
        if channel_mapping.frame == "W":
            channels_in_body[key] = replace(channels[key], values=_in_body(key, channels))
    start = min(channel.t[0] for channel in channels_in_body.values())
    issues = list(_time_doubts(mapping))
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
        issues.extend(_doubts(key, channel_mapping, rows[key]))
    for table in rows.values():
        notes += [table.layout, *table.notes]
    return recordings.Recording(
        name=name,
        channels={
            key: replace(channel, t=channel.t - start) for key, channel in channels_in_body.items()
        },
        issues_in_file=tuple(issues),
        layout=tuple(note for note in dict.fromkeys(notes) if note),
    )


def _in_body(key: str, read: Mapping[str, recordings.Channel]) -> np.ndarray:
    """Turn values of a channel from W to B."""
    if "attitude" not in read:
        raise InvalidInput(
            f"{key}: frame: W given, which needs the attitude; give that channel too"
        )
    R = rotations(read["attitude"], read[key].undelayed_t)
    vectors = read[key].values.reshape(len(R), -1, 3)
    return np.einsum("nji,nkj->nki", R, vectors).reshape(len(R), -1)


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
        path = source / channel.file.replace("{name}", name) if channel.file else source
        if file_kinds.holds_messages(path):
            # Messages that name no type are of the topic "".
            if not channel.topic and "" not in known_topics(path):
                raise InvalidInput(
                    f"{path}: {key} has no topic; give one of {', '.join(known_topics(path))}"
                )
            time = channel.time if isinstance(channel.time, str) else ""
            unit = recordings.SECONDS[channel.time_unit or "s"]
            by_path[path][key] = TopicColumns(
                topic=channel.topic,
                columns=channel.fields,
                time=time,
                unit=unit,
                rows=tuple(channel.rows.items()),
            )
        else:
            table = _table_rows(key, channel, path, mapping.table)
            tables_by_key[key] = _in_unit(key, channel, _chosen(key, channel, table))
    definitions = Path(mapping.messages) if mapping.messages else None
    for path, topics in by_path.items():
        for key, rows in message_rows(path, topics, definitions).items():
            channel = mapping.channels[key]
            has_seconds = channel.time_unit and isinstance(channel.time, str)
            table = rows if has_seconds else _in_seconds(channel, rows)
            tables_by_key[key] = _in_unit(key, channel, table)
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
        unit = _unix_unit(largest)
        if unit != "s":
            note = f"times in {unit}"
            layout = f"{layout}, {note}" if layout else note
    seconds = recordings.SECONDS[unit] * times
    return replace(rows, values=np.column_stack([seconds, rows.values[:, 1:]]), layout=layout)


def _unix_unit(largest: float) -> str:
    """Return the unit in which a time, if it is one since 1970, is of its size; else s."""
    for unit, smallest in _UNIX_TIME.items():
        if largest >= smallest:
            return unit
    return "s"


def _table_rows(
    key: str, mapping: ChannelMapping, path: Path, text_format: TextFormat | None
) -> tables.TableColumns:
    """Read the rows of one channel from a table: times [s], its columns, and those that choose
    rows.
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
    return replace(table, layout=f"{path.name}: {table.layout}" if table.layout else "")


def _chosen(key: str, mapping: ChannelMapping, table: tables.TableColumns) -> tables.TableColumns:
    """Choose the rows of a channel in a table."""
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
    if _FOREIGN * len(is_empty) < is_empty.sum() < len(is_empty):  # rows of other channels
        values = values[~is_empty]
    times = values[:, 0]
    numbers = values[:, 1:]
    for missing in mapping.missing:
        numbers = np.where(np.isclose(numbers, missing, rtol=1e-12), np.nan, numbers)
    file_units = table.units[1 : values.shape[1]]
    factors, notes, remarks = _factors(key, mapping, file_units)
    numbers = _with_constants(mapping, numbers * factors)
    if key == "position":
        remarks = [*_pressure_remarks(mapping, file_units, numbers), *remarks]
    if key == "attitude" and mapping.format != "rpy" and mapping.lost == "never":
        # Zeros: its sender knows no attitude.
        norms = np.linalg.norm(numbers, axis=1, keepdims=True)
        numbers = np.where(norms > 0.0, numbers, np.nan)
    numbers = (numbers + np.asarray(mapping.offset)) * np.asarray(mapping.scale)
    return replace(
        table,
        values=np.column_stack([times, numbers]),
        units=(),
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


def _is_sent_evenly(is_open: np.ndarray) -> bool:
    """Check whether rows (n, 1 + k) [bool] without any number are those between samples of a sensor
    that is slower than its table: whole rows come evenly.
    """
    is_empty = is_open[:, 1:].all(axis=1)
    is_whole = ~is_open.any(axis=1)
    if not (is_empty | is_whole).all() or is_whole.sum() < _FEW:
        return False
    strides = np.diff(np.flatnonzero(is_whole))
    usual = np.median(strides)
    return bool(usual >= 2 and (np.abs(strides - usual) <= 1).mean() > _EVENLY)


def _pressure_remarks(
    mapping: ChannelMapping, file_units: Sequence[str], numbers: np.ndarray
) -> Iterator[str]:
    """Yield a doubt about a height, the last of numbers (n, 3), that is a pressure by the name or the
    unit of its column, and is read as metres.
    """
    name = mapping.columns[-1]
    if not isinstance(name, str) or mapping.scale != 1.0 or mapping.unit is not None:
        return
    is_pressure, unit = told_by_name(name)
    unit_in_file = recordings.unit_named(file_units[-1]) if file_units else ""
    if unit_in_file in PRESSURE_UNITS:
        is_pressure = True
        unit = unit_in_file
    known_heights = numbers[np.isfinite(numbers[:, -1]), -1]
    if not is_pressure or not len(known_heights):
        return
    sign = -1.0 if name.startswith("-") else 1.0
    pressures = sign * known_heights
    unit = unit or unit_by_size(pressures)
    if not unit and pressures.min() > PRESSURE:
        unit = likely_unit(pressures)
    if unit:
        reading = read_in(unit, pressures)
        yield (
            f"{name} is a pressure in {unit}, read as m, {reading.evidence}: give"
            f" {reading.keys(sign)}"
        )
    else:
        yield (
            f"{name} is a pressure in a unit that nothing tells, read as m: give its offset and"
            f" scale, as of kPa {read_in('kPa', np.array([200.0])).keys(sign)}"
        )


def _doubts(
    key: str, mapping: ChannelMapping, table: tables.TableColumns
) -> Iterator[tuple[str, str]]:
    """Yield doubts about columns that stand twice, rows that are no numbers, and units that cannot
    be.
    """
    for remark in table.remarks:
        yield key, remark
    if key == "position":
        yield from ((key, text) for text in _depth_doubts(mapping, rows=table.values))
    repeated = sorted({name for name in mapping.fields if mapping.fields.count(name) > 1})
    if repeated:
        yield (
            key,
            (
                f"{', '.join(repeated)} stands for more than one of its axes: give a number for"
                " what is not measured"
            ),
        )
    rows = table.values
    is_open = ~np.isfinite(rows)
    n_open = int(is_open.any(axis=1).sum())
    if n_open and not _is_sent_evenly(is_open):
        names = _named(mapping, is_open.any(axis=0))
        text = f"{n_open} of {len(rows)} rows have NaN ({names}) and are left out"
        if recordings.CHANNEL_KINDS[key].command:
            text += ", and a fit takes the command before them for what was asked"
        yield key, text
    if key == "attitude" and mapping.format != "rpy":
        yield from (("attitude", text) for text in _norm_doubts(rows[:, 1:]))
    geographic = [name for name in mapping.fields if _is_geographic(name)]
    if key == "position" and geographic:
        yield (
            key,
            (
                f"{', '.join(geographic)} are degrees on the globe: give metres east and north of a"
                " point"
            ),
        )
    is_rpy_without_unit = mapping.format == "rpy" and mapping.unit is None
    if key == "attitude" and is_rpy_without_unit and _like_degrees(rows):
        yield (
            key,
            (
                f"yaw up to {np.nanmax(np.abs(rows[:, 3])):.4g} rad: in deg? give its unit, deg, or"
                " rad where it is so"
            ),
        )


def _depth_doubts(mapping: ChannelMapping, rows: np.ndarray) -> Iterator[str]:
    """Yield a doubt about a depth, by its name, of rows (n, 4) that is above the surface throughout."""
    name = str(mapping.columns[-1])
    if "depth" not in name.lower() or rows.shape[1] != 4 or not np.isfinite(rows[:, 3]).any():
        return
    up = -1.0 if mapping.world == "NED" else 1.0
    lowest = float(np.nanmin(up * rows[:, 3]))
    if lowest > _ABOVE:
        yield (
            f"{name} is {lowest:.3g} m and more above a surface at 0: a depth of the other sign? give"
            " the opposite"
        )


def _time_doubts(mapping: RecordingMapping) -> Iterator[tuple[str, str]]:
    """Yield channels whose times are read from the same column as those of most others, and in
    another unit.
    """
    by_source = defaultdict[tuple[str, str, object], dict[str, str]](dict)
    for key, channel in mapping.channels.items():
        if channel.time and not isinstance(channel.time, float):
            source = (channel.file, channel.topic, channel.time)
            by_source[source][key] = channel.time_unit or "s"
    for (_, _, time), units in by_source.items():
        usual_unit, _ = Counter(units.values()).most_common(1)[0]
        for key, unit in units.items():
            if unit != usual_unit:
                yield (
                    key,
                    (
                        f"its times are the column {time} in {unit}, and other channels read it in"
                        f" {usual_unit}: give time_unit: {usual_unit}"
                    ),
                )


def _norm_doubts(quaternions: np.ndarray) -> Iterator[str]:
    """Yield a doubt about quaternions (n, 4) of which some are far from norm 1; NaN and zeros are
    none.
    """
    norms = np.linalg.norm(quaternions, axis=1)
    norms = norms[np.isfinite(norms) & (norms > 0.0)]
    is_far = np.abs(norms - 1.0) > _NORM_ERROR
    if is_far.sum() > _OFTEN * len(norms):
        yield (
            f"{is_far.sum()} of {len(norms)} quaternions have a norm of {norms[is_far].min():.3g} to"
            f" {norms[is_far].max():.3g}, and those of attitudes have 1: other columns, another format"
            " or scale?"
        )


def _is_geographic(name: str) -> bool:
    """Recognise a latitude or a longitude by its name."""
    last_step = name.rpartition(".")[2].lower()
    return last_step.startswith(("lat", "lon", "lng"))


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
    """Make the channel of the rows that are whole, without repeated ones."""
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
    n_valid = len(rows)
    rows = _without_echoes(rows)
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
        missing=len(finite) - n_valid,
        constants=tuple(k for k, name in enumerate(mapping.columns) if not isinstance(name, str)),
    )


def _pass_midnight(tables_read: Iterable[tables.TableColumns]) -> None:
    """Let times of day [s] go on from one day to the next, in all channels where those of any do;
    other times stay.

    All are then within half a day, from middle to middle, of the first that does.
    """
    columns = [table.values[:, 0] for table in tables_read]
    times_of_day = [t for t in columns if _are_times_of_day(t)]
    continued_times = [_continued(t[np.isfinite(t)]) for t in times_of_day]
    first_middle = None
    for continued in continued_times:
        if continued.min() < 0.0 or continued.max() >= _DAY:
            first_middle = _middle(continued)
            break
    if first_middle is None:
        return
    for column, continued in zip(times_of_day, continued_times, strict=True):
        n_days = np.round((first_middle - _middle(continued)) / _DAY)
        column[np.isfinite(column)] = continued + _DAY * n_days


def _are_times_of_day(t: np.ndarray) -> bool:
    """Check that times (n,) [s], of which some are finite, lie within a day."""
    is_outside = (t < 0.0) | (t >= _DAY)
    return bool(np.isfinite(t).any() and not is_outside.any())


def _continued(t: np.ndarray) -> np.ndarray:
    """Let times of day (n,) [s] go on after midnight."""
    return np.unwrap(t, _DAY - 2.0 * _AROUND_MIDNIGHT, period=_DAY)


def _middle(t: np.ndarray) -> float:
    return 0.5 * float(t.min() + t.max())


def _without_echoes(rows: np.ndarray) -> np.ndarray:
    """Drop rows (n, 1 + k) that repeat the one before at nearly the same time, as republished
    topics do.
    """
    steps = np.diff(rows[:, 0])
    same = (np.diff(rows[:, 1:], axis=0) == 0.0).all(axis=1)
    if (~same).sum() < 2:
        return rows
    usual_step = float(np.median(np.diff(rows[np.r_[True, ~same], 0])))  # [s] between new values
    is_echo = same & (steps >= 0.0) & (steps < _AT_ONCE * usual_step)
    return rows[np.r_[True, ~is_echo]]


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

    width = 3 if mapping.format == "rpy" else 4
    if values.shape[1] != width:
        raise InvalidInput(
            f"attitude: {values.shape[1]} columns given; allowed: 4, or 3 with format: rpy"
        )
    if width == 3 and np.abs(values[:, :2]).max() > _LARGEST_ANGLE:
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
        R = Rotation.from_euler("xyz", values)
    else:
        R = Rotation.from_quat(values, scalar_first=mapping.format == "quaternion wxyz")
    world = Rotation.from_matrix(_DOWN if mapping.world == "NED" else np.eye(3))
    body = Rotation.from_matrix(_DOWN if mapping.body == "FRD" else np.eye(3))
    return np.asarray((world * R * body).as_quat())


def even_send_times(arrived: np.ndarray, period: float) -> np.ndarray:
    """Compute times (n,) [s] at which messages were sent every `period` [s], from when they arrived
    (n,) [s].

    A message was sent no later than it arrived, and at least a period before the next one: of all
    these bounds the least. Where messages are lost, the times after the gap are right again as soon
    as one comes without delay. What all messages are late by stays. Raises InvalidInput for a
    period that is not positive.
    """
    if not period > 0.0:
        raise InvalidInput(f"period = {period} s given; allowed: more than 0")
    since = period * np.arange(len(arrived))
    return np.asarray(np.minimum.accumulate((arrived - since)[::-1])[::-1] + since)
