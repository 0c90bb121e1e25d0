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
from uvms_ocp.identification.identified_numbers import INTERVAL
from uvms_ocp.identification.parameters import AXES
from uvms_ocp.identification.prediction_errors import SCORED, errors
from uvms_ocp.identification.profiles import Profile
from uvms_ocp.identification.validation import HeldOutRecording, HorizonPrediction
from uvms_ocp.identification.whiteness import (
    CHANNELS,
    LEAST_P,
    Whiteness,
)
from uvms_ocp.viz import layout, series, style
from uvms_ocp.viz.colours import BLACK, BLUE, FADED, GREEN, ORANGE, THRESHOLD, VERMILLION
from uvms_ocp.viz.label_text import label_text
from uvms_ocp.viz.line_widths import BROAD, EDGELESS, FINE, MEDIUM, PLAIN, STRONG, THIN

_AXES_OF_SENSOR = 3
_UNITS = ("m/s", "rad/s", "-")
"""Units of what the three sensors show: linear and angular velocity, and the vertical."""
_PARTS = ("linear", "angular")
"""Parts of the velocity, as the sensors measure them."""
_VERTICAL = 2  # place of its sensor
_COLUMNS = 4  # of profiles beside each other
_PREDICTORS = (BLUE, FADED, ORANGE, GREEN)
"""Colours of the calibrated vehicle, the vehicle before, and those that know less."""
_BAR_WIDTH = 0.2  # of the distance between horizons
_ROOM = 1.15  # height of the axis over the tallest bar, without those of the vehicle before
_WIDEST = 100.0  # [%] widest interval that is drawn: beyond it nothing is known


@style.styled
def figure_residuals(comparison: Comparison) -> Figure:
    """Draw the residuals, simulated less measured, and their autocorrelation."""
    residuals = comparison.residuals
    tests = {test.channel: test for test in comparison.whiteness}
    name = label_text(comparison.name)
    title = f"{name}: what the search has left, and its autocorrelation"
    figure = layout.titled(0.95 * len(CHANNELS) + 0.6, title)
    grid = figure.subplots(
        len(CHANNELS), 2, sharex="col", squeeze=False, gridspec_kw={"width_ratios": (3, 1)}
    )
    for i, name in enumerate(CHANNELS):
        over_time, over_lags = grid[i]
        sensor, column = divmod(i, _AXES_OF_SENSOR)
        simulated = residuals.rows[sensor][:, column]
        measured = residuals.measured[sensor][:, column]
        over_time.plot(residuals.t[sensor], simulated - measured, color=BLUE, lw=FINE)
        over_time.set_ylabel(f"{name}\n[{_UNITS[sensor]}]")
        if name in tests:
            _correlation(over_lags, tests[name])
    grid[-1, 0].set_xlabel(series.axis_label("time", "t"))
    grid[-1, 1].set_xlabel("lag [s]")
    return figure


def _correlation(axis: Axes, test: Whiteness) -> None:
    lags = test.interval * np.arange(len(test.correlation))
    axis.axhspan(-test.bound, test.bound, color=FADED, alpha=0.5, lw=EDGELESS)
    axis.vlines(lags[1:], 0.0, test.correlation[1:], color=BLUE, lw=STRONG)
    axis.set_ylim(-1.05, 1.05)
    color = THRESHOLD if test.white else VERMILLION
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
    figure = layout.titled(
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
    color = VERMILLION if profile.differs else BLUE
    for end in (-INTERVAL, INTERVAL):
        axis.axhline(end, color=THRESHOLD, lw=THIN, ls=(0, (5, 3)))
    straight = (np.array(number.interval) - number.value) / number.sigma
    scanned = (np.array(profile.values) - number.value) / number.sigma
    axis.plot(straight, (-INTERVAL, INTERVAL), color=FADED, lw=BROAD)
    axis.plot(scanned, profile.roots, color=color, lw=MEDIUM, marker="o", ms=3)
    axis.set_title(
        f"{label_text(number.name)}\n{number.value:.4g} ± {number.sigma:.2g}",
        fontsize=style.points(7),
    )


@style.styled
def figure_left_out(recordings: Sequence[HeldOutRecording]) -> Figure:
    """Draw errors of predictions of recordings that were not seen, medians over them, beside those
    that know less.
    """
    predictions: list[HorizonPrediction] = []
    for recording in recordings:
        predictions += recording.horizons
    figure = layout.titled(
        4.6, "Recordings that were not seen: errors by horizon; taller bars are cut"
    )
    axes = figure.subplots(2, 4).ravel()
    for i, name in enumerate(SCORED):
        unit = _UNITS[i // _AXES_OF_SENSOR] if name in AXES else "deg"
        _bars(axes[i], predictions, i)
        axes[i].set_title(name)
        axes[i].set_ylabel(f"[{unit}]")
    axes[-1].set_axis_off()
    axes[-1].legend(*axes[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure


def _bars(axis: Axes, predictions: Sequence[HorizonPrediction], i: int) -> None:
    """Draw median errors of the i-th of `SCORED` by horizon, a bar for each predictor."""
    if not predictions or not predictions[0].by:
        return
    names = list(predictions[0].by)
    horizons = sorted({prediction.asked for prediction in predictions})
    places = np.arange(len(horizons))
    heights = np.empty((len(names), len(horizons)))
    for column, horizon in enumerate(horizons):
        of_horizon = [prediction for prediction in predictions if prediction.asked == horizon]
        for k, name in enumerate(names):
            values = [errors(prediction.by[name])[i] for prediction in of_horizon]
            heights[k, column] = np.median(values)
    for k, name in enumerate(names):
        offset = _BAR_WIDTH * (k - 1.5)
        axis.bar(places + offset, heights[k], _BAR_WIDTH, color=_PREDICTORS[k], label=name)
    axis.set_ylim(0.0, _ROOM * max(heights[0].max(), heights[2:].max()))
    axis.set_xticks(places, [f"{horizon:g} s" for horizon in horizons])


def write_identification_figures(calibration: Calibration, folder: Path | str) -> list[Path]:
    """Write PNG files into the folder: two for each recording, one for all numbers, and those of
    what was asked for besides.
    """
    folder = Path(folder)
    paths = []

    def save(figure: Figure, name: str) -> None:
        paths.append(style.save_figure(figure, folder / f"{name}.png"))

    save(figure_intervals(calibration), "intervals")
    for k, comparison in enumerate(calibration.comparisons):
        save(figure_predicted(comparison), f"predicted_{k}")
        save(figure_residuals(comparison), f"residuals_{k}")
    if calibration.profiles:
        save(figure_profiles(calibration.profiles), "profiles")
    for name, recordings in (
        ("left_out", calibration.left_out),
        ("predicted_others", calibration.predicted),
    ):
        long_enough = [recording for recording in recordings if recording.horizons]
        if long_enough:
            save(figure_left_out(long_enough), name)
    return paths


@style.styled
def figure_predicted(comparison: Comparison) -> Figure:
    """Draw velocities, roll and pitch, measured and predicted from commands alone."""
    title = f"{label_text(comparison.name)}: measured and predicted"
    figure, axes = layout.stacked(len(AXES) + 2, 1.0, title)
    for i, name in enumerate(AXES):
        sensor, column = divmod(i, _AXES_OF_SENSOR)
        axes[i].set_ylabel(series.axis_label(name, "v", _PARTS[sensor]))
        _draw(axes[i], comparison, sensor, itemgetter((slice(None), column)))
    for axis, name, angle in ((axes[-2], "roll", _roll), (axes[-1], "pitch", _pitch)):
        axis.set_ylabel(f"{name} [deg]")
        _draw(axis, comparison, _VERTICAL, angle)
    layout.heading_legend(figure, axes[0].get_lines())
    return figure


def _roll(vertical: np.ndarray) -> np.ndarray:
    """Compute roll (n,) [deg] by W's vertical in B (n, 3)."""
    return np.rad2deg(np.arctan2(vertical[:, 1], vertical[:, 2]))


def _pitch(vertical: np.ndarray) -> np.ndarray:
    """Compute pitch (n,) [deg] by W's vertical in B (n, 3)."""
    return np.rad2deg(-np.arcsin(np.clip(vertical[:, 0], -1.0, 1.0)))


def _draw(
    axis: Axes, comparison: Comparison, sensor: int, column: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Draw a column of what a sensor shows, measured and predicted, over time."""
    calibrated = comparison.calibrated
    t = calibrated.t[sensor]
    measured = column(calibrated.measured[sensor])
    axis.plot(t, measured, color=BLACK, lw=THIN, label="measured")
    for name, predicted, color in (
        ("before", comparison.before, FADED),
        ("at rest in balance", comparison.balance, GREEN),
        ("calibrated", calibrated, VERMILLION),
    ):
        t = predicted.t[sensor]
        axis.plot(t, column(predicted.rows[sensor]), color=color, lw=PLAIN, label=name)


@style.styled
def figure_intervals(calibration: Calibration) -> Figure:
    """Draw intervals of 95 %, relative to the sizes of numbers; those that are not determined are
    faded.
    """
    numbers = calibration.numbers
    figure = layout.titled(0.17 * len(numbers) + 1.0, "Half widths of 95 % intervals")
    axis = figure.subplots()
    places = np.arange(len(numbers))
    widths = []
    colors = []
    for number in numbers:
        width = 100.0 * INTERVAL * number.sigma / max(number.size, 1e-300)
        widths.append(min(width, _WIDEST))
        colors.append(BLUE if number.determined else FADED)
    axis.barh(places, widths, color=colors)
    axis.set_yticks(places, [label_text(number.name) for number in numbers])
    axis.set_ylim(len(numbers) - 0.4, -0.6)
    axis.set_xlabel(f"[%] of the number's size, cut off at {_WIDEST:.0f}; grey: not determined")
    return figure
