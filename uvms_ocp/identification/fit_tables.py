"""Write tables of how well recordings are predicted, each beside predictors that know less."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from uvms_ocp.identification import parameters, report_prose
from uvms_ocp.identification.calibration import Comparison
from uvms_ocp.identification.prediction_errors import SCORED, errors
from uvms_ocp.identification.prediction_text import still_lines
from uvms_ocp.identification.predictor import Predicted, fit_percent
from uvms_ocp.identification.still_comparison import WorseThanStill
from uvms_ocp.identification.validation import (
    OTHERS,
    HeldOutRecording,
    HorizonPrediction,
)

_STILL = 1e-3  # [m/s, rad/s] deviation below which a channel has no fit


def fits(comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Tabulate fits of the recordings that the search used."""
    yield report_prose.FITS
    yield "| recording | " + " | ".join((*parameters.AXES, "tilt")) + " |"
    yield "|---" * (2 + len(parameters.AXES)) + "|"
    shortfalls: list[WorseThanStill] = []
    for comparison in comparisons:
        yield _fit_row(comparison)
        shortfalls.extend(comparison.worse_than_still)
    yield ""
    yield from still_lines(shortfalls)


def _fit_row(comparison: Comparison) -> str:
    """Write the fits of one recording along all axes, and the errors of its vertical."""
    calibrated = _fits_by_axis(comparison.calibrated)
    before = _fits_by_axis(comparison.before)
    static = _fits_by_axis(comparison.static)
    cells = []
    for columns in zip(calibrated, before, static, strict=True):
        cells.append("{} ({}; {})".format(*columns))
    predictions = (
        comparison.calibrated,
        comparison.before,
        comparison.static,
        comparison.balance,
    )
    tilts = [f"{errors(prediction)[-1]:.2g}" for prediction in predictions]  # [deg]
    return f"| {comparison.name} | {' | '.join(cells)} | {tilts[0]} ({'; '.join(tilts[1:])}) |"


def _fits_by_axis(predicted: Predicted) -> list[str]:
    """Write the fit [%] of each velocity; ``-`` where it does not move."""
    cells = []
    for sensor, axis in product(range(2), range(3)):
        measured = predicted.measured[sensor][:, axis]
        output = predicted.rows[sensor][:, axis]
        if np.std(measured) > _STILL:
            cells.append(f"{fit_percent(measured, output):.0f}")
        else:
            cells.append("-")
    return cells


def left_out_tables(
    recordings: Sequence[HeldOutRecording], heading: str = report_prose.LEFT_OUT
) -> Iterator[str]:
    """Tabulate predictions of held-out recordings, by horizons; nothing where none was predicted.

    heading: text before it.
    """
    if not recordings:
        return
    yield heading
    by_length = defaultdict[float, list[HorizonPrediction]](list)
    for recording in recordings:
        for prediction in recording.horizons:
            by_length[prediction.asked].append(prediction)
    for length in sorted(by_length):
        yield from _horizon(length, by_length[length])
    yield from _by_recording(recordings)


def _horizon(length: float, predictions: Sequence[HorizonPrediction]) -> Iterator[str]:
    """Tabulate median errors over one horizon, by the name of the predictor."""
    shortest = min(prediction.length for prediction in predictions)
    if shortest < length - 1e-6:
        yield f"\n### {length:g} s (recordings have {shortest:.3g} s)"
    else:
        yield f"\n### {length:g} s"
    yield "\n| predicted by | " + " | ".join(SCORED) + " |"
    yield "|---" + "|---:" * len(SCORED) + "|"
    medians = {}
    for name in predictions[0].by:
        by_prediction = [errors(prediction.by[name]) for prediction in predictions]
        medians[name] = np.median(by_prediction, axis=0)
    best = _best_baseline(medians)
    for name, row in medians.items():
        if name == OTHERS:
            cells = [_cell(value, value > bound) for value, bound in zip(row, best, strict=True)]
        else:
            cells = [_cell(value, worse=False) for value in row]
        yield f"| {name} | {' | '.join(cells)} |"


def _best_baseline(errors_by_name: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the smallest errors (4,) of the predictors that know less than other recordings."""
    baselines = [row for name, row in errors_by_name.items() if name != OTHERS]
    return np.asarray(np.min(baselines, axis=0))


def _by_recording(recordings: Sequence[HeldOutRecording]) -> Iterator[str]:
    """Tabulate the errors of each recording over its longest horizon."""
    yield "\n### Each recording, over the longest horizon that it has\n"
    yield (
        "In brackets: the best that knows less, and by how much the prediction was expected to"
        " err.\n"
    )
    yield "| recording | " + " | ".join(SCORED) + " |"
    yield "|---" * (1 + len(SCORED)) + "|"
    for recording in recordings:
        if recording.horizons:
            yield f"| {recording.name} | {' | '.join(_beside(recording.horizons[-1]))} |"
    for recording in recordings:
        yield from _warnings(recording)


def _warnings(recording: HeldOutRecording) -> Iterator[str]:
    """Yield warnings about the prediction of a recording: channels for which it is not reliable."""
    if not recording.horizons:
        yield (
            f"\n{recording.name}: the others determine too little to predict it (their search:"
            f" {recording.estimate.status.value})."
        )
        return
    longest = recording.horizons[-1]
    if longest.extrapolated:
        yield (
            f"\n{recording.name}: {', '.join(longest.extrapolated)} rest on what the others do not"
            " determine: do not rely on them."
        )
    if longest.uninformative:
        yield (
            f"\n{recording.name}: {', '.join(longest.uninformative)} move less than the prediction"
            " may err: it says nothing of them."
        )


def _beside(prediction: HorizonPrediction) -> Iterator[str]:
    """Yield a cell for each error: of the prediction, and in brackets of the best baseline and as
    it was expected.
    """
    errors_by_name = {name: errors(predicted) for name, predicted in prediction.by.items()}
    best = _best_baseline(errors_by_name)
    columns = zip(errors_by_name[OTHERS], best, prediction.expected_error, strict=True)
    for value, best_error, expected in columns:
        yield f"{_cell(value, value > best_error)} ({best_error:.2g}; {expected:.2g})"


def _cell(value: float, worse: bool) -> str:
    if worse:
        return f"**{value:.2g}**"
    return f"{value:.2g}"
