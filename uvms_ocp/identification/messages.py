"""Columns of numbers from the messages of MCAP files and rosbag2 folders, by paths of fields.

``pose.pose.position.x`` is a path; ``actuators[3]`` and ``position.2`` are elements; ``position[elbow]`` and
``transforms[base_link].translation.x`` are those of a name, which a ``name`` or ``child_frame_id`` says. A path to a whole array
has all its elements.
"""

from __future__ import annotations

import json
import re
import sqlite3
from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, NameNotFound, NotInstalled, UvmsError
from uvms_ocp.identification.tables import MOST_ROWS
from uvms_ocp.record.mcap import mcap_messages, mcap_topics, require_mcap
from uvms_ocp.record.untrusted import read_yaml, require_regular_file

# What the library of the extra ``uvms-ocp[rosbags]`` knows: bags of ROS 2 in SQLite, and what messages of ROS 2 mean.

_PARTED = "=" * 80 + "\n"
"""Between the definitions of a schema in IDL."""
_DATA_BASE = b"SQLite format 3\0"


def bag_messages(folder: Path, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    """Topic, when it was logged [ns] and content of those of some topics. Raises NotInstalled and InvalidInput."""
    with _opened(folder) as reader:
        chosen = [connection for connection in reader.connections if connection.topic in topics]
        for connection, logged, data in reader.messages(connections=chosen) if chosen else ():
            yield connection.topic, logged, reader.deserialize(data, connection.msgtype)


def bag_topics(folder: Path) -> tuple[str, ...]:
    """Return all topics of a bag, sorted. Raises NotInstalled and InvalidInput."""
    with _opened(folder) as reader:
        return tuple(sorted({connection.topic for connection in reader.connections}))


def _opened(folder: Path) -> Any:
    _typesystem()
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    for file in filter(_is_data_base, folder.iterdir()):
        _require_plain(file)
    return AnyReader([folder], default_typestore=get_typestore(Stores.LATEST))


def _is_data_base(file: Path) -> bool:
    """Recognise a data base by its first bytes: the bag names its files freely."""
    if not file.is_file():
        return False
    with file.open("rb") as content:
        return content.read(len(_DATA_BASE)) == _DATA_BASE


def _require_plain(file: Path) -> None:
    """Raise InvalidInput for a data base that makes up its rows: of a few bytes, as many as there is time for."""
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
        (others,) = base.execute("SELECT count(*) FROM sqlite_master WHERE type NOT IN ('table', 'index')").fetchone()
    if others:
        raise InvalidInput(f"{file}: {others} views or triggers; tables alone are read")


def ros_decoder(name: str, encoding: str, text: str) -> Callable[[bytes], Any]:
    """Make the decoder of a message type; encoding: ros2msg or ros2idl, of the text. Raises NotInstalled, InvalidInput."""
    typesys = _typesystem()
    known = {"ros2msg": lambda: typesys.get_types_from_msg(text, name), "ros2idl": lambda: _of_idl(typesys, text)}
    if encoding not in known:
        raise InvalidInput(f"{name}: a schema as {encoding[:40]!r}; allowed: {', '.join(known)}")
    store = typesys.get_typestore(typesys.Stores.EMPTY if text.strip() else typesys.Stores.LATEST)
    if text.strip():
        store.register(known[encoding]())
    return lambda data: store.deserialize_cdr(data, name)


def _of_idl(typesys: Any, text: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for part in filter(str.strip, text.split(_PARTED)):
        found |= typesys.get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part)
    return found


def _typesystem() -> Any:
    try:
        from rosbags import typesys
    except ImportError:
        raise NotInstalled("a recording of ROS 2", '"uvms-ocp[rosbags]"') from None
    return typesys


# Messages of MCAP files and rosbag2 folders, decoded: JSON, protobuf and those of ROS 2.

Message = tuple[str, int, Any]
"""Topic, when it was logged [ns], and what it says."""
METADATA = "metadata.yaml"
_MCAP = ".mcap"


def holds_messages(path: Path) -> bool:
    """Recognise a file or folder of messages, by its ending or its contents."""
    return path.suffix == _MCAP or (path / METADATA).is_file()


def messages(path: Path, topics: Collection[str]) -> Iterator[Message]:
    """Yield the messages of some topics as logged. Raises NotInstalled, and InvalidInput for damaged or too large files."""
    return _checked(path, lambda: _messages(path, topics))


def topics_of(path: Path) -> tuple[str, ...]:
    """Return all topics, sorted. Raises NotInstalled and InvalidInput, as `messages` does."""
    return tuple(_checked(path, lambda: _topics(path)))


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
    """List the files that hold the messages; `None` for a folder of another storage."""
    if not path.is_dir():
        require_regular_file(path)
        return [path]
    about: Any = read_yaml(path / METADATA)
    information = about["rosbag2_bagfile_information"]
    packed = str(information.get("compression_mode") or "none").lower()
    if packed != "none":
        raise InvalidInput(f"{path}: packed by {packed}; unpack it by `ros2 bag convert`")
    files = [path / PurePath(name).name for name in information["relative_file_paths"]]
    for file in files:
        require_regular_file(file)
    return files if information["storage_identifier"] == _MCAP[1:] else None


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


def _checked(path: Path, work: Callable[[], Iterator[Any]]) -> Iterator[Any]:
    try:
        yield from work()
    except (UvmsError, NotInstalled):
        raise
    except Exception as error:  # whatever libraries say to bytes that nobody meant
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InvalidInput(f"{path}: cannot be read ({said})") from None


# Numbers in a message by paths such as ``pose.pose.position.x``, whatever library has decoded it.

_STEP = re.compile(r"\[([^\[\]]+)\]|([^.\[\]]+)")
_PATH = re.compile(r"[^.\[\]]+(\.[^.\[\]]+|\[[^\[\]]+\])*$")
_NAMED = ("name", "child_frame_id")
_STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Fields of a time in ROS 2, in Foxglove's JSON, in ROS 1 and in protobuf."""


def steps_of(path: str) -> tuple[str, ...]:
    """Split a path into its steps. Raises InvalidInput for a malformed one."""
    if not _PATH.match(path):
        raise InvalidInput(
            f"field {path!r} given; allowed: names with dots between them, such as pose.position.x or a[3]"
        )
    return tuple(element or name for element, name in _STEP.findall(path))


def numbers_at(message: Any, steps: Sequence[str]) -> list[float]:
    """Return the number there, or all of an array. Raises NameNotFound, and InvalidInput for what is no number."""
    value = _value_at(message, steps)
    return [_number(x, steps) for x in value] if _is_array(value) else [_number(value, steps)]


def seconds_at(message: Any, steps: Sequence[str], unit: float) -> float:
    """A time [s]; unit: that of a plain number [s], which a stamp of seconds and nanoseconds does not need.

    Raises NameNotFound, and InvalidInput for what is neither.
    """
    value = _value_at(message, steps)
    names = () if isinstance(value, (int, float)) else _names_in(value)
    for whole, part in _STAMPS:
        if whole in names and part in names:
            return _number(_field(value, whole), steps) + 1e-9 * _number(_field(value, part), steps)
    return unit * _number(value, steps)


def _value_at(message: Any, steps: Sequence[str]) -> Any:
    parent, value = None, message
    for step in steps:
        parent, value = value, _element(parent, value, step) if _is_array(value) else _field(value, step)
    return value


def _field(value: Any, name: str) -> Any:
    names = _names_in(value)
    if name not in names:
        raise NameNotFound("field", name, names)
    return value[name] if isinstance(value, Mapping) else getattr(value, name)


def _names_in(value: Any) -> tuple[str, ...]:
    """Names of the fields of a message; none for a number."""
    if isinstance(value, Mapping):
        return tuple(map(str, value))
    if is_dataclass(value):
        return tuple(field.name for field in fields(value))
    return tuple(field.name for field in getattr(getattr(value, "DESCRIPTOR", None), "fields", ()))


def _element(parent: Any, value: Any, step: str) -> Any:
    if step.isdecimal():
        if int(step) >= len(value):
            raise NameNotFound("element", step, [f"0 to {len(value) - 1}"])
        return value[int(step)]
    names = list(_names_of_elements(parent, value))
    if step not in names:
        raise NameNotFound("element", step, names)
    return value[names.index(step)]


def _names_of_elements(parent: Any, value: Any) -> Iterator[str]:
    """Yield names of elements, by a field of each or by the names beside them."""
    beside = _names_in(parent)
    if _NAMED[0] in beside and len(_field(parent, _NAMED[0])) == len(value):
        yield from map(str, _field(parent, _NAMED[0]))
        return
    for one in value:
        yield from (str(_field(one, name)) for name in _NAMED if name in _names_in(one))


def _is_array(value: Any) -> bool:
    return isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (str, bytes))


def _number(value: Any, steps: Sequence[str]) -> float:
    if isinstance(value, (int, float, np.number, np.bool_)):
        return float(value)
    known = ", ".join(_names_in(value))
    raise InvalidInput(f"{'.'.join(steps)} is no number{f', it has {known}' if known else ''}; give a path to one")


# Columns of numbers out of messages, those of all channels in one pass.


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicColumns:
    """Columns to read from the messages of a topic."""

    topic: str
    columns: tuple[str, ...]
    """Paths of fields, see `uvms_ocp.identification.messages`."""
    time: str = ""
    """Path of the time; empty for the time of logging."""
    unit: float = 1.0
    """[s] of a time that is a plain number."""


def message_rows(path: Path, wanted: Mapping[str, TopicColumns]) -> dict[str, np.ndarray]:
    """Times [s] and values [as they are] (n, 1 + k) of all that is wanted, by the same names.

    A message without such a field gives no row. Raises NameNotFound where none has it, NotInstalled and InvalidInput.
    """
    found = {name: _Rows(one) for name, one in wanted.items()}
    by_topic: dict[str, list[_Rows]] = defaultdict(list)
    for rows in found.values():
        by_topic[rows.wanted.topic].append(rows)
    for topic, logged, content in messages(path, by_topic.keys()):
        for rows in by_topic[topic]:
            rows.add(logged, content)
    return {name: rows.whole(path) for name, rows in found.items()}


@dataclass(slots=True, eq=False)
class _Rows:
    """Rows of one channel, read so far."""

    wanted: TopicColumns
    time: tuple[str, ...] = field(init=False)
    columns: tuple[tuple[str, ...], ...] = field(init=False)
    numbers: array[float] = field(default_factory=lambda: array("d"))
    width: int = 0
    missing: NameNotFound | None = None

    def __post_init__(self) -> None:
        self.time = steps_of(self.wanted.time) if self.wanted.time else ()
        self.columns = tuple(map(steps_of, self.wanted.columns))

    def add(self, logged: int, content: Any) -> None:
        try:
            row = [seconds_at(content, self.time, self.wanted.unit) if self.time else 1e-9 * logged]
            for steps in self.columns:
                row += numbers_at(content, steps)
        except NameNotFound as error:
            self.missing = self.missing or error
            return
        self.width = self.width or len(row)
        if len(row) != self.width:
            raise InvalidInput(
                f"{self.wanted.topic}: {self.width - 1} numbers at first, then {len(row) - 1}; give elements"
            )
        if len(self.numbers) >= self.width * MOST_ROWS:
            raise InvalidInput(f"{self.wanted.topic}: more than {MOST_ROWS} messages; give recordings one by one")
        self.numbers.extend(row)

    def whole(self, path: Path) -> np.ndarray:
        if self.numbers:
            return np.array(self.numbers).reshape(-1, self.width)
        if self.missing is not None:
            raise InvalidInput(f"{path.name}: {self.wanted.topic}: {self.missing}")
        raise NameNotFound(f"topic of {path.name}", self.wanted.topic, topics_of(path))
