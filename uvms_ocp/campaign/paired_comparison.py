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

_RESAMPLED = 2000
_MOST_NAMED = 20  # runs that are named
_DRAWN = ("runs", "seed", "sampler", "parameters")  # of campaigns that draw the same


@checked
def compare_campaigns(
    first: Path | str, second: Path | str, success: Sequence[MetricBound] = ()
) -> dict[str, Any]:
    """Success and figures of both campaigns, as JSON values.

    Of campaigns with the same seed, sampler, number of runs and parameters runs of the same number
    are pairs: then only those count in which one succeeded and the other did not (McNemar's exact
    test), and differences have intervals by the bootstrap. success: bounds as for
    `campaign_report`. Raises `InvalidInput` where there is no campaign or no finished run.
    """
    folders = (Path(first), Path(second))
    tables = [table_with_success(folder, success) for folder in folders]
    rates = [Rate(number=int(table["success"].sum()), runs=len(table)) for table in tables]
    first_manifest, second_manifest = map(manifest.read_manifest, folders)
    comparison: dict[str, Any] = {
        "campaigns": [str(folder) for folder in folders],
        "success": [rate.to_dict() for rate in rates],
        "success_text": [str(rate) for rate in rates],
        "paired": all(
            getattr(first_manifest, name) == getattr(second_manifest, name) for name in _DRAWN
        ),
    }
    if comparison["paired"]:
        a, b = (table.set_index("run") for table in tables)
        common = a.index.intersection(b.index)
        comparison |= _pairs(a.loc[common].reset_index(), b.loc[common].reset_index())
    return comparison


def _pairs(a: Any, b: Any) -> dict[str, Any]:
    from scipy.stats import binomtest

    first_success, second_success = (table["success"].to_numpy(dtype=bool) for table in (a, b))
    lost, won = (
        np.flatnonzero(is_discordant)
        for is_discordant in (first_success & ~second_success, ~first_success & second_success)
    )
    discordant = len(lost) + len(won)
    differences = [_difference(name, a, b) for name in run_metrics.metrics_among(a)]
    return {
        "pairs": len(a),
        "both_succeed": int((first_success & second_success).sum()),
        "both_fail": int((~first_success & ~second_success).sum()),
        "first_only": len(lost),
        "second_only": len(won),
        "first_only_runs": a["run"].to_numpy()[lost[:_MOST_NAMED]].tolist(),
        "second_only_runs": a["run"].to_numpy()[won[:_MOST_NAMED]].tolist(),
        "p_value": float(binomtest(len(won), discordant).pvalue) if discordant else 1.0,
        "figures": [row for row in differences if row],
    }


def _difference(name: str, a: Any, b: Any) -> dict[str, Any] | None:
    """Second less first, of the runs in which both have the figure."""
    change = run_metrics.metric_values(b, name) - run_metrics.metric_values(a, name)
    changes = change[np.isfinite(change)]
    if not changes.size:
        return None
    rng = np.random.default_rng(0)
    means = [changes[rng.integers(0, changes.size, changes.size)].mean() for _ in range(_RESAMPLED)]
    lower, upper = np.quantile(means, [0.025, 0.975])
    summary = {"figure": name, "pairs": int(changes.size), "mean_change": float(changes.mean())}
    return {
        **summary,
        "lower": float(lower),
        "upper": float(upper),
        "median_change": float(np.median(changes)),
    }
