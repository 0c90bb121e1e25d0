"""A calibration to look at: measured against predicted, what is left, how sure its numbers are, and what others predict."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.identification.answers.numbers import INTERVAL
from uvms_ocp.identification.answers.predictions import Predicted
from uvms_ocp.identification.calibration.fitting import Calibration, Comparison
from uvms_ocp.identification.parameters.vehicle_quantities import AXES
from uvms_ocp.viz.calibration.certainty_figures import figure_left_out, figure_profiles, figure_residuals
from uvms_ocp.viz.series import labelled
from uvms_ocp.viz.style import (
    BLACK,
    BLUE,
    FADED,
    GREEN,
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
    """As PNG into the folder: two for each recording, one for all numbers, and those of what was asked for besides."""
    paths = [save_figure(figure_intervals(one), folder / "intervals.png")]
    kinds: dict[str, Callable[[Comparison], Figure]] = {"predicted": figure_predicted, "residuals": figure_residuals}
    for k, each in enumerate(one.comparisons):
        paths += [save_figure(draw(each), folder / f"{kind}_{k}.png") for kind, draw in kinds.items()]
    if one.profiles:
        paths.append(save_figure(figure_profiles(one.profiles), folder / "profiles.png"))
    long_enough = [each for each in one.left_out if each.horizons]
    if long_enough:
        paths.append(save_figure(figure_left_out(long_enough), folder / "left_out.png"))
    return paths


@styled
def figure_predicted(one: Comparison) -> Figure:
    """Velocities, roll and pitch, measured and predicted from commands alone."""
    figure, axes = stacked(len(AXES) + 2, 1.0, f"{shown(one.name)}: measured and predicted")
    for i, (axis, name) in enumerate(zip(axes, AXES, strict=False)):
        sensor, column = divmod(i, 3)
        axis.set_ylabel(labelled(name, "v", _PARTS[sensor]))
        _draw(axis, one, sensor, itemgetter((slice(None), column)))
    for axis, name, angle in zip(axes[len(AXES) :], ("roll", "pitch"), (_roll, _pitch), strict=True):
        axis.set_ylabel(f"{name} [deg]")
        _draw(axis, one, 2, angle)
    heading_legend(figure, axes[0].get_lines())
    return figure


def _draw(axis: Axes, one: Comparison, sensor: int, column: Callable[[np.ndarray], np.ndarray]) -> None:
    drawn: tuple[tuple[str, Predicted, str], ...] = (
        ("before", one.before, FADED),
        ("at rest in balance", one.balance, GREEN),
        ("calibrated", one.calibrated, VERMILLION),
    )
    axis.plot(one.calibrated.t[sensor], column(one.calibrated.seen[sensor]), color=BLACK, lw=0.7, label="measured")
    for name, predicted, color in drawn:
        axis.plot(predicted.t[sensor], column(predicted.rows[sensor]), color=color, lw=0.9, label=name)


def _roll(vertical: np.ndarray) -> np.ndarray:
    return np.asarray(np.rad2deg(np.arctan2(vertical[:, 1], vertical[:, 2])))


def _pitch(vertical: np.ndarray) -> np.ndarray:
    return np.asarray(np.rad2deg(-np.arcsin(np.clip(vertical[:, 0], -1.0, 1.0))))


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
