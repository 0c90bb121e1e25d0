"""Keep fewer rows than ticks: each has the extremes, means and worst codes of the ticks since the
row before, so that no peak and no sum is lost.
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
"""Series whose smallest and largest values since the row before are kept, as ``_least`` and
``_most``.
"""
MEANS = ("v", "saturated")
"""Series whose mean absolute value since the row before is kept, as ``_mean``."""
WORST = ("status", "health", "saturated", "freshness")
"""Series of codes, of which the largest since the row before is kept."""


def newest_readings(rows: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the newest readings (k, ...) of each row, NaN where there is none.

    rows (n, ...): readings of the ticks, NaN without one; last (k,): last tick of each row.
    """
    has_reading = np.isfinite(rows[:, -1])
    newest_so_far = np.maximum.accumulate(np.where(has_reading, np.arange(len(rows)), -1))
    newest = newest_so_far[last]
    is_new = newest > np.r_[-1, last[:-1]]
    return np.where(is_new[:, None], rows[newest], np.nan)


def thinned_rows(rows: Mapping[str, np.ndarray], last: np.ndarray) -> dict[str, np.ndarray]:
    """Return k rows by series, for the ticks after the row before.

    rows (n, ...): rows of all ticks by series; last (k,): last tick of each row, in order.
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
