"""Read columns of numbers from messages, those of all channels in one pass over a file."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.logged_message import FieldsWithUnits, Message
from uvms_ocp.identification.message_fields import (
    has_value,
    numbers_at,
    paths_by_name,
    seconds_at,
    steps_of,
    value_at,
)
from uvms_ocp.identification.message_senders import SenderCount
from uvms_ocp.identification.messages import (
    message_files,
    messages,
    topics_of,
)
from uvms_ocp.identification.tables import TableColumns
from uvms_ocp.identification.text_files import MOST_ROWS


def message_rows(
    path: Path, topics: Mapping[str, TopicColumns], definitions: Path | None = None
) -> dict[str, TableColumns]:
    """Read times [s] and values [as they are] (n, 1 + k) of columns of topics, by the same names.

    definitions: folder with ``.msg`` files that a bag of ROS 2 lacks. A message without such a
    field gives no row. Raises NameNotFound where none has it, NotInstalled and InvalidInput.
    """
    stats = [file.stat() for file in message_files(path)]
    state = tuple((stat.st_mtime_ns, stat.st_size) for stat in stats)
    return dict(_rows_of(path, tuple(topics.items()), definitions, state))


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicColumns:
    """Columns to read from the messages of a topic."""

    topic: str
    """Name of the topic."""
    columns: tuple[str, ...]
    """Paths of fields, see `uvms_ocp.identification.message_fields`."""
    time: str = ""
    """Path of the time; empty for the time of logging."""
    unit: float = 1.0
    """[s] unit of a time that is a plain number."""
    rows: tuple[tuple[str, float | str], ...] = ()
    """Fields, or properties of senders, and the values that messages must have in them."""


@lru_cache(maxsize=1)  # as a mapping is tried with other units and axes
def _rows_of(
    path: Path, topics: Sequence[tuple[str, TopicColumns]], definitions: Path | None, state: object
) -> Mapping[str, TableColumns]:
    """Read the columns of `message_rows`. state: times and sizes of the files, with which a changed
    file is read anew.
    """
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
        """Paths of each column in the first message, elements by their names."""
        self.conditions = [(name, steps_of(name), value) for name, value in topic_columns.rows]
        self.numbers = array("d")
        """Times and values, row after row."""
        self.width = 0
        """Numbers of a row, the time included."""
        self.missing: NameNotFound | None = None
        """First error of a field that a message lacks."""
        self.file_units: Mapping[str, str] = {}
        """Units of fields as the file states them."""
        self.n_others = 0
        """Number of messages that the mapping does not choose."""
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
        if isinstance(message.content, FieldsWithUnits):
            self.file_units = message.content.units

    def _paths_in(self, content: Any) -> list[tuple[str, ...]]:
        """Return the paths of all columns, by the names that elements have in the first message.

        Raises NameNotFound where there are no such elements, and InvalidInput where elements were
        given by their places, or as a whole array, and have other names now.
        """
        if not self.numbers:
            self.paths = [paths_by_name(content, steps) for steps in self.columns]
        for column, steps, first_paths in zip(
            self.selection.columns, self.columns, self.paths, strict=True
        ):
            if first_paths != (steps,):
                self._require_same_names(
                    content, column, first_paths, paths_by_name(content, steps)
                )
        return list(chain.from_iterable(self.paths))

    def _require_same_names(
        self,
        content: Any,
        column: str,
        first_paths: tuple[tuple[str, ...], ...],
        paths: tuple[tuple[str, ...], ...],
    ) -> None:
        """Check that a column of a message has the names that it had in the first one. Raises
        InvalidInput.
        """
        has_all = all(has_value(content, path) for path in first_paths)
        if has_all and len(paths) == len(first_paths):
            return
        raise InvalidInput(
            f"{self.name}: {self.selection.topic}: {column} is {_joined(first_paths)} at first, then"
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
        """Return the unit of each column as the file states it, empty where it does not, as for
        arrays, which have more columns than paths.
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
