"""Analyse the runs of a campaign: rates with intervals, causes of failure, sensitivities."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from uvms_ocp.campaign import distributions, jobs
from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, optional_module, plain_line
from uvms_ocp.record.tables import CAMPAIGN_EXTRA
from uvms_ocp.types import AtLeastOne, Count

# A share of runs with its interval.

_FEW = 10  # of either kind, below which Wilson's normal approximation is left


@checked_dataclass()
class Rate:
    """Rate of an event with its confidence interval. Raises `InvalidInput` for more cases than runs."""

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
        return "Clopper-Pearson" if min(self.number, self.runs - self.number) < _FEW else "Wilson"

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


# Why runs failed: causes that differ in their numbers alone are one, told with the numbers of one run.

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
_MOST, _LONGEST = 20, 300  # causes, letters of one


def cause_table(table: Any) -> list[dict[str, Any]]:
    """One row per outcome and kind of cause of the runs that failed, the most frequent first, each as its first run has it."""
    failed = table[~table["success"].astype(bool)]
    shortened = failed["cause"].fillna("").map(_shortened).astype(str)  # no runs keep the type of the column
    kind = shortened.str.replace(_NUMBER, "#", regex=True)  # so that causes that differ in their numbers alone are equal
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
    return [{"outcome": name, **Rate(number=int(n), runs=len(table)).to_dict()} for name, n in counts.items()]


def _shortened(text: str) -> str:
    """Keep the first two statements of a cause."""
    return plain_line("; ".join(text.partition("; last alarm")[0].split("; ")[:2]), _LONGEST)


# Which parameters matter: rank correlation as a first look, PAWN from any sample, Sobol' indices from their own design.

_FEWEST = 30  # runs with a value, below which nothing is said
SILENT = f"nothing is told of fewer than {_FEWEST} runs with a figure, of figures that are all alike, or where nothing is varied"
_SLICES = 10
_DUMMY = "(of no effect)"


def sensitivity_table(table: Any, parameters: Sequence[str], *, indices: bool) -> list[dict[str, Any]]:
    """One row per figure and parameter; indices: whether the runs are of the design that Sobol' indices need.

    rank_correlation [-1, 1] is Spearman's with its p-value. pawn [0, 1] is the median over slices of the distance between the
    distribution of the figure and that where the parameter is known; pawn_floor is that of a number of no effect: what is not
    clearly above it says nothing. s1 and st are the shares of variance that a parameter has alone and with all others.
    Raises `NotInstalled` without SALib.
    """
    if not parameters:
        return []
    rows = []
    for name in ("success", *jobs.metrics_among(table)):
        y = table[name].to_numpy(dtype=float, na_value=np.nan) if name == "success" else jobs.metric_values(table, name)
        known = np.isfinite(y)
        if known.sum() >= _FEWEST and np.ptp(y[known]) > 0.0:
            rows += _of_figure(name, table[list(parameters)].to_numpy(dtype=float), y, parameters, indices)
    return rows


def _of_figure(name: str, X: np.ndarray, y: np.ndarray, parameters: Sequence[str], indices: bool) -> list[dict[str, Any]]:
    known = np.isfinite(y)
    ranks, pawn = _ranks(X[known], y[known]), _pawn(X[known], y[known])
    shares = _sobol(y, len(parameters)) if indices else {}
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

    constant = np.ptp(X, axis=0) == 0.0
    found = [(0.0, 1.0) if constant[k] else spearmanr(X[:, k], y) for k in range(X.shape[1])]
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
    return {"s1": found["S1"], "s1_within": found["S1_conf"], "st": found["ST"], "st_within": found["ST_conf"]}
