"""Report of a campaign, finished or not, by one's own criterion of success, and two campaigns side
by side.
"""

from __future__ import annotations

import re
import shlex
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.campaign import distributions, jobs, store
from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput, NameNotFound, optional_module, plain_line
from uvms_ocp.record.tables import CAMPAIGN_EXTRA
from uvms_ocp.report.summary import ENDS
from uvms_ocp.types import AtLeastOne, Count

# A share of runs with its interval.

_FEW = 10  # of either kind, below which Wilson's normal approximation is left


@checked_dataclass()
class Rate:
    """Rate of an event with its confidence interval. Raises `InvalidInput` for more cases than
    runs.
    """

    number: Count
    """Number of runs with the event."""
    runs: AtLeastOne

    def __post_init__(self) -> None:
        if self.number > self.runs:
            raise InvalidInput(f"{self.number} of {self.runs} runs; give at most all of them")

    @property
    def share(self) -> float:
        return self.number / self.runs

    @property
    def method(self) -> str:
        """Wilson's interval, or the exact one of Clopper and Pearson where either kind is rare."""
        if min(self.number, self.runs - self.number) < _FEW:
            return "Clopper-Pearson"
        return "Wilson"

    @property
    def interval(self) -> tuple[float, float]:
        """(lower, upper) that holds the true share in 95 % of all campaigns."""
        from scipy.stats import binomtest

        kind: Any = "exact" if self.method == "Clopper-Pearson" else "wilson"
        found = binomtest(self.number, self.runs).proportion_ci(0.95, method=kind)
        return float(found.low), float(found.high)

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        lower, upper = self.interval
        own = {"number": self.number, "runs": self.runs, "share": self.share}
        return {**own, "lower": lower, "upper": upper, "method": self.method}

    def __str__(self) -> str:
        lower, upper = self.interval
        shown = f"{100 * self.share:.2f} % ({self.number} of {self.runs})"
        return f"{shown}, 95 % interval {100 * lower:.2f} to {100 * upper:.2f} % ({self.method})"


# Group the failures of runs by cause: those that differ only in their numbers are one, shown with
# the numbers of one run.

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


# Which parameters matter: rank correlation as a first look, PAWN from any sample, Sobol' indices
# from their own design.

_FEWEST = 30  # runs with a value, below which nothing is said
SILENT = (
    f"nothing is told of fewer than {_FEWEST} runs with a figure, of figures that are all alike, or"
    " where nothing is varied"
)
_SLICES = 10
_DUMMY = "(of no effect)"


def sensitivity_table(
    table: Any, parameters: Sequence[str], *, indices: bool
) -> list[dict[str, Any]]:
    """One row per figure and parameter; indices: whether the runs are of the design that Sobol'
    indices need.

    rank_correlation [-1, 1] is Spearman's with its p-value. pawn [0, 1] is the median over slices
    of the distance between the distribution of the figure and that where the parameter is known;
    pawn_floor is that of a number of no effect: what is not clearly above it says nothing. s1 and
    st are the shares of variance that a parameter has alone and with all others. Raises
    `NotInstalled` without SALib.
    """
    if not parameters:
        return []
    rows = []
    for name in ("success", *jobs.metrics_among(table)):
        if name == "success":
            y = table[name].to_numpy(dtype=float, na_value=np.nan)
        else:
            y = jobs.metric_values(table, name)
        known = np.isfinite(y)
        if known.sum() >= _FEWEST and np.ptp(y[known]) > 0.0:
            rows += _of_figure(
                name, table[list(parameters)].to_numpy(dtype=float), y, parameters, indices
            )
    return rows


def _of_figure(
    name: str, X: np.ndarray, y: np.ndarray, parameters: Sequence[str], indices: bool
) -> list[dict[str, Any]]:
    known = np.isfinite(y)
    ranks = _ranks(X[known], y[known])
    pawn = _pawn(X[known], y[known])
    if indices:
        shares = _sobol(y, len(parameters))
    else:
        shares = {}
    return [
        {
            "figure": name,
            "parameter": parameter,
            "rank_correlation": ranks[k][0],
            "p_value": ranks[k][1],
            "pawn": pawn[k],
            "pawn_floor": pawn[-1],
            **{key: float(values[k]) for key, values in shares.items()},
        }
        for k, parameter in enumerate(parameters)
    ]


def _ranks(X: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
    from scipy.stats import spearmanr

    found = [(0.0, 1.0) if np.ptp(x) == 0.0 else spearmanr(x, y) for x in X.T]
    return [(float(rho), float(p)) for rho, p in found]


def _pawn(X: np.ndarray, y: np.ndarray) -> list[float]:
    """PAWN sensitivity index of every column, and of one more that has no effect."""
    pawn = optional_module("SALib.analyze.pawn", "sensitivities", CAMPAIGN_EXTRA)
    dummy = np.random.default_rng(0).permutation(len(y))[:, None] / len(y)
    problem = distributions.problem_of([*(f"x{k}" for k in range(X.shape[1])), _DUMMY])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # slices of a parameter with few values are empty
        found = pawn.analyze(problem, np.hstack([X, dummy]), y, S=_SLICES, seed=0)
    return [float(value) for value in found["median"]]


def _sobol(y: np.ndarray, n: int) -> dict[str, np.ndarray]:
    """Sobol' indices from the complete blocks of the design; empty where they are too few."""
    sobol = optional_module("SALib.analyze.sobol", "sensitivities", CAMPAIGN_EXTRA)
    blocks = y[: len(y) // (n + 2) * (n + 2)].reshape(-1, n + 2)
    whole = blocks[np.isfinite(blocks).all(axis=1)]
    if len(whole) < _FEWEST:
        return {}
    problem = distributions.problem_of([f"x{k}" for k in range(n)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = sobol.analyze(problem, whole.ravel(), calc_second_order=False, seed=0)
    return {
        "s1": found["S1"],
        "s1_within": found["S1_conf"],
        "st": found["ST"],
        "st_within": found["ST_conf"],
    }


# Which runs succeeded: those that the mission counts, or those that finished within limits of one's
# own.


@dataclass(frozen=True, kw_only=True, slots=True)
class MetricBound:
    """A figure of merit that must stay on one side of a number."""

    merit: str
    sign: str
    """< or >."""
    limit: float
    """[unit of the merit]"""

    def kept(self, table: Any) -> np.ndarray:
        """(n,) whether each run of a table keeps it; one without the figure does not."""
        values = jobs.metric_values(table, self.merit)
        return np.asarray(values < self.limit if self.sign == "<" else values > self.limit)

    def __str__(self) -> str:
        return f"{self.merit} {self.sign} {self.limit:g}"


def parse_bounds(texts: Sequence[str]) -> tuple[MetricBound, ...]:
    """Parse texts such as ``tool_position_error_m<0.01``. Raises `InvalidInput` or, for an unknown
    figure, `NameNotFound`.
    """
    return tuple(map(_parse, texts))


def _parse(text: str) -> MetricBound:
    found = re.fullmatch(r"\s*(\w+(?:\[[^\]]*\])?)\s*([<>])\s*([-+.\deE]+)\s*", text)
    try:
        if found:
            name, sign, limit = found.groups()
        else:
            name, sign, limit = ("", "", "")
        value = float(limit)
    except ValueError:
        raise InvalidInput(
            f"success {text!r}; give a figure, < or > and a number: tool_position_error_m<0.01"
        ) from None
    if jobs.kind_of(name) not in jobs.METRICS:
        raise NameNotFound("figure of merit", name, jobs.METRICS)
    return MetricBound(merit=name, sign=sign, limit=value)


def judged(table: Any, bounds: Sequence[MetricBound]) -> Any:
    """The table with `success`, and `outcome` of what finished without it, by these bounds; as it
    is without any.

    Raises `NameNotFound` for a bound on what the campaign does not measure.
    """
    if not bounds:
        return table
    unknown = next(
        (bound.merit for bound in bounds if bound.merit not in jobs.metrics_among(table)), None
    )
    if unknown:
        raise NameNotFound("figure of merit", unknown, jobs.metrics_among(table))
    kept = np.array([bound.kept(table) for bound in bounds])
    finished = table["finished"].fillna(False).to_numpy(dtype=bool)
    success = finished & kept.all(axis=0)
    outcome = np.where(success, jobs.COMPLETED, table["outcome"].to_numpy(dtype=object))
    missed = finished & ~success
    outcome[missed] = [_missed(bounds, column) for column in kept[:, missed].T]
    return table.assign(
        success=success, outcome=outcome, cause=np.where(missed, outcome, table["cause"])
    )


def _missed(bounds: Sequence[MetricBound], kept: np.ndarray) -> str:
    return "not " + ", not ".join(
        str(bound) for bound, good in zip(bounds, kept, strict=True) if not good
    )


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
    identity = store.read_manifest(folder)
    rate = Rate(number=int(table["success"].sum()), runs=len(table))
    which = {
        "campaign": identity.name,
        "folder": str(folder),
        "runs": identity.runs,
        "finished": len(table),
    }
    return which | {
        **{name: getattr(identity, name) for name in ("package", "sampler", "seed", "parameters")},
        "criterion": [str(bound) for bound in success]
        or ["the mission completed, and its goals truly reached"],
        "success": rate.to_dict(),
        "success_text": str(rate),
        "outcomes": outcome_table(table),
        "causes": cause_table(table),
        "distributions": jobs.distribution_table(table),
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
    """Ten rows in the order of `WORST_FIRST`, each with the command that repeats it."""
    merits = np.array([jobs.metric_values(table, name) for name in _FINISHED_WORSE]).T
    keys = list(np.nan_to_num(merits, nan=np.inf).T[::-1])
    order = np.lexsort([-key for key in keys] + [table["success"].to_numpy(dtype=bool)])[:_WORST]
    rows = table.iloc[order]
    merits = merits[order]
    return [
        {
            "run": int(row["run"]),
            "outcome": row["outcome"],
            "cause": row["cause"] or "",
            **{
                name: None if np.isnan(metric) else float(metric)
                for name, metric in zip(_FINISHED_WORSE, own, strict=True)
            },
            "repeat": f"uvms-ocp campaign {shlex.quote(str(folder))} --rerun {row['run']}",
        }
        for (_, row), own in zip(rows.iterrows(), merits, strict=True)
    ]


# Two campaigns side by side; where they drew the same, run by run.

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
    one, other = map(store.read_manifest, folders)
    comparison: dict[str, Any] = {
        "campaigns": [str(folder) for folder in folders],
        "success": [rate.to_dict() for rate in rates],
        "success_text": [str(rate) for rate in rates],
        "paired": all(getattr(one, name) == getattr(other, name) for name in _DRAWN),
    }
    if comparison["paired"]:
        a, b = (table.set_index("run") for table in tables)
        common = a.index.intersection(b.index)
        comparison |= _pairs(a.loc[common].reset_index(), b.loc[common].reset_index())
    return comparison


def _pairs(a: Any, b: Any) -> dict[str, Any]:
    from scipy.stats import binomtest

    before, after = (table["success"].to_numpy(dtype=bool) for table in (a, b))
    lost, won = (np.flatnonzero(which) for which in (before & ~after, ~before & after))
    discordant = len(lost) + len(won)
    differences = [_difference(name, a, b) for name in jobs.metrics_among(a)]
    return {
        "pairs": len(a),
        "both_succeed": int((before & after).sum()),
        "both_fail": int((~before & ~after).sum()),
        "first_only": len(lost),
        "second_only": len(won),
        "first_only_runs": a["run"].to_numpy()[lost[:_MOST_NAMED]].tolist(),
        "second_only_runs": a["run"].to_numpy()[won[:_MOST_NAMED]].tolist(),
        "p_value": float(binomtest(len(won), discordant).pvalue) if discordant else 1.0,
        "figures": [row for row in differences if row],
    }


def _difference(name: str, a: Any, b: Any) -> dict[str, Any] | None:
    """Second less first, of the runs in which both have the figure."""
    change = jobs.metric_values(b, name) - jobs.metric_values(a, name)
    known = change[np.isfinite(change)]
    if not known.size:
        return None
    rng = np.random.default_rng(0)
    means = [known[rng.integers(0, known.size, known.size)].mean() for _ in range(_RESAMPLED)]
    lower, upper = np.quantile(means, [0.025, 0.975])
    own = {"figure": name, "pairs": int(known.size), "mean_change": float(known.mean())}
    return {
        **own,
        "lower": float(lower),
        "upper": float(upper),
        "median_change": float(np.median(known)),
    }
