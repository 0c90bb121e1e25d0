"""Runs of several seeds in one row each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from recording.report import Row
from recording.rows import column

_COUNTS = ("solves", "late", "unfit")


def worst_of_seeds(table: Sequence[Row], *by: str) -> list[Row]:
    """One row for each group that is alike in the columns `by`: extremes of all seeds, sums of
    counts, means of the rest.
    """
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in table:
        key = tuple([row[name] for name in by])
        groups.setdefault(key, []).append(row)
    return [_combined(group, by) for group in groups.values()]


def _combined(group: Sequence[Row], by: Sequence[str]) -> dict[str, Any]:
    combined = dict[str, Any]()
    for name in by:
        combined[name] = group[0][name]
    for name in group[0]:
        if name not in (*by, "seed"):
            combined[name] = _worst(name, column(group, name))
    return combined


def _worst(name: str, values: Sequence[Any]) -> Any:
    """Return the extreme, sum or mean of the values of a column, by its name."""
    if name in _COUNTS:
        return sum(values)
    if name.startswith("smallest"):
        return min(values)
    if name.startswith(("largest", "peak")) or "p99" in name:
        return max(values)
    return float(np.mean(values))
