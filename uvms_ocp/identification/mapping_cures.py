"""Cure a proposed mapping: a cure of a doubt about a first reading is applied, and kept where fewer
doubts are left and nothing speaks against it.

The cures of each doubt stand in ``proposed_mapping.toml``. A time column has one unit, whichever
channel shows it. A cure of the whole file that one channel alone would explain as well is said to
be one of two.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from uvms_ocp.errors import UvmsError
from uvms_ocp.identification import data_quality
from uvms_ocp.identification.channel_mapping import RecordingMapping, frames_of
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import CHANNEL_KINDS

_ROUNDS = 3  # of cures: one may show doubts that another one cures

MappedChannels = dict[str, dict[str, Any]]
"""Keys of each channel of a mapping, as in `RecordingMapping`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Doubt:
    """A doubt about one channel, or the error for which it cannot be read."""

    channel: str
    """Name of the channel."""
    problem: str
    """Evidence for the doubt, or the error, in words."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FirstReading:
    """Result of reading a recording by a proposed mapping."""

    ranges: Mapping[str, str]
    """Smallest and largest value, and rate, of each channel that can be read."""
    doubts: Sequence[Doubt]
    """Doubts about the channels, and errors of those that cannot be read."""
    is_above_water: bool = False
    """True where every height is above 0: some world has its zero at the bottom, but not most."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Candidate:
    """A mapping with one cure applied."""

    channel: str
    """Name of the channel that the cure is about."""
    channels: MappedChannels
    """Channels of the mapping with the cure."""
    keys: str
    """Keys of the mapping that make the cure, as YAML."""
    is_of_whole_file: bool
    """True if the cure changes all channels."""


def proposed_columns(channel: Mapping[str, Any]) -> list[str | float]:
    """Return the columns of a proposed channel, of all its parts one after the other."""
    columns: list[str | float] = []
    for source in channel.get("parts", [channel]):
        columns += source["columns"]
    return columns


def apply_cures(
    path: Path, channels: MappedChannels, cures: Sequence[Mapping[str, Any]]
) -> tuple[MappedChannels, Mapping[str, list[str]]]:
    """Apply to each doubt the cure that leaves the fewest doubts.

    Returns the cured channels, and by channel the doubts that were cured.
    """
    cured = defaultdict[str, list[str]](list)
    result = first_reading(path, channels)
    for _ in range(_ROUNDS):
        for doubt in result.doubts:
            if doubt not in result.doubts:  # cured together with another
                continue
            doubts_before = result.doubts
            lowest_score = _score(channels, result, doubts_before)
            best = None
            rival = None
            for candidate in _candidates(doubt, channels, cures):
                candidate_result = first_reading(path, candidate.channels)
                score = _score(candidate.channels, candidate_result, doubts_before)
                if score < lowest_score:
                    lowest_score = score
                    best = (candidate, candidate_result)
                    rival = None
                elif score == lowest_score and rival is None and not candidate.is_of_whole_file:
                    rival = candidate
            if best is not None:
                chosen, result = best
                channels = chosen.channels
                cured[chosen.channel].append(_cured_text(doubt, chosen, rival))
    return channels, cured


def _cured_text(doubt: Doubt, chosen: _Candidate, rival: _Candidate | None) -> str:
    """Write the doubt that was cured, and keys of one channel alone that would cure it as well."""
    if rival is None or not chosen.is_of_whole_file:
        return doubt.problem
    return (
        f"{doubt.problem} ({rival.keys} of {rival.channel} alone would explain it as well: which"
        " is so?)"
    )


def first_reading(path: Path, channels: MappedChannels) -> FirstReading:
    """Read a recording by a proposed mapping; a channel that cannot be read is left out, and its
    error is a doubt.
    """
    try:
        mapping = RecordingMapping.model_validate({"channels": channels})
        recording = mapped_recording(path, mapping)
    except UvmsError as error:
        return _reading_without_a_channel(path, channels, str(error))
    ranges = {}
    for name, channel in recording.channels.items():
        lowest = channel.values.min()
        highest = channel.values.max()
        unit = CHANNEL_KINDS[name].unit
        ranges[name] = f"{lowest:.4g} to {highest:.4g} {unit} at {channel.rate:.3g} Hz"
    doubts = []
    for issue in data_quality.check_data_quality(recording):
        if "are left out" not in issue.problem:
            doubts.append(Doubt(channel=issue.channel, problem=issue.problem))
    position = recording.channels.get("position")
    is_above_water = position is not None and bool(position.values[:, 2].min() > 0.0)
    return FirstReading(ranges=ranges, doubts=doubts, is_above_water=is_above_water)


def _reading_without_a_channel(path: Path, channels: MappedChannels, error: str) -> FirstReading:
    """Read a recording without the channel that an error names first."""

    def place_in_error(name: str) -> int:
        place = error.find(name)
        if place < 0:
            return len(error)
        return place

    unreadable = min(channels, key=place_in_error)
    doubt = Doubt(channel=unreadable, problem=error)
    readable = {name: keys for name, keys in channels.items() if name != unreadable}
    if not readable:
        return FirstReading(ranges={}, doubts=[doubt])
    result = first_reading(path, readable)
    return FirstReading(
        ranges=result.ranges,
        doubts=[doubt, *result.doubts],
        is_above_water=result.is_above_water,
    )


def _score(
    channels: MappedChannels, result: FirstReading, doubts_before: Sequence[Doubt]
) -> tuple[int, int, int, bool]:
    """Score the channels after a cure, less is better: channels that cannot be read, doubts, former
    doubts whose channel can no longer be read, and whether the vehicle is above the water.
    """
    n_unreadable = len(channels) - len(result.ranges)
    # A doubt about degrees hides others, that would follow from these values.
    n_hiding = sum("rad: in deg?" in doubt.problem for doubt in result.doubts)
    n_hidden = 0
    for doubt in result.doubts:
        if doubt.channel not in result.ranges and doubt in doubts_before:
            n_hidden += 1
    return n_unreadable + n_hiding, len(result.doubts), n_hidden, result.is_above_water


def _candidates(
    doubt: Doubt, channels: MappedChannels, cures: Sequence[Mapping[str, Any]]
) -> Iterator[_Candidate]:
    """Yield all channels with each cure of a doubt applied."""
    for cure in cures:
        match = re.search(cure["doubt"], doubt.problem)
        if match is None or cure.get("channel", doubt.channel) != doubt.channel:
            continue
        channel = cure.get("of", doubt.channel)
        if channel not in channels:
            continue
        last_column = str(proposed_columns(channels[channel])[-1])
        if not re.search(cure.get("last_column", ""), last_column.lower()):
            continue
        groups = match.groupdict()
        keys = yaml.safe_load(cure.get("keys", "{}").replace("VALUE", groups.get("value", "")))
        axes = cure.get("axes", groups.get("axes", ""))
        if axes:
            keys["columns"] = _turned(channels[channel], axes.split(", "))
        new_name = channel
        if "all" in cure:
            cured_channels = _with_frames(channels, keys)
        elif "same_time" in cure:
            cured_channels = _with_time(channels, channel, keys)
        elif keys.get("columns") == []:
            continue
        else:
            new_name = cure.get("becomes", channel)
            cured_channels = _with_keys(channels, channel, new_name, keys)
        yield _Candidate(
            channel=new_name,
            channels=cured_channels,
            keys=yaml.safe_dump(keys, default_flow_style=True).strip(),
            is_of_whole_file="all" in cure,
        )


def _with_time(channels: MappedChannels, channel: str, keys: Mapping[str, Any]) -> MappedChannels:
    """Set keys such as ``time_unit`` in all channels that have their times from the same column."""
    source = [channels[channel].get(key) for key in ("file", "topic", "time")]
    changed = MappedChannels()
    for name, old_keys in channels.items():
        changed[name] = old_keys
        if [old_keys.get(key) for key in ("file", "topic", "time")] == source:
            changed[name] = {**old_keys, **keys}
    return changed


def _with_frames(channels: MappedChannels, keys: Mapping[str, Any]) -> MappedChannels:
    """Set keys such as ``world`` in all channels that have such a frame."""
    changed = MappedChannels()
    for name, channel in channels.items():
        frames = frames_of(name, channel.get("frame"))
        changed[name] = channel | {key: value for key, value in keys.items() if key in frames}
    return changed


def _with_keys(
    channels: MappedChannels, channel: str, new_name: str, keys: Mapping[str, Any]
) -> MappedChannels:
    """Set keys of one channel, and its name."""
    changed = MappedChannels()
    for name, old_keys in channels.items():
        if name == channel:
            changed[new_name] = {**old_keys, **keys, **_composed_scale(old_keys, keys)}
        else:
            changed[name] = old_keys
    return changed


def _composed_scale(old_keys: Mapping[str, Any], keys: Mapping[str, Any]) -> dict[str, Any]:
    """Compose offset and scale of a channel with those of a cure; empty where only one of the two
    has any.
    """
    if "scale" not in keys or not {"offset", "scale"} & old_keys.keys():
        return {}
    old_offset = np.asarray(old_keys.get("offset", 0.0))
    old_scale = np.asarray(old_keys.get("scale", 1.0))
    offset = old_offset + np.asarray(keys.get("offset", 0.0)) / old_scale
    scale = old_scale * np.asarray(keys["scale"])
    composed = {"scale": scale.tolist()}
    if np.any(offset):
        composed["offset"] = offset.tolist()
    return composed


def _turned(channel: Mapping[str, Any], axes: Sequence[str]) -> list[str | float]:
    """Return columns of a channel for axes such as ``-y``; empty unless there is an axis for each
    column.
    """
    if "parts" in channel or len(channel["columns"]) != len(axes):
        return []
    letters = "wxyz" if str(channel.get("format")).endswith("wxyz") else "xyzw"
    columns = dict(zip(letters, channel["columns"], strict=False))
    turned = {}
    for axis in axes:
        letter = axis[-1]
        if axis[0] == "-":
            turned[letter] = _opposite(columns[letter])
        else:
            turned[letter] = columns[letter]
    if len(axes) == len(letters):
        return [turned[letter] for letter in letters]
    return [turned[axis[-1]] for axis in axes]


def _opposite(column: str | float) -> str | float:
    """Return a column with the other sign."""
    if isinstance(column, float):
        return -column
    if column.startswith("-"):
        return column[1:]
    return f"-{column}"
