"""Which parameters matter: rank correlation as a first look, PAWN from any sample, Sobol' indices
from their own design.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from uvms_ocp.campaign import run_metrics
from uvms_ocp.campaign.sampling_design import problem_of
from uvms_ocp.errors import optional_module
from uvms_ocp.record.table_files import CAMPAIGN_EXTRA

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
    """Return one row per figure and parameter; indices: whether the runs are of the design that
    Sobol' indices need.

    rank_correlation [-1, 1] is Spearman's with its p-value. pawn [0, 1] is the median over slices
    of the distance between the distribution of the figure and that where the parameter is known;
    pawn_floor is that of a number of no effect: what is not clearly above it says nothing. s1 and
    st are the shares of variance that a parameter has alone and with all others. Raises
    `NotInstalled` without SALib.
    """
    if not parameters:
        return []
    rows = []
    for name in ("success", *run_metrics.metrics_among(table)):
        if name == "success":
            y = table[name].to_numpy(dtype=float, na_value=np.nan)
        else:
            y = run_metrics.metric_values(table, name)
        is_finite = np.isfinite(y)
        if is_finite.sum() >= _FEWEST and np.ptp(y[is_finite]) > 0.0:
            rows += _of_figure(
                name, table[list(parameters)].to_numpy(dtype=float), y, parameters, indices
            )
    return rows


def _of_figure(
    name: str, X: np.ndarray, y: np.ndarray, parameters: Sequence[str], indices: bool
) -> list[dict[str, Any]]:
    is_finite = np.isfinite(y)
    ranks = _ranks(X[is_finite], y[is_finite])
    pawn = _pawn(X[is_finite], y[is_finite])
    if indices:
        shares = _sobol(y, len(parameters))
    else:
        shares = {}
    rows = []
    for k, parameter in enumerate(parameters):
        row = {
            "figure": name,
            "parameter": parameter,
            "rank_correlation": ranks[k][0],
            "p_value": ranks[k][1],
            "pawn": pawn[k],
            "pawn_floor": pawn[-1],
        }
        row |= {key: float(values[k]) for key, values in shares.items()}
        rows.append(row)
    return rows


def _ranks(X: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
    from scipy.stats import spearmanr

    ranks = []
    for x in X.T:
        if np.ptp(x) == 0.0:
            ranks.append((0.0, 1.0))
            continue
        rho, p_value = spearmanr(x, y)
        ranks.append((float(rho), float(p_value)))
    return ranks


def _pawn(X: np.ndarray, y: np.ndarray) -> list[float]:
    """Compute the PAWN sensitivity index of every column, and of one more that has no effect."""
    pawn = optional_module("SALib.analyze.pawn", "sensitivities", CAMPAIGN_EXTRA)
    dummy = np.random.default_rng(0).permutation(len(y))[:, None] / len(y)
    problem = problem_of([*(f"x{k}" for k in range(X.shape[1])), _DUMMY])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # slices of a parameter with few values are empty
        result = pawn.analyze(problem, np.hstack([X, dummy]), y, S=_SLICES, seed=0)
    return [float(value) for value in result["median"]]


def _sobol(y: np.ndarray, n: int) -> dict[str, np.ndarray]:
    """Compute Sobol' indices from the complete blocks of the design; empty where they are too few."""
    sobol = optional_module("SALib.analyze.sobol", "sensitivities", CAMPAIGN_EXTRA)
    blocks = y[: len(y) // (n + 2) * (n + 2)].reshape(-1, n + 2)
    complete_blocks = blocks[np.isfinite(blocks).all(axis=1)]
    if len(complete_blocks) < _FEWEST:
        return {}
    problem = problem_of([f"x{k}" for k in range(n)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = sobol.analyze(problem, complete_blocks.ravel(), calc_second_order=False, seed=0)
    return {
        "s1": result["S1"],
        "s1_within": result["S1_conf"],
        "st": result["ST"],
        "st_within": result["ST_conf"],
    }
