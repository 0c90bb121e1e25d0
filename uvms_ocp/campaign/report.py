"""Report of a campaign, finished or not, by one's own criterion of success, and two campaigns side
by side.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.campaign import jobs, manifest, run_metrics, store
from uvms_ocp.campaign.failure_causes import cause_table, outcome_table
from uvms_ocp.campaign.sensitivity import SILENT, sensitivity_table
from uvms_ocp.campaign.success_criteria import MetricBound, judged
from uvms_ocp.campaign.success_rate import Rate
from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.report.end_of_run import ENDS

# The report of a campaign, finished or not.

_WORST = 10
WORST_FIRST = (
    "failures before successes; among them runs without a tool position error first, then the"
    " largest, then the longest"
)
_FINISHED_WORSE = (
    "tool_position_error_m",
    "duration_s",
)  # by which runs are compared that end alike


@checked
def campaign_report(folder: Path | str, success: Sequence[MetricBound] = ()) -> dict[str, Any]:
    """Report on the finished runs of the campaign in a folder, as JSON values.

    success: bounds that a run has to keep, in place of what the mission itself counts. Raises
    `InvalidInput` where there is no campaign, or none of its runs is finished.
    """
    folder = Path(folder)
    return report_of(folder, table_with_success(folder, success), success)


def report_of(folder: Path, table: Any, success: Sequence[MetricBound]) -> dict[str, Any]:
    """`campaign_report` of the `table_with_success` of that folder."""
    identity = manifest.read_manifest(folder)
    rate = Rate(number=int(table["success"].sum()), runs=len(table))
    identity_entries = {
        "campaign": identity.name,
        "folder": str(folder),
        "runs": identity.runs,
        "finished": len(table),
    }
    return identity_entries | {
        **{name: getattr(identity, name) for name in ("package", "sampler", "seed", "parameters")},
        "criterion": [str(bound) for bound in success]
        or ["the mission completed, and its goals truly reached"],
        "success": rate.to_dict(),
        "success_text": str(rate),
        "outcomes": outcome_table(table),
        "causes": cause_table(table),
        "distributions": run_metrics.distribution_table(table),
        "sensitivity": sensitivity_table(
            table,
            [*identity.parameters],
            indices=identity.sampler == "indices" and len(table) == identity.runs,
        ),
        "sensitivity_silent": SILENT,
        "worst": worst_runs(table, folder),
        "worst_first": WORST_FIRST,
        "wall_s": float(table["wall_s"].fillna(0.0).sum()),
    }


def table_with_success(folder: Path, success: Sequence[MetricBound] = ()) -> Any:
    """Return all finished runs with their success. Raises `InvalidInput` where there are none."""
    table = store.read_table(folder)
    if not len(table):
        raise InvalidInput(
            f"{folder}: no run of its campaign is finished yet; start it, or wait a few seconds"
        )
    missing = [name for name in ("seed", "duration_s", "finished") if name not in table]
    if missing:
        raise InvalidInput(
            f"{folder}: its rows have no {missing[0]!r}; give the folder of a campaign of missions"
        )
    unknown = sorted({*table["outcome"]} - {*ENDS, jobs.ERROR, jobs.KILLED, jobs.TIME_LIMIT})
    if unknown:
        raise InvalidInput(
            f"{folder}: a run with the outcome {unknown[0][:80]!r}, which no run has; put back"
            " what was"
        )
    if (table["success"] & ~table["finished"].fillna(False).astype(bool)).any():
        raise InvalidInput(
            f"{folder}: a run that did not finish counts as success; put back what was"
        )
    return judged(table, success)


def worst_runs(table: Any, folder: Path) -> list[dict[str, Any]]:
    """Return ten rows in the order of `WORST_FIRST`, each with the command that repeats it."""
    figures = np.array([run_metrics.metric_values(table, name) for name in _FINISHED_WORSE])
    keys = [-key for key in np.nan_to_num(figures, nan=np.inf)[::-1]]
    order = np.lexsort([*keys, table["success"].to_numpy(dtype=bool)])[:_WORST]
    worst = []
    for row_figures, (_, row) in zip(figures.T[order], table.iloc[order].iterrows(), strict=True):
        metrics = {}
        for name, figure in zip(_FINISHED_WORSE, row_figures, strict=True):
            metrics[name] = None if np.isnan(figure) else float(figure)
        worst.append(
            {
                "run": int(row["run"]),
                "outcome": row["outcome"],
                "cause": row["cause"] or "",
                **metrics,
                "repeat": f"uvms-ocp campaign {shlex.quote(str(folder))} --rerun {row['run']}",
            }
        )
    return worst
