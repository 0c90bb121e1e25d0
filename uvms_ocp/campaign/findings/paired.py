"""Two campaigns side by side; where they drew the same, run by run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.campaign.findings.campaign_report import judged_table
from uvms_ocp.campaign.findings.rates import Rate
from uvms_ocp.campaign.findings.spread import merit_values
from uvms_ocp.campaign.findings.verdict import Bound
from uvms_ocp.campaign.runs.merits import MERITS
from uvms_ocp.campaign.store.identity import read_identity

_RESAMPLED = 2000
_MOST = 20  # runs that are named


@checked
def compare_campaigns(first: Path, second: Path, success: Sequence[Bound] = ()) -> dict[str, Any]:
    """Success and figures of both campaigns, as JSON values.

    Of campaigns with the same seed, sampler, number of runs and parameters runs of the same number are pairs: then only those
    count in which one succeeded and the other did not (McNemar's exact test), and differences have intervals by the bootstrap.
    success: bounds as for `campaign_report`. Raises `InvalidInput` where there is no campaign or no finished run.
    """
    folders, tables = (first, second), [judged_table(folder, success) for folder in (first, second)]
    rates = [Rate(number=int(table["success"].sum()), runs=len(table)) for table in tables]
    told: dict[str, Any] = {
        "campaigns": [str(folder) for folder in folders],
        "success": [rate.to_dict() for rate in rates],
        "success_text": [str(rate) for rate in rates],
        "paired": _same_draws(*folders),
    }
    if told["paired"]:
        a, b = (table.set_index("run") for table in tables)
        common = a.index.intersection(b.index)
        told |= _pairs(a.loc[common].reset_index(), b.loc[common].reset_index())
    return told


def _same_draws(first: Path, second: Path) -> bool:
    a, b = (read_identity(folder) for folder in (first, second))
    return all(getattr(a, name) == getattr(b, name) for name in ("runs", "seed", "sampler", "parameters"))


def _pairs(a: Any, b: Any) -> dict[str, Any]:
    from scipy.stats import binomtest

    before, after = (table["success"].to_numpy(dtype=bool) for table in (a, b))
    lost, won = (np.flatnonzero(which) for which in (before & ~after, ~before & after))
    discordant = len(lost) + len(won)
    return {
        "pairs": len(a),
        "both_succeed": int((before & after).sum()),
        "both_fail": int((~before & ~after).sum()),
        "first_only": len(lost),
        "second_only": len(won),
        "first_only_runs": a["run"].to_numpy()[lost[:_MOST]].tolist(),
        "second_only_runs": a["run"].to_numpy()[won[:_MOST]].tolist(),
        "p_value": float(binomtest(len(won), discordant).pvalue) if discordant else 1.0,
        "figures": [row for name in MERITS if (row := _difference(name, a, b))],
    }


def _difference(name: str, a: Any, b: Any) -> dict[str, Any] | None:
    """Second less first, of the runs in which both have the figure."""
    change = merit_values(b, name) - merit_values(a, name)
    known = change[np.isfinite(change)]
    if not known.size:
        return None
    rng = np.random.default_rng(0)
    means = [known[rng.integers(0, known.size, known.size)].mean() for _ in range(_RESAMPLED)]
    lower, upper = np.quantile(means, [0.025, 0.975])
    own = {"figure": name, "pairs": int(known.size), "mean_change": float(known.mean())}
    return {**own, "lower": float(lower), "upper": float(upper), "median_change": float(np.median(known))}
