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

# Small tables: what a public value says of itself, as text of 80 columns and in notebooks.

WIDTH = 80
"""Characters of a line."""
_MOST_ROWS = 40
_GAP = "  "

_FEW = 8  # entries of what is told in full
_LONGEST = 120  # letters of a row


@dataclass(frozen=True, kw_only=True, slots=True)
class SmallTable:
    """A title and rows of texts, the first of which are the names of the columns if there are
    any.
    """

    title: str
    words: str = ""
    """What there is to say before the rows, whole, whatever its length."""
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Return lines of at most 80 characters; what is longer is cut, and rows beyond the first
        are counted.
        """
        lines = [row for row in (self.head, *self._shown()) if row]
        widths = [
            max(len(row[k]) for row in lines if k < len(row))
            for k in range(max(map(len, lines), default=0))
        ]
        text = list[str]()
        for row in lines:
            cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=False))
            text.append(_GAP.join(cells).rstrip())
        words = wrap(plain_line(self.words), WIDTH - len(_GAP))
        indented = (f"{_GAP}{line}" for line in (*words, *text))
        return "\n".join(_cut(line) for line in (self.title, *indented, *self._rest()))

    def html(self) -> str:
        """Return a table in HTML; names are text, whatever they hold."""
        if self.head:
            head = f"<thead>{_row('th', self.head)}</thead>"
        else:
            head = ""
        rows = "".join(_row("td", row) for row in self._shown())
        rest = "".join(f"<p>{escape(line)}</p>" for line in self._rest())
        if self.words:
            words = f"<p>{escape(plain_line(self.words))}</p>"
        else:
            words = ""
        return f"<b>{escape(self.title)}</b>{words}<table>{head}<tbody>{rows}</tbody></table>{rest}"

    def _shown(self) -> Sequence[tuple[str, ...]]:
        return self.rows[:_MOST_ROWS]

    def _rest(self) -> tuple[str, ...]:
        n_more = len(self.rows) - _MOST_ROWS
        if n_more > 0:
            return (f"{_GAP}and {n_more} more",)
        return ()


def rows_of(values: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return a row for each value, numbers in four digits."""
    return tuple((name.replace("_", " "), cell(value)) for name, value in values.items())


def cell(value: Any) -> str:
    """Format a value as a table shows it: a number in four digits, a dash for none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return plain_line(str(value))


def _cut(line: str) -> str:
    plain = "".join(letter if letter.isprintable() else " " for letter in line)
    if len(plain) <= WIDTH:
        return plain
    return plain[: WIDTH - 1] + "…"


def _row(cell: str, row: Sequence[str]) -> str:
    style = ' style="text-align:left"'
    return "<tr>" + "".join(f"<{cell}{style}>{escape(text)}</{cell}>" for text in row) + "</tr>"


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
        if self:
            head = tuple(self[0])
        else:
            head = ()
        rows = tuple(tuple(cell(row.get(name)) for name in head) for row in self)
        return SmallTable(
            title=f"{len(self)} rows",
            head=tuple(name.replace("_", " ") for name in head),
            rows=rows,
        )


# Values that show themselves by their fields: a row for each, in a shell and in a notebook.


class FieldTable(TableDisplay):
    """A dataclass, made with ``repr=False``, that shows itself as a table of its fields."""

    __slots__ = ()

    def _table(self) -> SmallTable:
        shown = [field.name for field in fields(self) if field.repr]  # type: ignore[arg-type]
        title = " ".join(
            str(part) for part in (type(self).__name__, getattr(self, "name", "")) if part
        )
        return SmallTable(
            title=title, rows=tuple((name, format_value(getattr(self, name))) for name in shown)
        )


def format_value(value: Any) -> str:
    """Describe a value in one short row."""
    if value is None:
        return "-"
    if isinstance(value, np.ndarray):
        if value.size > _FEW or value.ndim > 1:
            return f"array of shape {value.shape}"
        return np.array2string(value, precision=4, suppress_small=True, max_line_width=_LONGEST)
    if isinstance(value, TableDisplay):
        return value._table().title
    if isinstance(value, Mapping):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, (tuple, list)):
        if any(isinstance(item, Mapping) for item in value):
            return f"{len(value)} rows"
        if len(value) > _FEW:
            more_text = f" and {len(value) - _FEW} more"
        else:
            more_text = ""
        return (", ".join(map(format_value, value[:_FEW])) or "none") + more_text
    if isinstance(value, Enum):
        return str(value.value)
    if callable(value) and hasattr(value, "__qualname__"):
        return str(value.__qualname__)
    # Describe it by its own words, where these are few; else by its kind.
    if isinstance(value, float):
        text = f"{value:.4g}"
    elif isinstance(value, str):
        text = str(value)
    else:
        text = repr(value)
    if "\n" in text or " at 0x" in text or len(text) > _LONGEST:
        return type(value).__name__
    return text
