"""Why runs failed: causes that differ in their numbers alone are one."""

from __future__ import annotations

import re
from typing import Any

from uvms_ocp.campaign.findings.rates import Rate

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
_MOST, _LONGEST = 20, 200  # causes, letters of one


def cause_table(table: Any) -> list[dict[str, Any]]:
    """One row per outcome and kind of cause of the runs that failed, the most frequent first, each with a run to look at."""
    failed = table[~table["success"].astype(bool)]
    kinds = failed["cause"].fillna("").map(_kind)
    groups = failed.assign(kind=kinds).groupby(["outcome", "kind"], sort=False)["run"]
    rows = [
        {
            "outcome": outcome,
            "cause": kind,
            **Rate(number=len(runs), runs=len(table)).to_dict(),
            "run": int(runs.iloc[0]),
        }
        for (outcome, kind), runs in groups
    ]
    return sorted(rows, key=lambda row: -row["number"])[:_MOST]


def outcome_table(table: Any) -> list[dict[str, Any]]:
    """One row per outcome of all runs, the most frequent first."""
    counts = table["outcome"].value_counts()
    return [{"outcome": name, **Rate(number=int(n), runs=len(table)).to_dict()} for name, n in counts.items()]


def _kind(text: str) -> str:
    """Without numbers, and without what comes after the first two statements."""
    told = text.partition("; last alarm")[0].split("; ")[:2]
    return _NUMBER.sub("#", "; ".join(told))[:_LONGEST]
