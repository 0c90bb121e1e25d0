"""Read tables of text that anyone may have written: encoding, delimiter, decimal sign, header and
units are found, or given.

A table is what follows a header: rows of equally many cells, in most of whose columns there are
numbers. Lines before it are passed over, so are comments, of which the last before the first row
may be the header. Columns have their names, and their places as ``#1``, ``#2``, ...
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import islice
from pathlib import Path
from typing import IO, Annotated, Any, Literal
from zipfile import ZipFile

import numpy as np
from pydantic import Field

from uvms_ocp.errors import InvalidInput, NameNotFound, optional_module, require_known
from uvms_ocp.identification.recording import unit_named
from uvms_ocp.model_errors import FileModel, one_line_errors
from uvms_ocp.record.untrusted import DENSEST, SMALL, as_input_errors

MOST_ROWS = 5_000_000
"""of a file: 14 hours at 100 Hz."""
LONGEST_LINE = 1 << 20
"""characters: a packed file may have one that fills any memory."""
# lines, and bytes, from which the layout is found
_HEAD = 200
_HEAD_BYTES = 1 << 16
_DELIMITERS = {"tab": "\t", ";": ";", ",": ",", "|": "|", "blank": ""}
_GZIP = b"\x1f\x8b"
_ZIP = b"PK"
_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_MISSING = frozenset(
    {"", "-", "--", "na", "n/a", "#n/a", "nan", "-nan", "none", "null", "nil", "missing"}
)
_TRUTH = {"true": 1.0, "false": 0.0}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?")
_TIME = re.compile(
    r"(?:(?:(?P<Y>\d{4})(?P<dash>[-/.]?)(?P<M>\d\d)(?P=dash)(?P<D>\d\d)|(?P<d>\d\d?)\.(?P<m>\d\d?)\.(?P<y>\d{4}))[T"
    r" _])?"
    r"(?P<hours>\d\d?)(?P<colon>(?(Y)[:-]?|:))(?P<minutes>\d\d)(?P=colon)(?P<seconds>\d\d)"
    r"(?:[.,](?P<part>\d+)|:(?P<ms>\d{3}))?(?: ?(?P<half>[ap])m)?"
    r" ?(?:Z|UTC|GMT|(?P<zone>[+-]\d\d):?(?P<more>\d\d)?)?",
    re.IGNORECASE,
)
_UNIT = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_OTHER_UNITS = re.compile(
    r"-|1|none|\[.*\]|\(.*\)|[hmd]?bar|[hk]?pa|psi|[km]?hz|m?[vaw]|(deg|°)? ?c|rpm|kg|lbs?",
    re.IGNORECASE,
)
"""Entries of a row of units for columns that no channel reads."""


@one_line_errors
class TextFormat(FileModel, use_attribute_docstrings=True):
    """What is known of a table of text; what is not given is found."""

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
    delimiter: str
    """Between cells, a key of `TextFormat`."""
    decimal: str
    names: tuple[str, ...]
    """Names of the columns; their numbers where there is no header."""
    units: tuple[str, ...]
    """Units of the columns, from a row of units or from brackets in the names; empty where nothing
    is said.
    """
    header: int
    """Its line, from 1; 0 for none."""
    first: int
    """Line of the first row, from 1."""
    time: str = ""
    """Format of its times as it was given, empty for one that is known by itself."""
    sheet: str = ""
    sheets: tuple[str, ...] = ()
    """The sheet of a workbook, and all that it has."""

    def __str__(self) -> str:
        if self.header:
            header = f"header in line {self.header}"
        else:
            header = "no header, columns are #1, #2, ..."
        if len(self.sheets) > 1:
            others = f" of {', '.join(self.sheets)}"
        else:
            others = ""
        if self.sheet:
            return f"sheet {self.sheet}{others}, {header}"
        cells = f"{self.encoding}, {self.delimiter!r} between cells"
        return f"{cells}, decimals after {self.decimal!r}, {header}"


def text_layout(path: Path, text_format: TextFormat | None = None) -> TextLayout:
    """Find the layout of a table.

    Raises InvalidInput for what is none, NotInstalled for a workbook without its library,
    NameNotFound for no such sheet.
    """
    text_format = text_format or TextFormat()
    encoding = text_format.encoding or _encoding(path)
    sheets = _sheets(path, text_format.sheet)
    with _opened(path, encoding, sheets[0]) as file:
        head = [(k, line) for k, line in enumerate(islice(_lines(file), _HEAD), 1) if line.strip()]
        rows = [(k, line) for k, line in head if not line.lstrip().startswith(("#", "%"))]
        delimiter = text_format.delimiter or _delimiter([line for _, line in rows])
        cells = [(k, _split(line, delimiter)) for k, line in rows]
        widest = max((len(row) for _, row in cells), default=0)
        if widest and not any(
            row[-1] for _, row in cells if len(row) == widest
        ):  # lines that end by a delimiter
            cells = [(k, row[:-1] if row[-1] == "" else row) for k, row in cells]
        if cells:
            width = Counter(len(row) for _, row in cells).most_common(1)[0][0]
        else:
            width = 0
        table = [(k, row) for k, row in cells if len(row) == width]
        decimal = text_format.decimal or _decimal([row for _, row in table], delimiter)
        first = _first_row(table, decimal)
        before = [
            (k, row)
            for k, row in table
            if k < first and 2 * sum(map(bool, row)) >= width and row[0][:3] != "***"
        ]
        comments = [
            (k, _split(line.lstrip().lstrip("#%"), delimiter)) for k, line in head if k < first
        ]
        before = (
            before
            or [(k, row) for k, row in comments if len(row) == width and not _is_row(row, decimal)][
                -1:
            ]
        )
        of_units = len(before) > 1 and all(
            unit_named(cell) or _OTHER_UNITS.fullmatch(cell) for cell in before[-1][1] if cell
        )
        if of_units:
            units = before.pop()
        else:
            units = None
        if text_format.header is not None:
            before = [(k, row) for k, row in cells + comments if k == text_format.header]
            first = max(first, text_format.header + 1)
        if before:
            line, names = before[-1]
        else:
            line = 0
            names = [f"#{k + 1}" for k in range(width)]
        if units:
            unit_names = tuple(cell.strip("[]() ") for cell in units[1])
        else:
            unit_names = tuple(map(_unit_in, names))
        table_of = {
            "encoding": encoding,
            "delimiter": delimiter,
            "decimal": decimal,
            "time": text_format.time,
        }
        return TextLayout(
            **table_of,
            names=tuple(names),
            units=unit_names,
            header=line,
            first=first,
            sheet=sheets[0],
            sheets=tuple(sheets[1:]),
        )


def text_columns(
    path: Path, places: Sequence[int], layout: TextLayout, words: Mapping[int, str]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Read columns (n, k) [as they are] of a table, NaN for empty cells, and remarks about rows
    that were left out.

    places: (k,) of `place_of`. words: by place, such that are 1 and all others 0.
    Times of day and ISO 8601 times are in seconds. Raises InvalidInput, and NotInstalled as
    `text_layout` does.
    """
    remarks: list[str] = []
    with _opened(path, layout.encoding, layout.sheet) as file:
        numbers = np.fromiter(_numbers(file, layout, places, words, remarks), dtype=float)
    return numbers.reshape(-1, len(places)), tuple(remarks)


def place_of(path: Path, names: Sequence[str], column: str) -> int:
    """Find the place of a column by its name, by its name without case, unit and sign of a comment
    where that is unambiguous, or by ``#k``.

    Raises NameNotFound, and InvalidInput for a name that stands more than once.
    """
    for key in (str.strip, _plain):
        matches = [k for k, name in enumerate(names) if key(name) == key(column)]
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
    return re.sub(r"^[#%]\s*(?=\D)", "", _UNIT.sub("", name).strip().lower())


def _unit_in(name: str) -> str:
    return match[1].strip() if (match := _UNIT.search(name)) else ""


# Layout.


def _encoding(path: Path) -> str:
    if _begins_with(path, _ZIP):
        return "utf-8"
    with (
        _damage_in_a_line(path),
        gzip.open(path) if _begins_with(path, _GZIP) else path.open("rb") as data,
    ):
        head = data.read(_HEAD_BYTES)
    marked = [encoding for mark, encoding in _BYTE_ORDER_MARKS.items() if head.startswith(mark)]
    if marked:
        return marked[0]
    if b"\0" in head:
        raise InvalidInput(
            f"{path}: no table of numbers (it is binary); CSV and other tables of text are read"
        )
    try:
        head[: len(head) - 4 if len(head) == _HEAD_BYTES else None].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _delimiter(lines: Sequence[str]) -> str:
    """Find the delimiter by which most lines have equally many cells, and most cells are
    numbers.
    """

    def share(name: str) -> float:
        rows = [_split(line, name) for line in lines]
        if rows:
            width, n = Counter(map(len, rows)).most_common(1)[0]
        else:
            width = 0
            n = 0
        if width < 2:
            return 0.0
        cells = [cell for row in rows for cell in row if len(row) == width]
        n_read = sum(
            _is_number(cell, "," if name != "," else ".") or _is_missing(cell) for cell in cells
        )
        return n / len(rows) * (0.01 + n_read / len(cells))

    return max(_DELIMITERS, key=share)


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == "blank":
        return line.split()
    return [
        cell.strip()
        for cell in next(
            csv.reader([line], delimiter=_DELIMITERS[delimiter], skipinitialspace=True), []
        )
    ]


def _decimal(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    if delimiter == ",":
        return "."
    cells = [cell for row in rows for cell in row]
    commas = sum(bool(_DECIMAL_COMMA.fullmatch(cell)) for cell in cells)
    if commas > sum("." in cell and bool(_NUMBER.fullmatch(cell)) for cell in cells):
        return ","
    return "."


def _first_row(table: Sequence[tuple[int, Sequence[str]]], decimal: str) -> int:
    """Find the line of the first row of numbers: as the later rows have them, column by column."""
    later = [row for _, row in table[len(table) // 2 :]]
    columns = enumerate(zip(*later, strict=True))
    numeric = [
        k
        for k, column in columns
        if 2 * sum(_is_number(cell, decimal) for cell in column) >= len(later)
    ]
    for line, row in table:
        cells = [row[k] for k in numeric if not _is_missing(row[k])]
        if cells and all(_is_number(cell, decimal) for cell in cells):
            return line
    return (table[-1][0] if table else 0) + 1


def _is_row(row: Sequence[str], decimal: str) -> bool:
    return 2 * sum(_is_number(cell, decimal) for cell in row) > len(row)


def _is_missing(cell: str) -> bool:
    """Recognise a cell that says nothing, also by asterisks, which stand for a number that found no
    room.
    """
    return cell.strip("*").lower() in _MISSING


def _is_number(cell: str, decimal: str) -> bool:
    with_comma = decimal == "," and _DECIMAL_COMMA.fullmatch(cell)
    return bool(
        with_comma or _NUMBER.fullmatch(cell) or _TIME.fullmatch(cell) or _GROUPED.fullmatch(cell)
    )


# Rows.


def _numbers(
    file: IO[str],
    layout: TextLayout,
    places: Sequence[int],
    words: Mapping[int, str],
    remarks: list[str],
) -> Iterator[float]:
    """Yield numbers, one row after the other; a last row that breaks off is left out."""
    lines = islice(_lines(file), layout.first - 1, None)
    rows: Iterable[list[str]]
    if layout.delimiter == "blank":
        rows = map(str.split, lines)
    else:
        delimiter = _DELIMITERS[layout.delimiter]
        rows = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    before = list[str]()
    number = 0
    for row in rows:
        if not row or row[0].startswith(("#", "%")):
            continue
        if before:
            yield from _cells(before, layout, number, places, words)
        before = row
        number = number + 1
        if number > MOST_ROWS:
            raise InvalidInput(f"more than {MOST_ROWS} rows; give recordings one by one")
    if before and len(before) < len(layout.names):
        remarks.append(
            f"the last row breaks off after {len(before)} of {len(layout.names)} cells and is"
            " left out"
        )
    elif before:
        yield from _cells(before, layout, number, places, words)


def _cells(
    row: Sequence[str],
    layout: TextLayout,
    number: int,
    places: Sequence[int],
    words: Mapping[int, str],
) -> Iterator[float]:
    if len(row) <= max(places):
        raise InvalidInput(
            f"row {number} has {len(row)} cells; its table has {len(layout.names)} columns"
        )
    for place in places:
        if layout.decimal == ",":
            cell = row[place].replace(",", ".")
        else:
            cell = row[place]
        try:
            if "_" in cell and place not in words:
                raise ValueError
            yield float(row[place].strip() == words[place]) if place in words else float(cell)
        except ValueError:
            yield _unusual(cell.strip(), layout.names[place], number, layout)


def _unusual(cell: str, name: str, number: int, layout: TextLayout) -> float:
    """Read a cell that is no plain number: an empty one, a time, or groups of digits."""
    if _is_missing(cell):
        return float("nan")
    if cell.lower() in _TRUTH:
        return _TRUTH[cell.lower()]
    if _GROUPED.fullmatch(cell):
        return float(cell.replace(",", ""))
    if layout.time:
        return datetime.strptime(cell, layout.time).replace(tzinfo=timezone.utc).timestamp()
    match = _TIME.fullmatch(cell)
    if not match:
        cell_text = f"row {number}, column {name!r}: {cell[:40]!r} is no number"
        read = "numbers, empty cells and times as 2024-05-31T23:59:59.5 or 23:59:59.5 are read"
        raise InvalidInput(
            f"{cell_text}; {read}, others by `table: {{time: '%d/%m/%Y %H:%M:%S.%f'}}` or their like"
        )
    groups = match.groupdict()
    hours = int(groups["hours"])
    if groups["half"]:
        hours %= 12
        if groups["half"] in "pP":
            hours += 12
    time = (
        3600.0 * hours
        + 60.0 * int(groups["minutes"])
        + int(groups["seconds"])
        + float(f"0.{groups['part'] or groups['ms'] or 0}")
    )
    year, month, day = (groups[key] for key in ("YMD" if groups["Y"] else "ymd"))
    if year:
        time += datetime(int(year), int(month), int(day), tzinfo=timezone.utc).timestamp()
    if groups["zone"]:
        time -= 3600.0 * int(groups["zone"]) + 60.0 * int(
            groups["zone"][0] + (groups["more"] or "0")
        )
    return time


# Files.


@contextmanager
def _opened(path: Path, encoding: str, sheet: str) -> Iterator[IO[str]]:
    """Open a text file, gzipped or not, or a sheet of a workbook as text; damage raises
    `InvalidInput` in one line.
    """
    with _damage_in_a_line(path):
        if _begins_with(path, _ZIP):
            with _workbook(path) as book:
                text = io.StringIO()
                csv.writer(text).writerows(book[sheet].iter_rows(values_only=True))
            text.seek(0)
            yield text
            return
        with gzip.open(path) if _begins_with(path, _GZIP) else path.open("rb") as data:
            yield io.TextIOWrapper(data, encoding=encoding, newline=None)


def _begins_with(path: Path, mark: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(mark)) == mark


def _sheets(path: Path, sheet_name: str) -> list[str]:
    """Return the sheet of a workbook to read, and the names of all; an empty name for a text file.

    Raises NameNotFound.
    """
    if not _begins_with(path, _ZIP):
        return [""]
    with _damage_in_a_line(path), _workbook(path) as book:
        names = [sheet.title for sheet in book.worksheets]
        if sheet_name:
            require_known(f"sheet of {path.name}", sheet_name, names)
            return [sheet_name, *names]
        for sheet in book.worksheets:
            if any(map(_has_numbers, islice(sheet.iter_rows(values_only=True), _HEAD))):
                return [sheet.title, *names]
        return [names[0], *names]


def _has_numbers(row: Sequence[object]) -> bool:
    return sum(isinstance(cell, int | float) for cell in row) > 1


@contextmanager
def _workbook(path: Path) -> Iterator[Any]:
    openpyxl = optional_module("openpyxl", "reading a workbook", "openpyxl")
    with ZipFile(path) as archive:
        size = path.stat().st_size
        unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > max(SMALL, DENSEST * size):
        raise InvalidInput(
            f"would unpack to {unpacked >> 20} MB; at most {DENSEST} times a file are read"
        )
    with (
        as_input_errors(path, what="no workbook"),
        closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book,
    ):
        yield book


def _damage_in_a_line(path: Path) -> AbstractContextManager[None]:
    return as_input_errors(
        path,
        OSError,
        EOFError,
        zlib.error,
        csv.Error,
        ValueError,
        LookupError,
        what="no table of numbers",
    )


def _lines(file: IO[str]) -> Iterator[str]:
    """Yield all lines, in bounds: a few bytes, packed, may hold as many as there is time for."""
    for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), 1):
        if len(line) == LONGEST_LINE:
            raise InvalidInput(f"a line of more than {LONGEST_LINE >> 20} MB")
        if number > MOST_ROWS + _HEAD:
            raise InvalidInput(f"more than {MOST_ROWS} lines; give recordings one by one")
        yield line
