"""What a vehicle predicts of a recording from its commands alone, once it is known how the vehicle moved at the beginning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.methods.output_error import Noise, OutputError
from uvms_ocp.identification.methods.rollout import Rollout, Start
from uvms_ocp.identification.methods.stretch import Prepared, Stretch
from uvms_ocp.identification.models.stage import Vehicle

_ITERATIONS = 10


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Predicted:
    """What sensors should show, beside what they showed."""

    t: tuple[np.ndarray, ...]
    """Three of (m,) [s]: of velocity, angular velocity and the vertical in B."""
    rows: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -]"""
    seen: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -]"""

    def after(self, t: float) -> Predicted:
        """Without what was before t [s]."""
        later = [times > t for times in self.t]
        parts = [
            tuple(values[chosen] for values, chosen in zip(all_of_them, later, strict=True))
            for all_of_them in (self.t, self.rows, self.seen)
        ]
        return Predicted(t=parts[0], rows=parts[1], seen=parts[2])

    @property
    def finite(self) -> bool:
        """Whether all of it is: a vehicle that was identified on too little may run away."""
        return all(bool(np.isfinite(rows).all()) for rows in self.rows)

    @staticmethod
    def joined(parts: Sequence[Predicted]) -> Predicted:
        """One after the other."""
        t, rows, seen = (
            tuple(np.concatenate([getattr(one, name)[k] for one in parts]) for k in range(3))
            for name in ("t", "rows", "seen")
        )
        return Predicted(t=t, rows=rows, seen=seen)


def rolled_out(rollout: Rollout, stretch: Stretch, start: Start, shared: np.ndarray, own: np.ndarray) -> Predicted:
    """A stretch from where it begins, with unknowns shared (n,) and own (m,) [as `Unknowns.start`]."""
    (seen,) = rollout.seen([stretch], [start], np.concatenate([shared, own])[None], slopes=False)
    return Predicted(t=stretch.t, rows=seen.rows, seen=stretch.seen)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Predictor:
    """A vehicle with its unknowns found."""

    vehicle: Vehicle
    rollout: Rollout
    shared: np.ndarray
    """(n,) [as `Unknowns.start`]"""
    noise: Noise
    """By which starts are fitted."""
    known: float = 2.0
    """[s] of the beginning of a stretch, from which its start is found; nothing later is looked at."""
    own: bool = False
    """Whether what a recording has for itself is found there too, and not taken as the declaration has it."""

    def of(self, stretch: Stretch) -> Predicted:
        """Predict a whole stretch."""
        error = OutputError(self.vehicle, [stretch.first(self.known)], self.noise, self.rollout)
        found = error.solve(error.start(self.shared), iterations=_ITERATIONS, frozen=True)
        own = found.own[stretch.recording] if self.own else self.vehicle.own.start
        return rolled_out(self.rollout, stretch, found.starts[0], self.shared, own)

    def over(self, prepared: Prepared, step: float, horizon: float) -> Predicted:
        """Predict a recording horizon by horizon [s], in steps of `step` [s], each from what was known before it."""
        windows = prepared.windows(step, self.known, horizon)
        return Predicted.joined([self.of(one).after(float(one.edges[0]) + self.known) for one in windows])


def fit(seen: np.ndarray, predicted: np.ndarray) -> float:
    """[%] ``100 (1 - |error| / |seen - mean|)`` of seen (m,) and predicted (m,) [of one unit]: 0 is as good as the mean."""
    return 100.0 * (1.0 - float(np.linalg.norm(predicted - seen) / np.linalg.norm(seen - seen.mean())))
