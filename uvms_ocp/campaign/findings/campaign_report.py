"""The report of a campaign, finished or not."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.campaign.findings.causes import cause_table, outcome_table
from uvms_ocp.campaign.findings.rates import Rate
from uvms_ocp.campaign.findings.sensitivity import SILENT, sensitivity_table
from uvms_ocp.campaign.findings.spread import merit_values, spread_table
from uvms_ocp.campaign.findings.verdict import Bound, judged
from uvms_ocp.campaign.store.identity import read_identity
from uvms_ocp.campaign.store.table import read_table
from uvms_ocp.exceptions import InvalidInput

_WORST = 10
WORST_FIRST = (
    "failures before successes; among them runs without a tool position error first, then the largest, then the longest"
)
_FINISHED_WORSE = ("tool_position_error_m", "duration_s")  # by which runs are compared that end alike


@checked
def campaign_report(folder: Path, success: Sequence[Bound] = ()) -> dict[str, Any]:
    """What the finished runs of the campaign in a folder say, as JSON values.

    success: bounds that a run has to keep, in place of what the mission itself counts. Raises `InvalidInput` where there is no
    campaign, or none of its runs is finished.
    """
    return report_of(folder, judged_table(folder, success), success)


def report_of(folder: Path, table: Any, success: Sequence[Bound]) -> dict[str, Any]:
    """`campaign_report` of the `judged_table` of that folder."""
    identity, rate = read_identity(folder), Rate(number=int(table["success"].sum()), runs=len(table))
    return {
        "campaign": identity.name,
        "folder": str(folder),
        "runs": identity.runs,
        "finished": len(table),
        "package": identity.package,
        "sampler": identity.sampler,
        "seed": identity.seed,
        "parameters": identity.parameters,
        "criterion": [str(bound) for bound in success] or ["the mission completed, and its goals truly reached"],
        "success": rate.to_dict(),
        "success_text": str(rate),
        "outcomes": outcome_table(table),
        "causes": cause_table(table),
        "distributions": spread_table(table),
        "sensitivity": sensitivity_table(
            table, [*identity.parameters], indices=identity.sampler == "indices" and len(table) == identity.runs
        ),
        "sensitivity_silent": SILENT,
        "worst": worst_runs(table, folder),
        "worst_first": WORST_FIRST,
        "wall_s": float(table["wall_s"].fillna(0.0).sum()),
    }


def judged_table(folder: Path, success: Sequence[Bound] = ()) -> Any:
    """All finished runs with their success. Raises `InvalidInput` where there are none, and for a study."""
    if "study" in read_identity(folder).scenario:
        raise InvalidInput(
            f"{folder}: the campaign of a study; give the name of the study with this --out for its table"
        )
    table = read_table(folder)
    if not len(table):
        raise InvalidInput(f"{folder}: no run of its campaign is finished yet; start it, or wait a few seconds")
    return judged(table, success)


def worst_runs(table: Any, folder: Path) -> list[dict[str, Any]]:
    """Ten rows in the order of `WORST_FIRST`, each with the command that repeats it."""
    keys = [np.nan_to_num(merit_values(table, name), nan=np.inf) for name in reversed(_FINISHED_WORSE)]
    order = np.lexsort([-key for key in keys] + [table["success"].to_numpy(dtype=bool)])[:_WORST]
    rows = table.iloc[order]
    return [
        {
            "run": int(row["run"]),
            "outcome": row["outcome"],
            "cause": row["cause"] or "",
            **{name: _number(row[name]) for name in _FINISHED_WORSE},
            "repeat": f"uvms-ocp campaign {shlex.quote(str(folder))} --rerun {row['run']}",
        }
        for _, row in rows.iterrows()
    ]


def _number(value: Any) -> float | None:
    return float(value) if value == value and value is not None else None
