"""Doubt a mapping by the columns of its file: columns that stand twice, pressures read as metres, rows
without numbers, angles in degrees, times in another unit.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from uvms_ocp.identification import recording as recordings, tables
from uvms_ocp.identification.channel_mapping import ChannelMapping, RecordingMapping
from uvms_ocp.identification.pressure_units import (
    PRESSURE,
    PRESSURE_UNITS,
    TWO_UNITS,
    likely_unit,
    read_in,
    told_by_name,
    unit_by_size,
)

LARGEST_ANGLE = 2.5 * np.pi
"""[rad] largest roll, pitch and yaw of files, unless yaw is unwound."""
_MIN_SAMPLES = 10  # from which on a rate is known
_EVEN_SHARE = 0.98  # share of intervals that are the usual one, where rows are sent evenly
_ABOVE_SURFACE = 0.5  # [m] height that no depth has throughout
_NORM_ERROR = 0.05  # error of the norm of a quaternion that few digits do not explain
_MIN_INTERVALS = 20  # times from which on it is said that they are intervals
_LONGEST_INTERVAL = 10.0  # [s] between rows
_MIN_SHARE_BACK = 0.2  # share of times that are not later than the one before
_MIN_SHARE = 0.01  # share of samples from which on such norms are no outliers


def channel_doubts(
    key: str, mapping: ChannelMapping, table: tables.TableColumns
) -> Iterator[tuple[str, str]]:
    """Yield doubts about one channel: columns that stand twice, rows without numbers, and units that
    cannot be.
    """
    for remark in table.remarks:
        yield key, remark
    for text in _interval_doubts(table.values[:, 0]):
        yield key, text
    if key == "position":
        for text in _depth_doubts(mapping, rows=table.values):
            yield key, text
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
        names = joined_names(mapping, is_open.any(axis=0))
        text = f"{n_open} of {len(rows)} rows have NaN ({names}) and are left out"
        if recordings.CHANNEL_KINDS[key].command:
            text += ", and a fit takes the command before them for what was asked"
        yield key, text
    if key == "attitude" and not mapping.has_angles:
        for text in _norm_doubts(rows[:, 1:]):
            yield key, text
    geographic = [name for name in mapping.fields if _is_geographic(name)]
    if key == "position" and geographic:
        yield (
            key,
            (
                f"{', '.join(geographic)} are degrees on the globe: give metres east and north of a"
                " point"
            ),
        )
    is_rpy_without_unit = mapping.has_angles and mapping.unit is None
    if key == "attitude" and is_rpy_without_unit and _like_degrees(rows):
        yield (
            key,
            (
                f"yaw up to {np.nanmax(np.abs(rows[:, 3])):.4g} rad: in deg? give its unit, deg, or"
                " rad where it is so"
            ),
        )


def time_doubts(mapping: RecordingMapping) -> Iterator[tuple[str, str]]:
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


def pressure_remarks(
    mapping: ChannelMapping, file_units: Sequence[str], numbers: np.ndarray
) -> Iterator[str]:
    """Yield a doubt about a height, the last of numbers (n, 3), that is a pressure by the name or the
    unit of its column, and is read as metres.
    """
    name = mapping.columns[-1]
    if not isinstance(name, str) or mapping.scale != 1.0 or mapping.unit is not None:
        return
    is_pressure, unit = told_by_name(name)
    unit_in_file = ""
    if file_units:
        unit_in_file = recordings.unit_named(file_units[-1])
    if unit_in_file in PRESSURE_UNITS:
        is_pressure = True
        unit = unit_in_file
    known_heights = numbers[np.isfinite(numbers[:, -1]), -1]
    if not is_pressure or not len(known_heights):
        return
    sign = -1.0 if name.startswith("-") else 1.0
    pressures = sign * known_heights
    unit = unit or unit_by_size(pressures)
    is_of_two_units = TWO_UNITS[0] < pressures.min() < TWO_UNITS[1]
    if not unit and pressures.min() > PRESSURE and not is_of_two_units:
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


def _interval_doubts(t: np.ndarray) -> Iterator[str]:
    """Yield a doubt about times (n,) [s] that are all alike, as intervals between rows are."""
    t = t[np.isfinite(t)]
    if len(t) < _MIN_INTERVALS or not 0.0 < t.min() < _LONGEST_INTERVAL:
        return
    goes_back = (np.diff(t) <= 0.0).mean() > _MIN_SHARE_BACK
    if goes_back and np.ptp(np.percentile(t, [5.0, 95.0])) < np.median(t):
        mean = float(t.mean())
        yield f"its times are all about {mean:.3g} s: intervals between rows? give time: {mean:.4g}"


def _depth_doubts(mapping: ChannelMapping, rows: np.ndarray) -> Iterator[str]:
    """Yield a doubt about a depth, by its name, of rows (n, 4) that is above the surface throughout."""
    name = str(mapping.columns[-1])
    if "depth" not in name.lower() or rows.shape[1] != 4 or not np.isfinite(rows[:, 3]).any():
        return
    up = -1.0 if mapping.world == "NED" else 1.0
    lowest = float(np.nanmin(up * rows[:, 3]))
    if lowest > _ABOVE_SURFACE:
        yield (
            f"{name} is {lowest:.3g} m and more above a surface at 0: a depth of the other sign? give"
            " the opposite"
        )


def _norm_doubts(quaternions: np.ndarray) -> Iterator[str]:
    """Yield a doubt about quaternions (n, 4) of which some are far from norm 1; NaN and zeros are
    none.
    """
    norms = np.linalg.norm(quaternions, axis=1)
    norms = norms[np.isfinite(norms) & (norms > 0.0)]
    is_far = np.abs(norms - 1.0) > _NORM_ERROR
    if is_far.sum() > _MIN_SHARE * len(norms):
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
    if len(yaw) < 2 or np.abs(yaw).max() < LARGEST_ANGLE:
        return False
    rates = np.abs(np.diff(yaw)) / np.maximum(np.diff(t), 1e-9)
    return bool(abs(yaw[0]) > LARGEST_ANGLE or np.percentile(rates, 90.0) > np.pi)


def _is_sent_evenly(is_open: np.ndarray) -> bool:
    """Check whether rows (n, 1 + k) [bool] without any number are those between samples of a sensor
    that is slower than its table: whole rows come evenly.
    """
    is_empty = is_open[:, 1:].all(axis=1)
    is_whole = ~is_open.any(axis=1)
    if not (is_empty | is_whole).all() or is_whole.sum() < _MIN_SAMPLES:
        return False
    strides = np.diff(np.flatnonzero(is_whole))
    usual = np.median(strides)
    return bool(usual >= 2 and (np.abs(strides - usual) <= 1).mean() > _EVEN_SHARE)


def joined_names(mapping: ChannelMapping, chosen: np.ndarray) -> str:
    """Join the names of time and columns where chosen (1 + k,) is true; a path to an array stands
    for all of its columns.
    """
    names = [str(mapping.time or "time"), *map(str, mapping.columns_of_parts)]
    if len(names) != len(chosen):
        return ", ".join(names[1:])
    return ", ".join(name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen)
