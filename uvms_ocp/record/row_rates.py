"""Fewer rows than ticks: what each keeps of the ticks since the row before, so that no peak and no
sum is lost.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

EXTREMES = (
    "q",
    "v",
    "thrust",
    "torque",
    "contact",
    "quantities",
    "altimeter_range",
    "tick_time",
    "controller_time",
)
"""Series whose least and largest values since the row before are kept in fewer rows, as ``_least``
and ``_most``.
"""
MEANS = ("v", "saturated")
"""Series of whose sizes the mean since the row before is kept, as ``_mean``."""
WORST = ("status", "health", "saturated", "freshness")
"""Series of which a row has the largest code since the row before."""


def newest_readings(rows: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the newest of readings (n, ...), NaN without one, of the ticks up to each of the
    `last` (k,) and after the one before.
    """
    has_reading = np.isfinite(rows[:, -1])
    newest_so_far = np.maximum.accumulate(np.where(has_reading, np.arange(len(rows)), -1))
    newest = newest_so_far[last]
    is_new = newest > np.r_[-1, last[:-1]]
    return np.where(is_new[:, None], rows[newest], np.nan)


def thinned_rows(rows: Mapping[str, np.ndarray], last: np.ndarray) -> dict[str, np.ndarray]:
    """Return one row for the ticks up to each of the `last` (k,), in order, after the one before;
    rows (n, ...) of ticks by series.
    """
    first = np.r_[0, last[:-1] + 1]
    series = dict[str, np.ndarray]()
    for name, part in rows.items():
        series[name] = part[last]
        if name in WORST:
            series[name] = np.maximum.reduceat(part, first)
        if name.startswith("measured_"):
            series[name] = newest_readings(part, last)
        if name in EXTREMES:
            series[f"{name}_least"] = np.fmin.reduceat(part, first)
            series[f"{name}_most"] = np.fmax.reduceat(part, first)
        if name in MEANS:
            sums = np.add.reduceat(np.abs(part * 1.0), first)
            series[f"{name}_mean"] = (sums.T / (last - first + 1)).T
    return series
