"""Judge predictions: by what one vehicle could explain at best, and by a vehicle that stands still.

The judge sees measurements and predictions alone, and nothing of the search that gave the vehicle.
Fits of a channel stand in order: the vehicle that has not seen the recordings, one vehicle that has
seen all of them, each recording by a vehicle of its own, and 100 %. What lies between two of them is
missed by the fit, by what differs between recordings, and by the model or its sensors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.errors import AdvisedStatus
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.prediction_bounds import ALONE, TOGETHER
from uvms_ocp.identification.predictor import Predicted, fit_percent
from uvms_ocp.identification.still_comparison import CHANNEL_UNITS, WorseThanStill
from uvms_ocp.identification.validation import OTHERS, HeldOutRecording, HorizonPrediction

FITTED_CHANNELS = (*tuple(CHANNEL_UNITS)[:6], "tilt")
"""Channels of which fits are told: velocities, and the vertical in B."""
NEARLY_ALL = 90.0
"""[%] of what one vehicle could explain, from which a prediction is called as good as one vehicle
can be.
"""
DIFFERENT = 10.0
"""[%] of a channel that recordings alone explain beyond one vehicle of all, from which recordings are
said to differ: a vehicle of one recording has more freedom for each of its samples.
"""


class PredictionVerdict(AdvisedStatus):
    """Judgement on the predictions of a set of recordings."""

    AS_GOOD_AS_ONE_VEHICLE = (
        "as good as one vehicle can be",
        "Other recordings to identify on will hardly predict these better.",
    )
    BELOW_THE_BOUND = (
        "short of what one vehicle could explain",
        "Identify on recordings that move as these do, too.",
    )
    BETTER_THAN_STILL = (
        "better than standing still",
        "How good predictions could be is not known: ask for bounds.",
    )
    WORSE_THAN_STILL = (
        "worse than standing still",
        (
            "Do not rely on the channels that are named: a vehicle that does not move predicts them"
            " better."
        ),
    )
    NOTHING_PREDICTED = (
        "nothing is predicted",
        "The recordings that the vehicle was identified on determine too little of it.",
    )


class MissCause(AdvisedStatus):
    """Reason for which a part of a channel is not predicted."""

    FIT = (
        "the fit",
        (
            "The recordings that the vehicle was identified on do not tell it: add some that move as"
            " these do."
        ),
    )
    RECORDINGS = (
        "what differs between recordings",
        (
            "No single vehicle explains it: ballast, trim, current or another day. Learn what each"
            " recording has for itself (wrench_offset, current, attitude_offset), or keep them apart."
        ),
    )
    MODEL = (
        "the model or the sensors",
        (
            "No recording is explained even by a vehicle of its own: look at residuals, at what was"
            " held fixed, and at noise and delays of the sensors."
        ),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class FitShares:
    """Fit of one channel, with the fits of vehicles that were identified on the predicted
    recordings.
    """

    channel: str
    """Name of the channel, of `FITTED_CHANNELS`."""
    predicted: float
    """[%] fit, by `fit_percent`, of the vehicle that has not seen it; median over recordings."""
    together: float
    """[%] fit of one vehicle that was identified on all recordings that are predicted."""
    alone: float
    """[%] fit of vehicles that were identified on one recording each; median over recordings."""

    @property
    def best_single(self) -> float:
        """[%] fit of the best single vehicle that is known, which may be the one that predicts."""
        return max(self.predicted, self.together)

    @property
    def share(self) -> float:
        """[%] share of what one vehicle could explain; NaN where that explains nothing."""
        if self.best_single <= 0.0:
            return float("nan")
        return 100.0 * self.predicted / self.best_single

    @property
    def missed(self) -> Mapping[MissCause, float]:
        """[%] part of the channel that each cause accounts for; together ``100 - predicted``.

        A vehicle of one recording alone may predict less than one of all: it was identified on few
        samples. Then nothing is known to differ between recordings.
        """
        bound = max(self.best_single, self.alone)
        return {
            MissCause.FIT: self.best_single - self.predicted,
            MissCause.RECORDINGS: bound - self.best_single,
            MissCause.MODEL: 100.0 - bound,
        }

    @property
    def cause(self) -> MissCause:
        """The cause that accounts for most of what is missed."""
        missed = self.missed
        return max(missed, key=lambda cause: missed[cause])

    def __str__(self) -> str:
        """Write one sentence: how much is missed, and by which causes."""
        parts = ", ".join(f"{part:.0f} by {cause.value}" for cause, part in self.missed.items())
        if np.isnan(self.share):
            share = ""
        else:
            share = f", {self.share:.0f} % of what one vehicle could"
        return (
            f"{self.channel}: {self.predicted:.0f} % explained{share};"
            f" {100.0 - self.predicted:.0f} % missed ({parts}), mostly by {self.cause.value}."
        )

    @property
    def recordings_differ(self) -> bool:
        """True if recordings alone explain so much more that no single vehicle shows them all."""
        return self.missed[MissCause.RECORDINGS] > DIFFERENT


@dataclass(frozen=True, kw_only=True, slots=True)
class PredictionJudgement:
    """Judgement on the predictions of a set of recordings."""

    worse: tuple[WorseThanStill, ...]
    """Channels of recordings that are predicted worse than by a vehicle that stands still."""
    shares: tuple[FitShares, ...]
    """Fits of the channels that move, over the longest horizon of each recording; none without
    bounds.
    """
    unpredicted: tuple[str, ...]
    """Names of recordings of which no prediction stays finite."""
    compared: int
    """Number of channels of recordings that were compared with a vehicle that stands still."""

    @property
    def verdict(self) -> PredictionVerdict:
        """Worst verdict that holds for any of the recordings."""
        if self.compared == 0:
            return PredictionVerdict.NOTHING_PREDICTED
        if self.worse or self.unpredicted:
            return PredictionVerdict.WORSE_THAN_STILL
        if not self.shares:
            return PredictionVerdict.BETTER_THAN_STILL
        # Not "share < ...": where one vehicle explains nothing the share is no number, nor good.
        if all(share.share >= NEARLY_ALL for share in self.shares):
            return PredictionVerdict.AS_GOOD_AS_ONE_VEHICLE
        return PredictionVerdict.BELOW_THE_BOUND

    @property
    def differing(self) -> tuple[str, ...]:
        """Channels in which recordings differ by more than one vehicle can show."""
        return tuple(entry.channel for entry in self.shares if entry.recordings_differ)


def judge_predictions(recordings: Sequence[HeldOutRecording]) -> PredictionJudgement:
    """Judge the predictions of recordings that the vehicle has not seen."""
    worse: list[WorseThanStill] = []
    predicted = []
    unpredicted = []
    for recording in recordings:
        worse += recording.worse_than_still
        if recording.horizons:
            predicted.append(recording)
        else:
            unpredicted.append(recording.name)
    return PredictionJudgement(
        worse=tuple(worse),
        shares=tuple(_shares(predicted)),
        unpredicted=tuple(unpredicted),
        compared=len(predicted) * len(CHANNEL_UNITS),
    )


def _shares(recordings: Sequence[HeldOutRecording]) -> Iterator[FitShares]:
    """Yield medians over the recordings with bounds in which a channel moves."""
    tables = []
    for recording in recordings:
        if recording.horizons[-1].bounds:
            tables.append(fits_beside_bounds(recording))
    for k, channel in enumerate(FITTED_CHANNELS):
        rows = []
        for table in tables:
            if np.isfinite(table[:, k]).all():
                rows.append(table[:, k])
        if rows:
            predicted, together, alone = np.median(rows, axis=0)
            yield FitShares(
                channel=channel,
                predicted=float(predicted),
                together=float(together),
                alone=float(alone),
            )


def fits_beside_bounds(recording: HeldOutRecording) -> np.ndarray:
    """Compute fits (3, 7) [%] of `FITTED_CHANNELS` over the longest horizon: as predicted, by one
    vehicle of all, by one of its own; NaN where a channel moves by less than the noise of its
    sensor.
    """
    longest = recording.horizons[-1]
    predictions = [longest.by[OTHERS], longest.bounds[TOGETHER], longest.bounds[ALONE]]
    fits = np.array([_fits(prediction) for prediction in predictions])
    fits[:, ~_moves(longest, recording.predictor.noise)] = np.nan
    return fits


def _fits(predicted: Predicted) -> np.ndarray:
    """Compute fits (7,) [%] of `FITTED_CHANNELS`."""
    if not predicted.finite:
        return np.full(len(FITTED_CHANNELS), np.nan)
    fits = []
    for measured, rows in zip(predicted.measured[:2], predicted.rows[:2], strict=True):
        for axis in range(3):
            fits.append(fit_percent(measured[:, axis], rows[:, axis]))
    vertical = predicted.measured[2]
    missed = np.linalg.norm(predicted.rows[2] - vertical)
    moved = np.linalg.norm(vertical - vertical.mean(axis=0))
    return np.array([*fits, 100.0 * (1.0 - missed / moved)])


def _moves(prediction: HorizonPrediction, noise: Noise) -> np.ndarray:
    """Compare the standard deviation of each channel with the noise of its sensor; (7,) [bool]."""
    linear, angular, vertical = prediction.by[OTHERS].measured
    spread = [*linear.std(axis=0), *angular.std(axis=0)]
    tilting = float(np.sqrt(vertical.var(axis=0).sum()))
    sensors = [noise.velocity] * 3 + [noise.rate] * 3 + [noise.vertical]
    return np.array([*spread, tilting]) > np.array(sensors)
