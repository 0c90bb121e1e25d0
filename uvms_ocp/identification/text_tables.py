"""Read tables of text of unknown origin: encoding, delimiter, decimal sign, header and units are
detected, or given.

A table is what follows a header: rows of equally many cells, in most of whose columns there are
numbers. Lines before it are passed over, so are comments, of which the last before the first row
may be the header. Columns have their names, and their places as ``#1``, ``#2``, ...
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import IO, Annotated, Literal

import numpy as np
from pydantic import Field

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.recording import unit_named
from uvms_ocp.identification.text_cells import (
    decimal_sign,
    is_grouped,
    is_missing,
    is_number,
    read_unusual_cell,
)
from uvms_ocp.identification.text_files import (
    HEAD_LINES,
    MOST_ROWS,
    encoding_of,
    lines_of,
    opened_text,
    sheets_of,
)
from uvms_ocp.model_errors import FileModel, one_line_errors

_DELIMITERS = {"tab": "\t", ";": ";", ",": ",", "|": "|", "blank": ""}
_UNIT = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_OTHER_UNITS = re.compile(
    r"-|1|none|\[.*\]|\(.*\)|[hmd]?bar|[hk]?pa|psi|[km]?hz|m?[vaw]|(deg|°)? ?c|rpm|kg|lbs?",
    re.IGNORECASE,
)
"""Entries of a row of units for columns that no channel reads."""


@one_line_errors
class TextFormat(FileModel, use_attribute_docstrings=True):
    """Known parts of the layout of a table of text; the rest is detected."""

    encoding: str | None = None
    """such as utf-8, cp1252"""
    delimiter: Literal["tab", ";", ",", "|", "blank"] | None = None
    """between cells"""
    decimal: Literal[".", ","] | None = None
    """sign before decimals"""
    header: Annotated[int, Field(ge=0)] | None = None
    """its line, from 1; 0: there is none"""
    time: str = ""
    """of times, such as '%m/%d/%Y %H:%M:%S.%f'; ISO 8601 and times of day need none"""
    sheet: str = ""
    """of a workbook; default: the first with a table"""


@dataclass(frozen=True, kw_only=True, slots=True)
class TextLayout:
    """Layout of a table of text."""

    encoding: str
    """Encoding of the text, as Python calls it."""
    delimiter: str
    """Delimiter between cells, one of `TextFormat.delimiter`."""
    decimal: str
    """Sign before decimals."""
    names: tuple[str, ...]
    """Names of the columns; ``#1``, ``#2``, ... where there is no header."""
    units: tuple[str, ...]
    """Units of the columns, from a row of units or from brackets in the names; empty for unknown
    ones.
    """
    header: int
    """Line of the header, from 1; 0 for none."""
    first: int
    """Line of the first row, from 1."""
    time: str = ""
    """Format of times as it was given; empty for ISO 8601, times of day and numbers."""
    sheet: str = ""
    """Sheet of a workbook that the table is in."""
    sheets: tuple[str, ...] = ()
    """All sheets of the workbook."""

    def __str__(self) -> str:
        if self.header:
            header = f"header in line {self.header}"
        else:
            header = "no header, columns are #1, #2, ..."
        if self.sheet:
            choice = f" of {', '.join(self.sheets)}" if len(self.sheets) > 1 else ""
            return f"sheet {self.sheet}{choice}, {header}"
        cells = f"{self.encoding}, {self.delimiter!r} between cells"
        return f"{cells}, decimals after {self.decimal!r}, {header}"


def text_layout(path: Path, text_format: TextFormat | None = None) -> TextLayout:
    """Detect the layout of a table.

    Raises InvalidInput for a file without a table, NotInstalled for a workbook without its library,
    NameNotFound for an unknown sheet.
    """
    text_format = text_format or TextFormat()
    encoding = text_format.encoding or encoding_of(path)
    sheet, all_sheets = sheets_of(path, text_format.sheet)
    with opened_text(path, encoding, sheet) as file:
        head = _head(file)
        lines = [(number, line) for number, line in head if not _is_comment(line)]
        delimiter = text_format.delimiter or _delimiter([line for _, line in lines])
        rows = _without_last_delimiter(
            [_Row(number, _split(line, delimiter)) for number, line in lines]
        )
        n_columns = _usual_width(rows)
        table = [row for row in rows if len(row.cells) == n_columns]
        decimal = text_format.decimal or _decimal(table, delimiter)
        first = _first_row(table, decimal)
        comments = _comments(head, first, delimiter)
        headers = _headers(table, comments, first, decimal)

        units = None
        if len(headers) > 1 and _has_units(headers[-1]):
            units = headers.pop()
        if text_format.header is not None:
            headers = [row for row in rows + comments if row.line == text_format.header]
            first = max(first, text_format.header + 1)
        if headers:
            header = headers[-1]
        else:
            header = _Row(0, [f"#{k + 1}" for k in range(n_columns)])
        if units is None:
            unit_names = tuple(_unit_in(name) for name in header.cells)
        else:
            unit_names = tuple(cell.strip("[]() ") for cell in units.cells)
        return TextLayout(
            encoding=encoding,
            delimiter=delimiter,
            decimal=decimal,
            time=text_format.time,
            names=tuple(header.cells),
            units=unit_names,
            header=header.line,
            first=first,
            sheet=sheet,
            sheets=all_sheets,
        )


def text_columns(
    path: Path, places: Sequence[int], layout: TextLayout, words: Mapping[int, str]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Read columns (n, k) [as they are] of a table, NaN for empty cells, and remarks about rows
    that were left out.

    places: (k,) of `place_of`. words: by place, the word that reads as 1, where all others read as 0.
    Times of day and ISO 8601 times are in seconds. Raises InvalidInput, and NotInstalled as
    `text_layout` does.
    """
    remarks: list[str] = []
    with opened_text(path, layout.encoding, layout.sheet) as file:
        numbers = np.fromiter(_numbers(file, layout, places, words, remarks), dtype=float)
    return numbers.reshape(-1, len(places)), tuple(remarks)


def place_of(path: Path, names: Sequence[str], column: str) -> int:
    """Find the place of a column by its name, by its name without case, unit and sign of a comment
    where that is unambiguous, or by ``#k``.

    Raises NameNotFound, and InvalidInput for a name that stands more than once.
    """
    for simplify in (str.strip, _plain):
        matches = [k for k, name in enumerate(names) if simplify(name) == simplify(column)]
        if len(matches) == 1:
            return matches[0]
        if matches:
            places = ", ".join(f"#{k + 1}" for k in matches)
            raise InvalidInput(
                f"{path.name}: {len(matches)} columns are called {column!r}; give one by its place:"
                f" {places}"
            )
    if re.fullmatch(r"#\d+", column) and 0 < int(column[1:]) <= len(names):
        return int(column[1:]) - 1
    raise NameNotFound(f"column of {path.name}", column, [name.strip() for name in names])


def _plain(name: str) -> str:
    """Return a name in lower case, without its unit and the sign of a comment."""
    without_unit = _UNIT.sub("", name).strip().lower()
    return re.sub(r"^[#%]\s*(?=\D)", "", without_unit)


def _unit_in(name: str) -> str:
    """Return the unit that stands in brackets at the end of a name; empty where there is none."""
    match = _UNIT.search(name)
    if match is None:
        return ""
    return match[1].strip()


@dataclass(frozen=True, slots=True)
class _Row:
    """A line of a table, split into cells."""

    line: int
    """Number of the line in the file, from 1; 0 for a header that the file does not have."""
    cells: list[str]


def _head(file: IO[str]) -> list[tuple[int, str]]:
    """Return those of the first lines that are not empty, with their numbers from 1."""
    numbered = enumerate(islice(lines_of(file), HEAD_LINES), 1)
    return [(number, line) for number, line in numbered if line.strip()]


def _is_comment(line: str) -> bool:
    """Check whether a line is a comment."""
    return line.lstrip().startswith(("#", "%"))


def _without_last_delimiter(rows: Sequence[_Row]) -> list[_Row]:
    """Remove the last, empty cell of each row where all the widest rows end by a delimiter."""
    n_widest = max((len(row.cells) for row in rows), default=0)
    widest = [row for row in rows if len(row.cells) == n_widest]
    if n_widest == 0 or any(row.cells[-1] for row in widest):
        return list(rows)
    shortened = []
    for row in rows:
        if row.cells[-1] == "":
            shortened.append(_Row(row.line, row.cells[:-1]))
        else:
            shortened.append(row)
    return shortened


def _usual_width(rows: Sequence[_Row]) -> int:
    """Return the number of cells that most rows have; 0 without rows."""
    if not rows:
        return 0
    widths = Counter(len(row.cells) for row in rows)
    return widths.most_common(1)[0][0]


def _comments(head: Sequence[tuple[int, str]], first: int, delimiter: str) -> list[_Row]:
    """Split the lines before the first row of numbers, without the signs of comments."""
    comments = []
    for number, line in head:
        if number < first:
            text = line.lstrip().lstrip("#%")
            comments.append(_Row(number, _split(text, delimiter)))
    return comments


def _headers(
    table: Sequence[_Row], comments: Sequence[_Row], first: int, decimal: str
) -> list[_Row]:
    """Return the rows that may name the columns: those before the first row of numbers, or else
    the last comment that has as many cells.
    """
    n_columns = len(table[0].cells) if table else 0
    headers = []
    for row in table:
        n_filled = sum(bool(cell) for cell in row.cells)
        is_line_of_stars = row.cells[0][:3] == "***"
        if row.line < first and 2 * n_filled >= n_columns and not is_line_of_stars:
            headers.append(row)
    if headers:
        return headers
    for row in reversed(comments):
        if len(row.cells) == n_columns and not _is_row(row.cells, decimal):
            return [row]
    return []


def _has_units(row: _Row) -> bool:
    """Recognise a row of units; empty cells may be among them."""
    cells = [cell for cell in row.cells if cell]
    return all(unit_named(cell) or _OTHER_UNITS.fullmatch(cell) for cell in cells)


def _delimiter(lines: Sequence[str]) -> str:
    """Find the delimiter by which most lines have equally many cells, and most cells are
    numbers.
    """
    return max(_DELIMITERS, key=lambda delimiter: _fitness(lines, delimiter))


def _fitness(lines: Sequence[str], delimiter: str) -> float:
    """Rate a delimiter: the share of lines with the usual number of cells, times the share of
    their cells that are numbers or empty.
    """
    if not lines:
        return 0.0
    rows = [_split(line, delimiter) for line in lines]
    width, n_rows = Counter(map(len, rows)).most_common(1)[0]
    if width < 2:
        return 0.0
    decimal = "." if delimiter == "," else ","
    n_cells = 0
    n_read = 0
    for row in rows:
        if len(row) != width:
            continue
        n_cells += width
        n_read += sum(is_number(cell, decimal) or is_missing(cell) for cell in row)
    return n_rows / len(rows) * (0.01 + n_read / n_cells)


def _split(line: str, delimiter: str) -> list[str]:
    """Split a line into cells."""
    if delimiter == "blank":
        return line.split()
    reader = csv.reader([line], delimiter=_DELIMITERS[delimiter], skipinitialspace=True)
    cells = next(reader, [])
    return [cell.strip() for cell in cells]


def _decimal(table: Sequence[_Row], delimiter: str) -> str:
    """Detect the sign before decimals."""
    cells = chain.from_iterable(row.cells for row in table)
    if delimiter == ",":
        # Only a cell in quotes has a comma, which may also stand between groups of digits.
        return decimal_sign(cell for cell in cells if not is_grouped(cell))
    return decimal_sign(cells)


def _first_row(table: Sequence[_Row], decimal: str) -> int:
    """Find the line of the first row of numbers: as the later rows have them, column by column."""
    if not table:
        return 1
    later_rows = [row.cells for row in table[len(table) // 2 :]]
    numeric_columns = []
    for k, column in enumerate(zip(*later_rows, strict=True)):
        n_numbers = sum(is_number(cell, decimal) for cell in column)
        if 2 * n_numbers >= len(later_rows):
            numeric_columns.append(k)
    for row in table:
        cells = [row.cells[k] for k in numeric_columns if not is_missing(row.cells[k])]
        if cells and all(is_number(cell, decimal) for cell in cells):
            return row.line
    return table[-1].line + 1


def _is_row(row: Sequence[str], decimal: str) -> bool:
    """Recognise a row of numbers: more than half of its cells are."""
    return 2 * sum(is_number(cell, decimal) for cell in row) > len(row)


def _numbers(
    file: IO[str],
    layout: TextLayout,
    places: Sequence[int],
    words: Mapping[int, str],
    remarks: list[str],
) -> Iterator[float]:
    """Yield numbers, one row after the other; a last row that breaks off is left out."""
    lines = islice(lines_of(file), layout.first - 1, None)
    rows: Iterable[list[str]]
    if layout.delimiter == "blank":
        rows = map(str.split, lines)
    else:
        delimiter = _DELIMITERS[layout.delimiter]
        rows = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    pending = list[str]()  # the row before, which is whole if another follows
    number = 0
    n_headers = 0
    header = [name.strip() for name in layout.names]
    for row in rows:
        if not row or row[0].startswith(("#", "%")):
            continue
        if row[0].strip() == header[0] and [cell.strip() for cell in row] == header:
            n_headers += 1
            continue
        if pending:
            yield from _cells(pending, layout, number, places, words)
        pending = row
        number += 1
        if number > MOST_ROWS:
            raise InvalidInput(f"more than {MOST_ROWS} rows; give recordings one by one")
    if pending and len(pending) < len(layout.names):
        remarks.append(
            f"the last row breaks off after {len(pending)} of {len(layout.names)} cells and is"
            " left out"
        )
    elif pending:
        yield from _cells(pending, layout, number, places, words)
    if n_headers > 0:
        remarks.append(
            f"the header stands {n_headers} more times between rows: recordings one after the other?"
        )


def _cells(
    row: Sequence[str],
    layout: TextLayout,
    number: int,
    places: Sequence[int],
    words: Mapping[int, str],
) -> Iterator[float]:
    """Yield the numbers of one row at some places."""
    if len(row) <= max(places):
        raise InvalidInput(
            f"row {number} has {len(row)} cells; its table has {len(layout.names)} columns"
        )
    for place in places:
        if layout.decimal == ",":
            cell = row[place].replace(",", ".")
        else:
            cell = row[place]
        if place in words:
            yield float(row[place].strip() == words[place])
        elif "_" in cell:  # which Python reads as a number, such as 1_000
            yield read_unusual_cell(cell.strip(), layout.names[place], number, layout.time)
        else:
            try:
                value = float(cell)
            except ValueError:
                value = read_unusual_cell(cell.strip(), layout.names[place], number, layout.time)
            yield value
