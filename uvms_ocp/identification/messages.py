"""Read messages and topics of MCAP files, ROS 1 and ROS 2 bags, lines of JSON, logs of MAVLink and PX4.

`uvms_ocp.identification.message_columns` makes columns of numbers of them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.file_kinds import BAG_METADATA, kind_of
from uvms_ocp.identification.json_logs import json_messages, json_topics
from uvms_ocp.identification.logged_message import Message
from uvms_ocp.identification.mavlink_logs import mavlink_messages, mavlink_topics
from uvms_ocp.identification.mcap_logs import mcap_contents
from uvms_ocp.identification.ros_logs import (
    ros1_messages,
    ros1_topics,
    sqlite_messages,
    sqlite_topics,
)
from uvms_ocp.identification.ulog_logs import ulog_messages, ulog_topics
from uvms_ocp.record import mcap_reading, untrusted, yaml_file


def messages(
    path: Path, topics: Collection[str], definitions: Path | None, remarks: list[str]
) -> Iterator[Message]:
    """Yield the messages of some topics as logged; definitions: folder with ``.msg`` files that a
    bag of ROS 2 lacks.

    remarks: gets a sentence for what was left out. Raises NotInstalled, and InvalidInput for damaged or too large
    files.
    """
    for file in message_files(path):
        with untrusted.as_input_errors(file):
            yield from _READERS[kind_of(file)].messages(file, topics, definitions, remarks)


def topics_of(path: Path) -> tuple[str, ...]:
    """Return all topics, sorted. Raises NotInstalled and InvalidInput, as `messages` does."""
    topics: set[str] = set()
    for file in message_files(path):
        with untrusted.as_input_errors(file):
            topics.update(_READERS[kind_of(file)].topics(file))
    return tuple(sorted(topics))


def message_files(path: Path) -> list[Path]:
    """List the file itself, or those of a folder of ROS 2. Raises InvalidInput for a packed folder."""
    if not path.is_dir():
        return [path]
    with untrusted.as_input_errors(path / BAG_METADATA):
        about: Any = yaml_file.read_yaml(path / BAG_METADATA)
        information = about["rosbag2_bagfile_information"]
        packed = str(information.get("compression_mode") or "none").lower()
        names = []
        if packed == "none":
            names = information["relative_file_paths"]
    if packed != "none":
        raise InvalidInput(f"{path}: packed by {packed}; unpack it by `ros2 bag convert`")
    files = [path / PurePath(name).name for name in names]
    for file in files:
        untrusted.require_regular_file(file)
    return files


@dataclass(frozen=True, slots=True)
class _Reader:
    """Functions that read messages of one kind of file."""

    messages: Callable[[Path, Collection[str], Path | None, list[str]], Iterator[Message]]
    """Yields messages, with the arguments of `messages`."""
    topics: Callable[[Path], Collection[str]]
    """Returns the topics of a file."""


_READERS = {
    "mcap": _Reader(mcap_contents, mcap_reading.mcap_topics),
    "bag": _Reader(ros1_messages, ros1_topics),
    "sqlite": _Reader(sqlite_messages, sqlite_topics),
    "json": _Reader(json_messages, json_topics),
    "dataflash": _Reader(mavlink_messages, mavlink_topics),
    "tlog": _Reader(mavlink_messages, mavlink_topics),
    "ulog": _Reader(ulog_messages, ulog_topics),
}
