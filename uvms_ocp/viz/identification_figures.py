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
def figure_residuals(comparison: Comparison) -> Figure:
    """Draw the residuals, simulated less measured, and their autocorrelation."""
    tests = {test.channel: test for test in comparison.whiteness}
    title = (
        f"{style.label_text(comparison.name)}: what the search has left, and its autocorrelation"
    )
    figure = style.titled(0.95 * len(CHANNELS) + 0.6, title)
    grid = figure.subplots(
        len(CHANNELS), 2, sharex="col", squeeze=False, gridspec_kw={"width_ratios": (3, 1)}
    )
    for i, (name, (over_time, over_lags)) in enumerate(zip(CHANNELS, grid, strict=True)):
        sensor, column = divmod(i, 3)
        residual = (
            comparison.residuals.rows[sensor][:, column]
            - comparison.residuals.measured[sensor][:, column]
        )
        over_time.plot(comparison.residuals.t[sensor], residual, color=style.BLUE, lw=0.6)
        over_time.set_ylabel(f"{name}\n[{_UNITS[sensor]}]")
        if name in tests:
            _correlation(over_lags, tests[name])
    grid[-1, 0].set_xlabel(series.axis_label("time", "t"))
    grid[-1, 1].set_xlabel("lag [s]")
    return figure


def _correlation(axis: Axes, test: Whiteness) -> None:
    lags = test.interval * np.arange(len(test.correlation))
    axis.axhspan(-test.bound, test.bound, color=style.FADED, alpha=0.5, lw=0)
    axis.vlines(lags[1:], 0.0, test.correlation[1:], color=style.BLUE, lw=1.2)
    axis.set_ylim(-1.05, 1.05)
    color = style.THRESHOLD if test.white else style.VERMILLION
    if test.p > LEAST_P:
        p = f"p = {test.p:.2g}"
    else:
        p = f"p < {LEAST_P:g}"
    axis.set_title(f"{p}, {test.inflation:.2g} alike", fontsize=style.points(7), color=color, pad=2)


@style.styled
def figure_profiles(profiles: Sequence[Profile]) -> Figure:
    """Draw roots of the deviance with each number held, and the straight line that standard errors
    take for them.
    """
    n_rows = -(-len(profiles) // _COLUMNS)
    figure = style.titled(
        1.5 * n_rows + 0.7, "Root of the deviance, a number held (grey: by standard errors)"
    )
    axes = figure.subplots(n_rows, _COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    for axis, profile in zip(axes, profiles, strict=False):
        _profile(axis, profile)
    for axis in axes[len(profiles) :]:
        axis.set_axis_off()
    figure.supxlabel("standard errors from where the search has ended", fontsize=style.points(8))
    return figure


def _profile(axis: Axes, profile: Profile) -> None:
    number = profile.number
    color = style.VERMILLION if profile.differs else style.BLUE
    for end in (-INTERVAL, INTERVAL):
        axis.axhline(end, color=style.THRESHOLD, lw=0.7, ls=(0, (5, 3)))
    straight = (np.array(number.interval) - number.value) / number.sigma
    scanned = (np.array(profile.values) - number.value) / number.sigma
    axis.plot(straight, (-INTERVAL, INTERVAL), color=style.FADED, lw=2.5)
    axis.plot(scanned, profile.roots, color=color, lw=1.0, marker="o", ms=3)
    axis.set_title(
        f"{style.label_text(number.name)}\n{number.value:.4g} ± {number.sigma:.2g}",
        fontsize=style.points(7),
    )


@style.styled
def figure_left_out(recordings: Sequence[HeldOutRecording]) -> Figure:
    """Draw errors of predictions of recordings that were not seen, medians over them, beside those
    that know less.
    """
    horizons = sorted(
        {prediction.asked for recording in recordings for prediction in recording.horizons}
    )
    figure = style.titled(
        4.6, "Recordings that were not seen: errors by horizon; taller bars are cut"
    )
    axes = figure.subplots(2, 4).ravel()
    for i, (axis, name) in enumerate(zip(axes, SCORED, strict=False)):
        _bars(axis, recordings, horizons, i)
        axis.set_title(name)
        axis.set_ylabel("[deg]" if i == len(SCORED) - 1 else f"[{_UNITS[i // 3]}]")
    axes[-1].set_axis_off()
    axes[-1].legend(*axes[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure


def _bars(
    axis: Axes, recordings: Sequence[HeldOutRecording], horizons: Sequence[float], i: int
) -> None:
    predictions = [prediction for recording in recordings for prediction in recording.horizons]
    if not predictions or not predictions[0].by:
        return
    names = list(predictions[0].by)
    heights = np.empty((len(names), len(horizons)))
    for column, horizon in enumerate(horizons):
        chosen = [prediction for prediction in predictions if prediction.asked == horizon]
        for k, name in enumerate(names):
            heights[k, column] = np.median(
                [errors(prediction.by[name])[i] for prediction in chosen]
            )
    for k, name in enumerate(names):
        axis.bar(
            np.arange(len(horizons)) + 0.2 * (k - 1.5),
            heights[k],
            0.2,
            color=_PREDICTORS[k],
            label=name,
        )
    axis.set_ylim(0.0, _ROOM * max(heights[0].max(), heights[2:].max()))
    axis.set_xticks(np.arange(len(horizons)), [f"{horizon:g} s" for horizon in horizons])


# A calibration to look at: measured against predicted, what is left, how sure its numbers are, and
# what others predict.


def write_identification_figures(calibration: Calibration, folder: Path | str) -> list[Path]:
    """Write PNG files into the folder: two for each recording, one for all numbers, and those of
    what was asked for besides.
    """
    folder = Path(folder)
    paths = [style.save_figure(figure_intervals(calibration), folder / "intervals.png")]
    kinds: dict[str, Callable[[Comparison], Figure]] = {
        "predicted": figure_predicted,
        "residuals": figure_residuals,
    }
    for k, comparison in enumerate(calibration.comparisons):
        paths += [
            style.save_figure(draw(comparison), folder / f"{kind}_{k}.png")
            for kind, draw in kinds.items()
        ]
    if calibration.profiles:
        paths.append(
            style.save_figure(figure_profiles(calibration.profiles), folder / "profiles.png")
        )
    for name, recordings in (
        ("left_out", calibration.left_out),
        ("predicted_others", calibration.predicted),
    ):
        long_enough = [recording for recording in recordings if recording.horizons]
        if long_enough:
            paths.append(style.save_figure(figure_left_out(long_enough), folder / f"{name}.png"))
    return paths


@style.styled
def figure_predicted(comparison: Comparison) -> Figure:
    """Draw velocities, roll and pitch, measured and predicted from commands alone."""
    figure, axes = style.stacked(
        len(AXES) + 2, 1.0, f"{style.label_text(comparison.name)}: measured and predicted"
    )
    for i, (axis, name) in enumerate(zip(axes, AXES, strict=False)):
        sensor, column = divmod(i, 3)
        axis.set_ylabel(series.axis_label(name, "v", _PARTS[sensor]))
        _draw(axis, comparison, sensor, itemgetter((slice(None), column)))
    roll = ("roll", lambda vertical: np.rad2deg(np.arctan2(vertical[:, 1], vertical[:, 2])))
    pitch = ("pitch", lambda vertical: np.rad2deg(-np.arcsin(np.clip(vertical[:, 0], -1.0, 1.0))))
    for axis, (name, angle) in zip(axes[len(AXES) :], (roll, pitch), strict=True):
        axis.set_ylabel(f"{name} [deg]")
        _draw(axis, comparison, 2, angle)
    style.heading_legend(figure, axes[0].get_lines())
    return figure


def _draw(
    axis: Axes, comparison: Comparison, sensor: int, column: Callable[[np.ndarray], np.ndarray]
) -> None:
    last = comparison.calibrated
    drawn = (
        ("before", comparison.before),
        ("at rest in balance", comparison.balance),
        ("calibrated", last),
    )
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
def figure_intervals(calibration: Calibration) -> Figure:
    """Draw intervals of 95 %, relative to the sizes of numbers; those that are not determined are
    faded.
    """
    numbers = calibration.numbers
    figure = style.titled(0.17 * len(numbers) + 1.0, "Half widths of 95 % intervals")
    axis = figure.subplots()
    widths = [
        min(100.0 * INTERVAL * number.sigma / max(number.size, 1e-300), _WIDEST)
        for number in numbers
    ]
    axis.barh(
        np.arange(len(numbers)),
        widths,
        color=[style.BLUE if number.determined else style.FADED for number in numbers],
    )
    axis.set_yticks(np.arange(len(numbers)), [style.label_text(number.name) for number in numbers])
    axis.set_ylim(len(numbers) - 0.4, -0.6)
    axis.set_xlabel(f"[%] of the number's size, cut off at {_WIDEST:.0f}; grey: not determined")
    return figure
