"""A vehicle, the recordings that it was identified on, and how: what answers are asked of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.identification.answers.predictions import Predicted, Predictor, rolled_out
from uvms_ocp.identification.methods.output_error import Estimate, Noise, OutputError
from uvms_ocp.identification.methods.pull import Pull
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.methods.search import Search
from uvms_ocp.identification.methods.stretch import Prepared, Stretch
from uvms_ocp.identification.models.stage import Vehicle


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fitted:
    """Of an estimate."""

    vehicle: Vehicle
    rollout: Rollout
    prepared: tuple[Prepared, ...]
    noise: Noise
    search: Search
    """By which recordings are cut into stretches."""
    estimate: Estimate

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """Of all recordings, as the estimate's starts are."""
        step, duration = self.search.step, self.search.stretch
        return tuple(part for one in self.prepared for part in one.stretches(step, duration))

    def left(self, recording: str | None = None) -> Predicted:
        """What the search has left in all its stretches, or in those of one recording: sensors beside the simulation."""
        pairs = zip(self.stretches, self.estimate.starts, strict=True)
        shared, own = self.estimate.shared, self.estimate.own
        return Predicted.joined(
            [
                rolled_out(self.rollout, one, start, shared, own[one.recording])
                for one, start in pairs
                if recording in (None, one.recording)
            ]
        )

    def predictor(self, shared: np.ndarray | None = None) -> Predictor:
        """With the unknowns of the estimate, or with shared (n,) [as `Unknowns.start`]."""
        chosen = self.estimate.shared if shared is None else shared
        return Predictor(vehicle=self.vehicle, rollout=self.rollout, shared=chosen, noise=self.noise)

    def problem(self, pull: Pull | None = None) -> OutputError:
        """What the estimate solves, with a number drawn to a value besides."""
        return OutputError(self.vehicle, self.stretches, self.noise, self.rollout, pull)

    def widened(self, together: float) -> Fitted:
        """The problem whose information intervals are taken from: the same optimum, where samples tell less.

        together: [-] samples that miss alike, as `correlated` finds. The cost of what is seen is divided by it. Priors are
        not; they are moved, so that they draw as little as the recordings do and the estimate stays where it is.
        """
        seen = ("velocity", "rate", "vertical", "process", "start")
        root, shared = float(np.sqrt(together)), self.estimate.shared
        wider = {name: root * getattr(self.noise, name) for name in seen}
        about = shared - (shared - self.vehicle.shared.start) / together
        vehicle = replace(
            self.vehicle,
            shared=self.vehicle.shared.believed(about),
            own=self.vehicle.own.believed(self.vehicle.own.start, root),
        )
        noise = replace(self.noise, **wider, outliers=self.noise.outliers / root)
        return replace(self, vehicle=vehicle, noise=noise)
