"""Recognise and read the cells of a table of text: numbers with either decimal sign, groups of
digits, times of day, ISO 8601 times, truth values, and the many ways to say that there is no value.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime, timezone

from uvms_ocp.errors import InvalidInput

_MISSING = frozenset(
    {"", "-", "--", "na", "n/a", "#n/a", "nan", "-nan", "none", "null", "nil", "missing"}
)
_TRUTH = {"true": 1.0, "false": 0.0}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?", re.IGNORECASE)
_WITH_UNIT = re.compile(
    r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)? ?(?P<unit>[^\W\d_][\w/²³^-]{0,9}|[°%]\w{0,3})"
)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?")
_TIME = re.compile(
    r"(?:(?:(?P<Y>\d{4})(?P<dash>[-/.]?)(?P<M>\d\d)(?P=dash)(?P<D>\d\d)"
    r"|(?P<d>\d\d?)\.(?P<m>\d\d?)\.(?P<y>\d{4}))[T _])?"
    r"(?P<hours>\d\d?)(?P<colon>(?(Y)[:-]?|:))(?P<minutes>\d\d)(?P=colon)(?P<seconds>\d\d)"
    r"(?:[.,](?P<part>\d+)|:(?P<ms>\d{3}))?(?: ?(?P<half>[ap])m)?"
    r" ?(?:Z|UTC|GMT|(?P<zone>[+-]\d\d):?(?P<more>\d\d)?)?",
    re.IGNORECASE,
)


def is_missing(cell: str) -> bool:
    """Recognise a cell without a value, also by asterisks, which stand for a number that was too
    wide for its column.
    """
    return cell.strip("*").lower() in _MISSING


def is_number(cell: str, decimal: str) -> bool:
    """Recognise a number or a time; decimal: the sign before decimals."""
    if decimal == "," and _DECIMAL_COMMA.fullmatch(cell):
        return True
    patterns = (_NUMBER, _TIME, _GROUPED)
    return any(pattern.fullmatch(cell) for pattern in patterns)


def is_grouped(cell: str) -> bool:
    """Recognise a number whose digits stand in groups of three, such as 1,234; none begins by 0."""
    return bool(_GROUPED.fullmatch(cell)) and not cell.lstrip("+-").startswith("0")


def decimal_sign(cells: Iterable[str]) -> str:
    """Return the sign before decimals that more of the cells have, ``.`` where none decides."""
    n_commas = 0
    n_points = 0
    for cell in cells:
        if _DECIMAL_COMMA.fullmatch(cell):
            n_commas += 1
        elif "." in cell and _NUMBER.fullmatch(cell):
            n_points += 1
    if n_commas > n_points:
        return ","
    return "."


def read_unusual_cell(cell: str, column: str, row: int, time_format: str) -> float:
    """Read a cell that is no plain number: an empty one as NaN, a time [s], or groups of digits.

    column, row: where the cell is, for the message. time_format: of `strptime`, empty for ISO 8601
    and times of day. Raises InvalidInput.
    """
    if is_missing(cell):
        return float("nan")
    if cell.lower() in _TRUTH:
        return _TRUTH[cell.lower()]
    if _GROUPED.fullmatch(cell):
        return float(cell.replace(",", ""))
    if time_format:
        return _formatted_time(cell, column, row, time_format)
    time = _TIME.fullmatch(cell)
    with_unit = _WITH_UNIT.fullmatch(cell)
    if not time and with_unit:
        raise InvalidInput(
            f"row {row}, column {column!r}: {cell[:40]!r} is a number with {with_unit['unit']!r} behind"
            " it; numbers alone are read: have units in the header, such as"
            f" {column} [{with_unit['unit']}]"
        )
    if not time:
        cell_text = f"row {row}, column {column!r}: {cell[:40]!r} is no number"
        allowed = "numbers, empty cells and times as 2024-05-31T23:59:59.5 or 23:59:59.5 are read"
        raise InvalidInput(
            f"{cell_text}; {allowed}, others by `table: {{time: '%d/%m/%Y %H:%M:%S.%f'}}` or their"
            " like"
        )
    return _seconds(time)


def _formatted_time(cell: str, column: str, row: int, time_format: str) -> float:
    """Read a time [s] of a given form, in which whole seconds may lack their fraction. Raises
    InvalidInput.
    """
    for form in (time_format, re.sub(r"[.,]?%f", "", time_format)):
        with suppress(ValueError):
            return datetime.strptime(cell, form).replace(tzinfo=timezone.utc).timestamp()
    raise InvalidInput(
        f"row {row}, column {column!r}: {cell[:40]!r} is no time of the form {time_format!r}; give"
        " table: {time: FORM} as its times have it"
    )


def _seconds(time: re.Match[str]) -> float:
    """Convert a match of `_TIME` to seconds: since 1970 where it has a date, else of the day."""
    hours = int(time["hours"])
    if time["half"]:
        hours %= 12
        if time["half"] in "pP":
            hours += 12
    fraction = time["part"] or time["ms"] or 0
    seconds = (
        3600.0 * hours + 60.0 * int(time["minutes"]) + int(time["seconds"]) + float(f"0.{fraction}")
    )
    if time["Y"]:
        year, month, day = time.group("Y", "M", "D")
    else:
        year, month, day = time.group("y", "m", "d")
    if year:
        seconds += datetime(int(year), int(month), int(day), tzinfo=timezone.utc).timestamp()
    if time["zone"]:
        sign = time["zone"][0]
        seconds -= 3600.0 * int(time["zone"]) + 60.0 * int(sign + (time["more"] or "0"))
    return seconds
