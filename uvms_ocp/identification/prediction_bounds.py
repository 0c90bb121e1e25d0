"""Fit vehicles that have seen the predicted recordings: their fits bound those of predictions.

One vehicle is identified on all predicted recordings together: no single vehicle of this model
explains more of them. Each recording also gets a separate vehicle, with current and trim of its own;
what that explains beyond the common one is what differs between recordings.
Searches begin where the vehicle was identified and have its noise, segments and priors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from uvms_ocp.identification.estimates import FitStatus
from uvms_ocp.identification.fit import FitContext, resumed_search
from uvms_ocp.identification.predictor import Predictor
from uvms_ocp.identification.segments import PreparedRecording

TOGETHER = "one vehicle that has seen them"
"""Name of the predictor that was fitted to all recordings that are predicted."""
ALONE = "each by a vehicle of its own"
"""Name of the predictor that was fitted to the predicted recording alone."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PredictionBounds:
    """Vehicles that were identified on the very recordings that are predicted."""

    together: FitContext
    """Fit of one vehicle to all of them."""
    alone: Mapping[str, FitContext]
    """Fit to each recording alone, by the name of its file; parts of one file are fitted
    together.
    """
    seconds: float
    """[s] time that these fits took."""

    def predictors(self, recording: PreparedRecording) -> dict[str, Predictor]:
        """Return the predictors of one of the recordings, by `TOGETHER` and `ALONE`.

        Unknowns that a recording has for itself are as declared in the vehicle of all recordings, as
        in any prediction; in the vehicle of this recording they are as identified.
        """
        alone = self.alone[recording.recording.source]
        return {
            TOGETHER: self.together.predictor(),
            ALONE: _with_fitted_recording(alone, recording.recording.name),
        }

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Sentences on the searches that have not converged: their figures are too low."""
        return tuple(self._unfinished())

    def _unfinished(self) -> Iterator[str]:
        if self.together.estimate.status is not FitStatus.CONVERGED:
            yield f"{TOGETHER}: the search has ended by {self.together.estimate.status.value}."
        for source, fitted in self.alone.items():
            if fitted.estimate.status is not FitStatus.CONVERGED:
                yield f"{source} alone: the search has ended by {fitted.estimate.status.value}."


def fit_bounds(
    identified: FitContext,
    predicted: Sequence[PreparedRecording],
    progress: Callable[[str], None] = lambda _: None,
) -> PredictionBounds:
    """Identify one vehicle on all recordings that are predicted, and one on each.

    identified: the vehicle whose predictions are bounded; where it was identified on these very
    recordings, as for leave-one-out, it is the vehicle of all itself and is not fitted again.
    progress gets a line for each search.
    """
    begin = perf_counter()
    together = identified
    if not _has_seen(identified, predicted):
        progress("bound: one vehicle of all recordings that are predicted")
        together = _refitted(identified, predicted)
    alone = {}
    sources = list(dict.fromkeys(recording.recording.source for recording in predicted))
    for k, source in enumerate(sources, start=1):
        progress(f"bound {k} of {len(sources)}: {source} alone")
        parts = [recording for recording in predicted if recording.recording.source == source]
        alone[source] = _refitted(together, parts)
    return PredictionBounds(together=together, alone=alone, seconds=perf_counter() - begin)


def _has_seen(identified: FitContext, predicted: Sequence[PreparedRecording]) -> bool:
    """Check whether a vehicle was identified on exactly these recordings."""
    fitted = {id(recording) for recording in identified.prepared}
    return fitted == {id(recording) for recording in predicted}


def _refitted(identified: FitContext, recordings: Sequence[PreparedRecording]) -> FitContext:
    """Fit the vehicle to other recordings, from where it was identified, by the same settings."""
    context = replace(identified, prepared=tuple(recordings))
    problem = context.problem()
    problem.progress = identified.search.progress
    iterations = identified.search.iterations
    # Starts of segments come near first: they are as measured, the vehicle is identified.
    first = problem.solve(
        problem.start(identified.estimate.shared), iterations=iterations, frozen=1
    )
    return replace(context, estimate=resumed_search(problem, first, iterations))


def _with_fitted_recording(fitted: FitContext, recording: str) -> Predictor:
    """Make a predictor whose unknowns of a recording are held as identified, not as declared."""
    unknowns = fitted.vehicle.per_recording
    is_held = np.ones(len(unknowns.start), dtype=bool)
    held_unknowns = unknowns.believed(fitted.estimate.per_recording[recording]).held(is_held)
    return replace(fitted.predictor(), vehicle=replace(fitted.vehicle, per_recording=held_unknowns))
