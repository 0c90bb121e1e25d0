"""Distributions of figures of merit."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.campaign.runs.merits import MERITS

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
_NAMES = ("least", "5 %", "25 %", "median", "75 %", "95 %", "largest")


def merit_values(table: Any, name: str) -> np.ndarray:
    """(n,) [unit of the merit] of all runs, NaN where one has none."""
    return np.asarray(table[name].to_numpy(dtype=float, na_value=np.nan))


def spread_table(table: Any) -> list[dict[str, Any]]:
    """One row per figure that some run has: quantiles over the runs that have it, failed ones too."""
    rows = []
    for name, meaning in MERITS.items():
        values = merit_values(table, name)
        known = values[np.isfinite(values)]
        if known.size:
            spread = dict(zip(_NAMES, map(float, np.quantile(known, QUANTILES)), strict=True))
            rows.append({"figure": name, "meaning": meaning, "runs": int(known.size), **spread})
    return rows
