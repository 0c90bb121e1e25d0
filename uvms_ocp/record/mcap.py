"""Write records as MCAP files, which Foxglove opens, and read MCAP files of anyone within bounds."""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import IO, Any

import numpy as np

from uvms_ocp.errors import InvalidInput, optional_module
from uvms_ocp.record.output import whole_file
from uvms_ocp.record.run_meta import is_floating, joint_positions, read_meta, write_meta
from uvms_ocp.record.tables import Series, column_names, column_units, series_description
from uvms_ocp.record.untrusted import DENSEST, SMALL, as_input_errors, require_regular_file

# Messages of an MCAP file in the order that they stand there, unpacked chunk by chunk within what each chunk declares.

LARGEST_CHUNK = 64 << 20
"""[B] when unpacked; writers close one after 1 to 4 MB."""
_WINDOW = 1 << 27  # [B] that zstd may look back


def mcap_messages(path: Path, topics: Collection[str] | None = None) -> Iterator[tuple[Any, Any, Any]]:
    """Schema (none for messages that need none), channel and message, of these topics or of all.

    Raises `InvalidInput` for a file that unpacks to far more than it is, and what the library raises for a damaged one.
    """
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
    """All of a file, sorted. Raises `InvalidInput` and others, as `mcap_messages` does."""
    from mcap.records import Channel

    return tuple(sorted({record.topic for record in _records(path) if isinstance(record, Channel)}))


def _records(path: Path) -> Iterator[Any]:
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    size, total = path.stat().st_size, 0
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=size).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            total += record.uncompressed_size
            _require_size(path, record.uncompressed_size, total, size)
            yield from breakup_chunk(replace(record, compression="", data=_unpacked(path, record)), validate_crc=True)


def _require_size(path: Path, chunk: int, total: int, size: int) -> None:
    if chunk > LARGEST_CHUNK:
        raise InvalidInput(f"{path}: a chunk of {chunk >> 20} MB; at most {LARGEST_CHUNK >> 20} MB are read")
    if total > max(SMALL, DENSEST * size):
        raise InvalidInput(f"{path}: would unpack to more than {total >> 20} MB; at most {DENSEST} times a file are read")


def _unpacked(path: Path, chunk: Any) -> bytes:
    """Return the contents of a chunk. Raises `InvalidInput` where they have another size than it states."""
    size = chunk.uncompressed_size
    found = _first(chunk, size + 1)
    if len(found) != size:
        raise InvalidInput(f"{path}: a chunk does not hold the {size} bytes that it declares; mcap recover may help")
    return found


def _first(chunk: Any, most: int) -> bytes:
    if chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return bytes(LZ4FrameDecompressor().decompress(chunk.data, max_length=most))
    if chunk.compression == "zstd":
        from zstandard import ZstdDecompressor

        stream: IO[bytes] = ZstdDecompressor(max_window_size=_WINDOW).stream_reader(chunk.data)
        return stream.read(most)
    if chunk.compression:
        raise InvalidInput(f"a chunk packed by {chunk.compression[:20]!r}; lz4 and zstd are read")
    return bytes(chunk.data)


# The libraries of the extra ``uvms-ocp[mcap]``, imported when a file is written or read.


def require_mcap() -> None:
    """Raise `NotInstalled` where any of them is missing."""
    for name in ("foxglove_schemas_protobuf", "mcap", "mcap_protobuf"):
        optional_module(name, "an MCAP file", '"uvms-ocp[mcap]"')


# A message for every tick of a series, with a field for every column: what is written is read again to the last digit.

_KINDS = {"f": ("TYPE_DOUBLE", "f8"), "i": ("TYPE_INT64", "i8"), "u": ("TYPE_UINT64", "u8"), "b": ("TYPE_BOOL", "?")}
"""Of fields and of their values, by the kind of an array: wide enough for all of its kind."""
_RESERVED = range(19000, 20000)  # numbers that fields may not have


def series_message(name: str, kind: str, columns: Sequence[str]) -> Any:
    """The class of the messages of a series; kind: of its array, "f", "i", "u" or "b"."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    title = field_names([name])[0]
    file = descriptor_pb2.FileDescriptorProto(name=f"uvms_ocp/{title}.proto", package="uvms_ocp", syntax="proto3")
    message = file.message_type.add(name=title)
    own = descriptor_pb2.FieldDescriptorProto
    numbers = (k for k in count(1) if k not in _RESERVED)
    as_said = {"type": getattr(own, _KINDS[kind][0]), "label": own.Label.Value("LABEL_OPTIONAL")}
    for number, column in zip(numbers, field_names(columns), strict=False):
        message.field.add(name=column, number=number, **as_said)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"uvms_ocp.{title}"))


def field_names(columns: Sequence[str]) -> list[str]:
    """Names that a message may have, each once."""
    found: list[str] = []
    for column in columns:
        plain = re.sub(r"\W", "_", column, flags=re.ASCII) or "_"
        plain = f"_{plain}" if plain[0].isdigit() else plain
        found.append(plain if plain not in found else f"{plain}_{len(found) + 1}")
    return found


def values_of(messages: Sequence[Any], dtype: str, n_axes: int) -> np.ndarray:
    """The series (n, k), or (n,) with one axis, of its messages; dtype: as numpy writes it. Raises `ValueError` for another."""
    wanted = np.dtype(dtype)
    if wanted.kind not in _KINDS:
        raise ValueError(f"a series of {dtype[:20]!r}")
    fields = [field.name for field in messages[0].DESCRIPTOR.fields]
    rows = [[getattr(message, field) for field in fields] for message in messages]
    found = np.array(rows, dtype=_KINDS[wanted.kind][1]).reshape(len(rows), -1).astype(wanted)
    return found[:, 0] if n_axes == 1 else found


# What Foxglove draws by itself: poses as transforms, states of joints, wrenches, and what was said.

WORLD, VEHICLE = "world", "base_link"
_POSES = {"q": VEHICLE, "q_estimated": f"{VEHICLE}_estimated", "tool": "tool"}
"""Series that begin with a pose in W, and the frame that has it."""
_WRENCHES = ("wrench", "unreachable", "disturbance")
_POSE, _WRENCH = 7, 6


@dataclass(frozen=True, kw_only=True, slots=True)
class Stream:
    """One topic."""

    topic: str
    at: Callable[[int, Any], Any]
    """The message of a tick, of that time stamp."""
    once: bool = False
    """True for messages of the first tick alone."""


def stamp(nanoseconds: int) -> Any:
    """A time stamp."""
    from google.protobuf.timestamp_pb2 import Timestamp

    return Timestamp(seconds=nanoseconds // 10**9, nanos=nanoseconds % 10**9)


def streams(series: Series, meta: Any) -> Iterator[Stream]:
    """All topics that a record can fill."""
    floating = is_floating(series, meta)
    poses = {frame: series[name] for name, frame in _POSES.items() if name in series and (floating or name == "tool")}
    if poses:
        yield Stream(topic="/tf", at=partial(_transforms, poses))
    if meta.surroundings.frames:
        goals = {frame.name: np.array([frame.pose]) for frame in meta.surroundings.frames}
        yield Stream(topic="/goals", at=partial(_transforms, goals), once=True)
    if meta.joints and (positions := joint_positions(series, meta)) is not None:
        states = {"position": positions, "velocity": series.get("v"), "effort": series.get("torque")}
        yield Stream(topic="/joint_states", at=partial(_joints, states, tuple(meta.joints)))
    if floating:
        for name in _WRENCHES:
            if name in series:
                yield Stream(topic=f"/{name}", at=partial(_wrench, wrench_class(), series[name]))


def _transforms(poses: Mapping[str, np.ndarray], k: int, when: Any) -> Any:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    found = FrameTransforms()
    for frame, rows in poses.items():
        x, y, z, *turn = rows[k, :_POSE].tolist()
        one = FrameTransform(timestamp=when, parent_frame_id=WORLD, child_frame_id=frame)
        one.translation.x, one.translation.y, one.translation.z = x, y, z
        one.rotation.x, one.rotation.y, one.rotation.z, one.rotation.w = turn
        found.transforms.append(one)
    return found


def _joints(states: Mapping[str, Any], names: Sequence[str], k: int, when: Any) -> Any:
    from foxglove_schemas_protobuf.JointState_pb2 import JointState
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

    n = len(names)
    columns = {key: rows[k, -n:].tolist() for key, rows in states.items() if rows is not None}
    joints = [JointState(name=name, **{key: row[i] for key, row in columns.items()}) for i, name in enumerate(names)]
    return JointStates(timestamp=when, joints=joints)


def _wrench(made: Any, rows: np.ndarray, k: int, when: Any) -> Any:
    found = made(timestamp=when, frame_id=VEHICLE)
    values = rows[k, :_WRENCH].tolist()
    found.force.x, found.force.y, found.force.z, found.torque.x, found.torque.y, found.torque.z = values
    return found


def wrench_class() -> Any:
    """The class of messages with a force [N] and a torque [N m], for which Foxglove has none."""
    from foxglove_schemas_protobuf import Vector3_pb2
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    needed = (Vector3_pb2.DESCRIPTOR.name, timestamp_pb2.DESCRIPTOR.name)
    known = {"package": "uvms_ocp", "syntax": "proto3", "dependency": needed}
    file = descriptor_pb2.FileDescriptorProto(name="uvms_ocp/Wrench.proto", **known)
    message, own = file.message_type.add(name="Wrench"), descriptor_pb2.FieldDescriptorProto
    once = own.Label.Value("LABEL_OPTIONAL")
    kinds = {"timestamp": ".google.protobuf.Timestamp", "force": ".foxglove.Vector3", "torque": ".foxglove.Vector3"}
    for number, (name, kind) in enumerate(kinds.items(), start=1):
        message.field.add(name=name, number=number, type=own.Type.Value("TYPE_MESSAGE"), type_name=kind, label=once)
    message.field.add(name="frame_id", number=4, type=own.Type.Value("TYPE_STRING"), label=once)
    pool = descriptor_pool.Default()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("uvms_ocp.Wrench"))


def log_messages(meta: Any) -> list[tuple[float, Any]]:
    """List events, alarms and faults of a run in order of time, each with its time [s]."""
    from foxglove_schemas_protobuf.Log_pb2 import Log

    events = [(e.t, Log.INFO, f"{e.source} to {e.target}: {e.reason}") for e in getattr(meta, "events", ())]
    alarms = [(alarm.t, Log.WARNING, alarm.text) for alarm in getattr(meta, "alarms", ())]
    faults = [(fault.t, Log.ERROR, fault.text) for fault in getattr(meta, "faults", ())]
    entries = sorted([*events, *alarms, *faults], key=lambda entry: entry[0])
    return [(t, Log(timestamp=stamp(round(1e9 * t)), level=level, message=text)) for t, level, text in entries]


# An MCAP file of a record: every series tick by tick, and what Foxglove draws of it; it comes back.

VERSION = "1"
"""Of the files."""
_KEY, _SERIES = "uvms_ocp", "/series/"


@dataclass(frozen=True, kw_only=True, slots=True)
class _Column:
    """One series on its way into a file."""

    channel: int
    made: Any
    fields: list[str]
    rows: list[Any]

    def message(self, k: int) -> bytes:
        return bytes(self.made(**dict(zip(self.fields, self.rows[k], strict=True))).SerializeToString())


def to_mcap(series: Mapping[str, np.ndarray], meta: Any, path: Path) -> None:
    """Write what `from_mcap` reads as the same; series: (n, ...) each [unit of it]. Raises `NotInstalled` and `OutputError`."""
    require_mcap()
    from mcap.writer import Writer
    from mcap_protobuf.schema import register_schema

    with whole_file(path) as file:
        writer = Writer(file)
        writer.start(profile="", library=f"uvms_ocp {VERSION}")
        writer.add_metadata(_KEY, {"version": VERSION, "meta": write_meta(meta)})
        columns = [_column(writer, name, array, meta) for name, array in series.items()]
        shown, said, channels = list(streams(series, meta)), log_messages(meta), dict[str, int]()

        def send(topic: str, message: Any, now: int, k: int) -> None:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "protobuf", register_schema(writer, type(message)))
            writer.add_message(channels[topic], now, message.SerializeToString(), now, k)

        t = series["t"]
        for k, now in enumerate(np.rint(1e9 * (t - min(t[0], 0.0))).astype(np.int64).tolist()):
            for column in columns:
                writer.add_message(column.channel, now, column.message(k), now, k)
            for stream in shown if k == 0 else (stream for stream in shown if not stream.once):
                send(stream.topic, stream.at(k, stamp(now)), now, k)
            while said and said[0][0] <= t[k]:
                send("/log", said.pop(0)[1], now, k)
        writer.finish()


def _column(writer: Any, name: str, array: np.ndarray, meta: Any) -> _Column:
    """A channel, with what its columns are."""
    from mcap_protobuf.schema import register_schema

    flat = array.reshape(len(array), -1)
    names = column_names(name, flat.shape[1], meta) if array.ndim > 1 else ["value"]
    units = column_units(name, flat.shape[1], meta)
    short = [column.removeprefix(f"{name}.") for column in names]
    made = series_message(name, array.dtype.kind, short)
    about = {"dtype": array.dtype.str, "columns": "\n".join(names), "units": "\n".join(units)}
    metadata = series_description(name, array) | about
    channel = writer.register_channel(f"{_SERIES}{name}", "protobuf", register_schema(writer, made), metadata)
    fields = [field.name for field in made.DESCRIPTOR.fields]
    return _Column(channel=channel, made=made, fields=fields, rows=flat.tolist())


def from_mcap(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    """Series by name and metadata of a file of `to_mcap`. Raises `InvalidInput` for another file, and `NotInstalled`."""
    require_mcap()
    from google.protobuf.message import DecodeError
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    damage = (McapError, DecodeError, ZstdError, OSError, ValueError, KeyError, TypeError, struct.error, MemoryError)
    with as_input_errors(path, *damage):
        require_regular_file(path)
        return _read(path)


def _read(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    from mcap_protobuf.decoder import DecoderFactory

    own = _metadata(path)
    if own.get("version") != VERSION:
        raise InvalidInput(f"{path}: no record of version {VERSION}; give a file that Record.to_mcap wrote")
    found, metadata, decoders = defaultdict(list), {}, DecoderFactory()
    for schema, channel, message in mcap_messages(path):
        if "series" in channel.metadata:
            metadata[channel.metadata["series"]] = channel.metadata
            decode = decoders.decoder_for(channel.message_encoding, schema)
            found[channel.metadata["series"]].append(decode(message.data))
    series = {}
    for name, rows in found.items():
        series[name] = values_of(rows, metadata[name]["dtype"], int(metadata[name]["axes"]))
    return series, read_meta(own["meta"])


def _metadata(path: Path) -> Mapping[str, str]:
    """Return the metadata that `to_mcap` wrote into the file; empty for one of others."""
    from mcap.reader import SeekingReader

    with path.open("rb") as file:
        reader = SeekingReader(file, record_size_limit=path.stat().st_size)
        return next((dict(entry.metadata) for entry in reader.iter_metadata() if entry.name == _KEY), {})
