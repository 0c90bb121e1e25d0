"""Write in words and in data how good predictions are, and how good they could be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from uvms_ocp.identification import report_prose
from uvms_ocp.identification.prediction_bounds import ALONE, TOGETHER, PredictionBounds
from uvms_ocp.identification.prediction_errors import errors
from uvms_ocp.identification.prediction_verdict import (
    DIFFERENT,
    FITTED_CHANNELS,
    NEARLY_ALL,
    FitShares,
    MissCause,
    PredictionJudgement,
    fits_beside_bounds,
    judge_predictions,
)
from uvms_ocp.identification.still_comparison import EQUAL_WITHIN, WorseThanStill
from uvms_ocp.identification.validation import OTHERS, HeldOutRecording


def prediction_lines(
    recordings: Sequence[HeldOutRecording], bounds: PredictionBounds | None
) -> Iterator[str]:
    """Yield lines of Markdown: the verdict, the channels that a vehicle at rest predicts better,
    and the bounds.

    None where no recordings were predicted. bounds: vehicles whose predictions stand in `recordings`.
    """
    if not recordings:
        return
    judgement = judge_predictions(recordings)
    yield f"\n**Predictions are {judgement.verdict.value}.** {judgement.verdict.advice}"
    yield "\n### Worse than standing still\n"
    yield from still_lines(judgement.worse)
    if bounds is not None:
        yield from _bound_lines(recordings, bounds, judgement)


def still_lines(worse: Sequence[WorseThanStill]) -> Iterator[str]:
    """Yield a list of the channels that are predicted worse than by a vehicle that stands still."""
    if not worse:
        yield report_prose.NONE_WORSE.format(share=100.0 * EQUAL_WITHIN)
    for shortfall in worse:
        yield f"- {shortfall}"


def verdict_words(name: str, recordings: Sequence[HeldOutRecording]) -> str:
    """Write one line on a set of predictions, such as of recordings that were left out."""
    judgement = judge_predictions(recordings)
    words = f"{name}: {judgement.verdict.value}"
    if judgement.worse:
        channels = {(entry.recording, entry.channel) for entry in judgement.worse}
        words += f" in {len(channels)} of {judgement.compared} channels"
    shares = [entry.share for entry in judgement.shares if np.isfinite(entry.share)]
    if shares:
        words += f"; {min(shares):.0f} to {max(shares):.0f} % of what one vehicle could explain"
    if judgement.differing:
        words += f"; recordings differ in {', '.join(judgement.differing)}"
    return f"{words}."


def prediction_data(
    recordings: Sequence[HeldOutRecording], bounds: PredictionBounds | None
) -> dict[str, Any]:
    """Return the judgement of predictions as numbers for JSON; `None` where there is no number."""
    judgement = judge_predictions(recordings)
    predicted = [recording for recording in recordings if recording.horizons]
    data: dict[str, Any] = {
        "verdict": judgement.verdict.value,
        "advice": judgement.verdict.advice,
        "worse_than_still": [shortfall_data(entry) for entry in judgement.worse],
        "unpredicted": list(judgement.unpredicted),
    }
    if bounds is not None:
        data["bounds"] = {
            "seconds": bounds.seconds,
            "unfinished": list(bounds.unfinished),
            "recordings_differ": list(judgement.differing),
            "channels": [_shares_data(entry) for entry in judgement.shares],
            "recordings": [_recording_data(recording) for recording in predicted],
        }
    return data


def shortfall_data(shortfall: WorseThanStill) -> dict[str, Any]:
    """Return a channel that is predicted worse than by a vehicle at rest, for JSON."""
    return {
        "sentence": str(shortfall),
        "recording": shortfall.recording,
        "channel": shortfall.channel,
        "unit": shortfall.unit,
        "error": _number(shortfall.error),
        "baseline": shortfall.baseline,
        "baseline_error": shortfall.baseline_error,
        "horizon_s": shortfall.horizon,
    }


def _shares_data(shares: FitShares) -> dict[str, Any]:
    """Return the fits of a channel for JSON."""
    return {
        "sentence": str(shares),
        "channel": shares.channel,
        "predicted_percent": shares.predicted,
        "one_vehicle_percent": shares.together,
        "alone_percent": shares.alone,
        "share_percent": _number(shares.share),
        "missed_percent": {cause.value: part for cause, part in shares.missed.items()},
        "cause": shares.cause.value,
    }


def _recording_data(recording: HeldOutRecording) -> dict[str, Any]:
    """Return the fits of a recording for JSON: as predicted, and by both bounds."""
    fits = {}
    for channel, column in zip(FITTED_CHANNELS, fits_beside_bounds(recording).T, strict=True):
        fits[channel] = [_number(value) for value in column]
    return {"recording": recording.name, "fits_percent": fits, "tilt_deg": _tilts(recording)}


def _number(value: float) -> float | None:
    """Return a value, or `None` where it is not finite."""
    if np.isfinite(value):
        return float(value)
    return None


def _bound_lines(
    recordings: Sequence[HeldOutRecording],
    bounds: PredictionBounds,
    judgement: PredictionJudgement,
) -> Iterator[str]:
    """Yield the table of fits with those of the bounds, and the causes of what is missed."""
    yield report_prose.BOUNDS.format(seconds=bounds.seconds, nearly=NEARLY_ALL, different=DIFFERENT)
    yield f"\n| recording | {' | '.join(FITTED_CHANNELS)} | tilt [deg] |"
    yield "|---" + "|---:" * (len(FITTED_CHANNELS) + 1) + "|"
    for recording in recordings:
        if recording.horizons:
            cells = [_fit_cell(column) for column in fits_beside_bounds(recording).T]
            tilts = _with_bounds(_tilts(recording), ".2g")
            yield f"| {recording.name} | {' | '.join(cells)} | {tilts} |"
    yield _median_row(judgement.shares)
    yield _share_row(judgement.shares)
    yield ""
    for shares in judgement.shares:
        yield f"- {shares}"
    if judgement.differing:
        yield report_prose.RECORDINGS_DIFFER.format(channels=", ".join(judgement.differing))
    causes = {shares.cause for shares in judgement.shares}
    for cause in MissCause:
        if cause in causes:
            yield f"\nWhat is missed by {cause.value}: {cause.advice}"
    for sentence in bounds.unfinished:
        yield f"\n{sentence} Its figures are no bound."


def _tilts(recording: HeldOutRecording) -> list[float]:
    """Compute root mean squares [deg] of the errors of the vertical: predicted, and by both
    bounds.
    """
    longest = recording.horizons[-1]
    predictions = (longest.by[OTHERS], longest.bounds[TOGETHER], longest.bounds[ALONE])
    return [float(errors(prediction)[-1]) for prediction in predictions]


def _median_row(shares: Sequence[FitShares]) -> str:
    """Write the row of medians over the recordings."""
    by_channel = {entry.channel: entry for entry in shares}
    cells = []
    for channel in FITTED_CHANNELS:
        if channel in by_channel:
            of_channel = by_channel[channel]
            cells.append(
                _with_bounds((of_channel.predicted, of_channel.together, of_channel.alone))
            )
        else:
            cells.append("-")
    return f"| median | {' | '.join(cells)} | |"


def _share_row(shares: Sequence[FitShares]) -> str:
    """Write the row of shares of what one vehicle could explain."""
    by_channel = {entry.channel: entry.share for entry in shares if np.isfinite(entry.share)}
    cells = []
    for channel in FITTED_CHANNELS:
        if channel in by_channel:
            cells.append(f"{by_channel[channel]:.0f} %")
        else:
            cells.append("-")
    return f"| of what one vehicle could explain | {' | '.join(cells)} | |"


def _fit_cell(column: np.ndarray) -> str:
    """Write the fits (3,) of one channel; - where it does not move."""
    if np.isfinite(column).all():
        return _with_bounds(column)
    return "-"


def _with_bounds(values: Sequence[float] | np.ndarray, form: str = ".0f") -> str:
    """Write a prediction's value, and in brackets those of one vehicle that has seen it and of a
    vehicle of its own.
    """
    predicted, together, alone = (format(float(value), form) for value in values)
    return f"{predicted} ({together}; {alone})"
