"""Predict recordings by an identified vehicle, from its commands alone once it is known how it moved at
the beginning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.rollout import Rollout, SegmentStart
from uvms_ocp.identification.segments import PreparedRecording, Segment

_ITERATIONS = 10  # of the search for a start


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Predictor:
    """Predictor of recordings by a vehicle with identified unknowns."""

    vehicle: Vehicle
    rollout: Rollout
    """Simulator of the vehicle's stage."""
    shared: np.ndarray
    """(n,) [as `Unknowns.start`] unknowns of all recordings."""
    noise: Noise
    """Noise with which starts are fitted."""
    start_window: float = 2.0
    """[s] length of the beginning of a segment to which its start is fitted."""
    fits_per_recording: bool = False
    """True to fit the unknowns that a recording has for itself there, too; else they stay as
    declared.
    """

    def of(self, segment: Segment) -> Predicted:
        """Predict a whole segment."""
        beginning = segment.first(self.start_window)
        problem = OutputErrorProblem(self.vehicle, [beginning], self.noise, self.rollout)
        first_guess = problem.start(self.shared)
        # Shared unknowns stay.
        estimate = problem.solve(first_guess, iterations=_ITERATIONS, frozen=_ITERATIONS)
        per_recording = self.vehicle.per_recording.start
        if self.fits_per_recording:
            per_recording = estimate.per_recording[segment.recording]
        return rolled_out(self.rollout, segment, estimate.starts[0], self.shared, per_recording)

    def over(self, prepared: PreparedRecording, step: float, horizon: float) -> Predicted:
        """Predict a recording horizon by horizon [s], in steps of `step` [s], each from the
        measurements before it.
        """
        windows = prepared.windows(step, self.start_window, horizon)
        parts = []
        for window in windows:
            end_of_start = float(window.edges[0]) + self.start_window
            parts.append(self.of(window).after(end_of_start))
        return Predicted.joined(parts)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Predicted:
    """Predicted and measured outputs of the three sensors."""

    t: tuple[np.ndarray, ...]
    """Three of (m,) [s]: times of velocity, angular velocity and the vertical in B."""
    rows: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -] predicted outputs."""
    measured: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -] measured outputs."""

    def after(self, t: float) -> Predicted:
        """Return the part from t [s] on."""
        times = []
        rows = []
        measured = []
        for sensor in range(3):
            is_later = self.t[sensor] > t
            times.append(self.t[sensor][is_later])
            rows.append(self.rows[sensor][is_later])
            measured.append(self.measured[sensor][is_later])
        return Predicted(t=tuple(times), rows=tuple(rows), measured=tuple(measured))

    @property
    def finite(self) -> bool:
        """True if every prediction is finite: a vehicle that was identified on too little may run
        away.
        """
        return all(bool(np.isfinite(rows).all()) for rows in self.rows)

    @staticmethod
    def joined(parts: Sequence[Predicted]) -> Predicted:
        """Join parts, one after the other."""
        t = []
        rows = []
        measured = []
        for sensor in range(3):
            t.append(np.concatenate([part.t[sensor] for part in parts]))
            rows.append(np.concatenate([part.rows[sensor] for part in parts]))
            measured.append(np.concatenate([part.measured[sensor] for part in parts]))
        return Predicted(t=tuple(t), rows=tuple(rows), measured=tuple(measured))


def rolled_out(
    rollout: Rollout,
    segment: Segment,
    start: SegmentStart,
    shared: np.ndarray,
    per_recording: np.ndarray,
) -> Predicted:
    """Simulate a segment from its start, with unknowns shared (n,) of all recordings and per_recording
    (m,) of this one [as `Unknowns.start`].
    """
    (outputs,) = rollout.predict([segment], [start], np.concatenate([shared, per_recording])[None])
    return Predicted(t=segment.t, rows=outputs.rows, measured=segment.measured)


@checked
def fit_percent(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Compute the normalised fit [%], ``100 (1 - |error| / |measured - mean|)``, of measured and
    predicted (m,); 0: as good as the mean.
    """
    error = np.linalg.norm(predicted - measured)
    error_of_mean = np.linalg.norm(measured - measured.mean())
    return 100.0 * (1.0 - float(error / error_of_mean))
