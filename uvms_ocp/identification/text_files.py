"""Open files of text of unknown origin in bounds: gzipped or not, of an encoding that is detected, or
a sheet of a workbook as text.

A file may be damaged, or unpack to more than memory or time allow: either raises `InvalidInput`.
"""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import IO, Any
from zipfile import ZipFile

from uvms_ocp.errors import InvalidInput, optional_module, require_known
from uvms_ocp.record.untrusted import DENSEST, SMALL, as_input_errors

MOST_ROWS = 5_000_000
"""Largest number of rows of a file: 14 hours at 100 Hz."""
LONGEST_LINE = 1 << 20
"""[characters] longest line: a packed file may have one that fills any memory."""
HEAD_LINES = 200
"""Number of first lines from which the layout of a table is detected."""
_HEAD_BYTES = 1 << 16  # first bytes, from which the encoding is detected
_GZIP = b"\x1f\x8b"
_ZIP = b"PK"
_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def encoding_of(path: Path) -> str:
    """Detect the encoding of a file by a mark at its beginning, or by its first bytes.

    Raises `InvalidInput` for a binary file.
    """
    if _begins_with(path, _ZIP):
        return "utf-8"
    with _damage_in_a_line(path), _unpacked(path) as data:
        head = data.read(_HEAD_BYTES)
    for mark, encoding in _BYTE_ORDER_MARKS.items():
        if head.startswith(mark):
            return encoding
    if b"\0" in head:
        raise InvalidInput(
            f"{path}: no table of numbers (it is binary); CSV and other tables of text are read"
        )
    if len(head) == _HEAD_BYTES:
        head = head[:-4]  # a character may have been cut
    try:
        head.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


@contextmanager
def opened_text(path: Path, encoding: str, sheet: str) -> Iterator[IO[str]]:
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
        with _unpacked(path) as data:
            yield io.TextIOWrapper(data, encoding=encoding, newline=None)


def lines_of(file: IO[str]) -> Iterator[str]:
    """Yield all lines. Raises InvalidInput for too many or too long ones, which a few packed bytes
    may hold.
    """
    for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), 1):
        if len(line) == LONGEST_LINE:
            raise InvalidInput(f"a line of more than {LONGEST_LINE >> 20} MB")
        if number > MOST_ROWS + HEAD_LINES:
            raise InvalidInput(f"more than {MOST_ROWS} lines; give recordings one by one")
        yield line


def sheets_of(path: Path, sheet_name: str) -> tuple[str, tuple[str, ...]]:
    """Return the sheet of a workbook to read, by default the first with numbers, and all sheets; an
    empty name and none for a text file.

    Raises `NameNotFound`, and `InvalidInput` for one that unpacks to too much.
    """
    if not _begins_with(path, _ZIP):
        return "", ()
    with _damage_in_a_line(path), _workbook(path) as book:
        names = tuple(sheet.title for sheet in book.worksheets)
        if sheet_name:
            require_known(f"sheet of {path.name}", sheet_name, names)
            return sheet_name, names
        for sheet in book.worksheets:
            head = islice(sheet.iter_rows(values_only=True), HEAD_LINES)
            if any(_has_numbers(row) for row in head):
                return sheet.title, names
        return names[0], names


def _has_numbers(row: Sequence[object]) -> bool:
    """Check whether a row of a sheet has two numbers at least."""
    return sum(isinstance(cell, int | float) for cell in row) > 1


@contextmanager
def _workbook(path: Path) -> Iterator[Any]:
    """Open a workbook. Raises InvalidInput for one that unpacks to too much."""
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


def _unpacked(path: Path) -> IO[bytes] | gzip.GzipFile:
    """Open a file for its bytes, gzipped or not."""
    if _begins_with(path, _GZIP):
        return gzip.open(path)
    return path.open("rb")


def _begins_with(path: Path, mark: bytes) -> bool:
    """Check the first bytes of a file."""
    with path.open("rb") as file:
        return file.read(len(mark)) == mark


def _damage_in_a_line(path: Path) -> AbstractContextManager[None]:
    """Turn errors of a damaged file into InvalidInput."""
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
