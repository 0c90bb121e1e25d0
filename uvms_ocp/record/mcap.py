"""Write records as MCAP files, which ROS 2 and Foxglove open, and read MCAP files of anyone within
bounds.
"""

from __future__ import annotations

import csv
import re
import struct
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import IO, Any

import numpy as np

from uvms_ocp.errors import InvalidInput, optional_module
from uvms_ocp.record import output, run_meta
from uvms_ocp.record.tables import Series, column_units, flat_columns, series_description
from uvms_ocp.record.untrusted import DENSEST, SMALL, as_input_errors, require_regular_file

# Messages of an MCAP file in the order that they stand there, unpacked chunk by chunk within what
# each chunk declares.

LARGEST_CHUNK = 64 << 20
"""[B] when unpacked; writers close one after 1 to 4 MB."""
_WINDOW = 1 << 27  # [B] that zstd may look back

_TABLE = (files("uvms_ocp.record") / "ros_messages.csv").read_text(encoding="utf-8").splitlines()
ROS_MESSAGES: Mapping[str, str] = {
    row["type"]: row["fields"].replace("; ", "\n") for row in csv.DictReader(_TABLE)
}
"""Fields of the types of ROS 2 that are written."""
_HEAD = np.array([0, 1, 0, 0], dtype="u1")  # little endian, plain CDR
_NEXT = "=" * 80 + "\nMSG: "

Part = str | np.ndarray
"""A text, an array (m,) that all messages have, or one (n, m) of which each has its row."""

_KINDS = {"f": ("float64", "f8"), "i": ("int64", "i8"), "u": ("uint64", "u8"), "b": ("bool", "?")}
"""Type of a ROS 2 field and of its values in NumPy, by `dtype.kind` of a series: the widest of each
kind.
"""

WORLD = "world"
VEHICLE = "base_link"
_POSES = {"q": VEHICLE, "q_estimated": f"{VEHICLE}_estimated", "tool": "tool"}
"""Series that begin with a pose in W, and the frame that has it."""
_ODOMETRY = {
    "odometry": ("q", "v", ""),
    "odometry_estimated": ("q_estimated", "v_estimated", "q_std"),
}
"""Topics with their pose, velocity, and standard deviations of the pose."""
_WRENCHES = ("wrench", "unreachable", "disturbance")
_POSE = 7
_SIX = 6
_INFO = 20
_WARN = 30
_ERROR = 40

_ENDLESS = "{sec: 9223372036, nsec: 854775807}"
_KEPT = (
    f"history: 1, depth: 1, reliability: 1, durability: 1, deadline: {_ENDLESS}, lifespan:"
    f" {_ENDLESS}"
)
_LIVE = (
    f"liveliness: 1, liveliness_lease_duration: {_ENDLESS}, avoid_ros_namespace_conventions: false"
)
_LATCHED = {"offered_qos_profiles": f"- {{{_KEPT}, {_LIVE}}}"}
"""Quality of service of what is published once, for those who listen later too."""

VERSION = "2"
_WITH_PROTOBUF = "1"
"""Versions of the format: the one that is written, and the older one, which is read too."""
_KEY = "uvms_ocp"
_SERIES = "/series/"
_BLOCK = 4096


def mcap_messages(
    path: Path, topics: Collection[str] | None = None
) -> Iterator[tuple[Any, Any, Any]]:
    """Yield schema (none for messages that need none), channel and message, of these topics or of
    all.

    Raises `InvalidInput` for a file that unpacks to far more than it is, and what the library
    raises for a damaged one.
    """
    require_mcap()
    from mcap.records import Channel, Message, Schema

    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            if topics is None or channel.topic in topics:
                yield schemas.get(channel.schema_id), channel, record


def mcap_topics(path: Path) -> tuple[str, ...]:
    """Return all topics of a file, sorted. Raises `InvalidInput` and others, as `mcap_messages`
    does.
    """
    require_mcap()
    from mcap.records import Channel

    return tuple(sorted({record.topic for record in _records(path) if isinstance(record, Channel)}))


def _records(path: Path) -> Iterator[Any]:
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    size = path.stat().st_size
    total = 0
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=size).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            total += record.uncompressed_size
            _require_size(path, record.uncompressed_size, total, size)
            yield from breakup_chunk(
                replace(record, compression="", data=_unpacked(path, record)), validate_crc=True
            )


def _require_size(path: Path, chunk: int, total: int, size: int) -> None:
    if chunk > LARGEST_CHUNK:
        raise InvalidInput(
            f"{path}: a chunk of {chunk >> 20} MB; at most {LARGEST_CHUNK >> 20} MB are read"
        )
    if total > max(SMALL, DENSEST * size):
        raise InvalidInput(
            f"{path}: would unpack to more than {total >> 20} MB; at most {DENSEST} times a file"
            " are read"
        )


def _unpacked(path: Path, chunk: Any) -> bytes:
    """Return the contents of a chunk. Raises `InvalidInput` where they have another size than it
    states.
    """
    size = chunk.uncompressed_size
    content = _first(chunk, size + 1)
    if len(content) != size:
        raise InvalidInput(
            f"{path}: a chunk does not hold the {size} bytes that it declares; mcap recover may"
            " help"
        )
    return content


def _first(chunk: Any, size: int) -> bytes:
    if chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return bytes(LZ4FrameDecompressor().decompress(chunk.data, max_length=size))
    if chunk.compression == "zstd":
        from zstandard import ZstdDecompressor

        stream: IO[bytes] = ZstdDecompressor(max_window_size=_WINDOW).stream_reader(chunk.data)
        return stream.read(size)
    if chunk.compression:
        raise InvalidInput(f"a chunk packed by {chunk.compression[:20]!r}; lz4 and zstd are read")
    return bytes(chunk.data)


# The libraries of the extra ``uvms-ocp[mcap]``, imported when a file is written or read.


def require_mcap() -> None:
    """Raise `NotInstalled` where any of them is missing."""
    for name in ("mcap", "mcap_protobuf"):
        optional_module(name, "an MCAP file", '"uvms-ocp[mcap]"')


# Messages of ROS 2: their definitions as text, and many of a kind at once in CDR, the form in which
# they are sent.


def ros_definition(kind: str) -> str:
    """Return the text by which a reader knows a message of that type: its fields, then those of all
    types in it.
    """
    texts = {kind: ROS_MESSAGES[kind]}
    pending = [kind]
    while pending:
        inner_kinds = [
            word
            for word in re.split(r"[\s\[\]]+", texts[pending.pop()])
            if word in ROS_MESSAGES and word not in texts
        ]
        texts |= {name: ROS_MESSAGES[name] for name in inner_kinds}
        pending += inner_kinds
    return f"\n{_NEXT}".join(
        [texts.pop(kind), *(f"{name}\n{text}" for name, text in texts.items())]
    )


def cdr_messages(n: int, parts: Iterable[Part]) -> np.ndarray:
    """Encode n messages of the same parts, (n, size) [B]: numbers at multiples of their size behind
    the head of four bytes.
    """
    blocks = [np.tile(_HEAD, (n, 1))]
    size = 0
    for part in parts:
        arrays: tuple[np.ndarray, ...]
        if isinstance(part, str):
            text = np.frombuffer(part.encode() + b"\0", dtype="u1")
            arrays = (_count(len(text)), text)
        else:
            arrays = (part,)
        for values in arrays:
            rows = np.broadcast_to(values, (n, np.shape(values)[-1]))
            gap = -size % rows.itemsize if rows.shape[1] else 0
            blocks += [
                np.zeros((n, gap), dtype="u1"),
                np.ascontiguousarray(rows, dtype=rows.dtype.newbyteorder("<")).view("u1"),
            ]
            size += gap + blocks[-1].shape[1]
    return np.hstack(blocks)


def _count(n: int) -> np.ndarray:
    """Return the length of a sequence, which stands before it."""
    return np.array([n], dtype="u4")


# A message for every tick of a series, with a field for every column: what is written is read again
# to the last digit.


def field_names(columns: Sequence[str]) -> list[str]:
    """Return names that a message may have, each once."""
    names: list[str] = []
    for column in columns:
        plain = re.sub(r"\W+|__+", "_", column, flags=re.ASCII).strip("_")
        if not plain[:1].isalpha():
            plain = f"c{plain}"
        names.append(plain if plain not in names else f"{plain}_{len(names) + 1}")
    return names


def values_of(messages: Sequence[Any], dtype: str, n_axes: int) -> np.ndarray:
    """Return the series (n, k), or (n,) with one axis, of its messages; dtype: as numpy writes it.
    Raises `ValueError` for another.

    messages: in CDR, or decoded ones of a file of version 1.
    """
    numpy_type = np.dtype(dtype)
    if numpy_type.kind not in _KINDS:
        raise ValueError(f"a series of {dtype[:20]!r}")
    stored = np.dtype(_KINDS[numpy_type.kind][1]).newbyteorder("<")
    if isinstance(messages[0], bytes):
        rows: Any = [
            np.frombuffer(message, dtype=stored, offset=len(_HEAD)) for message in messages
        ]
    else:
        fields = [field.name for field in messages[0].DESCRIPTOR.fields]
        rows = [[getattr(message, field) for field in fields] for message in messages]
    values = np.array(rows, dtype=stored).astype(numpy_type)
    if n_axes == 1:
        return values[:, 0]
    return values


# What ROS 2 and Foxglove know by themselves: poses as transforms and odometry, states of joints,
# wrenches, and what was said.


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """Messages of one type, a tick each, or one alone at the start where no part has rows."""

    name: str
    kind: str
    """Type, of `ROS_MESSAGES` unless it has a definition of its own."""
    parts: Sequence[Part]
    definition: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)

    def messages(self, rows: slice) -> np.ndarray:
        """Encode those of these rows; of a topic that has none its one message, with the first."""
        cut = [
            part[rows] if isinstance(part, np.ndarray) and part.ndim > 1 else part
            for part in self.parts
        ]
        lengths = [len(part) for part in cut if isinstance(part, np.ndarray) and part.ndim > 1]
        return cdr_messages(max(lengths, default=int(rows.start == 0)), cut)


def stamps(t: np.ndarray) -> np.ndarray:
    """Return time stamps (n, 2) [s, ns] of times t (n,) [ns]."""
    return np.stack([t // 10**9, t % 10**9], axis=1).astype("u4")


def topics(series: Series, meta: Any, t: np.ndarray, urdf: str | None) -> Iterator[Topic]:
    """Yield all topics that a record can fill, at t (n,) [ns]; urdf: text of the robot's
    description.
    """
    floating = run_meta.is_floating(series, meta)
    head = (stamps(t), WORLD)
    if urdf is not None:
        yield Topic(
            name="/robot_description", kind="std_msgs/String", parts=(urdf,), metadata=_LATCHED
        )
    poses = {
        frame: series[name][:, :_POSE]
        for name, frame in _POSES.items()
        if name in series and (floating or name == "tool")
    }
    if poses:
        yield Topic(name="/tf", kind="tf2_msgs/TFMessage", parts=_transforms(stamps(t), poses))
    if meta.surroundings.frames:
        goals = {
            frame.name: np.array(frame.pose) for frame in meta.surroundings.frames if not frame.way
        }
        yield Topic(
            name="/tf_static",
            kind="tf2_msgs/TFMessage",
            parts=_transforms(stamps(t)[0], goals),
            metadata=_LATCHED,
        )
    for name, (q, v, std) in _ODOMETRY.items():
        if floating and q in series and v in series:
            pose = series[q][:, :_POSE]
            spread_series = series.get(std)
            if spread_series is None:
                spread = np.zeros(_SIX**2)
            else:
                spread = _covariance(pose, spread_series)
            states = (*head, VEHICLE, pose, spread, series[v][:, :_SIX], np.zeros(_SIX**2))
            yield Topic(name=f"/{name}", kind="nav_msgs/Odometry", parts=states)
    if meta.joints and (positions := run_meta.joint_positions(series, meta)) is not None:
        n = len(meta.joints)
        arrays = (positions, series.get("v"), series.get("torque"))
        numbers = [np.empty(0) if array is None else array[:, -n:] for array in arrays]
        joint_parts = [part for values in numbers for part in (_count(values.shape[-1]), values)]
        yield Topic(
            name="/joint_states",
            kind="sensor_msgs/JointState",
            parts=(*head, _count(n), *meta.joints, *joint_parts),
        )
    for name in _WRENCHES:
        if floating and name in series:
            yield Topic(
                name=f"/{name}",
                kind="geometry_msgs/WrenchStamped",
                parts=(stamps(t), VEHICLE, series[name][:, :_SIX]),
            )


def _transforms(time_stamps: np.ndarray, poses: Mapping[str, np.ndarray]) -> list[Part]:
    return [
        _count(len(poses)),
        *(part for frame, pose in poses.items() for part in (time_stamps, WORLD, frame, pose)),
    ]


def _covariance(poses: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Return covariances (n, 36) along the axes of W, of deviations (n, 6...) along those of W, and
    for the attitude of B, at poses (n, 7).
    """
    from scipy.spatial.transform import Rotation

    axes = np.tile(np.eye(_SIX), (len(std), 1, 1))
    axes[:, 3:, 3:] = Rotation.from_quat(poses[:, 3:]).as_matrix()
    return ((axes * std[:, None, :_SIX] ** 2) @ axes.transpose(0, 2, 1)).reshape(len(std), -1)


def log_messages(meta: Any) -> list[tuple[float, bytes]]:
    """List events, alarms and faults of a run in order of time, each with its time [s]."""
    events = [
        (e.t, _INFO, f"{e.source} to {e.target}: {e.reason}") for e in getattr(meta, "events", ())
    ]
    alarms = [(alarm.t, _WARN, alarm.text) for alarm in getattr(meta, "alarms", ())]
    faults = [(fault.t, _ERROR, fault.text) for fault in getattr(meta, "faults", ())]
    entries = sorted([*events, *alarms, *faults], key=lambda entry: entry[0])
    return [(t, _log_message(t, level, text)) for t, level, text in entries]


def _log_message(t: float, level: int, text: str) -> bytes:
    time_stamp = stamps(np.array([round(1e9 * t)]))
    return cdr_messages(
        1, (time_stamp, np.array([level], dtype="u1"), "", text, "", "", _count(0))
    ).tobytes()


# An MCAP file of a record: every series tick by tick, and what ROS 2 and Foxglove know by
# themselves; it comes back.


def to_mcap(
    series: Mapping[str, np.ndarray], meta: Any, path: Path, urdf: str | None = None
) -> None:
    """Write what `from_mcap` reads as the same; series: (n, ...) each [unit of it]. Raises
    `NotInstalled` and `OutputError`.
    """
    require_mcap()
    from mcap.writer import Writer

    t = series["t"]
    times = np.rint(1e9 * (t - min(t[0], 0.0))).astype(np.int64)
    log_entries = log_messages(meta)
    with output.whole_file(path) as file:
        writer = Writer(file)
        writer.start(profile="ros2", library=f"uvms_ocp {VERSION}")
        writer.add_metadata(_KEY, {"version": VERSION, "meta": run_meta.write_meta(meta)})
        all_topics = [
            *(_of_series(name, array, meta) for name, array in series.items()),
            *topics(series, meta, times, urdf),
        ]
        channels = [(_channel(writer, topic), topic) for topic in all_topics]
        if log_entries:
            log = _channel(writer, Topic(name="/log", kind="rcl_interfaces/Log", parts=()))
        else:
            log = 0
        for first in range(0, len(t), _BLOCK):
            rows = slice(first, first + _BLOCK)
            encoded = [(channel, topic.messages(rows)) for channel, topic in channels]
            for k, stamp in enumerate(times[rows].tolist()):
                for channel, messages in encoded:
                    if k < len(messages):
                        writer.add_message(channel, stamp, messages[k].tobytes(), stamp, first + k)
                while log_entries and log_entries[0][0] <= t[first + k]:
                    writer.add_message(log, stamp, log_entries.pop(0)[1], stamp, first + k)
        writer.finish()


def _channel(writer: Any, topic: Topic) -> int:
    package, name = topic.kind.split("/")
    definition = (topic.definition or ros_definition(topic.kind)).encode()
    schema = writer.register_schema(f"{package}/msg/{name}", "ros2msg", definition)
    return int(writer.register_channel(topic.name, "cdr", schema, dict(topic.metadata)))


def _of_series(name: str, array: np.ndarray, meta: Any) -> Topic:
    """Make the topic of a series, with what its columns are."""
    names, flat = flat_columns(name, array, meta, alone="value")
    kind, stored = _KINDS[array.dtype.kind]
    fields = field_names([column.removeprefix(f"{name}.") for column in names])
    description = {
        "dtype": array.dtype.str,
        "columns": "\n".join(names),
        "units": "\n".join(column_units(name, flat.shape[1], meta)),
    }
    return Topic(
        name=f"{_SERIES}{name}",
        kind=f"uvms_ocp/{field_names([name])[0]}",
        parts=(flat.astype(stored, copy=False),),
        definition="\n".join(f"{kind} {field}" for field in fields),
        metadata=series_description(name, array) | description,
    )


def from_mcap(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    """Read series by name and metadata of a file of `to_mcap`. Raises `InvalidInput` for another
    file, and `NotInstalled`.
    """
    require_mcap()
    from google.protobuf.message import DecodeError
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    damage = (
        McapError,
        DecodeError,
        ZstdError,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        struct.error,
        MemoryError,
    )
    with as_input_errors(path, *damage):
        require_regular_file(path)
        return _read(path)


def _read(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    from mcap_protobuf.decoder import DecoderFactory

    file_metadata = _metadata(path)
    version = file_metadata.get("version")
    if version not in (VERSION, _WITH_PROTOBUF):
        raise InvalidInput(
            f"{path}: no record of version {VERSION} or {_WITH_PROTOBUF}; give a file that"
            " Record.to_mcap wrote"
        )
    messages = defaultdict(list)
    metadata = {}
    decoders = DecoderFactory()
    for schema, channel, message in mcap_messages(path):
        if "series" in channel.metadata:
            metadata[channel.metadata["series"]] = channel.metadata
            if version == VERSION:
                decode = bytes
            else:
                decode = decoders.decoder_for(channel.message_encoding, schema)
            messages[channel.metadata["series"]].append(decode(message.data))
    series = {
        name: values_of(rows, metadata[name]["dtype"], int(metadata[name]["axes"]))
        for name, rows in messages.items()
    }
    return series, run_meta.read_meta(file_metadata["meta"])


def _metadata(path: Path) -> Mapping[str, str]:
    """Return the metadata that `to_mcap` wrote into the file; empty for one of others."""
    from mcap.reader import SeekingReader

    with path.open("rb") as file:
        reader = SeekingReader(file, record_size_limit=path.stat().st_size)
        return next(
            (dict(entry.metadata) for entry in reader.iter_metadata() if entry.name == _KEY), {}
        )
