"""Values that show themselves by their fields: a row for each, in a shell and in a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from enum import Enum
from typing import Any

import numpy as np

from uvms_ocp.shown.small_table import SmallTable, Tabled

_FEW = 8  # entries of what is told in full
_LONGEST = 120  # letters of a row


class Fielded(Tabled):
    """A dataclass, made with ``repr=False``, that shows itself as a table of its fields."""

    __slots__ = ()

    def _table(self) -> SmallTable:
        shown = [field.name for field in fields(self) if field.repr]  # type: ignore[arg-type]
        title = " ".join(str(part) for part in (type(self).__name__, getattr(self, "name", "")) if part)
        return SmallTable(title=title, rows=tuple((name, in_a_row(getattr(self, name))) for name in shown))


def in_a_row(value: Any) -> str:
    """What a value is, in one short row."""
    if value is None:
        return "-"
    if isinstance(value, np.ndarray):
        return _of_array(value)
    if isinstance(value, Tabled):
        return value._table().title
    if isinstance(value, Mapping):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, (tuple, list)):
        return _of_items(value)
    if isinstance(value, Enum):
        return str(value.value)
    if callable(value) and hasattr(value, "__qualname__"):
        return str(value.__qualname__)
    return _of_other(value)


def _of_array(value: np.ndarray) -> str:
    if value.size > _FEW or value.ndim > 1:
        return f"array of shape {value.shape}"
    return np.array2string(value, precision=4, suppress_small=True, max_line_width=_LONGEST)


def _of_items(value: tuple[Any, ...] | list[Any]) -> str:
    if any(isinstance(item, Mapping) for item in value):
        return f"{len(value)} rows"
    more = f" and {len(value) - _FEW} more" if len(value) > _FEW else ""
    return (", ".join(map(in_a_row, value[:_FEW])) or "none") + more


def _of_other(value: Any) -> str:
    """By its own words, where these are few; else what kind of thing it is."""
    words = f"{value:.4g}" if isinstance(value, float) else str(value) if isinstance(value, str) else repr(value)
    return type(value).__name__ if "\n" in words or " at 0x" in words or len(words) > _LONGEST else words
