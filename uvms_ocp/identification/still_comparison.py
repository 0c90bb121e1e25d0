"""Compare a prediction, channel by channel, with a vehicle that stands still.

Two baselines stand still: one keeps its last measurement before the prediction begins, the other
has the mean of the measurements that follow, which nobody knew. A prediction that errs more than either
has explained nothing of that channel, whatever the fit says of its own numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.predictor import Predicted

CHANNEL_UNITS = {
    "surge": "m/s",
    "sway": "m/s",
    "heave": "m/s",
    "roll rate": "rad/s",
    "pitch rate": "rad/s",
    "yaw rate": "rad/s",
    "roll": "deg",
    "pitch": "deg",
}
"""Channels that are compared, with the unit of their errors."""
NOTHING_MOVES = "nothing moves"
"""Name of the baseline that keeps the last measurement."""
MEAN = "its mean"
"""Name of the baseline that has the mean of the measurements."""
EQUAL_WITHIN = 0.01
"""Share of a baseline's error within which a prediction counts as equally good: where nothing but
noise is measured, two predictors differ by less.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class WorseThanStill:
    """A channel of a recording that is predicted worse than by a vehicle that stands still."""

    recording: str
    """Name of the recording."""
    channel: str
    """Name of the channel, of `CHANNEL_UNITS`."""
    unit: str
    """Unit of the errors."""
    error: float
    """[unit] root mean square of the prediction's errors."""
    baseline: str
    """`NOTHING_MOVES`, or `MEAN` where the prediction errs less than that and more than the
    mean.
    """
    baseline_error: float
    """[unit] root mean square of the baseline's errors, over the same samples."""
    horizon: float | None = None
    """[s] over which it was predicted at a time; `None`: the whole recording."""

    def __str__(self) -> str:
        """Write one sentence that names the recording, the channel and both errors."""
        if self.horizon is None:
            span = ""
        else:
            span = f" over {self.horizon:g} s"
        return (
            f"{self.recording}: {self.channel}{span} is predicted worse than by"
            f' "{self.baseline}": off by {self.error:.3g} {self.unit},'
            f" for {self.baseline_error:.3g} {self.unit}."
        )


def worse_than_still(
    recording: str, predicted: Predicted, still: Predicted, horizon: float | None = None
) -> Iterator[WorseThanStill]:
    """Yield the channels in which a prediction errs more than a baseline that stands still.

    still: the vehicle that does not move, over the same samples. horizon: [s] as in
    `WorseThanStill`.
    """
    prediction_errors = root_mean_squares(deviations(predicted))
    still_errors = root_mean_squares(deviations(still))
    mean_errors = root_mean_squares(_about_mean(predicted))
    for channel, unit in CHANNEL_UNITS.items():
        shortfall = compared(
            recording=recording,
            channel=channel,
            unit=unit,
            error=prediction_errors[channel],
            baselines={NOTHING_MOVES: still_errors[channel], MEAN: mean_errors[channel]},
            horizon=horizon,
        )
        if shortfall is not None:
            yield shortfall


def compared(
    *,
    recording: str,
    channel: str,
    unit: str,
    error: float,
    baselines: dict[str, float],
    horizon: float | None = None,
) -> WorseThanStill | None:
    """Compare one error with those of baselines [unit], the first that it exceeds named; `None` if
    it exceeds none.
    """
    for baseline, baseline_error in baselines.items():
        # Not "error > ...": a prediction that is no number is worse than any that is one.
        if not error <= (1.0 + EQUAL_WITHIN) * baseline_error:
            return WorseThanStill(
                recording=recording,
                channel=channel,
                unit=unit,
                error=error,
                baseline=baseline,
                baseline_error=baseline_error,
                horizon=horizon,
            )
    return None


def deviations(predicted: Predicted) -> dict[str, np.ndarray]:
    """Compute deviations (m,) [as `CHANNEL_UNITS`] of each channel: predicted less measured, angles
    by the shorter way.
    """
    outputs = channel_values(predicted, predicted.rows)
    measured = channel_values(predicted, predicted.measured)
    differences = {name: outputs[name] - measured[name] for name in CHANNEL_UNITS}
    for name in ("roll", "pitch"):
        differences[name] = _shorter_way(differences[name])
    return differences


def channel_values(predicted: Predicted, rows: tuple[np.ndarray, ...]) -> dict[str, np.ndarray]:
    """Compute values (m,) [as `CHANNEL_UNITS`] of each channel from rows of the three sensors,
    predicted or measured.
    """
    linear, angular, vertical = rows
    columns = [*linear.T, *angular.T]
    roll = np.degrees(np.arctan2(vertical[:, 1], vertical[:, 2]))
    pitch = np.degrees(-np.arcsin(np.clip(vertical[:, 0], -1.0, 1.0)))
    return dict(zip(CHANNEL_UNITS, [*columns, roll, pitch], strict=True))


def root_mean_squares(values: dict[str, np.ndarray]) -> dict[str, float]:
    """Compute the root mean square of each channel, in its unit."""
    return {name: float(np.sqrt(np.mean(column**2))) for name, column in values.items()}


def _about_mean(predicted: Predicted) -> dict[str, np.ndarray]:
    """Subtract its mean from each measured channel; from angles the direction of their mean."""
    measured = channel_values(predicted, predicted.measured)
    differences = {name: column - column.mean() for name, column in measured.items()}
    for name in ("roll", "pitch"):
        turns = np.radians(measured[name])
        mean = np.degrees(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean()))
        differences[name] = _shorter_way(measured[name] - mean)
    return differences


def _shorter_way(angles: np.ndarray) -> np.ndarray:
    """Map angles (m,) [deg] to -180 to 180."""
    return np.asarray((angles + 180.0) % 360.0 - 180.0)
