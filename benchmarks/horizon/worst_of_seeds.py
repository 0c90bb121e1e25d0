"""Runs of several seeds in one row each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from recording.report import Row

_COUNTS = ("solves", "late", "unfit")


def worst_of_seeds(table: Sequence[Row], *by: str) -> list[Row]:
    """One row for each group that is alike in the columns `by`: extremes of all seeds, sums of
    counts, means of the rest.
    """
    kept: dict[tuple[Any, ...], list[Row]] = {}
    for row in table:
        kept.setdefault(tuple(row[name] for name in by), []).append(row)
    return [dict(zip(by, key, strict=True)) | _combined(group, by) for key, group in kept.items()]


def _combined(group: Sequence[Row], by: Sequence[str]) -> dict[str, Any]:
    names = [name for name in group[0] if name not in (*by, "seed")]
    return {name: _of(name, [row[name] for row in group]) for name in names}


def _of(name: str, values: Sequence[Any]) -> Any:
    if name in _COUNTS:
        return sum(values)
    if name.startswith("smallest"):
        return min(values)
    return (
        max(values)
        if name.startswith(("largest", "peak")) or "p99" in name
        else float(np.mean(values))
    )
