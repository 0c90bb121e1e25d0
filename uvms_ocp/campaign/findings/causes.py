"""Why runs failed: causes that differ in their numbers alone are one, told with the numbers of one run."""

from __future__ import annotations

import re
from typing import Any

from uvms_ocp.campaign.findings.rates import Rate
from uvms_ocp.exceptions import plain_line

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
_MOST, _LONGEST = 20, 300  # causes, letters of one


def cause_table(table: Any) -> list[dict[str, Any]]:
    """One row per outcome and kind of cause of the runs that failed, the most frequent first, each as its first run has it."""
    failed = table[~table["success"].astype(bool)]
    told = failed["cause"].fillna("").map(_told)
    groups = failed.assign(told=told, kind=told.map(_kind)).groupby(["outcome", "kind"], sort=False)
    rows = [
        {
            "outcome": outcome,
            "cause": runs["told"].iloc[0],
            **Rate(number=len(runs), runs=len(table)).to_dict(),
            "run": int(runs["run"].iloc[0]),
        }
        for (outcome, _), runs in groups
    ]
    return sorted(rows, key=lambda row: -row["number"])[:_MOST]


def outcome_table(table: Any) -> list[dict[str, Any]]:
    """One row per outcome of all runs, the most frequent first."""
    counts = table["outcome"].value_counts()
    return [{"outcome": name, **Rate(number=int(n), runs=len(table)).to_dict()} for name, n in counts.items()]


def _told(text: str) -> str:
    """Without what comes after the first two statements."""
    return plain_line("; ".join(text.partition("; last alarm")[0].split("; ")[:2]), _LONGEST)


def _kind(text: str) -> str:
    """Without numbers."""
    return _NUMBER.sub("#", text)
