"""Group the failures of runs by cause: those that differ only in their numbers are one, shown with
the numbers of one run.
"""

from __future__ import annotations

import re
from typing import Any

from uvms_ocp.campaign.success_rate import Rate
from uvms_ocp.errors import plain_line

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
# causes, letters of one
_MOST = 20
_LONGEST = 300


def cause_table(table: Any) -> list[dict[str, Any]]:
    """One row per outcome and kind of cause of the runs that failed, the most frequent first, each
    as its first run has it.
    """
    failed = table[~table["success"].astype(bool)]
    shortened = (
        failed["cause"].fillna("").map(_shortened).astype(str)
    )  # no runs keep the type of the column
    kind = shortened.str.replace(
        _NUMBER, "#", regex=True
    )  # so that causes that differ in their numbers alone are equal
    groups = failed.assign(shortened=shortened, kind=kind).groupby(["outcome", "kind"], sort=False)
    rows = [
        {
            "outcome": outcome,
            "cause": runs["shortened"].iloc[0],
            **Rate(number=len(runs), runs=len(table)).to_dict(),
            "run": int(runs["run"].iloc[0]),
        }
        for (outcome, _), runs in groups
    ]
    return sorted(rows, key=lambda row: -row["number"])[:_MOST]


def outcome_table(table: Any) -> list[dict[str, Any]]:
    """One row per outcome of all runs, the most frequent first."""
    counts = table["outcome"].value_counts()
    return [
        {"outcome": name, **Rate(number=int(n), runs=len(table)).to_dict()}
        for name, n in counts.items()
    ]


def _shortened(text: str) -> str:
    """Keep the first two statements of a cause."""
    return plain_line("; ".join(text.partition("; last alarm")[0].split("; ")[:2]), _LONGEST)
