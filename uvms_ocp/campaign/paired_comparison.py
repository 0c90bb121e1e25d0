"""Two campaigns side by side; where they drew the same, run by run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.campaign import manifest, run_metrics
from uvms_ocp.campaign.report import table_with_success
from uvms_ocp.campaign.success_criteria import MetricBound
from uvms_ocp.campaign.success_rate import Rate
from uvms_ocp.checks import checked

_N_RESAMPLES = 2000  # of the bootstrap
_MOST_NAMED = 20  # runs that are named
_DESIGN = (
    "runs",
    "seed",
    "sampler",
    "parameters",
)  # fields of a manifest that decide what is drawn


@checked
def compare_campaigns(
    first: Path | str, second: Path | str, success: Sequence[MetricBound] = ()
) -> dict[str, Any]:
    """Compare success and figures of two campaigns; returns JSON values.

    Of campaigns with the same seed, sampler, number of runs and parameters runs of the same number
    are pairs: then only those count in which one succeeded and the other did not (McNemar's exact
    test), and differences have intervals by the bootstrap. success: bounds as for
    `campaign_report`. Raises `InvalidInput` where there is no campaign or no finished run.
    """
    folders = (Path(first), Path(second))
    tables = [table_with_success(folder, success) for folder in folders]
    rates = [Rate(number=int(table["success"].sum()), runs=len(table)) for table in tables]
    first_manifest = manifest.read_manifest(folders[0])
    second_manifest = manifest.read_manifest(folders[1])
    is_paired = all(
        getattr(first_manifest, name) == getattr(second_manifest, name) for name in _DESIGN
    )
    comparison: dict[str, Any] = {
        "campaigns": [str(folder) for folder in folders],
        "success": [rate.to_dict() for rate in rates],
        "success_text": [str(rate) for rate in rates],
        "paired": is_paired,
    }
    if is_paired:
        first_rows = tables[0].set_index("run")
        second_rows = tables[1].set_index("run")
        runs = first_rows.index.intersection(second_rows.index)
        comparison |= _pairs(
            first_rows.loc[runs].reset_index(), second_rows.loc[runs].reset_index()
        )
    return comparison


def _pairs(first: Any, second: Any) -> dict[str, Any]:
    """Compare two tables, row by row of the same run."""
    from scipy.stats import binomtest

    first_success = first["success"].to_numpy(dtype=bool)
    second_success = second["success"].to_numpy(dtype=bool)
    first_only = np.flatnonzero(first_success & ~second_success)
    second_only = np.flatnonzero(~first_success & second_success)
    n_discordant = len(first_only) + len(second_only)
    p_value = 1.0
    if n_discordant:
        p_value = float(binomtest(len(second_only), n_discordant).pvalue)
    runs = first["run"].to_numpy()
    figures = []
    for name in run_metrics.metrics_among(first):
        difference = _difference(name, first, second)
        if difference is not None:
            figures.append(difference)
    return {
        "pairs": len(first),
        "both_succeed": int((first_success & second_success).sum()),
        "both_fail": int((~first_success & ~second_success).sum()),
        "first_only": len(first_only),
        "second_only": len(second_only),
        "first_only_runs": runs[first_only[:_MOST_NAMED]].tolist(),
        "second_only_runs": runs[second_only[:_MOST_NAMED]].tolist(),
        "p_value": p_value,
        "figures": figures,
    }


def _difference(name: str, first: Any, second: Any) -> dict[str, Any] | None:
    """Return the change of a figure from the first campaign to the second, over the runs in which
    both have it.
    """
    change = run_metrics.metric_values(second, name) - run_metrics.metric_values(first, name)
    changes = change[np.isfinite(change)]
    if not changes.size:
        return None
    rng = np.random.default_rng(0)
    means = []
    for _ in range(_N_RESAMPLES):
        resample = changes[rng.integers(0, changes.size, changes.size)]
        means.append(resample.mean())
    lower, upper = np.quantile(means, [0.025, 0.975])
    return {
        "figure": name,
        "pairs": int(changes.size),
        "mean_change": float(changes.mean()),
        "lower": float(lower),
        "upper": float(upper),
        "median_change": float(np.median(changes)),
    }
