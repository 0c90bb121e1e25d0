"""A calibration to look at: measured against predicted, what is left, and how sure its numbers are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.identification.answers.numbers import INTERVAL
from uvms_ocp.identification.calibration.fitting import Calibration, Comparison
from uvms_ocp.identification.parameters.vehicle_quantities import AXES
from uvms_ocp.viz.series import labelled
from uvms_ocp.viz.style import (
    BLACK,
    BLUE,
    FADED,
    VERMILLION,
    WIDTH,
    RecordFigure,
    heading_legend,
    save_figure,
    shown,
    stacked,
    styled,
)

_PARTS = ("linear", "angular")
"""Of the velocity, as the sensors measure them."""
_WIDEST = 100.0  # [%] of an interval that is drawn: beyond it nothing is known


def write_identification_figures(one: Calibration, folder: Path) -> list[Path]:
    """As PNG into the folder: two for each recording, one for all numbers."""
    paths = [save_figure(figure_intervals(one), folder / "intervals.png")]
    kinds: dict[str, Callable[[Comparison], Figure]] = {"predicted": figure_predicted, "residuals": figure_residuals}
    for k, each in enumerate(one.comparisons):
        paths += [save_figure(draw(each), folder / f"{kind}_{k}.png") for kind, draw in kinds.items()]
    return paths


@styled
def figure_predicted(one: Comparison) -> Figure:
    """Velocities, measured and predicted from commands alone."""
    figure, axes = _by_axis(f"{shown(one.name)}: measured and predicted")
    after, before = one.calibrated, one.before
    for axis, sensor, column in axes:
        axis.plot(after.t[sensor], after.seen[sensor][:, column], color=BLACK, lw=0.7, label="measured")
        axis.plot(before.t[sensor], before.rows[sensor][:, column], color=FADED, lw=0.9, label="before")
        axis.plot(after.t[sensor], after.rows[sensor][:, column], color=VERMILLION, lw=0.9, label="calibrated")
    heading_legend(figure, figure.axes[0].get_lines())
    return figure


@styled
def figure_residuals(one: Comparison) -> Figure:
    """Predicted less measured."""
    figure, axes = _by_axis(f"{shown(one.name)}: predicted less measured")
    predicted = one.calibrated
    for axis, sensor, column in axes:
        left = predicted.rows[sensor][:, column] - predicted.seen[sensor][:, column]
        axis.plot(predicted.t[sensor], left, color=BLUE, lw=0.7)
    return figure


def _by_axis(title: str) -> tuple[Figure, list[tuple[Axes, int, int]]]:
    """A panel for each of `AXES`, with the sensor that sees it and its column there."""
    figure, axes = stacked(len(AXES), 1.1, title)
    panels = [(axis, *divmod(i, 3)) for i, axis in enumerate(axes)]
    for name, (axis, sensor, _) in zip(AXES, panels, strict=True):
        axis.set_ylabel(labelled(name, "v", _PARTS[sensor]))
    return figure, panels


@styled
def figure_intervals(one: Calibration) -> Figure:
    """Intervals of 95 %, relative to the sizes of numbers; those that are not determined are faded."""
    told = one.numbers
    figure = RecordFigure(figsize=(WIDTH, 0.17 * len(told) + 1.0))
    figure.suptitle("Half widths of 95 % intervals", fontsize=10, fontweight="bold", x=0.01, ha="left")
    axis = figure.subplots()
    widths = [min(100.0 * INTERVAL * each.sigma / max(each.size, 1e-300), _WIDEST) for each in told]
    axis.barh(np.arange(len(told)), widths, color=[BLUE if each.determined else FADED for each in told])
    axis.set_yticks(np.arange(len(told)), [shown(each.name) for each in told])
    axis.set_ylim(len(told) - 0.4, -0.6)
    axis.set_xlabel(f"[%] of the number's size, cut off at {_WIDEST:.0f}; grey: not determined")
    return figure
