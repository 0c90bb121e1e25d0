"""Read messages of ROS, by the library of the extra ``uvms-ocp[rosbags]``: bags of ROS 1, bags of ROS 2 in
SQLite, and the definitions that decode messages.
"""

from __future__ import annotations

import sqlite3
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from uvms_ocp.errors import InvalidInput, optional_module
from uvms_ocp.identification.logged_message import Message, connection_identity

_SEPARATOR = "=" * 80 + "\n"
"""Separator of the definitions in a schema of IDL."""


def ros_decoder(
    name: str, encoding: str, text: str, definitions: Path | None = None
) -> Callable[[bytes], Any]:
    """Make the decoder of a message type. encoding: ros2msg or ros2idl, the language of the schema
    `text`; without a text the types of the library serve.

    definitions: folder with definitions of further types, ``.msg`` files. Raises NotInstalled,
    InvalidInput.
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
    """Return the types of a schema in IDL."""
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
    """Return the types of ``PACKAGE/msg/NAME.msg`` or ``PACKAGE/NAME.msg`` anywhere in a folder."""
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
    """Import the types of the library. Raises NotInstalled without it."""
    return optional_module("rosbags.typesys", "a recording of ROS", '"uvms-ocp[rosbags]"')


def ros1_messages(path: Path, topics: Collection[str], *_: object) -> Iterator[Message]:
    """Yield the messages of some topics of a bag of ROS 1."""
    with _ros1(path) as reader:
        chosen = [connection for connection in reader.connections if connection.topic in topics]
        if not chosen:
            return
        connections_of_topic = defaultdict[str, list[int]](list)
        for connection, logged, data in reader.messages(connections=chosen):
            publisher = getattr(connection.ext, "callerid", None) or ""
            numbers = connections_of_topic[connection.topic]
            sender = connection_identity(publisher, connection.id, numbers)
            content = reader.deserialize(data, connection.msgtype)
            yield Message(connection.topic, logged, content, sender)


def ros1_topics(path: Path) -> Collection[str]:
    """Return the topics of a bag of ROS 1."""
    with _ros1(path) as reader:
        return {connection.topic for connection in reader.connections}


def _ros1(path: Path) -> Any:
    """Return a reader of a bag of ROS 1."""
    _typesystem()
    from rosbags.highlevel import AnyReader

    return AnyReader([path])


def sqlite_messages(
    path: Path, topics: Collection[str], definitions: Path | None, _: list[str]
) -> Iterator[Message]:
    """Yield the messages of some topics of a bag of ROS 2 in SQLite. Raises InvalidInput for a damaged
    bag, and for messages without a definition.
    """
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
            sender = connection_identity("", k, connections_of_topic[topic_of[k]])
            yield Message(topic_of[k], logged, decoders[k](data), sender)


def sqlite_topics(path: Path) -> Collection[str]:
    """Return the topics of a bag of ROS 2 in SQLite. Raises InvalidInput for a damaged bag."""
    _typesystem()
    with _data_base(path) as base:
        return {topic for (topic,) in base.execute("SELECT name FROM topics")}


@contextmanager
def _data_base(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a data base that holds plain tables alone: views and triggers could make up rows without
    end. Raises InvalidInput for others.
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


def _definitions(base: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Return encoding and text of the definition of each type; bags of ROS 2 Humble and before hold
    none.
    """
    n_tables = base.execute(
        "SELECT count(*) FROM sqlite_master WHERE name = 'message_definitions'"
    ).fetchone()[0]
    if not n_tables:
        return {}
    columns = "topic_type, encoding, encoded_message_definition"
    rows = base.execute(f"SELECT {columns} FROM message_definitions")
    return {kind: (encoding, text) for kind, encoding, text in rows}
