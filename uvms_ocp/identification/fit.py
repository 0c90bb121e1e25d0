"""Fit a vehicle to recordings from far away, and predict recordings with the fit.

In segments of a second everything is nearly linear in the unknowns, as in an equation error; that
solution starts long ones.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import getitem

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import (
    Estimate,
    FitStatus,
    Noise,
    OutputErrorProblem,
    ProfilePenalty,
)
from uvms_ocp.identification.parameters import Declaration, Unknowns
from uvms_ocp.identification.rollout import PreparedRecording, Rollout, Segment, SegmentStart

# What a vehicle predicts of a recording from its commands alone, once it is known how the vehicle
# moved at the beginning.

_ITERATIONS = 10

_COARSER = 10.0  # noise of the first search, which is to find the way and not the place
# times the steps with which most of the way is gone: few of the fine ones, which take long, are
# left
_COARSE = 4.0
_COARSER_STEP = 1.5  # times the step, at least, with which another search tells what the step does
# [s]
_ROUGH_STEP = 0.05
_ROUGH_STRETCH = 1.0
_ROUGH_ITERATIONS = 20
_ROUGH_TOLERANCE = 1e-3
_NOTHING = 1e-9  # of information
# [s] of recordings, on which the way is found that the last search goes on along all of them
_ENOUGH = 600.0
_ROUNDS = 10  # of iterations, the first among them, while each of them still lowers the cost


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
        later = [times > t for times in self.t]
        return Predicted(
            t=tuple(map(getitem, self.t, later)),
            rows=tuple(map(getitem, self.rows, later)),
            measured=tuple(map(getitem, self.measured, later)),
        )

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
    stretch: Segment,
    start: SegmentStart,
    shared: np.ndarray,
    per_recording: np.ndarray,
) -> Predicted:
    """Simulate a stretch from its start, with unknowns shared (n,) of all recordings and per_recording
    (m,) of this one [as `Unknowns.start`].
    """
    (outputs,) = rollout.predict([stretch], [start], np.concatenate([shared, per_recording])[None])
    return Predicted(t=stretch.t, rows=outputs.rows, measured=stretch.measured)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Predictor:
    """Predictor of recordings by a vehicle with identified unknowns."""

    vehicle: Vehicle
    rollout: Rollout
    shared: np.ndarray
    """(n,) [as `Unknowns.start`] unknowns of all recordings."""
    noise: Noise
    """Noise with which starts are fitted."""
    start_window: float = 2.0
    """[s] length of the beginning of a stretch to which its start is fitted."""
    fits_per_recording: bool = False
    """True to fit the unknowns that a recording has for itself there, too; else they stay as
    declared.
    """

    def of(self, stretch: Segment) -> Predicted:
        """Predict a whole stretch."""
        error = OutputErrorProblem(
            self.vehicle, [stretch.first(self.start_window)], self.noise, self.rollout
        )
        estimate = error.solve(error.start(self.shared), iterations=_ITERATIONS, frozen=_ITERATIONS)
        per_recording = self.vehicle.per_recording.start
        if self.fits_per_recording:
            per_recording = estimate.per_recording[stretch.recording]
        return rolled_out(self.rollout, stretch, estimate.starts[0], self.shared, per_recording)

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


@checked
def fit_percent(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Compute the normalised fit [%], ``100 (1 - |error| / |measured - mean|)``, of measured and
    predicted (m,); 0: as good as the mean.
    """
    error = np.linalg.norm(predicted - measured)
    error_of_mean = np.linalg.norm(measured - measured.mean())
    return 100.0 * (1.0 - float(error / error_of_mean))


# Output error from far away: roughly in short stretches first, then as it is meant.
#
# In stretches of a second everything is nearly linear in the unknowns, as in an equation error, if
# what their beginnings showed is trusted and the end of one need not be the beginning of the next.
# What is found there is near enough for long ones.


@dataclass(frozen=True, kw_only=True, slots=True)
class Search:
    """Settings of the second part of the search."""

    step: float = 0.02
    """[s] of the simulation; errors from a step that is too long are in the intervals."""
    stretch: float = 20.0
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
    chosen = search or Search()
    duration = sum(float(np.ptp(recording.recording.span)) for recording in recordings)
    thinning = max(1, round(duration / _ENOUGH))
    coarse = max(_COARSER_STEP * chosen.step, min(_COARSE * chosen.step, _ROUGH_STEP))
    steps = [(coarse, thinning), (chosen.step, thinning)]
    if thinning > 1:
        steps.append((chosen.step, 1))
    optima = list[np.ndarray]()

    def error(
        number: int, noise: Noise, step: float, stretch: float, thinning: int
    ) -> OutputErrorProblem:
        parts: list[Segment] = []
        for recording in recordings:
            parts += recording.stretches(step, stretch)
        problem = OutputErrorProblem(vehicle, _some(parts, thinning), noise, rollout)
        problem.progress = lambda text: chosen.progress(
            f"search {number} of {len(steps) + 1}, {text}"
        )
        return problem

    rough = error(1, _rough(noise), _ROUGH_STEP, _ROUGH_STRETCH, thinning)
    estimate = rough.solve(rough.start(), iterations=_ROUGH_ITERATIONS, tolerance=_ROUGH_TOLERANCE)
    for k, (step, step_thinning) in enumerate(steps, start=2):
        fine = error(k, noise, step, chosen.stretch, step_thinning)
        begin = fine.start(estimate.shared)
        # Starts come near first.
        estimate = fine.solve(begin, iterations=chosen.iterations, frozen=int(k > 2))
        estimate = resumed_search(fine, estimate, chosen.iterations)
        optima.append(estimate.shared)
    # Errors of the simulation grow with the square of its step (Richardson's extrapolation).
    step_error = (optima[1] - optima[0]) / ((coarse / chosen.step) ** 2 - 1.0)
    return replace(estimate, assumed=np.outer(step_error, step_error))


def _some(stretches: Sequence[Segment], thinning: int) -> Sequence[Segment]:
    """Draw one of `thinning` minutes by lot, and return the segments that lie in them, as
    separate recordings; with `thinning` 1 return all segments as they are.
    """
    if thinning == 1:
        return stretches
    groups = groupby(stretches, key=lambda segment: (segment.recording, segment.edges[0] // 60.0))
    minutes = [list(group) for _, group in groups]
    n_drawn = -(-len(minutes) // thinning)
    # Not every nth minute: motions may alternate.
    numbers = sorted(np.random.default_rng(0).permutation(len(minutes))[:n_drawn])
    segments = []
    for k in numbers:
        for segment in minutes[k]:
            segments.append(replace(segment, recording=f"{segment.recording} {k}"))
    return segments


def resumed_search(error: OutputErrorProblem, estimate: Estimate, iterations: int) -> Estimate:
    """Resume a search that reached its iteration limit, in rounds, until it converges or no step is
    left.
    """
    for _ in range(_ROUNDS - 1):
        if estimate.status is not FitStatus.ITERATION_LIMIT:
            break
        continuation = error.solve(error.resumed(estimate), iterations=iterations)
        estimate = replace(continuation, iterations=estimate.iterations + continuation.iterations)
    return estimate


def _rough(noise: Noise) -> Noise:
    sigmas = {name: _COARSER * getattr(noise, name) for name in ("velocity", "rate", "vertical")}
    return replace(noise, **sigmas, process=1.0, start=2.0 * noise.velocity, outliers=1e3)


# A vehicle, the recordings that it was identified on, and how: what answers are asked of.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FitContext:
    """Estimate with the vehicle, recordings and settings of its fit."""

    vehicle: Vehicle
    rollout: Rollout
    prepared: tuple[PreparedRecording, ...]
    noise: Noise
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
    def stretches(self) -> tuple[Segment, ...]:
        """Segments of all recordings, in the order of the estimate's starts."""
        segments: list[Segment] = []
        for recording in self.prepared:
            segments += recording.stretches(self.search.step, self.search.stretch)
        return tuple(segments)

    def residuals(self) -> dict[str, Predicted]:
        """Return measurements beside the simulation in the segments of each recording, by its
        name.
        """
        predictions = defaultdict[str, list[Predicted]](list)
        shared = self.estimate.shared
        per_recording = self.estimate.per_recording
        for segment, start in zip(self.stretches, self.estimate.starts, strict=True):
            predictions[segment.recording].append(
                rolled_out(self.rollout, segment, start, shared, per_recording[segment.recording])
            )
        return {name: Predicted.joined(parts) for name, parts in predictions.items()}

    def predictor(self, shared: np.ndarray | None = None) -> Predictor:
        """Make a predictor with the unknowns of the estimate, or with shared (n,) [as
        `Unknowns.start`].
        """
        chosen = self.estimate.shared if shared is None else shared
        return Predictor(
            vehicle=self.vehicle, rollout=self.rollout, shared=chosen, noise=self.noise
        )

    def problem(self, pull: ProfilePenalty | None = None) -> OutputErrorProblem:
        """Build the problem that the estimate solves, with a penalty that draws one number to a
        value if given.
        """
        return OutputErrorProblem(self.vehicle, self.stretches, self.noise, self.rollout, pull)

    def inflated(self, inflation: float) -> FitContext:
        """Build the problem with inflated variances, for intervals: the same optimum with less
        information.

        inflation: samples that miss alike, as `variance_inflation` finds. The cost of what is seen
        is divided by it. Priors are not; they are moved, so that they draw as little as the
        recordings do and the estimate stays where it is.
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
        prior_means = shared - (shared - self.vehicle.shared.start) / inflation
        per_recording = self.vehicle.per_recording.believed(self.vehicle.per_recording.start, root)
        vehicle = replace(
            self.vehicle,
            shared=self.vehicle.shared.believed(prior_means),
            per_recording=per_recording,
        )
        return replace(self, vehicle=vehicle, noise=noise)


def constant_slopes(
    fitted: FitContext, constants: Sequence[str]
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return coordinates of the quantities that a fit held, and slopes (n, m) of its n unknowns
    with m of these.

    What each recording may have for itself is off in all of them alike.
    """
    unknowns = fitted.vehicle.shared
    quantities = dict(fitted.vehicle.shared.declaration.quantities)
    for name in constants:
        all_free = np.ones_like(quantities[name].free)
        quantities[name] = replace(quantities[name], free=all_free, per_recording=False)
    all_unknowns = Unknowns(Declaration(quantities=quantities))
    learnt = np.isin(all_unknowns.names, unknowns.names)
    point = all_unknowns.start
    point[learnt] = fitted.estimate.shared
    per_recording = Unknowns(all_unknowns.declaration, per_recording=True)
    vehicle = replace(fitted.vehicle, shared=all_unknowns, per_recording=per_recording)
    rollout = Rollout(stage_of(vehicle, sharp=True))
    problem = replace(fitted, vehicle=vehicle, rollout=rollout).problem()
    start = problem.resumed(replace(fitted.estimate, shared=point))
    H = problem.solve(start, iterations=0).information
    stiffness = H[np.ix_(learnt, learnt)] + _NOTHING * np.eye(int(learnt.sum()))
    to_constants = H[np.ix_(learnt, ~learnt)]
    try:
        slopes = -np.linalg.solve(stiffness, to_constants)
    except np.linalg.LinAlgError:  # unknowns that nothing tells do not move
        slopes = -np.linalg.pinv(stiffness, hermitian=True) @ to_constants
    return tuple(np.array(all_unknowns.names)[~learnt].tolist()), slopes
