"""Columns of numbers out of messages, those of all channels in one pass."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.identification.recordings.fields import numbers_at, seconds_at, steps_of
from uvms_ocp.identification.recordings.messages import messages, topics_of
from uvms_ocp.identification.recordings.tables import MOST_ROWS


@dataclass(frozen=True, kw_only=True, slots=True)
class Wanted:
    """What of the messages of a topic."""

    topic: str
    columns: tuple[str, ...]
    """Paths of fields, see `uvms_ocp.identification.recordings.fields`."""
    time: str = ""
    """That of the time; empty for when they were logged."""
    unit: float = 1.0
    """[s] of a time that is a plain number."""


def message_rows(path: Path, wanted: Mapping[str, Wanted]) -> dict[str, np.ndarray]:
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
    """Of one channel, so far."""

    wanted: Wanted
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
            row = [self._time(logged, content)]
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

    def _time(self, logged: int, content: Any) -> float:
        return seconds_at(content, self.time, self.wanted.unit) if self.time else 1e-9 * logged

    def whole(self, path: Path) -> np.ndarray:
        if self.numbers:
            return np.array(self.numbers).reshape(-1, self.width)
        if self.missing is not None:
            raise InvalidInput(f"{path.name}: {self.wanted.topic}: {self.missing}")
        raise NameNotFound(f"topic of {path.name}", self.wanted.topic, topics_of(path))
