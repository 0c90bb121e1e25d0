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
    """Of one recording."""

    recording: Recording
    shift: np.ndarray
    """(3,) [m] of the centre of buoyancy, fitted on the other recordings in which the arm moves."""
    predictions: Mapping[str, np.ndarray]
    """Roll and pitch (n, 2) [rad] at the times of the joints, by name."""
    scores: Mapping[str, tuple[Score, Score]]
    """Of roll and pitch."""

    def rows(self) -> list[Row]:
        """One for each prediction."""
        return [self._row(name) for name in PREDICTIONS]

    def _row(self, name: str) -> Row:
        shift = self.shift if name in (FITTED_STATIC, FITTED) else np.zeros(3)
        row: dict[str, object] = {"recording": self.recording.name, "prediction": name}
        row["shift_mm"] = " ".join(f"{1000 * value:.1f}" for value in shift)
        for angle, score in zip(("roll", "pitch"), self.scores[name], strict=True):
            row |= {f"{angle}_{figure}": value for figure, value in asdict(score).items()}
        return row


def evaluate(vehicle: PoolVehicle, recordings: Sequence[Recording]) -> list[Evaluation]:
    """All of them, each with the fit that has not seen it."""
    return [
        _evaluation(
            vehicle, one, [other for other in recordings if other.moves and other is not one]
        )
        for one in recordings
    ]


def _evaluation(
    vehicle: PoolVehicle, recording: Recording, others: Sequence[Recording]
) -> Evaluation:
    shift = fit_shift(vehicle, others, replay)
    own = np.zeros(3)
    predictions = {
        STATIC: static_balance(vehicle, recording, own),
        REPLAY: replay(vehicle, recording, own),
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
    moving = [one for one in evaluations if one.recording.moves]
    return [
        {
            "prediction": text,
            "roll RMSE [deg]": float(np.median([one.scores[name][0].rmse for one in moving])),
            "pitch RMSE [deg]": float(np.median([one.scores[name][1].rmse for one in moving])),
        }
        for name, text in PREDICTIONS.items()
    ]


def changes(evaluations: Sequence[Evaluation]) -> list[Row]:
    """What the fit changes in the replay of each recording."""
    return [{"recording": one.recording.name, **_change(one)} for one in evaluations]


def _change(one: Evaluation) -> dict[str, object]:
    (roll, pitch), (fitted_roll, fitted_pitch) = one.scores[REPLAY], one.scores[FITTED]
    return {
        "roll RMSE [deg]": f"{roll.rmse:.2f} to {fitted_roll.rmse:.2f}",
        "pitch RMSE [deg]": f"{pitch.rmse:.2f} to {fitted_pitch.rmse:.2f}",
        "pitch lag [s]": f"{pitch.lag:.2f} to {fitted_pitch.lag:.2f}",
        "pitch overshoot [%]": f"{100 * pitch.overshoot:.0f} to {100 * fitted_pitch.overshoot:.0f}",
    }
