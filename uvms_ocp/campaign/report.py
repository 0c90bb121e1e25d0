"""Report of a campaign, finished or not, by one's own criterion of success: how often runs succeed,
what failures come from, and which runs are the worst.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.campaign import jobs, manifest, run_metrics, store
from uvms_ocp.campaign.sensitivity import SILENT, sensitivity_table
from uvms_ocp.campaign.success_criteria import MetricBound, judged
from uvms_ocp.campaign.success_rate import Rate
from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.report.end_of_run import ENDS

_WORST = 10
"""Rows of the worst runs."""
WORST_FIRST = (
    "failures before successes; among them runs without a tool position error first, then the"
    " largest, then the longest"
)
"""Order of the worst runs, in words."""
_FINISHED_WORSE = ("tool_position_error_m", "duration_s")
"""Columns by which runs are compared that end alike."""
_MISSION_CRITERION = "the mission completed, and its goals truly reached"
_MAX_CAUSES = 20
"""Rows of the causes of failures."""
_LONGEST_CAUSE = 300
"""Letters of a cause."""
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")


@checked
def campaign_report(folder: Path | str, success: Sequence[MetricBound] = ()) -> dict[str, Any]:
    """Report on the finished runs of the campaign in a folder, as JSON values.

    success: bounds that a run has to keep, in place of what the mission itself counts. Raises
    `InvalidInput` where there is no campaign, or none of its runs is finished.
    """
    folder = Path(folder)
    return report_of(folder, table_with_success(folder, success), success)


def report_of(folder: Path, table: Any, success: Sequence[MetricBound]) -> dict[str, Any]:
    """Report on the finished runs of a campaign as `campaign_report` does; table: of
    `table_with_success`.
    """
    identity = manifest.read_manifest(folder)
    rate = Rate(number=int(table["success"].sum()), runs=len(table))
    criterion = [str(bound) for bound in success] or [_MISSION_CRITERION]
    has_indices = identity.sampler == "indices" and len(table) == identity.runs
    return {
        "campaign": identity.name,
        "folder": str(folder),
        "runs": identity.runs,
        "finished": len(table),
        "package": identity.package,
        "sampler": identity.sampler,
        "seed": identity.seed,
        "parameters": identity.parameters,
        "criterion": criterion,
        "success": rate.to_dict(),
        "success_text": str(rate),
        "outcomes": outcome_table(table),
        "causes": cause_table(table),
        "distributions": run_metrics.distribution_table(table),
        "sensitivity": sensitivity_table(table, list(identity.parameters), indices=has_indices),
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


def outcome_table(table: Any) -> list[dict[str, Any]]:
    """Return one row per outcome of all runs, the most frequent first."""
    rows = []
    for name, number in table["outcome"].value_counts().items():
        rows.append({"outcome": name, **Rate(number=int(number), runs=len(table)).to_dict()})
    return rows


def cause_table(table: Any) -> list[dict[str, Any]]:
    """Return one row per outcome and kind of cause of the runs that failed, the most frequent
    first, each as its first run has it. Causes that differ in their numbers alone are of one kind.
    """
    failed = table[~table["success"].astype(bool)]
    # Without runs the column has to be made one of texts.
    shortened = failed["cause"].fillna("").map(_shortened).astype(str)
    kind = shortened.str.replace(_NUMBER, "#", regex=True)
    groups = failed.assign(shortened=shortened, kind=kind).groupby(["outcome", "kind"], sort=False)
    rows = []
    for (outcome, _), runs in groups:
        rows.append(
            {
                "outcome": outcome,
                "cause": runs["shortened"].iloc[0],
                **Rate(number=len(runs), runs=len(table)).to_dict(),
                "run": int(runs["run"].iloc[0]),
            }
        )
    return sorted(rows, key=lambda row: -row["number"])[:_MAX_CAUSES]


def _shortened(text: str) -> str:
    """Keep the first two statements of a cause."""
    cause, _, _ = text.partition("; last alarm")
    return plain_line("; ".join(cause.split("; ")[:2]), _LONGEST_CAUSE)


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
