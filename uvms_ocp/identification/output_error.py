"""Output-error identification by multiple shooting and Gauss-Newton, with a pseudo-Huber loss.

The start of every segment is unknown, and the end of a segment may differ from the start of the
next by process noise. Unknowns of single recordings, and starts, are eliminated recording by
recording, so that a step costs little more than the simulation.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, groupby

import numpy as np

from uvms_ocp.identification.estimates import (
    Estimate,
    FitStatus,
    Noise,
    ProfilePenalty,
    SearchPoint,
)
from uvms_ocp.identification.model import N_Q, N_V, Vehicle
from uvms_ocp.identification.normal_equations import (
    Elimination,
    NormalEquations,
    are_finite,
    loss,
    weights,
)
from uvms_ocp.identification.rollout import (
    N_START,
    PredictedOutputs,
    Rollout,
    SegmentStart,
    turn_slope,
)
from uvms_ocp.identification.segments import Segment
from uvms_ocp.robot.spatial import quaternion_conjugate, quaternion_log, quaternion_multiply

_LEAST_DAMPING = 1e-9  # damping of a Gauss-Newton step
_PROMISED_GAIN = 30.0
"""Gain, in tolerances, above which a search has not converged where an undamped step promises it,
however little the last step gained.
"""
_MAX_STEPS = 4_000  # steps of segments that are simulated together, which take tens of megabytes


class OutputErrorProblem:
    """Least-squares problem of a vehicle and segments of recordings; the segments of one recording
    follow each other.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        segments: Sequence[Segment],
        noise: Noise,
        rollout: Rollout,
        penalty: ProfilePenalty | None = None,
    ) -> None:
        self._vehicle = vehicle
        self._noise = noise
        self._rollout = rollout
        self._penalty = penalty
        self._recordings = [
            tuple(group) for _, group in groupby(segments, key=lambda segment: segment.recording)
        ]
        self._n_shared = len(vehicle.shared.start)
        self._n_per_recording = len(vehicle.per_recording.start)
        self._sigma = noise.velocity, noise.rate, noise.vertical
        self.progress: Callable[[str], None] = lambda _: None  # gets a line before each step

    def start(self, shared: np.ndarray | None = None) -> SearchPoint:
        """Return the first iterate: unknowns as declared, or shared (n,) [as `Unknowns.start`];
        segments begin as measured.
        """
        begins = tuple(tuple(map(_measured_start, group)) for group in self._recordings)
        if shared is None:
            shared = self._vehicle.shared.start
        per_recording = tuple(self._vehicle.per_recording.start for _ in self._recordings)
        return SearchPoint(shared=shared, per_recording=per_recording, starts=begins)

    def resumed(self, estimate: Estimate) -> SearchPoint:
        """Return the iterate at which an estimate from the same segments ended."""
        per_recording = tuple(
            estimate.per_recording[group[0].recording] for group in self._recordings
        )
        begins = []
        first = 0
        for group in self._recordings:
            begins.append(estimate.starts[first : first + len(group)])
            first += len(group)
        return SearchPoint(
            shared=estimate.shared, per_recording=per_recording, starts=tuple(begins)
        )

    def stepped(
        self, point: SearchPoint, blocks: list[NormalEquations] | None = None
    ) -> tuple[SearchPoint, float]:
        """Take one step of Gauss and Newton; return the point after it and the cost there.

        blocks: normal equations at the point without the penalty, the same for any penalty.
        """
        if blocks is None:
            blocks = self.blocks(point)
        try:
            next_point = self._moved(point, blocks, _LEAST_DAMPING, frozen=False)
        except np.linalg.LinAlgError:  # there is no such step
            return point, self._total(point, [block.cost for block in blocks])
        with np.errstate(all="ignore"):
            costs = []
            for k, outputs in enumerate(self._simulated(next_point)):
                costs.append(self._cost(k, next_point, outputs))
            return next_point, self._total(next_point, costs)

    def solve(
        self,
        point: SearchPoint,
        *,
        iterations: int = 20,
        frozen: int = 0,
        tolerance: float = 1e-4,
        damping: float = 1e-3,
    ) -> Estimate:
        """Minimise the cost by Levenberg and Marquardt's method.

        frozen: number of first steps in which shared unknowns stay. tolerance: share of the cost
        that is worth a step. damping: of the first step.
        """
        blocks = self.blocks(point)
        status = FitStatus.ITERATION_LIMIT
        n_done = 0
        if not are_finite(blocks):
            return self._estimate(point, blocks, FitStatus.RUNS_AWAY, 0)
        while n_done < iterations:
            n_done += 1
            self.progress(f"step {n_done} of at most {iterations}")
            trial = self._step(point, blocks, damping, n_done <= frozen)
            if trial is None:
                status = FitStatus.STALLED
                break
            next_point, damping, cost, next_blocks = trial
            gain = 1.0 - cost / self._total(point, [block.cost for block in blocks])
            point = next_point
            blocks = next_blocks
            if gain < tolerance and (n_done > frozen or frozen >= iterations):
                # A step that damping held back gains little anywhere.
                is_frozen = frozen >= iterations
                if is_frozen or self._promised_gain(point, blocks) < _PROMISED_GAIN * tolerance:
                    status = FitStatus.CONVERGED
                    break
        return self._estimate(point, blocks, status, n_done)

    def _promised_gain(self, point: SearchPoint, blocks: list[NormalEquations]) -> float:
        """Compute the share of the cost by which the undamped step of the shared unknowns would
        lower it.

        That is half the square of Newton's decrement, from gradient and normal equations at the
        point; unknowns that a bound stops do not count.
        """
        if not self._n_shared:
            return 0.0
        if not self._is_solvable(point, blocks):
            return np.inf
        H, g, _ = self._reduced(point, blocks, 0.0)
        if self._penalty is not None:
            penalty_H, penalty_g = self._penalty.normal(point.shared)
            H = H + penalty_H
            g = g + penalty_g
        shared = self._vehicle.shared
        at_lower = (point.shared <= shared.lower) & (g > 0.0)
        at_upper = (point.shared >= shared.upper) & (g < 0.0)
        is_free = ~(at_lower | at_upper)
        stiffness = H[np.ix_(is_free, is_free)] + _LEAST_DAMPING * np.eye(int(is_free.sum()))
        try:
            step = np.linalg.solve(stiffness, g[is_free])
        except np.linalg.LinAlgError:  # a step of any length
            return np.inf
        decrease = 0.5 * float(g[is_free] @ step)
        cost = self._total(point, [block.cost for block in blocks])
        return decrease / max(cost, np.finfo(float).tiny)

    def _step(
        self, point: SearchPoint, blocks: list[NormalEquations], damping: float, frozen: bool
    ) -> tuple[SearchPoint, float, float, list[NormalEquations]] | None:
        """Find a step that lowers the cost (Levenberg-Marquardt); return the point after it, the next
        damping, the cost and the normal equations, all finite; `None` where there is no such step.
        """
        present_cost = self._total(point, [block.cost for block in blocks])
        for _ in range(8):
            try:
                next_point = self._moved(point, blocks, damping, frozen)
            except np.linalg.LinAlgError:  # rounding has left no positive definite matrix
                damping *= 8.0
                continue
            next_blocks = self.blocks(next_point)  # with slopes, as most steps are taken
            cost = self._total(next_point, [block.cost for block in next_blocks])
            if np.isfinite(cost) and cost < present_cost and are_finite(next_blocks):
                return next_point, max(damping / 5.0, _LEAST_DAMPING), cost, next_blocks
            damping *= 8.0
        return None

    def _moved(
        self, point: SearchPoint, blocks: list[NormalEquations], damping: float, frozen: bool
    ) -> SearchPoint:
        """Take one damped step, within the bounds of the unknowns; frozen: shared unknowns stay, and
        only starts and unknowns of single recordings move.
        """
        H, g, eliminations = self._reduced(point, blocks, damping)
        change = np.zeros(self._n_shared)
        if not frozen and self._n_shared:
            damped = H + damping * np.diag(np.diag(H) + 1e-9)
            if self._penalty is not None:
                penalty_H, penalty_g = self._penalty.normal(point.shared)
                damped = damped + penalty_H
                g = g + penalty_g
            change = -np.linalg.solve(damped, g)
        bounds = self._vehicle.shared
        shared = np.clip(point.shared + np.clip(change, -1.0, 1.0), bounds.lower, bounds.upper)
        change = shared - point.shared
        per_recording = []
        starts = []
        for k, elimination in enumerate(eliminations):
            local = elimination(change)
            per_recording.append(point.per_recording[k] + local[: self._n_per_recording])
            start_changes = np.clip(local[self._n_per_recording :].reshape(-1, N_START), -0.5, 0.5)
            moved = []
            for start, start_change in zip(point.starts[k], start_changes, strict=True):
                moved.append(start.moved(start_change))
            starts.append(tuple(moved))
        return SearchPoint(shared=shared, per_recording=tuple(per_recording), starts=tuple(starts))

    def _reduced(
        self, point: SearchPoint, blocks: list[NormalEquations], damping: float
    ) -> tuple[np.ndarray, np.ndarray, list[Elimination]]:
        """Build the normal equations of the shared unknowns, and the maps from their change to
        those of the others.
        """
        weight = 1.0 / self._vehicle.shared.sigma**2
        parts = [block.without_starts(damping, self._n_shared) for block in blocks]
        H = np.diag(weight) + sum(part[0] for part in parts)
        prior_gradient = weight * (point.shared - self._vehicle.shared.start)
        g = prior_gradient + sum(part[1] for part in parts)
        eliminations = [part[2] for part in parts]
        return H, g, eliminations

    def _is_solvable(self, point: SearchPoint, blocks: list[NormalEquations]) -> bool:
        """Check whether the undamped normal equations have a solution."""
        try:
            self._reduced(point, blocks, 0.0)
        except np.linalg.LinAlgError:
            return False
        return True

    def _estimate(
        self, point: SearchPoint, blocks: list[NormalEquations], status: FitStatus, iterations: int
    ) -> Estimate:
        """Make the estimate at the point where a search ended."""
        informative = blocks
        if status is FitStatus.RUNS_AWAY or not self._is_solvable(point, blocks):
            informative = []  # of which nothing is learnt
        names = [group[0].recording for group in self._recordings]
        return Estimate(
            shared=point.shared,
            per_recording=dict(zip(names, point.per_recording, strict=True)),
            starts=tuple(chain.from_iterable(point.starts)),
            cost=self._total(point, [block.cost for block in blocks]),
            information=self._reduced(point, informative, 0.0)[0],
            status=status,
            iterations=iterations,
        )

    def _total(self, point: SearchPoint, costs: Sequence[float]) -> float:
        """Add the costs of all recordings, of the priors, and of the profile's penalty."""
        deviations = (point.shared - self._vehicle.shared.start) / self._vehicle.shared.sigma
        penalty = 0.0
        if self._penalty is not None:
            penalty = self._penalty.cost(point.shared)
        return float(sum(costs) + deviations @ deviations / 2 + penalty)

    def blocks(self, point: SearchPoint) -> list[NormalEquations]:
        """Build the normal equations of every recording at a point."""
        blocks = []
        with np.errstate(all="ignore"):
            for k, outputs in enumerate(self._simulated(point, slopes=True)):
                blocks.append(self._block(k, point, outputs))
        return blocks

    def _simulated(
        self, point: SearchPoint, *, slopes: bool = False
    ) -> list[list[PredictedOutputs]]:
        """Simulate the segments of every recording, those of equally many steps in batches whose
        size memory allows.
        """
        jobs = []
        for recording, segments in enumerate(self._recordings):
            unknowns = np.r_[point.shared, point.per_recording[recording]]
            for segment, start in zip(segments, point.starts[recording], strict=True):
                jobs.append(_SegmentJob(recording, segment, start, unknowns))
        places_by_length = defaultdict[int, list[int]](list)
        for place, job in enumerate(jobs):
            places_by_length[len(job.segment.edges)].append(place)
        predictions: dict[int, PredictedOutputs] = {}
        for n_edges, places in places_by_length.items():
            n_at_once = max(1, _MAX_STEPS // n_edges)
            for first in range(0, len(places), n_at_once):
                batch = places[first : first + n_at_once]
                outputs = self._simulated_batch([jobs[place] for place in batch], slopes=slopes)
                predictions.update(zip(batch, outputs, strict=True))
        by_recording: list[list[PredictedOutputs]] = [[] for _ in self._recordings]
        for place, job in enumerate(jobs):
            by_recording[job.recording].append(predictions[place])
        return by_recording

    def _simulated_batch(
        self, jobs: Sequence[_SegmentJob], *, slopes: bool
    ) -> Iterator[PredictedOutputs]:
        """Simulate segments of equally many steps; yield their predictions with the loss of the rows
        in place of the rows.
        """
        segments = [job.segment for job in jobs]
        starts = [job.start for job in jobs]
        unknowns = np.array([job.unknowns for job in jobs])
        weighting = partial(self._weights, segments) if slopes else None
        predictions = self._rollout.predict(segments, starts, unknowns, weighting)
        for segment, prediction in zip(segments, predictions, strict=True):
            residuals = self._residuals(segment, prediction.rows)
            total_loss = sum(loss(residual, self._noise.outliers) for residual in residuals)
            yield replace(prediction, rows=(), loss=total_loss)

    def _residuals(self, segment: Segment, rows: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Compute the weighted residuals (m, 3) of each sensor."""
        residuals = []
        for predicted, measured, sigma in zip(rows, segment.measured, self._sigma, strict=True):
            residuals.append((predicted - measured) / sigma)
        return residuals

    def _weights(
        self, segments: Sequence[Segment], k: int, rows: Sequence[np.ndarray]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Compute weights and weighted residuals (m, 3) of the slopes of segment k, sensor by
        sensor.
        """
        pairs = []
        for residual, sigma in zip(self._residuals(segments[k], rows), self._sigma, strict=True):
            weight = weights(residual, self._noise.outliers)
            pairs.append((weight / sigma**2, weight * residual / sigma))
        return pairs

    def _cost(self, k: int, point: SearchPoint, outputs: list[PredictedOutputs]) -> float:
        """Compute the cost of recording k: of its rows, its starts, and the gaps between segments."""
        cost_of_rows = sum(prediction.loss for prediction in outputs)
        _, cost_of_starts = self._beginnings(k, point)
        squares = sum(gap @ gap for gap, _ in self._gaps(k, point, outputs))
        return float(cost_of_rows + cost_of_starts + squares / 2)

    def _beginnings(self, k: int, point: SearchPoint) -> tuple[list[np.ndarray], float]:
        """Compute weighted residuals of the starts against the measurements, and the cost of these and
        of the unknowns of recording k against their priors.
        """
        residuals = []
        for segment, start in zip(self._recordings[k], point.starts[k], strict=True):
            residuals.append(difference(_measured_start(segment), start) / self._noise.start)
        priors = self._vehicle.per_recording
        deviations = (point.per_recording[k] - priors.start) / priors.sigma
        squares = sum(residual @ residual for residual in residuals)
        return residuals, float(squares + deviations @ deviations) / 2

    def _gaps(
        self, k: int, point: SearchPoint, outputs: list[PredictedOutputs]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Compute weighted gaps (9,) between the ends of segments and the next starts, with their
        slopes with end states (9, n_x).
        """
        gaps = []
        for prediction, start in zip(outputs[:-1], point.starts[k][1:], strict=True):
            end = SegmentStart(q=prediction.end[:N_Q], v=prediction.end[N_Q : N_Q + N_V])
            slope = np.zeros((N_START, len(prediction.end)))
            slope[:N_V, N_Q : N_Q + N_V] = np.eye(N_V)
            slope[N_V:, 3:N_Q] = 4.0 * turn_slope(end.q[3:]).T
            gaps.append((difference(start, end) / self._noise.process, slope / self._noise.process))
        return gaps

    def _block(
        self, k: int, point: SearchPoint, outputs: list[PredictedOutputs]
    ) -> NormalEquations:
        """Build the normal equations of recording k from its simulated segments."""
        n = self._n_shared
        size = self._n_shared + self._n_per_recording
        slope_back = -1.0 / self._noise.process
        priors = self._vehicle.per_recording
        weight = 1.0 / priors.sigma**2
        start_residuals, _ = self._beginnings(k, point)
        # Blocks of each segment with itself, then of its start with the next one.
        hessians = np.array([prediction.H for prediction in outputs])
        gradients = np.array([prediction.g for prediction in outputs])
        hessians[:, size:, size:] += np.eye(N_START) / self._noise.start**2
        gradients[:, size:] += np.array(start_residuals) / self._noise.start
        gaps = self._gaps(k, point, outputs)
        if gaps:
            gap_slopes = []
            for (_, slope), prediction in zip(gaps, outputs[:-1], strict=True):
                gap_slopes.append(slope @ prediction.end_slope)
            J = np.array(gap_slopes)
            gap = np.array([residual for residual, _ in gaps])
            hessians[:-1] += J.swapaxes(1, 2) @ J
            hessians[1:, size:, size:] += slope_back**2 * np.eye(N_START)
            hessians[1:, size:, :size] += slope_back * J[:, :, :size]
            gradients[:-1] += np.einsum("lij,li->lj", J, gap)
            gradients[1:, size:] += slope_back * gap
        # Lower band of the starts' matrix: row i of a column is the entry i places below the
        # diagonal.
        band = np.zeros((3 * N_START, len(outputs), N_START))
        band[:N_START] = np.moveaxis(hessians[:, size:, size:], 1, 0)
        if gaps:
            band[N_START : 2 * N_START, :-1] = slope_back * np.moveaxis(J[:, :, size:], 1, 0)
        rows = np.arange(2 * N_START)[:, None, None] + np.arange(N_START)
        prior_H = np.diag(np.r_[np.zeros(n), weight])
        prior_g = np.r_[np.zeros(n), weight * (point.per_recording[k] - priors.start)]
        return NormalEquations(
            cost=self._cost(k, point, outputs),
            H=prior_H + hessians[:, :size, :size].sum(axis=0),
            g=prior_g + gradients[:, :size].sum(axis=0),
            H_starts=np.take_along_axis(band, rows, axis=0).reshape(2 * N_START, -1),
            g_starts=gradients[:, size:].ravel(),
            cross=hessians[:, size:, :size].reshape(-1, size),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _SegmentJob:
    """A segment to be simulated."""

    recording: int
    """Index of its recording."""
    segment: Segment
    """Inputs and measurements along it."""
    start: SegmentStart
    """State at which it begins."""
    unknowns: np.ndarray
    """(n + m,) [as `Unknowns.start`] shared unknowns, then those of the recording."""


def _measured_start(segment: Segment) -> SegmentStart:
    """Return the start of a segment as it was measured."""
    return SegmentStart(q=segment.q, v=segment.v)


def difference(begin: SegmentStart, end: SegmentStart) -> np.ndarray:
    """Compute the change (9,) [m/s, rad/s, rad] that moves one start to another."""
    turn = quaternion_log(quaternion_multiply(quaternion_conjugate(begin.q[3:]), end.q[3:]))
    return np.concatenate([end.v - begin.v, np.asarray(turn).ravel()])
