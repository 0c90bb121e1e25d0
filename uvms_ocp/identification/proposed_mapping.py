"""Propose a mapping for an unknown file: by the names of its columns and fields, then by the doubts that a
first reading of it raises.

Forms of names, and cures of doubts, stand in ``proposed_mapping.toml``. A cure is proposed only where
the recording, read with it, raises fewer doubts than without. Columns without names get names by
their values, which the forms then know.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
import tomllib
import yaml

from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.identification import channel_mapping, file_kinds, tables
from uvms_ocp.identification.column_guesses import GuessedName, guessed_names
from uvms_ocp.identification.mapping_cures import (
    MappedChannels,
    apply_cures,
    first_reading,
    proposed_columns,
)
from uvms_ocp.identification.message_fields import paths_by_name
from uvms_ocp.identification.messages import messages, topics_of
from uvms_ocp.identification.proposed_parts import (
    times_of_columns,
    topics_of_thrusters,
    with_own_times,
)
from uvms_ocp.identification.recording import CHANNEL_KINDS, unit_named

_TABLE = tomllib.loads(
    (files("uvms_ocp.identification") / "proposed_mapping.toml").read_text(encoding="utf-8")
)
_SUFFIX = re.compile(_TABLE["unit"])
_NO_MATCH = re.compile("$.")  # matches nothing
_JOINT_STATE = {"name", "position", "velocity", "effort"}
"""Fields of a message about joints in ROS: names, and arrays in their order."""
_OF_TWO_SENSORS = ("position",)
"""Channels of which some columns may have a unit and others none: a depth is of another sensor than x and
y.
"""
_COPIED_KEYS = ("format", "frame", "world", "body", "offset", "scale")
"""Keys of a mapping that a form may hold."""


def propose_mapping(path: Path) -> str:
    """Propose a mapping as YAML, to be edited: every channel with the evidence for it in comments.

    Raises InvalidInput for a file in which nothing has a name that is known, with the names that
    there are, and NotInstalled.
    """
    of_topics = not path.is_dir() and file_kinds.kind_of(path) in _TABLE["kinds"]
    forms = [form for form in _TABLE["forms"] if ("topic" in form) == of_topics]
    if file_kinds.holds_messages(path):
        labels_by_topic = dict(_fields(path, forms))
    else:
        names = tables.column_names(path)
        labels_by_topic = {"": dict(zip(names, names, strict=True))}
    guesses = _guesses(path, labels_by_topic)
    named_channels = _named_commands_and_channels(path, forms, labels_by_topic, guesses)
    if not named_channels:
        raise InvalidInput(_no_known_name(path, labels_by_topic))
    channels, cured = apply_cures(path, named_channels, _TABLE["cures"])
    result = first_reading(path, channels)

    lines = ["channels:"]
    for name, channel in channels.items():
        keys = yaml.safe_dump(channel, default_flow_style=True, sort_keys=False, width=10_000)
        lines.append(f"  {name}: {keys.strip()}")
        by_values = []
        for column in (str(channel.get("time")), *_names_of(channel)):
            if column in guesses:
                by_values.append(guesses[column].evidence)
        is_constant = 0.0 in proposed_columns(channel)
        is_assumed = not is_constant and not _tells_axes(name, channel, channels)
        notes = [("by values", text) for text in by_values]
        if name in result.ranges:
            notes.append(("by names", result.ranges[name]))
        if "parts" in channel:
            notes.append(("joined", _TABLE["joined"]))
        if is_assumed:
            notes.append(("assumed", _TABLE["assumed"]))
        if is_constant:
            notes.append(("not measured", _TABLE["constant"]))
        notes += [("cured", text) for text in cured[name]]
        notes += [("doubtful", doubt.problem) for doubt in result.doubts if doubt.channel == name]
        for kind, text in dict.fromkeys(notes):
            lines.append(f"    # {kind}: {text}")
    return "\n".join(lines) + "\n"


def _named_commands_and_channels(
    path: Path,
    forms: Sequence[Mapping[str, Any]],
    labels_by_topic: Mapping[str, Mapping[str, str]],
    guesses: Mapping[str, GuessedName],
) -> MappedChannels:
    """Map channels by names; commands in parts where thrusters have topics, or times, of their own."""
    times_of = {}
    labels = dict(labels_by_topic)
    if not file_kinds.holds_messages(path):
        times_of = times_of_columns(path, _plain_names(labels[""]))
        times = set(times_of.values())
        labels[""] = {name: label for name, label in labels[""].items() if name not in times}
    channels = _named_channels(forms, labels, guesses)
    for name, channel in channels.items():
        if CHANNEL_KINDS[name].command:
            channels[name] = with_own_times(channel, times_of)
    if not channels.keys() & {"thrust", "propeller_commands"}:
        parts = topics_of_thrusters(labels, _plain_names(labels))
        if parts:
            channels["thrust"] = {"parts": parts}
    return channels


def _no_known_name(path: Path, labels_by_topic: Mapping[str, Collection[str]]) -> str:
    """Say that a file has no name that is known, and which names it has."""
    lists = []
    for topic, names in labels_by_topic.items():
        lists.append(f"{topic} {', '.join(islice(names, 40))}".strip())
    return (
        f"{path}: nothing in it has a name that is known: {'; '.join(lists)}; write a mapping of"
        " these"
    )


def _tells_axes(name: str, channel: Mapping[str, Any], channels: Collection[str]) -> bool:
    """Check whether a mapping says which way the axes of a channel point, or other channels do."""
    if channel.keys() & {"world", "body", "frame"}:
        return True
    if name not in _TABLE["tells"]:
        return True
    return any(witness in channels for witness in _TABLE["tells"][name])


def _guesses(path: Path, labels_by_topic: Mapping[str, Collection[str]]) -> dict[str, GuessedName]:
    """Guess names by values where columns have numbers alone, #1, #2, ..."""
    names = list(labels_by_topic.get("", ()))
    if not names or any(name != f"#{k}" for k, name in enumerate(names, start=1)):
        return {}
    return guessed_names(names, tables.read_columns(path, names), _TABLE["guesses"])


def _named_channels(
    forms: Sequence[Mapping[str, Any]],
    labels_by_topic: Mapping[str, Mapping[str, str]],
    guesses: Mapping[str, GuessedName],
) -> MappedChannels:
    """Map each channel to the first columns whose names have one of its forms."""
    channels = MappedChannels()
    for form, (topic, labels_in_file) in product(forms, labels_by_topic.items()):
        if form["channel"] in channels or not re.fullmatch(form.get("topic", ".*"), topic):
            continue
        has_companion = any(
            re.fullmatch(form.get("beside", ".*"), _plain(name)) for name in labels_in_file
        )
        if not has_companion:
            continue
        labels = {}
        for name, label in labels_in_file.items():
            if name in guesses:
                labels[name] = guesses[name].name
            else:
                labels[name] = _label(topic, label)
        free_labels = _free_labels(form, labels, _used_names(channels, topic))
        columns = _matched(form, free_labels, _NO_MATCH) or _matched(form, free_labels, _SUFFIX)
        if columns:
            channel: dict[str, Any] = {}
            if topic:
                channel["topic"] = topic
            channel |= _time(labels, of_messages=bool(topic))
            channel["columns"] = columns
            channel |= _keys_of(form, labels, columns)
            channels[form["channel"]] = channel
    return channels


def _used_names(channels: MappedChannels, topic: str) -> set[str]:
    """Return the names of a topic that channels read already."""
    used_names = set[str]()
    for channel in channels.values():
        if channel.get("topic", "") == topic:
            used_names.update(_names_of(channel))
    return used_names


def _free_labels(
    form: Mapping[str, Any], labels: Mapping[str, str], used_names: Collection[str]
) -> dict[str, str]:
    """Return the labels, by name, that a form may be of: not used, and measured unless the channel
    is a command.
    """
    is_command = CHANNEL_KINDS[form["channel"]].command
    free_labels = {}
    for name, label in labels.items():
        has_case = "capitals" not in form or name[:1].isupper()
        is_measured = not re.search(_TABLE["asked"], _plain(label))
        if name not in used_names and has_case and (is_command or is_measured):
            free_labels[name] = label
    return free_labels


def _keys_of(
    form: Mapping[str, Any], names: Collection[str], columns: Sequence[str | float]
) -> dict[str, Any]:
    """Return the keys of a channel that follow from its form, and from units in the names of its columns."""
    keys = {key: form[key] for key in _COPIED_KEYS if key in form}
    units = [_unit_of(name) if isinstance(name, str) else "" for name in columns]
    measured_units = {unit for name, unit in zip(columns, units, strict=True) if name != 0.0}
    known_units = measured_units - {""}
    factors = channel_mapping.units_of(form["channel"], form.get("format"))
    are_of_channel = bool(known_units) and known_units <= factors.keys()
    are_complete = known_units == measured_units or form["channel"] in _OF_TWO_SENSORS
    if len(measured_units) == 1 and measured_units <= factors.keys():
        keys["unit"] = measured_units.pop()
    elif are_of_channel and are_complete:
        keys["scale"] = [factors.get(unit, 1.0) for unit in units]
    rows = {name: value for name, value in form.get("rows", {}).items() if name in names}
    if rows:
        keys["rows"] = rows
    return keys


def _names_of(channel: Mapping[str, Any]) -> list[str]:
    """List the names of the columns of a channel, without signs."""
    return [str(column).removeprefix("-") for column in proposed_columns(channel)]


def _fields(path: Path, forms: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield topics that a form may be of, with the paths and labels of the fields of their second message:
    a topic that is sent once is no measurement.
    """
    for topic in topics_of(path):
        if not any(re.fullmatch(form.get("topic", ".*"), topic) for form in forms):
            continue
        labels: dict[str, str] = {}
        try:
            for message in islice(messages(path, [topic], None, []), 1, 2):
                labels.update(_leaves("", "", message.content))
        except UvmsError as error:  # such as for want of its definition
            labels = {f"({error})": ""}
        yield topic, labels


def _leaves(path: str, label: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield paths and labels of all numbers in a message; an element of an array has its place in the
    label, and in the path its name, if it has one.
    """
    if isinstance(value, dict):
        parts = value
    else:
        parts = getattr(value, "__dict__", {})
    is_of_joints = parts.keys() >= _JOINT_STATE
    for name, part in parts.items():
        quantity = name
        if is_of_joints and name in _JOINT_STATE:
            quantity = f"joint_{name}"
        part_path = f"{path}.{name}".strip(".")
        part_label = f"{label}.{quantity}".strip(".")
        element_names = [steps[-1] for steps in paths_by_name(parts, (name,))]
        if _is_short_array(part) and len(element_names) == len(part) > 0:
            for k, element in enumerate(element_names):
                yield f"{part_path}[{element}]", f"{part_label}[{k}]"
        else:
            yield from _leaves(part_path, part_label, part)
    if isinstance(value, int | float):
        yield path, label
    elif _is_short_array(value):
        for k in range(len(value)):
            yield f"{path}[{k}]", f"{label}[{k}]"


def _is_short_array(value: Any) -> bool:
    """Recognise an array of no more elements than a channel has columns."""
    return isinstance(value, list | tuple | np.ndarray) and len(value) < len(_TABLE["numbers"])


def _plain_names(names: Collection[str]) -> dict[str, str]:
    """Return names as `_plain` writes them."""
    return {name: _plain(name) for name in names}


def _plain(name: str) -> str:
    """Write a name in small letters, without units in brackets, other signs as ``_``."""
    without_unit = re.sub(r"\(.*?\)|\[[^\d\]]*\]", "", name)
    words = re.sub(r"([a-z])([A-Z])", r"\1_\2", without_unit).lower()
    return re.sub(r"[^a-z0-9]+", "_", words).strip("_")


def _unit_of(name: str) -> str:
    """Return the unit at the end of a name, such as mm/s of ``vel_x_mm_s``; empty for none."""
    match = _SUFFIX.search(_plain(name.removeprefix("-")))
    if match:
        return unit_named(match["unit"].replace("_", "/"))
    return ""


def _label(topic: str, name: str) -> str:
    """Name the quantity of a field: the topic's where it is ``data`` alone, as in ROS standard
    messages.
    """
    return re.sub(r"^data(?=$|\[)", topic.rpartition("/")[2], name)


def _matched(
    form: Mapping[str, Any], labels: Mapping[str, str], ignored: re.Pattern[str]
) -> list[str | float]:
    """Choose columns of all axes of a form, by labels without the parts that match `ignored`;
    empty where there are too few.
    """
    axes = form.get("axes", _TABLE["numbers"])
    groups = defaultdict[str, dict[int, str]](dict)  # by what stands before the axis
    for (name, label), (k, axis) in product(labels.items(), enumerate(axes)):
        pattern = form["pattern"].replace("AXIS", axis)
        match = re.fullmatch(pattern, ignored.sub("", _plain(label)))
        if match:
            groups[match["pre"]].setdefault(k, name)
    required_axes = set(form.get("must", range(len(axes))))
    fitting = [group for group in groups.values() if group.keys() & required_axes]
    best = max(fitting, key=len, default={})
    if len(best) < form.get("least", len(axes)):
        return []
    if "axes" not in form:
        return [best[k] for k in sorted(best)]
    signs = form.get("signs", [""] * len(axes))
    columns: list[str | float] = []
    for k, sign in enumerate(signs):
        columns.append(sign + best[k] if k in best else 0.0)
    return columns


def _time(labels: Mapping[str, str], *, of_messages: bool) -> dict[str, Any]:
    """Return the keys that say which field or column is the time; none where no name is known."""
    if of_messages and any(name.startswith("header.stamp") for name in labels):
        return {"time": "header.stamp"}
    candidates = []
    for name, label in labels.items():
        match = re.fullmatch(_TABLE["time"], _plain(label))
        if match:
            candidates.append((name, match["unit"]))
    if not of_messages:
        for seconds, nanoseconds in product(labels, labels):
            if not re.fullmatch(_TABLE["stamp"], f"{seconds} {nanoseconds}"):
                continue
            others = [name for name, _ in candidates if name not in (seconds, nanoseconds)]
            # Seconds of something else, such as of GPS, are not the time beside a column of times.
            if not others or "stamp" in seconds or "header" in seconds:
                return {"time": [seconds, nanoseconds]}
    if not candidates:
        return {}
    # The time of a header comes before that of logging.
    name, unit = min(candidates, key=lambda candidate: "header" not in candidate[0])
    if unit:
        return {"time": name, "time_unit": unit_named(unit)}
    return {"time": name}
