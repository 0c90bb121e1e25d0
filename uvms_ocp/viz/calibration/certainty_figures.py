"""What speaks for and against a calibration: residuals and whether they are white, profiles, recordings that were left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.identification.answers.left_out import LeftOut
from uvms_ocp.identification.answers.numbers import INTERVAL
from uvms_ocp.identification.answers.profiles import Profile
from uvms_ocp.identification.answers.scores import SCORED, errors
from uvms_ocp.identification.answers.whiteness import CHANNELS, LEAST_TOLD, Whiteness
from uvms_ocp.identification.calibration.fitting import Comparison
from uvms_ocp.viz.series import labelled
from uvms_ocp.viz.style import BLUE, FADED, GREEN, ORANGE, THRESHOLD, VERMILLION, WIDTH, RecordFigure, shown, styled

_UNITS = ("m/s", "rad/s", "-")
"""Of what the three sensors show."""
_COLUMNS = 4  # of profiles beside each other
_PREDICTORS = (BLUE, FADED, ORANGE, GREEN)
_ROOM = 1.15  # [-] of the tallest bar but those of the vehicle before, which may be anywhere


@styled
def figure_residuals(one: Comparison) -> Figure:
    """What the search has left, simulated less measured, and how it is correlated."""
    told = {each.channel: each for each in one.whiteness}
    figure = RecordFigure(figsize=(WIDTH, 0.95 * len(CHANNELS) + 0.6))
    _title(figure, f"{shown(one.name)}: what the search has left, and its autocorrelation")
    grid = figure.subplots(len(CHANNELS), 2, sharex="col", squeeze=False, gridspec_kw={"width_ratios": (3, 1)})
    for i, (name, (over_time, over_lags)) in enumerate(zip(CHANNELS, grid, strict=True)):
        sensor, column = divmod(i, 3)
        left = one.left.rows[sensor][:, column] - one.left.seen[sensor][:, column]
        over_time.plot(one.left.t[sensor], left, color=BLUE, lw=0.6)
        over_time.set_ylabel(f"{name}\n[{_UNITS[sensor]}]")
        if name in told:
            _correlation(over_lags, told[name])
    grid[-1, 0].set_xlabel(labelled("time", "t"))
    grid[-1, 1].set_xlabel("lag [s]")
    return figure


def _correlation(axis: Axes, one: Whiteness) -> None:
    lags = one.interval * np.arange(len(one.correlation))
    axis.axhspan(-one.bound, one.bound, color=FADED, alpha=0.5, lw=0)
    axis.vlines(lags[1:], 0.0, one.correlation[1:], color=BLUE, lw=1.2)
    axis.set_ylim(-1.05, 1.05)
    color = THRESHOLD if one.white else VERMILLION
    p = f"p = {one.p:.2g}" if one.p > LEAST_TOLD else f"p < {LEAST_TOLD:g}"
    axis.set_title(f"{p}, {one.together:.2g} alike", fontsize=7, color=color, pad=2)


@styled
def figure_profiles(told: Sequence[Profile]) -> Figure:
    """Roots of the deviance with each number held, and the straight line that standard errors take for them."""
    n_rows = -(-len(told) // _COLUMNS)
    figure = RecordFigure(figsize=(WIDTH, 1.5 * n_rows + 0.7))
    _title(figure, "Root of the deviance, a number held (grey: by standard errors)")
    axes = figure.subplots(n_rows, _COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    for axis, one in zip(axes, told, strict=False):
        _profile(axis, one)
    for axis in axes[len(told) :]:
        axis.set_axis_off()
    figure.supxlabel("standard errors from where the search has ended", fontsize=8)
    return figure


def _profile(axis: Axes, one: Profile) -> None:
    number, color = one.number, VERMILLION if one.differs else BLUE
    for end in (-INTERVAL, INTERVAL):
        axis.axhline(end, color=THRESHOLD, lw=0.7, ls=(0, (5, 3)))
    straight, found = ((np.array(ends) - number.value) / number.sigma for ends in (number.interval, one.values))
    axis.plot(straight, (-INTERVAL, INTERVAL), color=FADED, lw=2.5)
    axis.plot(found, one.roots, color=color, lw=1.0, marker="o", ms=3)
    axis.set_title(f"{shown(number.name)}\n{number.value:.4g} ± {number.sigma:.2g}", fontsize=7)


@styled
def figure_left_out(found: Sequence[LeftOut]) -> Figure:
    """Errors of predictions of recordings that were left out, medians over them, beside those that know less."""
    asked = sorted({each.asked for one in found for each in one.horizons})
    figure = RecordFigure(figsize=(WIDTH, 4.6))
    _title(figure, "Recordings that were left out: errors by horizon; taller bars are cut")
    axes = figure.subplots(2, 4).ravel()
    for i, (axis, name) in enumerate(zip(axes, SCORED, strict=False)):
        _bars(axis, found, asked, i)
        axis.set_title(name)
        axis.set_ylabel("[deg]" if i == len(SCORED) - 1 else f"[{_UNITS[i // 3]}]")
    axes[-1].set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    axes[-1].legend(handles, labels, loc="center", frameon=False)
    return figure


def _bars(axis: Axes, found: Sequence[LeftOut], asked: Sequence[float], i: int) -> None:
    names = list(next((each.by for one in found for each in one.horizons), ()))
    if not names:
        return
    heights = np.array([[_median(found, horizon, name, i) for horizon in asked] for name in names])
    for k, name in enumerate(names):
        axis.bar(np.arange(len(asked)) + 0.2 * (k - 1.5), heights[k], 0.2, color=_PREDICTORS[k], label=name)
    axis.set_ylim(0.0, _ROOM * max(heights[0].max(), heights[2:].max()))
    axis.set_xticks(np.arange(len(asked)), [f"{horizon:g} s" for horizon in asked])


def _median(found: Sequence[LeftOut], asked: float, name: str, i: int) -> float:
    chosen = [each for one in found for each in one.horizons if each.asked == asked]
    return float(np.median([errors(each.by[name])[i] for each in chosen]))


def _title(figure: RecordFigure, text: str) -> None:
    figure.suptitle(text, fontsize=10, fontweight="bold", x=0.01, ha="left")
