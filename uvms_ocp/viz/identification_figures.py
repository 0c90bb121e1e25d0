"""Figures of an identification: measured against predicted, residuals, whiteness, intervals,
profiles, recordings left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.identification.calibration import Calibration, Comparison
from uvms_ocp.identification.parameters import AXES
from uvms_ocp.identification.uncertainty import CHANNELS, INTERVAL, LEAST_P, Whiteness
from uvms_ocp.identification.validation import SCORED, HeldOutRecording, Profile, errors
from uvms_ocp.viz import series, style

# What speaks for and against a calibration: residuals and whether they are white, profiles,
# recordings that were left out.

_UNITS = ("m/s", "rad/s", "-")
"""Units of what the three sensors show."""
_COLUMNS = 4  # of profiles beside each other
_PREDICTORS = (style.BLUE, style.FADED, style.ORANGE, style.GREEN)
_ROOM = 1.15  # of the tallest bar but those of the vehicle before, which may be anywhere

_PARTS = ("linear", "angular")
"""Parts of the velocity, as the sensors measure them."""
_WIDEST = 100.0  # [%] of an interval that is drawn: beyond it nothing is known


@style.styled
def figure_residuals(one: Comparison) -> Figure:
    """Draw the residuals, simulated less measured, and their autocorrelation."""
    tests = {each.channel: each for each in one.whiteness}
    title = f"{style.label_text(one.name)}: what the search has left, and its autocorrelation"
    figure = style.titled(0.95 * len(CHANNELS) + 0.6, title)
    grid = figure.subplots(
        len(CHANNELS), 2, sharex="col", squeeze=False, gridspec_kw={"width_ratios": (3, 1)}
    )
    for i, (name, (over_time, over_lags)) in enumerate(zip(CHANNELS, grid, strict=True)):
        sensor, column = divmod(i, 3)
        left = one.residuals.rows[sensor][:, column] - one.residuals.measured[sensor][:, column]
        over_time.plot(one.residuals.t[sensor], left, color=style.BLUE, lw=0.6)
        over_time.set_ylabel(f"{name}\n[{_UNITS[sensor]}]")
        if name in tests:
            _correlation(over_lags, tests[name])
    grid[-1, 0].set_xlabel(series.axis_label("time", "t"))
    grid[-1, 1].set_xlabel("lag [s]")
    return figure


def _correlation(axis: Axes, one: Whiteness) -> None:
    lags = one.interval * np.arange(len(one.correlation))
    axis.axhspan(-one.bound, one.bound, color=style.FADED, alpha=0.5, lw=0)
    axis.vlines(lags[1:], 0.0, one.correlation[1:], color=style.BLUE, lw=1.2)
    axis.set_ylim(-1.05, 1.05)
    color = style.THRESHOLD if one.white else style.VERMILLION
    if one.p > LEAST_P:
        p = f"p = {one.p:.2g}"
    else:
        p = f"p < {LEAST_P:g}"
    axis.set_title(f"{p}, {one.inflation:.2g} alike", fontsize=style.points(7), color=color, pad=2)


@style.styled
def figure_profiles(profiles: Sequence[Profile]) -> Figure:
    """Roots of the deviance with each number held, and the straight line that standard errors take
    for them.
    """
    n_rows = -(-len(profiles) // _COLUMNS)
    figure = style.titled(
        1.5 * n_rows + 0.7, "Root of the deviance, a number held (grey: by standard errors)"
    )
    axes = figure.subplots(n_rows, _COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    for axis, one in zip(axes, profiles, strict=False):
        _profile(axis, one)
    for axis in axes[len(profiles) :]:
        axis.set_axis_off()
    figure.supxlabel("standard errors from where the search has ended", fontsize=style.points(8))
    return figure


def _profile(axis: Axes, one: Profile) -> None:
    number = one.number
    color = style.VERMILLION if one.differs else style.BLUE
    for end in (-INTERVAL, INTERVAL):
        axis.axhline(end, color=style.THRESHOLD, lw=0.7, ls=(0, (5, 3)))
    straight, found = (
        (np.array(ends) - number.value) / number.sigma for ends in (number.interval, one.values)
    )
    axis.plot(straight, (-INTERVAL, INTERVAL), color=style.FADED, lw=2.5)
    axis.plot(found, one.roots, color=color, lw=1.0, marker="o", ms=3)
    axis.set_title(
        f"{style.label_text(number.name)}\n{number.value:.4g} ± {number.sigma:.2g}",
        fontsize=style.points(7),
    )


@style.styled
def figure_left_out(found: Sequence[HeldOutRecording]) -> Figure:
    """Errors of predictions of recordings that were not seen, medians over them, beside those that
    know less.
    """
    asked = sorted({each.asked for one in found for each in one.horizons})
    figure = style.titled(
        4.6, "Recordings that were not seen: errors by horizon; taller bars are cut"
    )
    axes = figure.subplots(2, 4).ravel()
    for i, (axis, name) in enumerate(zip(axes, SCORED, strict=False)):
        _bars(axis, found, asked, i)
        axis.set_title(name)
        axis.set_ylabel("[deg]" if i == len(SCORED) - 1 else f"[{_UNITS[i // 3]}]")
    axes[-1].set_axis_off()
    axes[-1].legend(*axes[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure


def _bars(axis: Axes, found: Sequence[HeldOutRecording], asked: Sequence[float], i: int) -> None:
    names = list(next((each.by for one in found for each in one.horizons), ()))
    if not names:
        return
    chosen = [
        [each for one in found for each in one.horizons if each.asked == horizon]
        for horizon in asked
    ]
    heights = np.array(
        [
            [np.median([errors(each.by[name])[i] for each in some]) for some in chosen]
            for name in names
        ]
    )
    for k, name in enumerate(names):
        axis.bar(
            np.arange(len(asked)) + 0.2 * (k - 1.5),
            heights[k],
            0.2,
            color=_PREDICTORS[k],
            label=name,
        )
    axis.set_ylim(0.0, _ROOM * max(heights[0].max(), heights[2:].max()))
    axis.set_xticks(np.arange(len(asked)), [f"{horizon:g} s" for horizon in asked])


# A calibration to look at: measured against predicted, what is left, how sure its numbers are, and
# what others predict.


def write_identification_figures(one: Calibration, folder: Path | str) -> list[Path]:
    """Write PNG files into the folder: two for each recording, one for all numbers, and those of
    what was asked for besides.
    """
    folder = Path(folder)
    paths = [style.save_figure(figure_intervals(one), folder / "intervals.png")]
    kinds: dict[str, Callable[[Comparison], Figure]] = {
        "predicted": figure_predicted,
        "residuals": figure_residuals,
    }
    for k, each in enumerate(one.comparisons):
        paths += [
            style.save_figure(draw(each), folder / f"{kind}_{k}.png")
            for kind, draw in kinds.items()
        ]
    if one.profiles:
        paths.append(style.save_figure(figure_profiles(one.profiles), folder / "profiles.png"))
    for name, recordings in (("left_out", one.left_out), ("predicted_others", one.predicted)):
        long_enough = [each for each in recordings if each.horizons]
        if long_enough:
            paths.append(style.save_figure(figure_left_out(long_enough), folder / f"{name}.png"))
    return paths


@style.styled
def figure_predicted(one: Comparison) -> Figure:
    """Velocities, roll and pitch, measured and predicted from commands alone."""
    figure, axes = style.stacked(
        len(AXES) + 2, 1.0, f"{style.label_text(one.name)}: measured and predicted"
    )
    for i, (axis, name) in enumerate(zip(axes, AXES, strict=False)):
        sensor, column = divmod(i, 3)
        axis.set_ylabel(series.axis_label(name, "v", _PARTS[sensor]))
        _draw(axis, one, sensor, itemgetter((slice(None), column)))
    roll = ("roll", lambda vertical: np.rad2deg(np.arctan2(vertical[:, 1], vertical[:, 2])))
    pitch = ("pitch", lambda vertical: np.rad2deg(-np.arcsin(np.clip(vertical[:, 0], -1.0, 1.0))))
    for axis, (name, angle) in zip(axes[len(AXES) :], (roll, pitch), strict=True):
        axis.set_ylabel(f"{name} [deg]")
        _draw(axis, one, 2, angle)
    style.heading_legend(figure, axes[0].get_lines())
    return figure


def _draw(
    axis: Axes, one: Comparison, sensor: int, column: Callable[[np.ndarray], np.ndarray]
) -> None:
    last = one.calibrated
    drawn = (("before", one.before), ("at rest in balance", one.balance), ("calibrated", last))
    axis.plot(
        last.t[sensor], column(last.measured[sensor]), color=style.BLACK, lw=0.7, label="measured"
    )
    for (name, predicted), color in zip(
        drawn, (style.FADED, style.GREEN, style.VERMILLION), strict=True
    ):
        axis.plot(
            predicted.t[sensor], column(predicted.rows[sensor]), color=color, lw=0.9, label=name
        )


@style.styled
def figure_intervals(one: Calibration) -> Figure:
    """Intervals of 95 %, relative to the sizes of numbers; those that are not determined are
    faded.
    """
    numbers = one.numbers
    figure = style.titled(0.17 * len(numbers) + 1.0, "Half widths of 95 % intervals")
    axis = figure.subplots()
    widths = [
        min(100.0 * INTERVAL * each.sigma / max(each.size, 1e-300), _WIDEST) for each in numbers
    ]
    axis.barh(
        np.arange(len(numbers)),
        widths,
        color=[style.BLUE if each.determined else style.FADED for each in numbers],
    )
    axis.set_yticks(np.arange(len(numbers)), [style.label_text(each.name) for each in numbers])
    axis.set_ylim(len(numbers) - 0.4, -0.6)
    axis.set_xlabel(f"[%] of the number's size, cut off at {_WIDEST:.0f}; grey: not determined")
    return figure
