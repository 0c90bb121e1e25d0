"""What the library of the extra ``uvms-ocp[rosbags]`` knows: bags of ROS 2 in SQLite, and what messages of ROS 2 mean."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from uvms_ocp.exceptions import InvalidInput, NotInstalled

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
    """All of a bag, sorted. Raises NotInstalled and InvalidInput."""
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
    """By what is in it: the bag says what its files are called."""
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
    """What makes messages of that type of bytes; encoding: ros2msg or ros2idl, of the text. Raises NotInstalled, InvalidInput."""
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
