"""Show values as small tables, in a shell and in a notebook."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from html import escape
from textwrap import wrap
from typing import Any

import numpy as np

from uvms_ocp.errors import plain_line

WIDTH = 80
"""Characters of a line."""
_MAX_ROWS = 40
"""Rows that are shown."""
_GAP = "  "
"""Space between columns, and before a row."""
_MAX_ENTRIES = 8
"""Entries of an array or a list that is written in full."""
_MAX_LETTERS = 120
"""Letters of a value that is written in full."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SmallTable:
    """A table with a title, which shows itself as text and in HTML."""

    title: str
    words: str = ""
    """Text before the rows, whole, whatever its length."""
    head: tuple[str, ...] = ()
    """Names of the columns, if they have any."""
    rows: tuple[tuple[str, ...], ...]
    """Cells of each row."""

    def text(self) -> str:
        """Return lines of at most 80 characters; what is longer is cut, and rows beyond the first
        are counted.
        """
        rows = [row for row in (self.head, *self._first_rows()) if row]
        widths = _column_widths(rows)
        lines = [self.title]
        for line in wrap(plain_line(self.words), WIDTH - len(_GAP)):
            lines.append(f"{_GAP}{line}")
        for row in rows:
            cells = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
            lines.append(_GAP + _GAP.join(cells).rstrip())
        lines += self._more_rows_text()
        return "\n".join(map(_cut, lines))

    def html(self) -> str:
        """Return a table in HTML; names are text, whatever they hold."""
        html = f"<b>{escape(self.title)}</b>"
        if self.words:
            html += f"<p>{escape(plain_line(self.words))}</p>"
        html += "<table>"
        if self.head:
            html += f"<thead>{_html_row('th', self.head)}</thead>"
        html += "<tbody>"
        for row in self._first_rows():
            html += _html_row("td", row)
        html += "</tbody></table>"
        for line in self._more_rows_text():
            html += f"<p>{escape(line)}</p>"
        return html

    def _first_rows(self) -> Sequence[tuple[str, ...]]:
        """Return the rows that are shown."""
        return self.rows[:_MAX_ROWS]

    def _more_rows_text(self) -> list[str]:
        """Return a line that counts the other rows, if there are any."""
        n_more = len(self.rows) - _MAX_ROWS
        if n_more > 0:
            return [f"{_GAP}and {n_more} more"]
        return []


def _column_widths(rows: Sequence[tuple[str, ...]]) -> list[int]:
    """Return the letters of the longest cell of each column."""
    widths = list[int]()
    for row in rows:
        for k, text in enumerate(row):
            if k == len(widths):
                widths.append(0)
            widths[k] = max(widths[k], len(text))
    return widths


def _cut(line: str) -> str:
    """Shorten a line to `WIDTH` letters, all of them printable."""
    plain = "".join(letter if letter.isprintable() else " " for letter in line)
    if len(plain) <= WIDTH:
        return plain
    return plain[: WIDTH - 1] + "…"


def _html_row(tag: str, row: Sequence[str]) -> str:
    """Return a row in HTML; tag: of each cell."""
    style = ' style="text-align:left"'
    cells = ""
    for text in row:
        cells += f"<{tag}{style}>{escape(text)}</{tag}>"
    return f"<tr>{cells}</tr>"


def rows_of(values: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return a row for each value, numbers in four digits."""
    rows = []
    for name, value in values.items():
        rows.append((name.replace("_", " "), cell(value)))
    return tuple(rows)


def cell(value: Any) -> str:
    """Format a value as a table shows it: a number in four digits, a dash for none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return plain_line(str(value))


class TableDisplay:
    """Mixin of values that show themselves as a `SmallTable`: in a shell, and in a notebook."""

    __slots__ = ()

    def _table(self) -> SmallTable:
        raise NotImplementedError

    def __repr__(self) -> str:
        return self._table().text()

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return self._table().html()


class TableRows(TableDisplay, list[dict[str, Any]]):
    """Rows that show themselves as a table, whose head are the keys of the first."""

    __slots__ = ()

    def _table(self) -> SmallTable:
        title = f"{len(self)} rows"
        if not self:
            return SmallTable(title=title, rows=())
        names = list(self[0])
        rows = list[tuple[str, ...]]()
        for row in self:
            rows.append(tuple([cell(row.get(name)) for name in names]))
        head = [name.replace("_", " ") for name in names]
        return SmallTable(title=title, head=tuple(head), rows=tuple(rows))


class FieldTable(TableDisplay):
    """A dataclass, made with ``repr=False``, that shows itself as a table of its fields."""

    __slots__ = ()

    def _table(self) -> SmallTable:
        title = type(self).__name__
        name = getattr(self, "name", "")
        if name:
            title = f"{title} {name}"
        rows = list[tuple[str, str]]()
        for field in fields(self):  # type: ignore[arg-type]
            if field.repr:
                rows.append((field.name, format_value(getattr(self, field.name))))
        return SmallTable(title=title, rows=tuple(rows))


def format_value(value: Any) -> str:
    """Describe a value in one short row."""
    if value is None:
        return "-"
    if isinstance(value, np.ndarray):
        if value.size > _MAX_ENTRIES or value.ndim > 1:
            return f"array of shape {value.shape}"
        return np.array2string(value, precision=4, suppress_small=True, max_line_width=_MAX_LETTERS)
    if isinstance(value, TableDisplay):
        return value._table().title
    if isinstance(value, Mapping):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, (tuple, list)):
        return _format_list(value)
    if isinstance(value, Enum):
        return str(value.value)
    if callable(value) and hasattr(value, "__qualname__"):
        return str(value.__qualname__)
    if isinstance(value, float):
        text = f"{value:.4g}"
    elif isinstance(value, str):
        text = str(value)
    else:
        text = repr(value)
    # Describe what needs many words by its type.
    if "\n" in text or " at 0x" in text or len(text) > _MAX_LETTERS:
        return type(value).__name__
    return text


def _format_list(values: tuple[Any, ...] | list[Any]) -> str:
    """Describe the first entries, and how many more there are; of rows only how many."""
    if any(isinstance(item, Mapping) for item in values):
        return f"{len(values)} rows"
    text = ", ".join(format_value(item) for item in values[:_MAX_ENTRIES]) or "none"
    n_more = len(values) - _MAX_ENTRIES
    if n_more > 0:
        return f"{text} and {n_more} more"
    return text
