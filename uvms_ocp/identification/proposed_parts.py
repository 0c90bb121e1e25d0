"""Propose commands that come in parts: topics that differ in the number of a thruster alone, and columns
with a column of times for each number.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.identification import tables

_OF_THRUSTER = re.compile(
    r"(?P<before>.*?)(?P<word>thrusters?|thrust|motors?|propellers?|esc|pwm)_?(?P<number>\d+)"
    r"(?P<after>(?!\d).*)"
)
"""Topic of one thruster, in small letters with ``_`` between words."""
_COMMANDED = re.compile(
    r"|.*_(cmds?|commands?|inputs?|thrust|pwm|set_?points?|refs?|efforts?)(_.*)?"
)
"""What may follow the number in a topic of commands: one of these words, or nothing."""
_NUMBERED = re.compile(r"(?P<before>.*?)_?(?P<number>\d+)(?P<after>(_[a-z]+)*)")
_TIME_WORDS = {"t", "ts", "time", "timestamp", "stamp", "secs", "seconds"}
_BESIDE_VALUE = ("header.", "stamp.", "layout.")
"""Beginnings of fields that are none of the values of a message."""
_LEAST = 2  # thrusters

_Series = dict[int, str]
"""Names by the number in them."""


def topics_of_thrusters(
    labels_by_topic: Mapping[str, Collection[str]], plain_names: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return the parts of commands that have a topic for each thruster, in the order of their numbers;
    empty where there are none.

    labels_by_topic: fields of a message of each topic; one that was sent once has none.
    plain_names: topics in small letters, with ``_`` between words.
    """
    topics_by_group = defaultdict[tuple[str, ...], _Series](dict)
    for topic in labels_by_topic:
        match = _OF_THRUSTER.fullmatch(plain_names[topic])
        if match and _COMMANDED.fullmatch(match["after"]):
            group = (match["before"], match["word"], match["after"])
            topics_by_group[group][int(match["number"])] = topic
    largest_group = max(topics_by_group.values(), key=len, default={})
    fields = [_value_fields(labels_by_topic[topic]) for topic in largest_group.values()]
    known_fields = [names for names in fields if names]
    if len(largest_group) < _LEAST or not known_fields:
        return []
    columns = known_fields[0]
    if len(columns) != 1 or any(names != columns for names in known_fields):
        return []
    parts = []
    for number in sorted(largest_group):
        topic = largest_group[number]
        part: dict[str, Any] = {"topic": topic}
        if any(name.startswith("header.stamp") for name in labels_by_topic[topic]):
            part["time"] = "header.stamp"
        parts.append(part | {"columns": list(columns)})
    return parts


def _value_fields(names: Collection[str]) -> list[str]:
    """List the fields of a message that are neither of its header nor of a layout."""
    return [name for name in names if not name.startswith(_BESIDE_VALUE)]


def times_of_columns(path: Path, plain_names: Mapping[str, str]) -> dict[str, str]:
    """Return the column of times of each column that has one of its own, by the number of both, as
    ``t_1`` of ``thruster_1``: times rise throughout.

    plain_names: columns in small letters, with ``_`` between words.
    """
    series = defaultdict[tuple[str, str], _Series](dict)
    for name, plain in plain_names.items():
        match = _NUMBERED.fullmatch(plain)
        if match:
            series[match["before"], match["after"]][int(match["number"])] = name
    times_of = {}
    for words, times in series.items():
        if len(times) < _LEAST or not _are_of_time(words):
            continue
        if not _rise(tables.read_columns(path, list(times.values()))):
            continue
        for other_words, names in series.items():
            if not _are_of_time(other_words) and names.keys() == times.keys():
                for number, name in names.items():
                    times_of[name] = times[number]
    return times_of


def _are_of_time(words: Sequence[str]) -> bool:
    """Check whether the words of a name, without its number, are those of a time."""
    return bool(_TIME_WORDS & set("_".join(words).split("_")))


def _rise(columns: np.ndarray) -> bool:
    """Check whether all columns (n, k) rise throughout, where they have numbers."""
    for column in columns.T:
        known = column[np.isfinite(column)]
        if len(known) < 2 or (np.diff(known) <= 0.0).any():
            return False
    return True


def with_own_times(channel: Mapping[str, Any], times_of: Mapping[str, str]) -> dict[str, Any]:
    """Return a proposed channel with a part for each of its columns, if each has times of its own."""
    columns = channel["columns"]
    if not all(str(column) in times_of for column in columns):
        return dict(channel)
    parts = [{"time": times_of[column], "columns": [column]} for column in columns]
    others = {
        key: value for key, value in channel.items() if key not in ("time", "time_unit", "columns")
    }
    return {"parts": parts, **others}
