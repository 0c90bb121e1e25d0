"""Columns of numbers from messages: MCAP files, ROS 1 and ROS 2 bags, lines of JSON, logs of
MAVLink and PX4; `uvms_ocp.identification.message_fields` finds numbers in one message.
"""

from __future__ import annotations

import json
import re
import sqlite3
from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from uvms_ocp.errors import InvalidInput, NameNotFound, optional_module
from uvms_ocp.identification.file_kinds import BAG_METADATA, kind_of
from uvms_ocp.identification.message_fields import (
    has_value,
    numbers_at,
    paths_by_name,
    seconds_at,
    steps_of,
    value_at,
)
from uvms_ocp.identification.message_senders import Identity, SenderCount
from uvms_ocp.identification.tables import TableColumns
from uvms_ocp.identification.text_tables import LONGEST_LINE, MOST_ROWS
from uvms_ocp.record import mcap_messages, untrusted, yaml_file


class Message(NamedTuple):
    """One message as logged."""

    topic: str
    """Name of the topic."""
    logged: int
    """[ns] time of logging."""
    content: Any
    """Fields of the message, by their names."""
    sender: Identity = MappingProxyType({})
    """Identity of the sender; empty where the file does not tell senders apart."""


_SEPARATOR = "=" * 80 + "\n"
"""Line between the definitions of a schema in IDL."""

_loads = partial(json.loads, parse_int=float)  # any number of digits


def messages(
    path: Path, topics: Collection[str], definitions: Path | None, remarks: list[str]
) -> Iterator[Message]:
    """Yield the messages of some topics as logged; definitions: folder with ``.msg`` files that a
    bag of ROS 2 lacks.

    remarks: gets what was left out. Raises NotInstalled, and InvalidInput for damaged or too large
    files.
    """
    for file in _files(path):
        with untrusted.as_input_errors(file):
            yield from _READERS[kind_of(file)].messages(file, topics, definitions, remarks)


def topics_of(path: Path) -> tuple[str, ...]:
    """Return all topics, sorted. Raises NotInstalled and InvalidInput, as `messages` does."""
    topics: set[str] = set()
    for file in _files(path):
        with untrusted.as_input_errors(file):
            topics.update(_READERS[kind_of(file)].topics(file))
    return tuple(sorted(topics))


@dataclass(frozen=True, slots=True)
class _Reader:
    """Functions that read messages of one kind of file."""

    messages: Callable[[Path, Collection[str], Path | None, list[str]], Iterator[Message]]
    topics: Callable[[Path], Collection[str]]


def _files(path: Path) -> list[Path]:
    """List the file itself, or those of a folder of ROS 2."""
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


# MCAP: JSON, protobuf and messages of ROS 2.


def _mcap_messages(
    path: Path, topics: Collection[str], definitions: Path | None, _: list[str]
) -> Iterator[Message]:
    decoders: dict[tuple[str, int], Callable[[bytes], Any]] = {}
    channels_of_topic = defaultdict[str, list[int]](list)
    for schema, channel, message in mcap_messages.mcap_messages(path, topics):
        key = (channel.message_encoding, channel.schema_id)
        if key not in decoders:
            decoders[key] = _decoder(channel, schema, definitions)
        publisher = channel.metadata.get("callerid", "")
        sender = _connection(publisher, channel.id, channels_of_topic[channel.topic])
        content = decoders[key](message.data)
        yield Message(channel.topic, message.log_time, content, sender)


def _connection(publisher: str, number: int, numbers: list[int]) -> Identity:
    """Return the publisher, or where a file names none the place of its connection among those of a
    topic, whose numbers so far are kept.
    """
    if publisher:
        return {"publisher": publisher}
    if number not in numbers:
        numbers.append(number)
    return {"connection": numbers.index(number)}


def _decoder(channel: Any, schema: Any, definitions: Path | None) -> Callable[[bytes], Any]:
    if channel.message_encoding == "json":
        return _loads
    if channel.message_encoding == "cdr" and schema is not None:
        return ros_decoder(schema.name, schema.encoding, schema.data.decode(), definitions)
    from mcap_protobuf.decoder import DecoderFactory

    decoder: Callable[[bytes], Any] | None = DecoderFactory().decoder_for(
        channel.message_encoding, schema
    )
    if decoder is None:
        encoding = channel.message_encoding[:40]
        raise InvalidInput(
            f"{channel.topic[:80]} is encoded as {encoding!r}; json, protobuf and cdr with a schema are"
            " read"
        )
    return decoder


# ROS, by the library of the extra ``uvms-ocp[rosbags]``: what messages mean, bags of ROS 1, and
# those of ROS 2 in SQLite.


def ros_decoder(
    name: str, encoding: str, text: str, definitions: Path | None = None
) -> Callable[[bytes], Any]:
    """Make the decoder of a message type; encoding: ros2msg or ros2idl, of the text; without text
    by those that are known.

    definitions: folder with more of these, ``.msg`` files. Raises NotInstalled, InvalidInput.
    """
    typesys = _typesystem()
    parsers = {
        "ros2msg": lambda: typesys.get_types_from_msg(text, name),
        "ros2idl": lambda: _of_idl(typesys, text),
    }
    if text.strip() and encoding not in parsers:
        raise InvalidInput(f"{name}: a schema as {encoding[:40]!r}; allowed: {', '.join(parsers)}")
    store = typesys.get_typestore(typesys.Stores.EMPTY if text.strip() else typesys.Stores.LATEST)
    if text.strip():
        store.register(parsers[encoding]())
    elif definitions is not None:
        store.register(_of_folder(typesys, definitions))
    if name not in store.fielddefs:
        raise InvalidInput(
            f"no definition of {name[:80]} in it; give a folder with its .msg file as `messages:"
            " FOLDER`"
        )
    return lambda data: store.deserialize_cdr(data, name)


def _of_idl(typesys: Any, text: str) -> dict[str, Any]:
    types: dict[str, Any] = {}
    for part in text.split(_SEPARATOR):
        if not part.strip():
            continue
        if part.startswith("IDL: "):
            definition = part.partition("\n")[2]
        else:
            definition = part
        types |= typesys.get_types_from_idl(definition)
    return types


def _of_folder(typesys: Any, folder: Path) -> dict[str, Any]:
    """Definitions of ``PACKAGE/msg/NAME.msg`` or ``PACKAGE/NAME.msg``, anywhere in a folder."""
    types: dict[str, Any] = {}
    for file in sorted(folder.rglob("*.msg")):
        folder_of_package = file.parent.parent if file.parent.name == "msg" else file.parent
        package = folder_of_package.name
        types |= typesys.get_types_from_msg(
            file.read_text(encoding="utf-8"), f"{package}/msg/{file.stem}"
        )
    if not types:
        raise InvalidInput(
            f"messages: {folder} has no .msg files; give a folder of PACKAGE/msg/NAME.msg"
        )
    return types


def _typesystem() -> Any:
    return optional_module("rosbags.typesys", "a recording of ROS", '"uvms-ocp[rosbags]"')


def _ros1(path: Path) -> Any:
    _typesystem()
    from rosbags.highlevel import AnyReader

    return AnyReader([path])


def _ros1_messages(path: Path, topics: Collection[str], *_: object) -> Iterator[Message]:
    with _ros1(path) as reader:
        chosen = [connection for connection in reader.connections if connection.topic in topics]
        if not chosen:
            return
        connections_of_topic = defaultdict[str, list[int]](list)
        for connection, logged, data in reader.messages(connections=chosen):
            publisher = getattr(connection.ext, "callerid", None) or ""
            numbers = connections_of_topic[connection.topic]
            sender = _connection(publisher, connection.id, numbers)
            content = reader.deserialize(data, connection.msgtype)
            yield Message(connection.topic, logged, content, sender)


def _ros1_topics(path: Path) -> Collection[str]:
    with _ros1(path) as reader:
        return {connection.topic for connection in reader.connections}


@contextmanager
def _data_base(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a data base of tables alone: one that makes up its rows has as many, of a few bytes, as
    there is time for.
    """
    uri = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(uri, uri=True)) as base:
        n_no_tables = base.execute(
            "SELECT count(*) FROM sqlite_master WHERE type NOT IN ('table', 'index')"
        ).fetchone()[0]
        n_hidden_columns = base.execute(
            "SELECT count(*) FROM sqlite_master AS one, pragma_table_xinfo(one.name) AS it WHERE"
            " it.hidden <> 0"
        ).fetchone()[0]
        n_computed = n_no_tables + n_hidden_columns
        if n_computed > 0:
            raise InvalidInput(
                f"{path}: {n_computed} views, triggers or made up columns; plain tables are read"
            )
        yield base


def _sqlite_messages(
    path: Path, topics: Collection[str], definitions: Path | None, _: list[str]
) -> Iterator[Message]:
    with _data_base(path) as base:
        texts = _definitions(base)
        topic_of = {}
        decoders = {}
        for k, topic, kind in base.execute("SELECT id, name, type FROM topics").fetchall():
            if topic in topics:
                encoding, text = texts.get(kind, ("", ""))
                topic_of[k] = topic
                decoders[k] = ros_decoder(kind, encoding, text, definitions)
        connections_of_topic = defaultdict[str, list[int]](list)
        placeholders = ",".join("?" * len(topic_of))
        rows = base.execute(
            "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN"
            f" ({placeholders}) ORDER BY timestamp",
            tuple(topic_of),
        )
        for k, logged, data in rows:
            sender = _connection("", k, connections_of_topic[topic_of[k]])
            yield Message(topic_of[k], logged, decoders[k](data), sender)


def _definitions(base: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Encoding and text of the definition of each type, which bags of Humble and before do not
    hold.
    """
    n_tables = base.execute(
        "SELECT count(*) FROM sqlite_master WHERE name = 'message_definitions'"
    ).fetchone()[0]
    if not n_tables:
        return {}
    columns = "topic_type, encoding, encoded_message_definition"
    rows = base.execute(f"SELECT {columns} FROM message_definitions")
    return {kind: (encoding, text) for kind, encoding, text in rows}


def _sqlite_topics(path: Path) -> Collection[str]:
    _typesystem()
    with _data_base(path) as base:
        return {topic for (topic,) in base.execute("SELECT name FROM topics")}


# Lines of JSON, such as a DVL sends: the topic is what stands as `type`.


def _json_messages(
    path: Path, topics: Collection[str] | None, _: Path | None, remarks: list[str]
) -> Iterator[Message]:
    with path.open(encoding="utf-8-sig") as file:
        for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), 1):
            if number > MOST_ROWS or len(line) == LONGEST_LINE:
                raise InvalidInput(
                    f"{path}: more than {MOST_ROWS} lines, or one of {LONGEST_LINE >> 20} MB"
                )
            if not line.strip():
                continue
            try:
                message = _loads(line)
            except ValueError as error:
                is_unfinished = not line.endswith("\n") and line.count("{") > line.count("}")
                if number > 1 and is_unfinished:  # as where power was cut
                    remarks.append(f"the last line, {number}, breaks off and is left out")
                    return
                raise InvalidInput(
                    f"{path}: line {number} is no JSON ({error}); mend it, or leave it out"
                ) from None
            topic = str(message.get("type", "")) if isinstance(message, dict) else ""
            if topics is None or topic in topics:
                yield Message(topic, number, message)


def _json_topics(path: Path) -> Collection[str]:
    return {message.topic for message in _json_messages(path, None, None, [])}


# Logs of MAVLink by pymavlink: dataflash (.BIN) and telemetry (.tlog); topics are the types of
# messages.


class _WithUnits(dict[str, Any]):
    """Fields of a message, and what units they have."""

    units: Mapping[str, str]


def _mavlink(path: Path) -> closing[Any]:
    mavutil = optional_module("pymavlink.mavutil", "a log of MAVLink", '"uvms-ocp[mavlink]"')
    return closing(
        mavutil.mavlink_connection(str(path), dialect="ardupilotmega", robust_parsing=True)
    )


def _mavlink_messages(path: Path, topics: Collection[str], *_: object) -> Iterator[Message]:
    with _mavlink(path) as log:
        for message in iter(lambda: log.recv_match(type=list(topics)), None):
            content = _WithUnits(message.to_dict())
            # The first messages of dataflash say its units, of telemetry the protocol does.
            layout = getattr(message, "fmt", None)
            if layout:
                content.units = dict(zip(layout.columns, layout.units or (), strict=False))
            else:
                content.units = message.fieldunits_by_name
            logged = round(1e9 * message._timestamp)
            yield Message(message.get_type(), logged, content, _mavlink_sender(message, content))


def _mavlink_sender(message: Any, content: Mapping[str, Any]) -> Identity:
    """Return system and component of a message of telemetry, and the instance of its sensor."""
    sender: dict[str, float | str] = {}
    layout = getattr(message, "fmt", None)
    if layout:
        instance_field = layout.instance_field
    else:
        instance_field = message.instance_field
        sender["system"] = message.get_srcSystem()
        sender["component"] = message.get_srcComponent()
    if instance_field in content:
        sender[instance_field] = content[instance_field]
    return sender


def _mavlink_topics(path: Path) -> Collection[str]:
    with _mavlink(path) as log:
        return {message.get_type() for message in iter(log.recv_match, None)} - {"BAD_DATA"}


# Logs of PX4 (ULog) by pyulog: topics are its messages, NAME_1 for the second instance of one.


def _ulog(path: Path) -> dict[str, Mapping[str, np.ndarray]]:
    pyulog = optional_module("pyulog", "a ULog of PX4", '"uvms-ocp[ulog]"')
    with path.open("rb") as file:
        instances = pyulog.ULog(file).data_list
    columns_by_topic = {}
    for instance in instances:
        topic = instance.name
        if instance.multi_id:
            topic = f"{instance.name}_{instance.multi_id}"
        columns_by_topic[topic] = instance.data
    return columns_by_topic


def _ulog_messages(path: Path, topics: Collection[str], *_: object) -> Iterator[Message]:
    for topic, columns in _ulog(path).items():
        if topic not in topics:
            continue
        fields = defaultdict[str, list[list[float]]](list)
        for name, column in columns.items():
            fields[re.sub(r"\[\d+\]$", "", name)].append(column.tolist())
        rows_of_fields: list[Iterable[Any]] = []
        for elements in fields.values():
            if len(elements) == 1:
                rows_of_fields.append(elements[0])
            else:
                rows_of_fields.append(zip(*elements, strict=True))
        for row in zip(*rows_of_fields, strict=True):
            content = _WithUnits(zip(fields, row, strict=True))
            content.units = {"timestamp": "us"}
            yield Message(topic, 1000 * content["timestamp"], content)


def _ulog_topics(path: Path) -> Collection[str]:
    return _ulog(path).keys()


_READERS = {
    "mcap": _Reader(_mcap_messages, mcap_messages.mcap_topics),
    "bag": _Reader(_ros1_messages, _ros1_topics),
    "sqlite": _Reader(_sqlite_messages, _sqlite_topics),
    "json": _Reader(_json_messages, _json_topics),
    "dataflash": _Reader(_mavlink_messages, _mavlink_topics),
    "tlog": _Reader(_mavlink_messages, _mavlink_topics),
    "ulog": _Reader(_ulog_messages, _ulog_topics),
}


# Columns of numbers out of messages, those of all channels in one pass.


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicColumns:
    """Columns to read from the messages of a topic."""

    topic: str
    columns: tuple[str, ...]
    """Paths of fields, see `uvms_ocp.identification.message_fields`."""
    time: str = ""
    """Path of the time; empty for the time of logging."""
    unit: float = 1.0
    """[s] unit of a time that is a plain number."""
    rows: tuple[tuple[str, float | str], ...] = ()
    """Fields, or names of senders, and the values that messages must have in them."""


def message_rows(
    path: Path, topics: Mapping[str, TopicColumns], definitions: Path | None = None
) -> dict[str, TableColumns]:
    """Read times [s] and values [as they are] (n, 1 + k) of columns of topics, by the same names.

    definitions: folder with ``.msg`` files that a bag of ROS 2 lacks. A message without such a
    field gives no row. Raises NameNotFound where none has it, NotInstalled and InvalidInput.
    """
    stats = [file.stat() for file in _files(path)]
    state = tuple((stat.st_mtime_ns, stat.st_size) for stat in stats)
    return dict(_rows_of(path, tuple(topics.items()), definitions, state))


@lru_cache(maxsize=1)  # as a mapping is tried with other units and axes
def _rows_of(
    path: Path, topics: Sequence[tuple[str, TopicColumns]], definitions: Path | None, state: object
) -> Mapping[str, TableColumns]:
    remarks: list[str] = []
    rows_by_name = {name: _Rows(name, columns) for name, columns in topics}
    by_topic: dict[str, list[_Rows]] = defaultdict(list)
    for rows in rows_by_name.values():
        by_topic[rows.selection.topic].append(rows)
    for message in messages(path, by_topic.keys(), definitions, remarks):
        for rows in by_topic[message.topic]:
            rows.add(message)
    tables = {}
    for name, rows in rows_by_name.items():
        values = rows.whole(path)
        tables[name] = TableColumns(values=values, units=rows.units(), remarks=tuple(remarks))
    return tables


class _Rows:
    """Rows of one channel, read so far."""

    def __init__(self, name: str, topic_columns: TopicColumns) -> None:
        self.name = name
        self.selection = topic_columns
        self.time = steps_of(topic_columns.time) if topic_columns.time else ()
        self.columns = [steps_of(column) for column in topic_columns.columns]
        self.paths: list[tuple[tuple[str, ...], ...]] = []
        self.conditions = [(name, steps_of(name), value) for name, value in topic_columns.rows]
        self.numbers = array("d")
        self.width = 0
        self.missing: NameNotFound | None = None
        self.file_units: Mapping[str, str] = {}
        self.n_others = 0
        self.senders = SenderCount()

    def add(self, message: Message) -> None:
        """Add the row of one message; none where a field is missing, or has another value than the
        mapping chooses.
        """
        try:
            if not self._is_chosen(message):
                self.n_others += 1
                return
            if self.time:
                row = [seconds_at(message.content, self.time, self.selection.unit)]
            else:
                row = [1e-9 * message.logged]
            for steps in self._paths_in(message.content):
                row += numbers_at(message.content, steps)
        except NameNotFound as error:
            self.missing = self.missing or error
            return
        self.width = self.width or len(row)
        if len(row) != self.width:
            raise InvalidInput(
                f"{self.selection.topic}: {self.width - 1} numbers at first, then {len(row) - 1}; give"
                " elements"
            )
        if len(self.numbers) >= self.width * MOST_ROWS:
            raise InvalidInput(
                f"{self.selection.topic}: more than {MOST_ROWS} messages; give recordings one by one"
            )
        self.numbers.extend(row)
        self.senders.add(message.sender, message.content)
        if isinstance(message.content, _WithUnits):
            self.file_units = message.content.units

    def _paths_in(self, content: Any) -> list[tuple[str, ...]]:
        """Return the paths of all columns, by the names that elements have in the first message.

        Raises NameNotFound where there are no such elements, and InvalidInput where elements were
        given by their places, or as a whole array, and have other names now.
        """
        if not self.numbers:
            self.paths = [paths_by_name(content, steps) for steps in self.columns]
        for column, steps, first in zip(
            self.selection.columns, self.columns, self.paths, strict=True
        ):
            if first != (steps,):
                self._require_same_names(content, column, first, paths_by_name(content, steps))
        return list(chain.from_iterable(self.paths))

    def _require_same_names(
        self,
        content: Any,
        column: str,
        first: tuple[tuple[str, ...], ...],
        paths: tuple[tuple[str, ...], ...],
    ) -> None:
        """Check that a column has in a message the names that it had first. Raises InvalidInput."""
        has_all = all(has_value(content, path) for path in first)
        if has_all and len(paths) == len(first):
            return
        raise InvalidInput(
            f"{self.name}: {self.selection.topic}: {column} is {_joined(first)} at first, then"
            f" {_joined(paths)}; give elements by their names"
        )

    def _is_chosen(self, message: Message) -> bool:
        """Check whether fields and sender of a message have the values that the mapping chooses."""
        for name, steps, expected in self.conditions:
            try:
                value = value_at(message.content, steps)
            except NameNotFound:
                if name not in message.sender:
                    raise
                value = message.sender[name]
            if isinstance(expected, str):
                differs = str(value) != expected
            else:
                differs = numbers_at({name: value}, (name,)) != [expected]
            if differs:
                return False
        return True

    def units(self) -> tuple[str, ...]:
        """Return the unit of each column as the file says it, empty where it does not; arrays have
        more columns than paths.
        """
        paths = (self.selection.time, *self.selection.columns)
        units = tuple(self.file_units.get(path, "") for path in paths)
        if len(units) == self.width:
            return units
        return (units[0], *("",) * (self.width - 1))

    def whole(self, path: Path) -> np.ndarray:
        """Return all rows (n, 1 + k). Raises InvalidInput and NameNotFound where there are none."""
        if self.numbers:
            where = f"{self.name}: {self.selection.topic} of {path.name}"
            self.senders.require_single(where, dict(self.selection.rows))
            return np.array(self.numbers).reshape(-1, self.width)
        if self.missing is not None:
            raise InvalidInput(f"{path.name}: {self.selection.topic}: {self.missing}")
        if self.n_others > 0:
            raise InvalidInput(
                f"{self.name}: no row has {dict(self.selection.rows)}; leave rows out, or give"
                " values that there are"
            )
        topics = topics_of(path)
        if self.selection.topic in topics:
            raise InvalidInput(
                f"{path.name}: {self.selection.topic} has no messages; leave the channel out"
            )
        raise NameNotFound(f"topic of {path.name}", self.selection.topic, topics)


def _joined(paths: Iterable[Sequence[str]]) -> str:
    """Join paths as a mapping has them, names of elements as steps."""
    return ", ".join(".".join(path) for path in paths)
