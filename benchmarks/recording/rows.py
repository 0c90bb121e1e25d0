"""Choose, count and collect among the rows of a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from recording.report import Row


def rows_where(rows: Sequence[Row], name: str, value: object) -> list[Row]:
    """Return the rows whose column `name` has this value, in their order."""
    return [row for row in rows if row[name] == value]


def count_where(rows: Sequence[Row], name: str, value: object) -> int:
    """Count the rows whose column `name` has this value."""
    return len(rows_where(rows, name, value))


def column(rows: Sequence[Row], name: str) -> list[Any]:
    """Return the values of a column, in the order of the rows."""
    return [row[name] for row in rows]


def known_values(rows: Sequence[Row], name: str) -> list[Any]:
    """Return the values of a column, those that are None aside."""
    return [value for value in column(rows, name) if value is not None]
