"""Messages of MCAP files and rosbag2 folders, decoded: JSON, protobuf and those of ROS 2."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
from pathlib import Path, PurePath
from typing import Any

from uvms_ocp.exceptions import InvalidInput, NotInstalled, UvmsError
from uvms_ocp.identification.recordings.bags import bag_messages, bag_topics, ros_decoder
from uvms_ocp.tables.mcap.libraries import require_mcap
from uvms_ocp.untrusted.mcap_records import mcap_messages, mcap_topics
from uvms_ocp.untrusted.regular_file import require_regular
from uvms_ocp.untrusted.yaml_file import read_yaml

Message = tuple[str, int, Any]
"""Topic, when it was logged [ns], and what it says."""
METADATA = "metadata.yaml"
_MCAP = ".mcap"


def holds_messages(path: Path) -> bool:
    """Whether it is such a file or folder, by its ending or by what is in it."""
    return path.suffix == _MCAP or (path / METADATA).is_file()


def messages(path: Path, topics: Collection[str]) -> Iterator[Message]:
    """Those of some topics as they were logged. Raises NotInstalled, and InvalidInput for what is damaged or too large."""
    return _told(path, lambda: _messages(path, topics))


def topics_of(path: Path) -> tuple[str, ...]:
    """All, sorted. Raises NotInstalled and InvalidInput, as `messages` does."""
    return tuple(_told(path, lambda: _topics(path)))


def _messages(path: Path, topics: Collection[str]) -> Iterator[Message]:
    files = _mcap_files(path)
    if files is None:
        yield from bag_messages(path, topics)
        return
    require_mcap()
    for file in files:
        decoders: dict[tuple[str, int], Callable[[bytes], Any]] = {}
        for schema, channel, message in mcap_messages(file, topics):
            key = (channel.message_encoding, channel.schema_id)
            if key not in decoders:
                decoders[key] = _decoder(channel, schema)
            yield channel.topic, message.log_time, decoders[key](message.data)


def _topics(path: Path) -> Iterator[str]:
    files = _mcap_files(path)
    if files is None:
        yield from bag_topics(path)
        return
    require_mcap()
    yield from sorted({topic for file in files for topic in mcap_topics(file)})


def _mcap_files(path: Path) -> list[Path] | None:
    """Those that hold the messages; none of a folder whose storage is another."""
    if not path.is_dir():
        require_regular(path)
        return [path]
    about: Any = read_yaml(path / METADATA)
    told = about["rosbag2_bagfile_information"]
    packed = str(told.get("compression_mode") or "none").lower()
    if packed != "none":
        raise InvalidInput(f"{path}: packed by {packed}; unpack it by `ros2 bag convert`")
    files = [path / PurePath(name).name for name in told["relative_file_paths"]]
    for file in files:
        require_regular(file)
    return files if told["storage_identifier"] == _MCAP[1:] else None


def _decoder(channel: Any, schema: Any) -> Callable[[bytes], Any]:
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding == "cdr" and schema is not None:
        return ros_decoder(schema.name, schema.encoding, schema.data.decode())
    from mcap_protobuf.decoder import DecoderFactory

    found: Callable[[bytes], Any] | None = DecoderFactory().decoder_for(channel.message_encoding, schema)
    if found is None:
        said = channel.message_encoding[:40]
        raise InvalidInput(
            f"{channel.topic[:80]} is encoded as {said!r}; json, protobuf and cdr with a schema are read"
        )
    return found


def _told(path: Path, work: Callable[[], Iterator[Any]]) -> Iterator[Any]:
    try:
        yield from work()
    except (UvmsError, NotInstalled):
        raise
    except Exception as error:  # whatever libraries say to bytes that nobody meant
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InvalidInput(f"{path}: cannot be read ({said})") from None
