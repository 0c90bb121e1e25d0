"""Propose a mapping for a file that nobody has described: by names, then by what its values say
against a first reading.

What columns and fields are called, and what cures a doubt, stands in ``proposed_mapping.toml``. A
cure is proposed only where the recording, read with it, raises fewer doubts than without. Columns
without names are guessed by their values, and by what those of some say of others; the names that
they are given are such as files with a header have, and known by the forms.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
import tomllib
import yaml

from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.identification import (
    data_quality,
    file_kinds,
    reading,
    sample_checks as checks,
    tables,
)
from uvms_ocp.identification.messages import messages, topics_of
from uvms_ocp.identification.recording import CHANNEL_KINDS, smoothed, unit_named

_TABLE = tomllib.loads(
    (files("uvms_ocp.identification") / "proposed_mapping.toml").read_text(encoding="utf-8")
)
_ROUNDS = 3  # of cures, one of which may show what another one cures
_SUFFIX = re.compile(_TABLE["unit"])
_Found = dict[str, dict[str, Any]]
_Doubt = tuple[str, str]  # of which channel, and what


def propose_mapping(path: Path) -> str:
    """Propose a mapping as YAML, to be edited: every channel with the evidence for it in comments.

    Raises InvalidInput for a file in which nothing has a name that is known, with the names that
    there are, and NotInstalled.
    """
    of_topics = not path.is_dir() and file_kinds.kind_of(path) in _TABLE["kinds"]
    forms = [form for form in _TABLE["forms"] if ("topic" in form) == of_topics]
    if file_kinds.holds_messages(path):
        names_by_topic = dict(_fields(path, forms))
    else:
        names_by_topic = {"": list(tables.column_names(path))}
    channels = _Found()
    labels = dict[str, tuple[str, str]]()
    if all(name == f"#{k}" for k, name in enumerate(names_by_topic.get("", [""]), start=1)):
        labels = guessed_names(
            names_by_topic[""], tables.read_columns(path, names_by_topic[""]), _TABLE["guesses"]
        )
    for form, (topic, names) in product(forms, names_by_topic.items()):
        used_names = {
            name
            for channel in channels.values()
            if channel.get("topic", "") == topic
            for name in _names_of(channel)
        }
        unused = [
            name
            for name in names
            if name not in used_names and (name[:1].isupper() or "capitals" not in form)
        ]
        labelled = {name: labels.get(name, (_label(topic, name), ""))[0] for name in names}
        of_commands = CHANNEL_KINDS[form["channel"]].command
        free_names = {
            name: labelled[name]
            for name in unused
            if of_commands or not re.search(_TABLE["asked"], _plain(labelled[name]))
        }
        columns = _matched(form, free_names, re.compile("$.")) or _matched(
            form, free_names, _SUFFIX
        )
        has_neighbour = any(re.fullmatch(form.get("beside", ".*"), _plain(name)) for name in names)
        if (
            columns
            and has_neighbour
            and form["channel"] not in channels
            and re.fullmatch(form.get("topic", ".*"), topic)
        ):
            keys = {
                key: form[key]
                for key in ("format", "frame", "world", "body", "offset", "scale")
                if key in form
            }
            units = {_unit_of(name) for name in columns if isinstance(name, str)}
            if (
                len(units) == 1
                and units <= reading.units_of(form["channel"], form.get("format")).keys()
            ):
                keys["unit"] = units.pop()
            rows = {name: value for name, value in form.get("rows", {}).items() if name in names}
            if rows:
                keys["rows"] = rows
            topic_key = {"topic": topic} if topic else {}
            channels[form["channel"]] = (
                topic_key | _time(labelled, of_messages=bool(topic)) | {"columns": columns} | keys
            )
    if not channels:
        names_text = "; ".join(
            f"{topic} {', '.join(names[:40])}".strip() for topic, names in names_by_topic.items()
        )
        raise InvalidInput(
            f"{path}: nothing in it has a name that is known: {names_text}; write a mapping of these"
        )
    channels, cured = _cured(path, channels)
    ranges, doubts = _judged(path, channels)
    lines = ["channels:"]
    for name, channel in channels.items():
        lines.append(
            f"  {name}:"
            f" {yaml.safe_dump(channel, default_flow_style=True, sort_keys=False, width=10_000).strip()}"
        )
        known_axes = channel.keys() & {"world", "body", "frame"} or channels.keys() & _TABLE[
            "tells"
        ].get(name, channels)
        notes = {
            "by values": [
                labels[at][1]
                for at in (str(channel.get("time")), *_names_of(channel))
                if at in labels
            ],
            "by names": [ranges[name]] if name in ranges else [],
            "assumed": [] if known_axes or 0.0 in channel["columns"] else [_TABLE["assumed"]],
            "not measured": [_TABLE["constant"]] if 0.0 in channel["columns"] else [],
            "cured": cured[name],
            "doubtful": [why for key, why in doubts if key == name],
        }
        lines += [
            f"    # {kind}: {text}"
            for kind, texts in notes.items()
            for text in dict.fromkeys(texts)
        ]
    return "\n".join(lines) + "\n"


def _names_of(channel: Mapping[str, Any]) -> list[str]:
    """List the names of the columns of a channel, without signs."""
    return [str(column).removeprefix("-") for column in channel["columns"]]


def _fields(path: Path, forms: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, list[str]]]:
    """Yield topics that a form may be of, with the fields of their second message: a topic that is
    sent once is no measurement.
    """
    for topic in topics_of(path):
        if any(re.fullmatch(form.get("topic", ".*"), topic) for form in forms):
            try:
                yield (
                    topic,
                    [
                        name
                        for _, _, content in islice(messages(path, [topic], None, []), 1, 2)
                        for name in _leaves("", content)
                    ],
                )
            except UvmsError as error:  # such as for want of its definition
                yield topic, [f"({error})"]


def _leaves(prefix: str, value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        parts = value
    else:
        parts = getattr(value, "__dict__", {})
    for name, part in parts.items():
        yield from _leaves(f"{prefix}.{name}".strip("."), part)
    if isinstance(value, int | float):
        yield prefix
    elif isinstance(value, list | tuple | np.ndarray) and len(value) < len(_TABLE["numbers"]):
        yield from (f"{prefix}[{k}]" for k in range(len(value)))


def _plain(name: str) -> str:
    words = re.sub(r"([a-z])([A-Z])", r"\1_\2", re.sub(r"\(.*?\)|\[[^\d\]]*\]", "", name)).lower()
    return re.sub(r"[^a-z0-9]+", "_", words).strip("_")


def _unit_of(name: str) -> str:
    """Unit at the end of a name, such as of ``vel_x_mm_s``."""
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
    form: Mapping[str, Any], names: Mapping[str, str], left_out: re.Pattern[str]
) -> list[str | float]:
    """Choose columns of all axes of a form, by labels without the parts that match `left_out`;
    empty where there are too few.
    """
    axes = form.get("axes", _TABLE["numbers"])
    groups = defaultdict[str, dict[int, str]](dict)
    for (name, label), (k, axis) in product(names.items(), enumerate(axes)):
        match = re.fullmatch(form["pattern"].replace("AXIS", axis), left_out.sub("", _plain(label)))
        if match:
            groups[match["pre"]].setdefault(k, name)
    fitting = [
        group for group in groups.values() if group.keys() & set(form.get("must", range(len(axes))))
    ]
    best = max(fitting, key=len, default={})
    signs = form.get("signs", [""] * len(axes))
    axis_numbers: Sequence[int]
    if "axes" in form:
        axis_numbers = range(len(axes))
    else:
        axis_numbers = sorted(best)
    if len(best) >= form.get("least", len(axes)):
        return [signs[k] + best[k] if k in best else 0.0 for k in axis_numbers]
    return []


def _time(names: Mapping[str, str], *, of_messages: bool) -> dict[str, Any]:
    if any(name.startswith("header.stamp") for name in names) and of_messages:
        return {"time": "header.stamp"}
    pairs = [
        [seconds, nanoseconds]
        for seconds, nanoseconds in product(names, names)
        if re.fullmatch(_TABLE["stamp"], f"{seconds} {nanoseconds}")
    ]
    if pairs and not of_messages:
        return {"time": pairs[0]}
    candidates = [
        (name, match["unit"])
        for name, label in names.items()
        if (match := re.fullmatch(_TABLE["time"], _plain(label)))
    ]
    # The time of a header comes before that of logging.
    candidates.sort(key=lambda candidate: "header" not in candidate[0])
    if not candidates:
        return {}
    name, unit = candidates[0]
    if unit:
        return {"time": name, "time_unit": unit_named(unit)}
    return {"time": name}


# Cures: what a doubt says, applied and judged by what is doubtful then.


def _cured(path: Path, channels: _Found) -> tuple[_Found, Mapping[str, list[str]]]:
    """Apply of the cures for each doubt the one that leaves fewest; returns the channels, and
    doubts that were cured.
    """
    cured = defaultdict[str, list[str]](list)
    (ranges, doubts) = _judged(path, channels)
    for _ in range(_ROUNDS):
        for doubt in tuple(doubts):
            if doubt not in doubts:  # cured together with another
                continue
            lowest_score = _left(channels, ranges, doubts, doubts)
            chosen = None
            for channel, candidate in _others(doubt, channels):
                other_ranges, other_doubts = _judged(path, candidate)
                score = _left(candidate, other_ranges, other_doubts, doubts)
                if score < lowest_score:
                    lowest_score = score
                    chosen = (channel, candidate, other_ranges, other_doubts)
            if chosen:
                channel, channels, ranges, doubts = chosen
                cured[channel].append(doubt[1])
    return channels, cured


def _left(
    channels: _Found, ranges: Mapping[str, str], doubts: Sequence[_Doubt], before: Sequence[_Doubt]
) -> tuple[int, int, int]:
    """Count what a cure leaves: channels that cannot be read, doubts, and doubts of `before` whose
    channel no longer reads.
    """
    hiding = sum("rad: in deg?" in why for _, why in doubts)  # others, that would follow from these
    return (
        len(channels) - len(ranges) + hiding,
        len(doubts),
        sum(doubt in before for doubt in doubts if doubt[0] not in ranges),
    )


def _others(doubt: _Doubt, channels: _Found) -> Iterator[tuple[str, _Found]]:
    """Yield for each cure of a doubt its channel, and all channels with the cure applied."""
    for cure in _TABLE["cures"]:
        channel = cure.get("of", doubt[0])
        match = re.search(cure["doubt"], doubt[1])
        if match is None or cure.get("channel", doubt[0]) != doubt[0] or channel not in channels:
            continue
        keys = yaml.safe_load(
            cure.get("keys", "{}").replace("VALUE", match.groupdict().get("value", ""))
        )
        axes = cure.get("axes", match.groupdict().get("axes", ""))
        if axes:
            keys["columns"] = _turned(channels[channel], axes.split(", "))
        named = cure.get("becomes", channel)
        if "all" in cure:
            frames = {
                name: reading.frames_of(name, entry.get("frame"))
                for name, entry in channels.items()
            }
            yield (
                channel,
                {
                    name: entry | {key: keys[key] for key in keys if key in frames[name]}
                    for name, entry in channels.items()
                },
            )
        elif keys.get("columns") != []:
            candidate = _Found()
            for name, entry in channels.items():
                if name == channel:
                    candidate[named] = entry | keys
                else:
                    candidate[name] = entry
            yield named, candidate


def _turned(channel: Mapping[str, Any], axes: Sequence[str]) -> list[str | float]:
    """Return columns of a channel for axes such as ``-y``; empty unless there is an axis for each
    column.
    """
    letters = "wxyz" if str(channel.get("format")).endswith("wxyz") else "xyzw"
    if len(channel["columns"]) != len(axes):
        return []
    columns = dict(zip(letters, channel["columns"], strict=False))
    turned = {
        axis[-1]: _opposite(columns[axis[-1]]) if axis[0] == "-" else columns[axis[-1]]
        for axis in axes
    }
    if len(axes) == len(letters):
        return [turned[letter] for letter in letters]
    return [turned[axis[-1]] for axis in axes]


def _opposite(column: str | float) -> str | float:
    if isinstance(column, float):
        return -column
    if column.startswith("-"):
        return column[1:]
    return f"-{column}"


def _judged(path: Path, channels: _Found) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """Return ranges of the channels that can be read, and doubts about each; a channel that cannot
    be read is left out.
    """
    try:
        recording = reading.mapped_recording(
            path, reading.RecordingMapping.model_validate({"channels": channels})
        )
    except UvmsError as error:
        text = str(error)
        wrong = min(
            channels, key=lambda name: text.find(name) if name in text else len(text)
        )  # the first that is named
        others = {name: entry for name, entry in channels.items() if name != wrong}
        if others:
            ranges, doubts = _judged(path, others)
        else:
            ranges = {}
            doubts = []
        return ranges, [(wrong, text), *doubts]
    issues = data_quality.check_data_quality(recording)
    ranges = {
        name: (
            f"{entry.values.min():.4g} to {entry.values.max():.4g} {CHANNEL_KINDS[name].unit} at"
            f" {entry.rate:.3g} Hz"
        )
        for name, entry in recording.channels.items()
    }
    return ranges, [
        (entry.channel, entry.problem) for entry in issues if "are left out" not in entry.problem
    ]


# What columns without names hold: what is looked for, one after the other, stands in
# ``proposed_mapping.toml`` as guesses.

# rows that are looked at
_LEAST = 100
_MOST = 20_000
# [s] assumed between rows, and to smooth over: magnitudes are compared, whatever their scale
_STEP = 0.1
_WINDOW = 1.5
# correlations; steps beside what values spread
_AGREES = 0.8
_PLANAR = 0.98
_SMOOTH = 0.15
# [%] of samples below peaks, as where an angle jumps; [us]
_PEAKS = 95.0
_PULSES = (900.0, 2200.0)


def guessed_names(
    places: Sequence[str], values: np.ndarray, guesses: Sequence[Mapping[str, Any]]
) -> dict[str, tuple[str, str]]:
    """Guess a name, with the evidence for it, for columns (n, k) [as they are], by their places;
    unknown ones are left out.
    """
    finite = np.isfinite(values)
    labels = dict[str, tuple[str, str]]()
    values = np.where(finite.any(axis=0), values, 0.0)[finite[:, finite.any(axis=0)].all(axis=1)][
        :_MOST
    ]
    if len(values) < _LEAST:
        return labels
    table = _Columns(values)
    for guess in guesses:
        if guess["names"] in table.found:
            continue
        conditions = guess.keys() & _CONDITIONS.keys()
        names = guess["names"].split()
        for group in table.left(len(names)):
            if all(_CONDITIONS[key](table, group, guess[key]) for key in conditions):
                table.found[guess["names"]] = group
                ends = dict.fromkeys((places[group[0]], places[group[-1]]))
                evidence = f"{' to '.join(ends)}: {guess['why']}"
                labels |= {
                    places[k]: (name, evidence) for k, name in zip(group, names, strict=True)
                }
                break
    return labels


def _without_peaks(values: np.ndarray) -> np.ndarray:
    """Clip values (n,) [any] from above at their percentile `_PEAKS`."""
    return np.minimum(values, np.percentile(values, _PEAKS))


class _Columns:
    """Columns of numbers, and those that have been found, by their names."""

    def __init__(self, values: np.ndarray) -> None:
        t = _STEP * np.arange(len(values))
        self.values = values
        self.steps = np.diff(values, axis=0)
        self.spread = values.std(axis=0)
        self.smooth, self.rates = (smoothed(t, values, _WINDOW, derivative=k)[1] for k in (0, 1))
        self.found: dict[str, range] = {}

    def left(self, width: int) -> list[range]:
        free = np.ptp(self.values, axis=0) > 0.0
        free[[k for group in self.found.values() for k in group]] = False
        return [
            range(k, k + width) for k in range(len(free) - width + 1) if free[k : k + width].all()
        ]

    def rates_of(self, pose: range) -> Iterator[range]:
        """Yield groups as large as the rate of a pose, with any axes."""
        for group in self.left(3):
            if set(group) & set(pose):
                continue
            rate = _without_peaks(np.linalg.norm(self.rates[:, pose], axis=1))
            size = _without_peaks(np.linalg.norm(self.smooth[:, group], axis=1))
            if checks.correlation(rate, size) > _AGREES:
                yield group

    def is_planar(self, pose: range, group: range) -> bool:
        """Check whether a rate is turned by the third number of a pose, its heading."""
        plane, moved = (
            x[:, 0] + 1j * x[:, 1] for x in (self.rates[:, pose], self.smooth[:, group])
        )
        turned = float(np.vdot(plane * np.exp(-1j * self.smooth[:, pose[2]]), moved).real)
        return turned > _PLANAR * float(np.linalg.norm(plane) * np.linalg.norm(moved))

    def differ(self, group: range, size: float) -> float:
        """Share by which norms differ from a size, most of the time."""
        return float(
            np.percentile(np.abs(np.linalg.norm(self.values[:, group], axis=1) / size - 1.0), 90.0)
        )

    def are_commands(self, group: range) -> bool:
        """Recognise pulse widths, and values that stay from row to row."""
        pulses = (self.values > _PULSES[0]) & (self.values < _PULSES[1])
        held = self.steps == 0.0
        return bool((pulses.all(axis=0) | (held.mean(axis=0) > 0.5))[list(group)].all())


_CONDITIONS: Mapping[str, Callable[[_Columns, range, Any], bool]] = {
    "rises": lambda of, one, by: bool(
        (of.steps[:, one] >= 0.0).all() and (of.steps[:, one] > 0.0).mean() > by
    ),
    "counts": lambda of, one, given: bool((of.steps[:, one] == 1.0).all()) is given,
    "size": lambda of, one, is_: of.differ(one, is_[0]) < is_[1],
    "rate_of": lambda of, one, names: names in of.found and one in of.rates_of(of.found[names]),
    "has_rate": lambda of, one, planar: any(
        of.is_planar(one, other) or not planar for other in of.rates_of(one)
    ),
    "commands": lambda of, one, given: of.are_commands(one) is given,
    "smooth": lambda of, one, given: (
        bool((of.steps[:, one].std(axis=0) < _SMOOTH * of.spread[one]).all()) is given
    ),
    "begins_at": lambda of, one, within: bool(np.abs(of.values[:, one]).min() < within),
    "unless": lambda of, one, names: (
        not set(names) & {name for group in of.found for name in group.split()}
    ),
}
