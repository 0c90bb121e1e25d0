"""Every recording against four predictions: balanced or simulated, as the author has the vehicle or
fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from recording.report import Row

from pool.recordings import Recording
from pool.replay import replay, static_balance
from pool.scores import Score, fit_shift, scores
from pool.vehicle import PoolVehicle

STATIC = "static"
REPLAY = "replay"
FITTED_STATIC = "static, fitted"
FITTED = "replay, fitted"
PREDICTIONS = {
    STATIC: "static balance, the author's figures",
    REPLAY: "replay, the author's figures",
    FITTED_STATIC: "static balance, centre of buoyancy fitted on the others",
    FITTED: "replay, centre of buoyancy fitted on the others",
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evaluation:
    """Predictions of one recording and their scores."""

    recording: Recording
    shift: np.ndarray
    """(3,) [m] of the centre of buoyancy, fitted on the other recordings in which the arm moves."""
    predictions: Mapping[str, np.ndarray]
    """Roll and pitch (n, 2) [rad] at the times of the joints, by name."""
    scores: Mapping[str, tuple[Score, Score]]
    """Scores of roll and pitch, by the name of the prediction."""

    def rows(self) -> list[Row]:
        """One for each prediction."""
        return list(map(self._row, PREDICTIONS))

    def _row(self, name: str) -> Row:
        shift = self.shift if name in (FITTED_STATIC, FITTED) else np.zeros(3)
        row: dict[str, object] = {"recording": self.recording.name, "prediction": name}
        row["shift_mm"] = " ".join(f"{1000 * value:.1f}" for value in shift)
        for angle, score in zip(("roll", "pitch"), self.scores[name], strict=True):
            for figure, value in asdict(score).items():
                row[f"{angle}_{figure}"] = value
        return row


def evaluate(vehicle: PoolVehicle, recordings: Sequence[Recording]) -> list[Evaluation]:
    """Evaluate all recordings, each with the fit that has not seen it."""
    moving = [recording for recording in recordings if recording.moves]
    evaluations = []
    for recording in recordings:
        training = [candidate for candidate in moving if candidate is not recording]
        evaluations.append(_evaluation(vehicle, recording, training))
    return evaluations


def _evaluation(
    vehicle: PoolVehicle, recording: Recording, training: Sequence[Recording]
) -> Evaluation:
    """Evaluate a recording with the fit of others."""
    shift = fit_shift(vehicle, training, replay)
    unshifted = np.zeros(3)
    predictions = {
        STATIC: static_balance(vehicle, recording, unshifted),
        REPLAY: replay(vehicle, recording, unshifted),
        FITTED_STATIC: static_balance(vehicle, recording, shift),
        FITTED: replay(vehicle, recording, shift),
    }
    return Evaluation(
        recording=recording,
        shift=shift,
        predictions=predictions,
        scores={name: scores(recording, predicted) for name, predicted in predictions.items()},
    )


def medians(evaluations: Sequence[Evaluation]) -> list[Row]:
    """RMSE of the recordings in which the arm moves."""
    moving = [evaluation for evaluation in evaluations if evaluation.recording.moves]
    rows = list[Row]()
    for name, text in PREDICTIONS.items():
        rolls = [evaluation.scores[name][0].rmse for evaluation in moving]
        pitches = [evaluation.scores[name][1].rmse for evaluation in moving]
        rows.append(
            {
                "prediction": text,
                "roll RMSE [deg]": float(np.median(rolls)),
                "pitch RMSE [deg]": float(np.median(pitches)),
            }
        )
    return rows


def changes(evaluations: Sequence[Evaluation]) -> list[Row]:
    """List what the fit changes in the replay of each recording."""
    return list(map(_change, evaluations))


def _change(evaluation: Evaluation) -> Row:
    roll, pitch = evaluation.scores[REPLAY]
    fitted_roll, fitted_pitch = evaluation.scores[FITTED]
    return {
        "recording": evaluation.recording.name,
        "roll RMSE [deg]": f"{roll.rmse:.2f} to {fitted_roll.rmse:.2f}",
        "pitch RMSE [deg]": f"{pitch.rmse:.2f} to {fitted_pitch.rmse:.2f}",
        "pitch lag [s]": f"{pitch.lag:.2f} to {fitted_pitch.lag:.2f}",
        "pitch overshoot [%]": f"{100 * pitch.overshoot:.0f} to {100 * fitted_pitch.overshoot:.0f}",
    }
