"""An MCAP file of a record: every series tick by tick, and what Foxglove draws of it; it comes back."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.run_meta import read_meta, write_meta
from uvms_ocp.tables.mcap.libraries import require_mcap
from uvms_ocp.tables.mcap.series_messages import series_message, values_of
from uvms_ocp.tables.mcap.shown_messages import log_messages, stamp, streams
from uvms_ocp.tables.record_files import described, written
from uvms_ocp.tables.series_table import column_names, column_units
from uvms_ocp.untrusted.mcap_records import mcap_messages
from uvms_ocp.untrusted.regular_file import require_regular

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
    written(path, lambda fresh: _write(series, meta, fresh))


def _write(series: Mapping[str, np.ndarray], meta: Any, path: Path) -> None:
    from mcap.writer import Writer
    from mcap_protobuf.schema import register_schema

    with path.open("wb") as file:
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
    told = {**described(name, array), "dtype": array.dtype.str, "columns": "\n".join(names), "units": "\n".join(units)}
    channel = writer.register_channel(f"{_SERIES}{name}", "protobuf", register_schema(writer, made), told)
    fields = [field.name for field in made.DESCRIPTOR.fields]
    return _Column(channel=channel, made=made, fields=fields, rows=flat.tolist())


def from_mcap(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    """Series by name and metadata of a file of `to_mcap`. Raises `InvalidInput` for another file, and `NotInstalled`."""
    require_mcap()
    from google.protobuf.message import DecodeError
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    damage = (McapError, DecodeError, ZstdError, OSError, ValueError, KeyError, TypeError, struct.error, MemoryError)
    try:
        require_regular(path)
        return _read(path)
    except InvalidInput:
        raise
    except damage as error:
        raise InvalidInput(f"{path}: cannot be read ({' '.join(str(error).split())[:200]})") from None


def _read(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    from mcap_protobuf.decoder import DecoderFactory

    own = _metadata(path)
    if own.get("version") != VERSION:
        raise InvalidInput(f"{path}: no record of version {VERSION}; give a file that Record.to_mcap wrote")
    found, told, decoders = defaultdict(list), {}, DecoderFactory()
    for schema, channel, message in mcap_messages(path):
        if "series" in channel.metadata:
            told[channel.metadata["series"]] = channel.metadata
            decode = decoders.decoder_for(channel.message_encoding, schema)
            found[channel.metadata["series"]].append(decode(message.data))
    series = {name: values_of(rows, told[name]["dtype"], int(told[name]["axes"])) for name, rows in found.items()}
    return series, read_meta(own["meta"])


def _metadata(path: Path) -> Mapping[str, str]:
    """What `to_mcap` says of the file; empty for one of others."""
    from mcap.reader import SeekingReader

    with path.open("rb") as file:
        reader = SeekingReader(file, record_size_limit=path.stat().st_size)
        return next((dict(entry.metadata) for entry in reader.iter_metadata() if entry.name == _KEY), {})
