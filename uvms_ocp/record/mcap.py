"""Write a record as an MCAP file, which ROS 2 and Foxglove open, and read it again to the last
digit: every series is a topic, with a message for every tick and a field for every column.
"""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record import output, run_meta
from uvms_ocp.record.mcap_reading import mcap_messages, require_mcap
from uvms_ocp.record.ros_topics import CDR_HEAD, Topic, log_messages, ros_definition, topics
from uvms_ocp.record.tables import column_units, flat_columns, series_description
from uvms_ocp.record.untrusted import as_input_errors, require_regular_file

VERSION = "2"
"""Version of the format that is written."""
_WITH_PROTOBUF = "1"
"""Older version, which is read too."""
_KEY = "uvms_ocp"
"""Name of our metadata in a file."""
_SERIES = "/series/"
"""Prefix of the topics of series."""
_BLOCK = 4096
"""Ticks that are encoded at a time."""
_KINDS = {"f": ("float64", "f8"), "i": ("int64", "i8"), "u": ("uint64", "u8"), "b": ("bool", "?")}
"""Type of a ROS 2 field and of its values in NumPy, by `dtype.kind` of a series: the widest of each
kind.
"""


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
        all_topics = [_series_topic(name, array, meta) for name, array in series.items()]
        all_topics += topics(series, meta, times, urdf)
        channels = [_channel(writer, topic) for topic in all_topics]
        log = 0
        if log_entries:
            log = _channel(writer, Topic(name="/log", kind="rcl_interfaces/Log", parts=()))
        for first in range(0, len(t), _BLOCK):
            rows = slice(first, first + _BLOCK)
            blocks = [topic.messages(rows) for topic in all_topics]
            encoded = list(zip(channels, blocks, strict=True))
            for k, stamp in enumerate(times[rows].tolist()):
                for channel, messages in encoded:
                    if k < len(messages):
                        writer.add_message(channel, stamp, messages[k].tobytes(), stamp, first + k)
                while log_entries and log_entries[0][0] <= t[first + k]:
                    writer.add_message(log, stamp, log_entries.pop(0)[1], stamp, first + k)
        writer.finish()


def _channel(writer: Any, topic: Topic) -> int:
    """Register a topic, and return the number of its channel."""
    package, name = topic.kind.split("/")
    definition = (topic.definition or ros_definition(topic.kind)).encode()
    schema = writer.register_schema(f"{package}/msg/{name}", "ros2msg", definition)
    return int(writer.register_channel(topic.name, "cdr", schema, dict(topic.metadata)))


def _series_topic(name: str, array: np.ndarray, meta: Any) -> Topic:
    """Make the topic of a series, with what its columns are."""
    names, flat = flat_columns(name, array, meta, alone="value")
    kind, stored = _KINDS[array.dtype.kind]
    columns = [column.removeprefix(f"{name}.") for column in names]
    definition = [f"{kind} {field}" for field in field_names(columns)]
    description = {
        "dtype": array.dtype.str,
        "columns": "\n".join(names),
        "units": "\n".join(column_units(name, flat.shape[1], meta)),
    }
    return Topic(
        name=f"{_SERIES}{name}",
        kind=f"uvms_ocp/{field_names([name])[0]}",
        parts=(flat.astype(stored, copy=False),),
        definition="\n".join(definition),
        metadata=series_description(name, array) | description,
    )


def field_names(columns: Sequence[str]) -> list[str]:
    """Return names that a message may have, each once."""
    names: list[str] = []
    for column in columns:
        plain = re.sub(r"\W+|__+", "_", column, flags=re.ASCII).strip("_")
        if not plain[:1].isalpha():
            plain = f"c{plain}"
        if plain in names:
            plain = f"{plain}_{len(names) + 1}"
        names.append(plain)
    return names


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
    """Read series and metadata; what a damaged file raises is passed on."""
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
        name = channel.metadata.get("series")
        if name is None:
            continue
        if version == VERSION:
            decode = bytes
        else:
            decode = decoders.decoder_for(channel.message_encoding, schema)
        metadata[name] = channel.metadata
        messages[name].append(decode(message.data))
    series = dict[str, np.ndarray]()
    for name, rows in messages.items():
        description = metadata[name]
        series[name] = values_of(rows, description["dtype"], int(description["axes"]))
    return series, run_meta.read_meta(file_metadata["meta"])


def _metadata(path: Path) -> Mapping[str, str]:
    """Return the metadata that `to_mcap` wrote into the file; empty for one of others."""
    from mcap.reader import SeekingReader

    with path.open("rb") as file:
        reader = SeekingReader(file, record_size_limit=path.stat().st_size)
        for entry in reader.iter_metadata():
            if entry.name == _KEY:
                return dict(entry.metadata)
    return {}


def values_of(messages: Sequence[Any], dtype: str, n_axes: int) -> np.ndarray:
    """Return the series (n, k), or (n,) with one axis, of its messages; dtype: as numpy writes it.
    Raises `ValueError` for another.

    messages: in CDR, or decoded ones of a file of version 1.
    """
    numpy_type = np.dtype(dtype)
    if numpy_type.kind not in _KINDS:
        raise ValueError(f"a series of {dtype[:20]!r}")
    stored = np.dtype(_KINDS[numpy_type.kind][1]).newbyteorder("<")
    rows = list[Any]()
    if isinstance(messages[0], bytes):
        for message in messages:
            rows.append(np.frombuffer(message, dtype=stored, offset=len(CDR_HEAD)))
    else:
        fields = [field.name for field in messages[0].DESCRIPTOR.fields]
        for message in messages:
            rows.append([getattr(message, name) for name in fields])
    values = np.array(rows, dtype=stored).astype(numpy_type)
    if n_axes == 1:
        return values[:, 0]
    return values
