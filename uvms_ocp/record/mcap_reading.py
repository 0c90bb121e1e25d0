"""Read messages from MCAP files of any origin, in the order of the file.

Chunks are unpacked one at a time and only up to the size that each declares, so that a damaged or
hostile file cannot fill the memory.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from uvms_ocp.errors import InvalidInput, optional_module
from uvms_ocp.record.untrusted import DENSEST, SMALL

LARGEST_CHUNK = 64 << 20
"""[B] largest unpacked size of a chunk that is read; usual writers make chunks of 1 to 4 MB."""
_WINDOW = 1 << 27  # [B] that zstd may look back


def mcap_messages(
    path: Path, topics: Collection[str] | None = None
) -> Iterator[tuple[Any, Any, Any]]:
    """Yield schema, channel and message of each message, of these topics or of all; the schema is
    `None` for an encoding that needs none.

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
    """Return all topics of a file, sorted.

    Raises `InvalidInput` for a file that unpacks to far more than it is, and what the library
    raises for a damaged one.
    """
    require_mcap()
    from mcap.records import Channel

    names = {record.topic for record in _records(path) if isinstance(record, Channel)}
    return tuple(sorted(names))


def _records(path: Path) -> Iterator[Any]:
    """Yield the records of a file, those within chunks too."""
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
            unpacked = replace(record, compression="", data=_unpacked(path, record))
            yield from breakup_chunk(unpacked, validate_crc=True)


def _require_size(path: Path, chunk: int, total: int, size: int) -> None:
    """Raise `InvalidInput` where a chunk, or the total of chunks up to it, unpacks to too much for
    a file of that size; all in bytes.
    """
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
    content = _first_bytes(chunk, size + 1)
    if len(content) != size:
        raise InvalidInput(
            f"{path}: a chunk does not hold the {size} bytes that it declares; mcap recover may"
            " help"
        )
    return content


def _first_bytes(chunk: Any, size: int) -> bytes:
    """Unpack a chunk up to that size [B]; one that is not packed is returned whole."""
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


def require_mcap() -> None:
    """Raise `NotInstalled` where one of the libraries that read MCAP files is missing."""
    for name in ("mcap", "mcap_protobuf"):
        optional_module(name, "an MCAP file", '"uvms-ocp[mcap]"')
