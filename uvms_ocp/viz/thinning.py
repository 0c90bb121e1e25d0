"""Thin a long record to the rows that a figure can show."""

from __future__ import annotations

import numpy as np

from uvms_ocp.record import row_files
from uvms_ocp.record.record import Record

_LONG = 50_000
"""Rows from which on not all are drawn; a page is 1,300 dots wide."""
_STRETCHES = 4096
"""Stretches of a long record, of each of which two rows are drawn."""
_AS_THEY_ARE = (
    "t",
    "phase",
    "q",
    "q_estimated",
    "q_std",
    "v",
    "v_estimated",
    "command",
    "tick_time",
    "tool",
)
"""Series of which rows of the record are drawn, not extremes: they are taken from one another."""


def thinned(record: Record) -> Record:
    """Thin a record of very many rows to two for each of 4,096 stretches: the least and the largest
    value of every column.

    Of what is taken from one another, or counted, they are rows of the record: of state, estimate,
    command and times. What is shorter than half a stretch, such as a short phase, is in none of
    them.
    """
    if len(record) <= _LONG:
        return record
    step = -(-len(record) // _STRETCHES)
    starts = np.arange(0, len(record), step)
    series = dict[str, np.ndarray]()
    rows = np.append(np.stack([starts, starts + step // 2], axis=1).ravel()[:-1], len(record) - 1)
    for name in record.series:
        if name in _AS_THEY_ARE:
            series[name] = record[name][rows]
        else:
            series[name] = _extremes(record[name], step)
    return Record(series=series, meta=record.meta)


def _extremes(values: np.ndarray, step: int) -> np.ndarray:
    """Return the least and the largest value of every column, for each stretch of `step` rows."""
    extremes = list[np.ndarray]()
    for (stretch,) in row_files.parts(values, rows=step):
        extremes += [np.fmin.reduce(stretch), np.fmax.reduce(stretch)]
    return np.stack(extremes)
