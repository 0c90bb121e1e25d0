"""Simulate shooting segments, many at once, with the sensitivities of what sensors show.

The derivatives of single steps come from the stage, and are chained: ``S_next = A S + B + C
du/dp``. That is the variational equation of the discrete model, so that slopes are those of what is
simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from uvms_ocp.codegen.background import n_processors
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.compile import compile_function
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.model import N_Q, N_V, PAST, PAST_STEP, StageFunctions
from uvms_ocp.identification.segments import Segment
from uvms_ocp.robot import spatial

N_SEEN = 9
"""Number of outputs, as `StageFunctions.outputs` has them: velocity, angular velocity, vertical, three
of each.
"""
N_START = 9
"""Number of unknowns of a start: velocity (6), then the turn of the attitude in B (3)."""
_MAX_STEPS = (
    4_000  # of steps in sequence in a function, and of states whose outputs are evaluated at once
)
Weights = Callable[[int, tuple[np.ndarray, ...]], Sequence[tuple[np.ndarray, np.ndarray]]]
"""Maps the index of a segment and its rows to weights w and weighted residuals w r of each sensor,
both (m, 3).
"""


class Rollout:
    """Simulator of segments by one stage; functions are compiled where there is a compiler, once
    for each number of steps.
    """

    def __init__(self, stage: StageFunctions) -> None:
        self.stage = stage
        self.step = compile_function(stage.step)
        self.slope = compile_function(stage.slope)
        self._many: dict[tuple[str, int, int], ca.Function] = {}

    def predict(
        self,
        segments: Sequence[Segment],
        starts: Sequence[SegmentStart],
        p: np.ndarray,
        weights: Weights | None = None,
    ) -> list[PredictedOutputs]:
        """Simulate segments of equally many steps, all with unknowns p (n, n_p) [any], a row for
        each; with slopes if weighted.

        Raises InvalidInput where they have different numbers of steps, or joints other than the
        vehicle's.
        """
        step_counts = {len(segment.edges) - 1 for segment in segments}
        n_joint_rows = {segment.joints.shape[0] for segment in segments}
        if len(step_counts) != 1 or n_joint_rows != {3 * self.stage.n_j}:
            raise InvalidInput(
                f"stretches of {sorted(step_counts)} steps; allowed: equally many, with all joints of the"
                " vehicle"
            )
        run = _SegmentSimulation(self, segments, starts, p, step_counts.pop())
        if weights is None:
            return run.rows()
        return run.with_slopes(weights)

    def many(self, name: str, function: ca.Function, n: int, m: int) -> ca.Function:
        """Return the map of a function over m arguments on all processors; with n, of the function
        applied n times in sequence.
        """
        key = (name, n, m)
        if key not in self._many:
            chain = function
            if n:
                chain = function.mapaccum(n)
            self._many[key] = chain.map(m, "thread", min(m, n_processors()))
        return self._many[key]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PredictedOutputs:
    """Predicted outputs of the three sensors over a segment, and the state at its end; from passes
    with slopes also weighted squares of the slopes.
    """

    rows: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -] predicted outputs."""
    end: np.ndarray
    """(n_x,) [as `StageFunctions`] state at the end."""
    H: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n_p + 9, n_p + 9) [1 / unknowns^2] ``sum w s s'`` of the slopes s of all rows with the
    unknowns, then with the start.
    """
    g: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n_p + 9,) [1 / unknowns] ``sum w r s`` with the residuals r."""
    loss: float = 0.0
    """Cost of the residuals of its rows, for passes that do not keep the rows."""
    end_slope: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n_x, n_p + 9) [as `StageFunctions`, per unknown] slope of the end with unknowns and start."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SegmentStart:
    """State in which a segment begins."""

    q: np.ndarray
    """(7,) [m, -] pose."""
    v: np.ndarray
    """(6,) [m/s, rad/s] velocity in B."""

    def moved(self, change: np.ndarray) -> SegmentStart:
        """Return the start moved by a change (9,) [m/s, rad/s, rad]."""
        turn = spatial.quaternion_exp(change[N_V:])
        turned = np.asarray(spatial.quaternion_multiply(self.q[3:], turn))
        attitude = turned / np.linalg.norm(turned)
        return SegmentStart(q=np.concatenate([self.q[:3], attitude]), v=self.v + change[:N_V])


class _SegmentSimulation:
    """One simulation of m segments in n steps, whose states (m, n + 1, n_x) are kept for slopes."""

    def __init__(
        self,
        rollout: Rollout,
        segments: Sequence[Segment],
        starts: Sequence[SegmentStart],
        p: np.ndarray,
        n_steps: int,
    ) -> None:
        self._rollout = rollout
        self._stage = rollout.stage
        self._segments = segments
        self._n_steps = n_steps
        self._p = p
        self._delays = self._each("delays", self._stage.delays, p.T)
        """Delays (2, 1) [s] and their slopes (2, n_p), segment by segment."""
        acting = []
        past = []
        for k, segment in enumerate(segments):
            acting.append(segment.commands.mean(segment.edges - self._command_delay(k)))
            past.append(segment.commands.mean(self._past_edges(k)).T)
        self._begun = self._each("begun", self._stage.begun, np.hstack(past), p.T)
        """Outputs of actuators at the start and their slopes, as in `StageFunctions.begun`, segment by
        segment.
        """
        self._step_inputs = (
            np.vstack(acting).T,
            np.hstack([segment.joints for segment in segments]),
            np.repeat(p, n_steps, axis=0).T,
            np.repeat([segment.step for segment in segments], n_steps)[None],
        )
        """Commands, joints, unknowns and length of every step, side by side, segment by segment."""
        self._x = self._simulated(starts)

    def rows(self) -> list[PredictedOutputs]:
        """Return the outputs at the times of the samples, without slopes."""
        m, n_edges, _ = self._x.shape
        parts = np.array_split(np.arange(m * n_edges), -(-m * n_edges // _MAX_STEPS))
        y = np.vstack([self._outputs(part)[0].T for part in parts]).reshape(m, n_edges, N_SEEN)
        predictions = []
        for k in range(m):
            predictions.append(PredictedOutputs(rows=self._sampled(k, y[k]), end=self._x[k, -1]))
        return predictions

    def with_slopes(self, weights: Weights) -> list[PredictedOutputs]:
        """Return the outputs at the times of the samples, with weighted squares of their slopes."""
        m, n_edges, _ = self._x.shape
        y, *derivatives = self._outputs(np.arange(m * n_edges))
        y = y.T.reshape(m, n_edges, N_SEEN)
        y_x, y_p = (_blocks(derivative, -1, m, n_edges) for derivative in derivatives)
        S = self._sensitivities()
        predictions = []
        for k in range(m):
            slopes = y_x[k] @ S[k]
            slopes[:, :, : self._stage.n_p] += y_p[k]
            rows = self._sampled(k, y[k])
            H, g = self._squares(k, y[k], slopes, weights(k, rows))
            predictions.append(
                PredictedOutputs(rows=rows, H=H, g=g, end=self._x[k, -1], end_slope=S[k, -1].copy())
            )
        return predictions

    def _simulated(self, starts: Sequence[SegmentStart]) -> np.ndarray:
        """Simulate the states (m, n + 1, n_x) from the starts of all segments."""
        m = len(self._p)
        n = self._n_steps
        x = np.empty((m, n + 1, self._stage.n_x))
        for k, (start, (thrust, _, _)) in enumerate(zip(starts, self._begun, strict=True)):
            x[k, 0] = np.concatenate([start.q, start.v, thrust.ravel()])
        for first in range(0, n, _MAX_STEPS):
            parts = []
            for inputs in self._step_inputs:
                by_segment = inputs.reshape(len(inputs), m, n)
                parts.append(by_segment[:, :, first : first + _MAX_STEPS])
            n_part = parts[0].shape[2]
            arguments = [part.reshape(len(part), m * n_part) for part in parts]
            function = self._rollout.many("step", self._rollout.step, n_part, m)
            (after,) = _evaluated(function, x[:, first].T, *arguments)
            x[:, first + 1 : first + 1 + n_part] = after.T.reshape(m, n_part, -1)
        return x

    def _squares(
        self,
        k: int,
        y: np.ndarray,
        slopes: np.ndarray,
        weights: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sum weighted squares over the samples by sums of weights over steps: a step may hold many
        samples, and slopes are linear within it.
        """
        n_p = slopes.shape[2]
        step = self._segments[k].step
        H = np.zeros((n_p, n_p))
        g = np.zeros(n_p)
        _, delay_slopes = self._delays[k]
        velocity_delay_slope = np.concatenate([-delay_slopes[1], np.zeros(N_START)])
        for sensor, (w, wr) in enumerate(weights):
            index, share = self._place(k, sensor)
            sensor_slopes = slopes[:, 3 * sensor : 3 * sensor + 3]
            # A delay shifts all samples along the rate of their step, but those before the first,
            # where there is only its start.
            steps, place = np.unique(
                np.where(index + share > 0.0, index, self._n_steps), return_inverse=True
            )
            first_edges = np.where(steps < self._n_steps, steps, 0)
            last_edges = np.where(steps < self._n_steps, steps + 1, 0)
            shift: np.ndarray | float = 0.0
            if sensor == 0:
                change = (y[last_edges, :3] - y[first_edges, :3])[..., None]
                shift = change / step * velocity_delay_slope
            edge_slopes = [
                (sensor_slopes[edges] + shift).reshape(-1, n_p)
                for edges in (first_edges, last_edges)
            ]
            edge_shares = [1.0 - share[:, None], share[:, None]]
            place = (3 * place.reshape(-1, 1) + np.arange(3)).ravel()
            size = 3 * len(steps)
            for row_share, row_slope in zip(edge_shares, edge_slopes, strict=True):
                weighted = []
                for column_share, column_slope in zip(edge_shares, edge_slopes, strict=True):
                    sums = np.bincount(place, (w * row_share * column_share).ravel(), size)
                    weighted.append(sums[:, None] * column_slope)
                H += row_slope.T @ (weighted[0] + weighted[1])
                g += row_slope.T @ np.bincount(place, (wr * row_share).ravel(), size)
        return H, g

    def _outputs(self, chosen: np.ndarray) -> list[np.ndarray]:
        """Evaluate the outputs and their derivatives, side by side, at the chosen (l,) of all
        states.
        """
        function = self._rollout.many("seen", self._stage.outputs, 0, len(chosen))
        n_edges = self._x.shape[1]
        states = self._x.reshape(-1, self._stage.n_x)[chosen]
        return _evaluated(function, states.T, self._p[chosen // n_edges].T)

    def _each(
        self, name: str, function: ca.Function, *arguments: np.ndarray
    ) -> list[list[np.ndarray]]:
        """Evaluate a function for every segment, whose arguments are side by side."""
        m = len(self._p)
        results = _evaluated(self._rollout.many(name, function, 0, m), *arguments)
        blocks = [np.split(result, m, axis=1) for result in results]
        return [list(segment_results) for segment_results in zip(*blocks, strict=True)]

    def _sensitivities(self) -> np.ndarray:
        """Compute the slopes (m, n + 1, n_x, n_p + 9) of states with unknowns and starts."""
        m = len(self._segments)
        n = self._n_steps
        stage = self._stage
        before = self._x[:, :-1].reshape(-1, stage.n_x).T
        function = self._rollout.many("slope", self._rollout.slope, 0, m * n)
        by_x, by_p, by_u = _evaluated(function, before, *self._step_inputs)
        A = _blocks(by_x, stage.n_x, m, n)
        B = _blocks(by_p, stage.n_p, m, n)
        C = _blocks(by_u, stage.n_u, m, n)
        for k, segment in enumerate(self._segments):
            _, delay_slopes = self._delays[k]
            by_delay = -segment.commands.mean_slope(segment.edges - self._command_delay(k))
            B[k] += np.einsum("nij,nj->ni", C[k], by_delay)[:, :, None] * delay_slopes[0]
        first = np.array([self._start_slope(k) for k in range(m)])
        return np.moveaxis(chained(np.moveaxis(A, 1, 0), np.moveaxis(B, 1, 0), first), 0, 1)

    def _start_slope(self, k: int) -> np.ndarray:
        """Compute the slope (n_x, n_p + 9) of the first state of a segment."""
        n_p = self._stage.n_p
        S = np.zeros((self._stage.n_x, n_p + N_START))
        _, by_unknowns, by_past = self._begun[k]
        _, delay_slopes = self._delays[k]
        past_change = -self._segments[k].commands.mean_slope(self._past_edges(k))
        by_delay = by_past @ past_change.ravel()  # command by command
        S[N_Q + N_V :, :n_p] = by_unknowns + np.outer(by_delay, delay_slopes[0])
        S[N_Q : N_Q + N_V, n_p : n_p + N_V] = np.eye(N_V)
        S[3:N_Q, n_p + N_V :] = turn_slope(self._x[k, 0, 3:N_Q])
        return S

    def _command_delay(self, k: int) -> float:
        """Return the delay [s] of commands in segment k."""
        return self._delays[k][0][0, 0]

    def _past_edges(self, k: int) -> np.ndarray:
        """Return the edges (PAST + 1,) [s] of the commands before the start of segment k."""
        begin = self._segments[k].edges[0] - self._command_delay(k)
        return begin + PAST_STEP * np.arange(-PAST, 1)

    def _sampled(self, k: int, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Interpolate the rows of each sensor at the times of its samples."""
        sampled = []
        for sensor in range(3):
            index, share = self._place(k, sensor)
            rows = values[:, 3 * sensor : 3 * sensor + 3]
            later = share[:, None]
            sampled.append((1.0 - later) * rows[index] + later * rows[index + 1])
        return tuple(sampled)

    def _place(self, k: int, sensor: int) -> tuple[np.ndarray, np.ndarray]:
        """Locate the samples of a sensor: the step (m,) of each, and the share (m,) of the step
        before it.
        """
        segment = self._segments[k]
        delay = 0.0  # [s]
        if sensor == 0:
            delay = float(self._delays[k][0][1, 0])
        place = np.maximum((segment.t[sensor] - delay - segment.edges[0]) / segment.step, 0.0)
        index = np.clip(place.astype(int), 0, self._n_steps - 1)
        return index, place - index


def chained(A: np.ndarray, B: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Solve (n + 1, ..., n_x, k) [any] ``S_next = A S + B``, B for the first n_p columns only,
    those of unknowns.

    A: (n, ..., n_x, n_x) [any], B: (n, ..., n_x, n_p) [any], first: (..., n_x, k) [any].
    """
    S = np.empty((len(A) + 1, *first.shape))
    S[0] = first
    n_p = B.shape[-1]
    for k, (A_k, B_k) in enumerate(zip(A, B, strict=True)):
        S[k + 1] = A_k @ S[k]
        S[k + 1, ..., :n_p] += B_k
    return S


def turn_slope(quaternion: np.ndarray) -> np.ndarray:
    """Compute the derivative of a quaternion (4,) xyzw by a turn in B, (4, 3) [1/rad]."""
    x, y, z, w = quaternion
    return np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]) / 2


def _evaluated(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Evaluate a function; results are column by column in memory of their own, as lists of numbers
    would take longer than the function.
    """
    buffered = BufferedFunction(function)
    buffered.write(*arguments)
    buffered.evaluate()
    results = []
    for k, result in enumerate(buffered.results):  # where columns are (m,)
        results.append(result.reshape(function.size_out(k), order="F"))
    return results


def _blocks(wide: np.ndarray, width: int, m: int, n: int) -> np.ndarray:
    """View (m, n, rows, width) of m n blocks side by side, in the same memory where that is column
    by column.
    """
    return np.moveaxis(wide.T.reshape(m, n, width, len(wide)), 2, 3)
