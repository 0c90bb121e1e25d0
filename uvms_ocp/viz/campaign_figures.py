"""Figures of a campaign: success rate and its interval, outcomes, spread of figures of merit, and
what they depend on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from matplotlib.figure import Figure

from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Mask, Shape
from uvms_ocp.viz import layout, style
from uvms_ocp.viz.colours import BLUE, FADED, GREEN, ORANGE, THRESHOLD, VERMILLION
from uvms_ocp.viz.label_text import label_text
from uvms_ocp.viz.line_widths import EDGELESS, PLAIN

_Success = Annotated[Mask, Shape("n")]
_COLUMNS = 3  # of histograms beside each other
_MOST_BARS = 12
_LONGEST_NAME = 60  # letters
_LARGEST = 1e300  # drawn: a spread of twice this is still finite
_CONSTANT = 1e-9
"""Spread over size below which a column is drawn as a constant: 30 bins need more digits than
doubles have.
"""


@style.styled
def figure_rate(
    success: _Success,
    interval: tuple[float, float],
    *,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure:
    """Draw the share of successes over the number of runs; success (n,) of all runs in their order,
    interval of the whole.
    """
    figure = layout.titled(2.4, "Success rate, and its 95 % interval at the end", fig, width)
    axis = figure.subplots()
    n = np.arange(1, len(success) + 1)
    axis.axhspan(100 * interval[0], 100 * interval[1], color=BLUE, alpha=0.15, lw=EDGELESS)
    axis.plot(n, 100 * np.cumsum(success) / n, color=BLUE)
    axis.set(xlabel="runs", ylabel="successes [%]", xlim=(1, max(2, len(success))))
    return figure


@style.styled
def figure_outcomes(outcomes: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw the shares of all outcomes with their intervals; rows as the report has them."""
    rows = list(outcomes)[:_MOST_BARS][::-1]
    figure = style.RecordFigure(figsize=(layout.WIDTH, 0.7 + 0.28 * len(rows)))
    axis = figure.subplots()
    labels = []
    colors = []
    errors = []  # [%] below and above each share
    for row in rows:
        labels.append(label_text(row["outcome"], _LONGEST_NAME))
        colors.append(GREEN if row["outcome"] == "completed" else VERMILLION)
        errors.append((100 * (row["share"] - row["lower"]), 100 * (row["upper"] - row["share"])))
    shares = np.array([100 * row["share"] for row in rows])
    axis.barh(labels, shares, xerr=np.maximum(np.array(errors).T, 0.0), color=colors)
    axis.set(xlabel="share of runs [%], with 95 % intervals", xlim=(0, 100))
    return figure


def _bin_edges(values: np.ndarray) -> np.ndarray:
    """Divide the range of finite values (n,) into 30 bins that differ in double precision, also
    where all are one number.
    """
    lower = float(values.min())
    upper = float(values.max())
    size = max(abs(lower), abs(upper))
    if size > 1e-290 and upper - lower > _CONSTANT * size:
        return np.histogram_bin_edges(values, bins=30)
    half = max(0.5, 1e-3 * size)
    return np.linspace(lower - half, upper + half, 31)


@style.styled
def figure_spread(
    values: Mapping[str, np.ndarray],
    success: _Success,
    *,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure:
    """Draw histograms of figures of merit, values (n,) [unit in the name] by name, NaN where a run
    has none; success (n,).

    Values beyond 1e300 are left out as infinite ones are: their spread is no number.
    Raises `InvalidInput` for columns of another length.
    """
    for name, column in values.items():
        if column.shape != success.shape:
            shapes = f"success has shape {success.shape}, values[{name!r}] {column.shape}"
            raise InvalidInput(f"{shapes}; give one of each per run")
    names = [name for name, column in values.items() if (np.abs(column) <= _LARGEST).any()]
    figure = layout.titled(1.7, "", fig, width)
    n_columns = _COLUMNS if layout.inches(figure) > layout.NARROW else 1
    n_rows = max(1, -(-len(names) // n_columns))
    if fig is None:
        figure.set_figheight(1.7 * n_rows)
    axes = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
    for axis, name in zip(axes, names, strict=False):
        is_drawn = np.abs(values[name]) <= _LARGEST
        edges = _bin_edges(values[name][is_drawn])
        parts = [values[name][is_drawn & success], values[name][is_drawn & ~success]]
        axis.hist(
            parts,
            bins=edges,
            stacked=True,
            color=[GREEN, VERMILLION],
            label=["success", "failure"],
        )
        axis.set_xlabel(label_text(name))
    for axis in axes[len(names) :]:
        axis.set_axis_off()
    axes[0].legend()
    return figure


@style.styled
def figure_sensitivity(rows: Sequence[Mapping[str, Any]], figure_name: str) -> Figure:
    """Draw PAWN indices of one figure by parameter, beside what a number of no effect would have;
    rows as the report has them.
    """
    figure_rows = [row for row in rows if row["figure"] == figure_name]
    bars = sorted(figure_rows, key=lambda row: row["pawn"])[-_MOST_BARS:]
    figure = style.RecordFigure(figsize=(layout.WIDTH, 0.8 + 0.28 * len(bars)))
    axis = figure.subplots()
    colors = []
    for row in bars:
        has_effect = row["pawn"] > row["pawn_floor"]
        colors.append(ORANGE if has_effect else FADED)
    axis.barh(
        [label_text(row["parameter"], _LONGEST_NAME) for row in bars],
        [row["pawn"] for row in bars],
        color=colors,
    )
    if bars:
        axis.axvline(bars[0]["pawn_floor"], color=THRESHOLD, lw=PLAIN, ls=(0, (5, 3)))
    axis.set_xlabel(f"PAWN index of {figure_name} [-]; left of the dashed line nothing is told")
    return figure
