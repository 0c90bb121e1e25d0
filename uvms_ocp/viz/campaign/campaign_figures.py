"""Figures of many runs: how sure the rate is, how runs end, how figures of merit spread, what they depend on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uvms_ocp.viz.style import BLUE, FADED, GREEN, ORANGE, THRESHOLD, VERMILLION, WIDTH, RecordFigure, shown, styled

_COLUMNS = 3
_MOST = 12  # bars
_LONGEST = 60


@styled
def figure_rate(success: np.ndarray, interval: tuple[float, float]) -> Figure:
    """The share of successes over the number of runs; success (n,) [-] of all runs in their order, interval [-] of the whole."""
    figure = RecordFigure(figsize=(WIDTH, 2.4))
    axis = figure.subplots()
    n = np.arange(1, len(success) + 1)
    axis.axhspan(100 * interval[0], 100 * interval[1], color=BLUE, alpha=0.15, lw=0)
    axis.plot(n, 100 * np.cumsum(success) / n, color=BLUE)
    axis.set(xlabel="runs", ylabel="successes [%]", xlim=(1, max(2, len(success))))
    figure.suptitle("Success rate, and its 95 % interval at the end", fontsize=10, fontweight="bold", x=0.01, ha="left")
    return figure


@styled
def figure_outcomes(outcomes: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares of all outcomes with their intervals; rows as the report has them."""
    rows = list(outcomes)[:_MOST][::-1]
    figure = RecordFigure(figsize=(WIDTH, 0.7 + 0.28 * len(rows)))
    axis = figure.subplots()
    shares = np.array([100 * row["share"] for row in rows])
    errors = np.array([[100 * (row["share"] - row["lower"]), 100 * (row["upper"] - row["share"])] for row in rows]).T
    colors = [GREEN if row["outcome"] == "completed" else VERMILLION for row in rows]
    axis.barh([shown(row["outcome"], _LONGEST) for row in rows], shares, xerr=np.maximum(errors, 0.0), color=colors)
    axis.set(xlabel="share of runs [%], with 95 % intervals", xlim=(0, 100))
    return figure


@styled
def figure_spread(values: Mapping[str, np.ndarray], success: np.ndarray) -> Figure:
    """Histograms of figures of merit, values (n,) [unit in the name] by name, NaN where a run has none; success (n,) [-]."""
    names = [name for name, column in values.items() if np.isfinite(column).any()]
    n_rows = max(1, -(-len(names) // _COLUMNS))
    figure = RecordFigure(figsize=(WIDTH, 1.7 * n_rows))
    axes = figure.subplots(n_rows, _COLUMNS, squeeze=False).ravel()
    for axis, name in zip(axes, names, strict=False):
        known = np.isfinite(values[name])
        edges = np.histogram_bin_edges(values[name][known], bins=30)
        parts = [values[name][known & success], values[name][known & ~success]]
        axis.hist(parts, bins=edges, stacked=True, color=[GREEN, VERMILLION], label=["success", "failure"])
        axis.set_xlabel(shown(name))
    for axis in axes[len(names) :]:
        axis.set_axis_off()
    axes[0].legend()
    return figure


@styled
def figure_sensitivity(rows: Sequence[Mapping[str, Any]], figure_name: str) -> Figure:
    """PAWN indices of one figure by parameter, beside what a number of no effect would have; rows as the report has them."""
    own = sorted((row for row in rows if row["figure"] == figure_name), key=lambda row: row["pawn"])[-_MOST:]
    figure = RecordFigure(figsize=(WIDTH, 0.8 + 0.28 * len(own)))
    axis = figure.subplots()
    names = [shown(row["parameter"], _LONGEST) for row in own]
    above = [row["pawn"] > row["pawn_floor"] for row in own]
    axis.barh(names, [row["pawn"] for row in own], color=[ORANGE if told else FADED for told in above])
    if own:
        axis.axvline(own[0]["pawn_floor"], color=THRESHOLD, lw=0.9, ls=(0, (5, 3)))
    axis.set_xlabel(f"PAWN index of {figure_name} [-]; left of the dashed line nothing is told")
    return figure
