"""Fit a vehicle to recordings from far away: roughly in short segments first, then in long ones.

In segments of a second everything is nearly linear in the unknowns, as in an equation error, if the
measurements at their beginnings are trusted and the end of one need not be the beginning of the
next. That solution is near enough to start the search in long segments.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from uvms_ocp.identification.estimates import Estimate, FitStatus, Noise, ProfilePenalty
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.predictor import (
    Predicted,
    Predictor,
    rolled_out,
)
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording, Segment

# The first, rough search.
_ROUGH_NOISE = 10.0  # times the noise: it is to find the way and not the place
_ROUGH_STEP = 0.05  # [s]
_ROUGH_SEGMENT = 1.0  # [s]
_ROUGH_ITERATIONS = 20
_ROUGH_TOLERANCE = 1e-3

# The second search, in coarser steps, leaves few of the fine ones, which take long.
_COARSE = 4.0  # times the step, but not more than the rough one
_LEAST_COARSE = 1.5  # times the step, at least: the two together tell what the step does

_ENOUGH = 600.0  # [s] of recordings that searches before the last one use
_ROUNDS = 10  # rounds of iterations, as long as each still lowers the cost


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FitContext:
    """Estimate with the vehicle, recordings and settings of its fit."""

    vehicle: Vehicle
    rollout: Rollout
    """Simulator of the vehicle's stage."""
    prepared: tuple[PreparedRecording, ...]
    """Recordings that the vehicle is fitted to."""
    noise: Noise
    """Standard deviations that weigh residuals."""
    search: Search
    """Settings by which recordings are cut into segments."""
    estimate: Estimate

    @classmethod
    def searched(
        cls,
        *,
        vehicle: Vehicle,
        rollout: Rollout,
        prepared: tuple[PreparedRecording, ...],
        noise: Noise,
        search: Search,
    ) -> FitContext:
        """Search for the estimate, see `search_fit`."""
        return cls(
            vehicle=vehicle,
            rollout=rollout,
            prepared=prepared,
            noise=noise,
            search=search,
            estimate=search_fit(vehicle, prepared, noise, rollout, search),
        )

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Segments of all recordings, in the order of the estimate's starts."""
        segments: list[Segment] = []
        for recording in self.prepared:
            segments += recording.segments(self.search.step, self.search.segment_length)
        return tuple(segments)

    def residuals(self) -> dict[str, Predicted]:
        """Return predicted and measured outputs in the segments of each recording, by its name."""
        predictions = defaultdict[str, list[Predicted]](list)
        shared = self.estimate.shared
        per_recording = self.estimate.per_recording
        for segment, start in zip(self.segments, self.estimate.starts, strict=True):
            recording = segment.recording
            prediction = rolled_out(self.rollout, segment, start, shared, per_recording[recording])
            predictions[recording].append(prediction)
        return {name: Predicted.joined(parts) for name, parts in predictions.items()}

    def predictor(self, shared: np.ndarray | None = None) -> Predictor:
        """Make a predictor with the unknowns of the estimate, or with shared (n,) [as
        `Unknowns.start`].
        """
        if shared is None:
            shared = self.estimate.shared
        return Predictor(
            vehicle=self.vehicle, rollout=self.rollout, shared=shared, noise=self.noise
        )

    def problem(self, penalty: ProfilePenalty | None = None) -> OutputErrorProblem:
        """Build the problem that the estimate solves; penalty: draws a number to a value."""
        return OutputErrorProblem(self.vehicle, self.segments, self.noise, self.rollout, penalty)

    def inflated(self, inflation: float) -> FitContext:
        """Inflate the variances, for intervals: the same optimum with less information.

        inflation: number of samples that miss alike, as `variance_inflation` finds. The cost of the
        measurements is divided by it. Priors are not; they are moved, so that they draw as little as
        the recordings do and the estimate stays where it is.
        """
        root = float(np.sqrt(inflation))
        shared = self.estimate.shared
        noise = replace(
            self.noise,
            velocity=root * self.noise.velocity,
            rate=root * self.noise.rate,
            vertical=root * self.noise.vertical,
            process=root * self.noise.process,
            start=root * self.noise.start,
            outliers=self.noise.outliers / root,
        )
        priors = self.vehicle.per_recording
        prior_means = shared - (shared - self.vehicle.shared.start) / inflation
        vehicle = replace(
            self.vehicle,
            shared=self.vehicle.shared.believed(prior_means),
            per_recording=priors.believed(priors.start, root),
        )
        return replace(self, vehicle=vehicle, noise=noise)


@dataclass(frozen=True, kw_only=True, slots=True)
class Search:
    """Settings of the search in long segments."""

    step: float = 0.02
    """[s] step of the simulation; intervals include the errors that come from its length."""
    segment_length: float = 20.0
    """[s] length of the segments."""
    iterations: int = 15
    """Number of iterations in a round; a search that has not converged goes on for more rounds."""
    progress: Callable[[str], None] = lambda _: None
    """Function that gets a line before each step."""


def search_fit(
    vehicle: Vehicle,
    recordings: Sequence[PreparedRecording],
    noise: Noise,
    rollout: Rollout,
    search: Search | None = None,
) -> Estimate:
    """Find the unknowns that explain the recordings best, from where the declaration has them."""
    settings = search or Search()
    duration = sum(float(np.ptp(recording.span)) for recording in recordings)
    thinning = max(1, round(duration / _ENOUGH))
    coarse_step = max(_LEAST_COARSE * settings.step, min(_COARSE * settings.step, _ROUGH_STEP))
    searches = [(coarse_step, thinning), (settings.step, thinning)]
    if thinning > 1:
        searches.append((settings.step, 1))
    optima = list[np.ndarray]()

    def build_problem(
        number: int, noise: Noise, step: float, segment_length: float, thinning: int
    ) -> OutputErrorProblem:
        """Build the problem of one search, which says its number before each step."""
        segments: list[Segment] = []
        for recording in recordings:
            segments += recording.segments(step, segment_length)
        problem = OutputErrorProblem(vehicle, _drawn_minutes(segments, thinning), noise, rollout)
        problem.progress = lambda text: settings.progress(
            f"search {number} of {len(searches) + 1}, {text}"
        )
        return problem

    rough = build_problem(1, _rough(noise), _ROUGH_STEP, _ROUGH_SEGMENT, thinning)
    estimate = rough.solve(rough.start(), iterations=_ROUGH_ITERATIONS, tolerance=_ROUGH_TOLERANCE)
    for k, (step, step_thinning) in enumerate(searches, start=2):
        fine = build_problem(k, noise, step, settings.segment_length, step_thinning)
        warm_start = fine.start(estimate.shared)
        # Starts come near first.
        estimate = fine.solve(warm_start, iterations=settings.iterations, frozen=int(k > 2))
        estimate = resumed_search(fine, estimate, settings.iterations)
        optima.append(estimate.shared)
    # Errors of the simulation grow with the square of its step (Richardson's extrapolation).
    step_error = (optima[1] - optima[0]) / ((coarse_step / settings.step) ** 2 - 1.0)
    return replace(estimate, assumed=np.outer(step_error, step_error))


def resumed_search(problem: OutputErrorProblem, estimate: Estimate, iterations: int) -> Estimate:
    """Resume a search that reached its iteration limit, in rounds, until it converges or no step is
    left.
    """
    for _ in range(_ROUNDS - 1):
        if estimate.status is not FitStatus.ITERATION_LIMIT:
            break
        continuation = problem.solve(problem.resumed(estimate), iterations=iterations)
        estimate = replace(continuation, iterations=estimate.iterations + continuation.iterations)
    return estimate


def _drawn_minutes(all_segments: Sequence[Segment], thinning: int) -> Sequence[Segment]:
    """Draw one of `thinning` minutes by lot, and return the segments that lie in them, as
    separate recordings; with `thinning` 1 return all segments as they are.
    """
    if thinning == 1:
        return all_segments

    def minute(segment: Segment) -> tuple[str, float]:
        return segment.recording, segment.edges[0] // 60.0

    groups = groupby(all_segments, key=minute)
    minutes = [list(group) for _, group in groups]
    n_drawn = -(-len(minutes) // thinning)
    # Not every nth minute: motions may alternate.
    numbers = sorted(np.random.default_rng(0).permutation(len(minutes))[:n_drawn])
    segments = []
    for k in numbers:
        for segment in minutes[k]:
            segments.append(replace(segment, recording=f"{segment.recording} {k}"))
    return segments


def _rough(noise: Noise) -> Noise:
    """Return the noise of the rough search: large, and next to no bond between segments."""
    sigmas = {
        name: _ROUGH_NOISE * getattr(noise, name) for name in ("velocity", "rate", "vertical")
    }
    return replace(noise, **sigmas, process=1.0, start=2.0 * noise.velocity, outliers=1e3)
