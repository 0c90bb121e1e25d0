"""Mapping of the columns of a foreign file to the channels of a recording.

It is a YAML file, or the same as a value:

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

Commands that have a topic, or a column of times, for each thruster come in parts, in the order of the
robot's thrusters or by their names:

      thrust:
        parts: [{topic: /thruster_0/cmd, columns: [data]}, {topic: /thruster_1/cmd, columns: [data]}]

What a table of text looks like is found, or given (``table: {delimiter: tab}``). Frames: ``world:
NED`` and ``body: FRD`` are turned to W with z up and B forward-left-up. A world with z up is taken
as it is: where it has its x axis changes no fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.identification import recording as recordings
from uvms_ocp.identification.text_tables import TextFormat
from uvms_ocp.model_errors import FileModel, one_line_errors
from uvms_ocp.record import yaml_file

UNITS: Mapping[str, Mapping[str, float]] = recordings.CHANNEL_TABLE["units"]
"""Factors of the units that values of a channel may be given in, by the unit of the channel."""
_OF_CHANNEL = recordings.CHANNEL_TABLE["of_channel"]
_Numbers = float | tuple[float, ...]


class ColumnSource(FileModel, allow_inf_nan=False, use_attribute_docstrings=True):
    """Source of columns: a topic or a table, their times and names, and the rows that count."""

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
    columns: tuple[str | float, ...] = ()
    """in the order that the channel has; -name for the opposite, a number for what is not measured;
    of messages, paths such as position.x, actuators[3]; of tables also places, #1
    """
    rows: dict[str, float | str] = Field(default={})
    """only rows or messages that have these values, such as {instance: 0, valid: 1, sensor:
    left}; of messages also by their sender: {system: 1, component: 1} of MAVLink, {publisher:
    /node} or {connection: 0} of ROS
    """

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the columns or fields that are measured, without their signs."""
        return tuple(column.removeprefix("-") for column in self.columns if isinstance(column, str))


class ChannelMapping(ColumnSource, allow_inf_nan=False, use_attribute_docstrings=True):
    """Source of one channel: topic or columns, units and frame."""

    parts: tuple[ColumnSource | float, ...] | dict[str, ColumnSource | float] = ()
    """of a command, in place of topic, time and columns: sources one after the other, such as a
    topic for each thruster, in the robot's order or by the thrusters' names; a number for one that
    is not recorded. Each is held from its last sample, from where all are known
    """
    series: Annotated[int, Field(ge=1)] | None = None
    """which of several series, far apart, that alternate in the channel where nothing in the file
    tells their senders apart; 1 is that of the first sample
    """
    missing: tuple[float, ...] = ()
    """values that stand where nothing was measured"""
    format: (
        Literal[
            "rpy",
            "rpy 3-1-2",
            "rpy 2-3-1",
            "rpy 2-1-3",
            "rpy 1-3-2",
            "rpy 1-2-3",
            "quaternion xyzw",
            "quaternion wxyz",
        ]
        | None
    ) = None
    """of an attitude; default: quaternion xyzw; rpy is yaw about z first, then pitch about the new
    y, then roll about the new x (3-2-1), unless another order is said
    """
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
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts, such as those of thrusters; empty where they have none."""
        return tuple(self.parts) if isinstance(self.parts, dict) else ()

    @property
    def columns_of_parts(self) -> tuple[str | float, ...]:
        """Columns of all parts one after the other, or those of the channel where it has none."""
        if not self.parts:
            return self.columns
        columns: list[str | float] = []
        for part in self._parts():
            if isinstance(part, ColumnSource):
                columns += part.columns
            else:
                columns.append(part)
        return tuple(columns)

    def mappings_of_parts(self) -> tuple[ChannelMapping | float, ...]:
        """Return what each part is by itself: its source, in the unit of the channel; numbers as they
        are.
        """
        mappings: list[ChannelMapping | float] = []
        first = 0
        for part in self._parts():
            if not isinstance(part, ColumnSource):
                mappings.append(part)
                first += 1
                continue
            keys = dict[str, Any](part)
            last = first + len(part.columns)
            for name in ("offset", "scale"):
                values = getattr(self, name)
                keys[name] = values[first:last] if isinstance(values, tuple) else values
            mappings.append(self.model_copy(update={**keys, "parts": ()}))
            first = last
        return tuple(mappings)

    def _parts(self) -> tuple[ColumnSource | float, ...]:
        """Return all parts in their order."""
        return tuple(self.parts.values()) if isinstance(self.parts, dict) else self.parts

    @property
    def has_angles(self) -> bool:
        """True for an attitude of roll, pitch and yaw."""
        return is_of_angles(self.format)

    @property
    def words(self) -> tuple[str | None, ...]:
        """Words of the columns, then of the rows, that a flag is read by: a cell with this word is
        1, any other 0. None for columns and rows of numbers.
        """
        words: list[str | None] = [None] * len(self.fields)
        for value in self.rows.values():
            words.append(value if isinstance(value, str) else None)
        return tuple(words)


@one_line_errors
class RecordingMapping(FileModel, use_attribute_docstrings=True):
    """Mapping of all channels of a recording, by the names of `CHANNEL_KINDS`."""

    channels: dict[str, ChannelMapping] = Field(min_length=1)
    table: TextFormat | None = None
    """what is known of tables of text"""
    messages: str = ""
    """folder with PACKAGE/msg/NAME.msg that a bag of ROS 2 lacks"""


@checked
def read_mapping(path: Path | str) -> RecordingMapping:
    """Read a mapping from its YAML file, beside which its folder of messages is.

    Raises InvalidInput in one line for what is none, NameNotFound for a channel that there is not.
    """
    path = Path(path)
    mapping = yaml_file.read_yaml_as(path, RecordingMapping)
    for key, channel in mapping.channels.items():
        require_meaning(key, channel)
    if mapping.messages:
        return mapping.model_copy(update={"messages": str(path.parent / mapping.messages)})
    return mapping


def stated_aspects(key: str, mapping: ChannelMapping) -> dict[str, str]:
    """Return what a mapping states of a channel, by aspect of its reading.

    Axes are stated where all are of which they depend: of an attitude those of W and of B.
    """
    keys_of_aspects: dict[str, tuple[str, ...]] = {
        "unit": ("unit",),
        "axes": ("frame", "world", "body", "format"),
        "time": ("time_unit", "sent_every"),
        "delay": ("delay",),
        "offset": ("offset", "scale"),
    }
    stated = {}
    for aspect, keys in keys_of_aspects.items():
        parts = []
        for name in keys:
            if name in mapping.model_fields_set:
                parts.append(f"{name}: {getattr(mapping, name)}")
        if parts:
            stated[aspect] = f"{', '.join(parts)} of the mapping"
    sides = {"world", "body"} & set(frames_of(key, mapping.frame))
    if not sides <= mapping.model_fields_set:
        stated.pop("axes", None)
    return stated


def require_meaning(key: str, mapping: ChannelMapping) -> None:
    """Check that every key has a meaning for its channel: none is ignored.

    Raises NameNotFound for no channel, InvalidInput for a key without meaning.
    """
    require_known("channel", key, recordings.CHANNEL_KINDS)
    _require_source(key, mapping)
    for name in ("format", "frame", "world", "body"):
        if getattr(mapping, name) is not None and name not in frames_of(key, mapping.frame):
            raise InvalidInput(
                f"{key}: {name}: {getattr(mapping, name)} given, which means nothing of it; leave"
                " it out"
            )
    allowed_units = units_of(key, mapping.format)
    if mapping.unit is not None and mapping.unit not in allowed_units:
        raise InvalidInput(
            f"{key}: unit {mapping.unit!r} given; allowed:"
            f" {', '.join(allowed_units) or 'none, it has no unit'}"
        )
    for name in ("offset", "scale"):
        values = getattr(mapping, name)
        if isinstance(values, tuple) and len(values) != len(mapping.columns_of_parts):
            raise InvalidInput(
                f"{key}: {len(values)} numbers of {name} given; allowed: one, or one for each column"
            )
    _require_width(key, mapping)


def _require_source(key: str, mapping: ChannelMapping) -> None:
    """Check that a channel has either columns or parts, and parts nothing that means nothing of them."""
    if not mapping.parts:
        if not mapping.columns:
            raise InvalidInput(
                f"{key}: no columns given; allowed: one or more, or parts of a command"
            )
        return
    if not recordings.CHANNEL_KINDS[key].command:
        commands = [name for name, kind in recordings.CHANNEL_KINDS.items() if kind.command]
        raise InvalidInput(
            f"{key}: parts given; allowed: of {', '.join(commands)}, which are held between samples"
        )
    for name in ("file", "topic", "time", "time_unit", "columns", "rows", "series", "sent_every"):
        if getattr(mapping, name):
            raise InvalidInput(
                f"{key}: {name} given beside parts; allowed: {name} of each part, if it has any"
            )
    sources = [part for part in mapping.mappings_of_parts() if isinstance(part, ChannelMapping)]
    if not sources:
        raise InvalidInput(f"{key}: parts of numbers alone given; leave the channel out")
    for part in sources:
        if not part.columns:
            raise InvalidInput(f"{key}: a part without columns given; allowed: one or more columns")
        if mapping.part_names and len(part.columns) > 1:
            raise InvalidInput(
                f"{key}: {len(part.columns)} columns of one name given; allowed: one column of each"
            )


def _require_width(key: str, mapping: ChannelMapping) -> None:
    """Check that a channel has as many columns as its kind; an array may have several of them."""
    if mapping.has_angles:
        width = 3
    else:
        width = len(recordings.CHANNEL_KINDS[key].columns)
    n_columns = len(mapping.columns_of_parts)
    if not width or n_columns == width:
        return
    if n_columns > width:
        raise InvalidInput(f"{key}: {n_columns} columns given; allowed: {width}")
    has_paths = any("." in column or "[" in column for column in mapping.fields)
    if not has_paths and not mapping.topic:
        raise InvalidInput(
            f"{key}: {n_columns} columns given; allowed: {width}; a number may stand for one that is"
            " not measured, such as 0.0"
        )


def frames_of(key: str, frame: str | None) -> tuple[str, ...]:
    """Return the keys about axes that have a meaning for a channel in a frame."""
    if key == "attitude":
        return "format", "world", "body"
    usual_frame = recordings.CHANNEL_KINDS[key].frame
    if usual_frame == "W":
        return ("world",)
    if usual_frame == "B":
        return ("frame", "world") if frame == "W" else ("frame", "body")
    return ()


def is_of_angles(form: str | None) -> bool:
    """Check whether a format of an attitude is one of roll, pitch and yaw."""
    return form is not None and form.startswith("rpy")


def units_of(key: str, form: str | None) -> dict[str, float]:
    """Return the units that a channel may have, an attitude in a form, and their factors."""
    if key != "attitude" or is_of_angles(form):
        bases = _OF_CHANNEL.get(key, (recordings.CHANNEL_KINDS[key].unit,))
    else:
        bases = ()
    factors = dict[str, float]()
    for base in bases:
        factors |= UNITS[base]
    return factors
