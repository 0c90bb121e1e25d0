"""Experiments: limits of thrust and pool, commands as knots, the trajectory that follows from them
and its Fisher information.

The information is that of sensors which see every step; its derivative needs the second derivatives
of the stage, but only in the one direction that adjoints ask for: a trajectory costs a few
simulations with slopes, whatever the number of commands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_constructor, checked_dataclass
from uvms_ocp.codegen import BufferedFunction, compile_function
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import model, output_error, recording
from uvms_ocp.identification.rollout import Rollout, chained
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.types import Array, Shape

_AT_REST = np.array([0.0, 0, 0, 0, 0, 0, 1])  # pose: position, quaternion
_NOTHING = 1e-6  # [1 / unknowns^2] what is known of an unknown without a prior
_SHARP = 20.0
"""Power of standard errors whose mean counts: 0 would make all count alike, more and more the worst
alone.
"""
_WITHIN = 1e-9  # share of a step by which edges are moved inside it


@checked_dataclass(checked_constructor, eq=False)
class ExperimentLimits:
    """Limits of commands and motion. Raises InvalidInput for limits that the start already
    violates.
    """

    thrust: Annotated[Array, Shape("n_u", 2)]
    """(n_u, 2) [N, N m] lowest and highest command of each actuator, around 0."""
    pool: Annotated[Array, Shape(2, 3)]
    """(2, 3) [m] corners between which the hull stays, in W, from where the vehicle's origin
    begins.
    """
    hull: Annotated[Array, Shape(2, 3)] = field(default_factory=lambda: np.zeros((2, 3)))
    """(2, 3) [m] lowest and highest corner of a box that holds the hull, in B; default: the origin
    alone.
    """
    slew: float = np.inf
    """[N/s, N m/s] by which a command may change."""
    tilt: float = 0.7
    """[rad] between the vehicle's z axis and W's."""
    margin: float = 0.1
    """Share of the pool's half width and of the tilt that is kept free: other numbers lead
    elsewhere.
    """

    def __post_init__(self) -> None:
        if not (_are_sizes(self.thrust * [-1, 1]) and _are_sizes(self.pool * [[-1], [1]])):
            raise InvalidInput(
                "thrust or pool without 0 inside given; allowed: lowest below 0, highest above,"
                " finite"
            )
        if not (self.slew > 0.0 and 0.0 < self.tilt < np.pi / 2 and 0.0 <= self.margin < 1.0):
            problem = f"slew = {self.slew}, tilt = {self.tilt}, margin = {self.margin} given"
            raise InvalidInput(
                f"{problem}; allowed: slew > 0, tilt from 0 to pi/2, margin from 0 to 1"
            )
        if not (self.hull[0] <= self.hull[1]).all():
            raise InvalidInput(
                f"hull {self.hull.tolist()} given; allowed: its lowest corner, then its highest"
            )
        if not (self.room > 0.0).all():
            raise InvalidInput(
                f"hull of {_sides(self.hull)} m in a pool of {_sides(self.pool)} m given; give a"
                " pool that leaves it room"
            )

    @property
    def room(self) -> np.ndarray:
        """(3,) [m] that the vehicle can go either way before the hull, turned as at first, comes to
        a wall.
        """
        return np.asarray(((self.pool - self.hull) * [[-1.0], [1.0]]).min(axis=0))

    def swept(self, x: np.ndarray) -> np.ndarray:
        """Compute the (2, 3) [m] lowest and highest corner of a box in W around the hull at all
        states x (n, n_x) [as `StageFunctions`].
        """
        R = _rotations(x[:, 3:7])
        middle = x[:, :3] + R @ self.hull.mean(axis=0)
        reach = np.abs(R) @ (np.diff(self.hull, axis=0)[0] / 2)
        return np.array([(middle - reach).min(axis=0), (middle + reach).max(axis=0)])

    def kept(self, commands: np.ndarray, step: float) -> np.ndarray:
        """Clip commands (n, n_u) [N, N m], a step [s] apart, to thrust and slew; they begin from
        0.
        """
        limited = np.empty_like(commands)
        before = np.zeros(commands.shape[1])
        for k, command in enumerate(commands):
            limited[k] = self.after(before, command, step)
            before = limited[k]
        return limited

    def after(self, before: np.ndarray, command: np.ndarray, step: float) -> np.ndarray:
        """Return the possible command (n_u,) [N, N m] nearest to command (n_u,) [N, N m], a step
        [s] after before (n_u,) [N, N m].
        """
        largest_change = self.slew * step
        within_thrust = np.clip(command, *self.thrust.T)
        return np.asarray(np.clip(within_thrust, before - largest_change, before + largest_change))

    def beyond(self, x: np.ndarray, margin: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Compute by how much states x (n, n_x) leave pool and tilt (n, 4) [-, in half widths], and
        the slope with x (n, 4, 7).

        margin: default: the limits' own.
        """
        if margin is None:
            margin = self.margin
        remaining = 1.0 - margin
        far = np.zeros((len(x), 4))
        slope = np.zeros((len(x), 4, 7))
        far[:, :3], slope[:, :3] = self._distances(x)
        # The root of qx^2 + qy^2 is the sine of half the tilt.
        leaning = np.maximum(np.hypot(x[:, 3], x[:, 4]), 1e-9)
        largest_lean = np.sin(remaining * self.tilt / 2)
        far[:, 3] = leaning / largest_lean
        slope[:, 3, 3:5] = x[:, 3:5] / leaning[:, None] / largest_lean
        over = far - [remaining, remaining, remaining, 1.0]
        return np.maximum(over, 0.0), slope * (over > 0.0)[:, :, None]

    def _distances(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute distances of the hull's outermost corners from the pool's middle (n, 3) [-, in
        half widths], and their slope (n, 3, 7).
        """
        centre = self.hull.mean(axis=0)
        size = np.diff(self.hull, axis=0)[0] / 2
        half = np.diff(self.pool, axis=0)[0] / 2
        R = _rotations(x[:, 3:7])
        R_q = np.einsum("ijkl,nl->nijk", _ROTATION_CURVATURE, x[:, 3:7])
        off = x[:, :3] + R @ centre - np.asarray(self.pool.mean(axis=0))
        side = np.where(off < 0.0, -1.0, 1.0)
        outermost = centre + side[:, :, None] * np.sign(R) * size  # corner in each direction
        by_position = np.tile(np.eye(3), (len(x), 1, 1))
        by_quaternion = np.einsum("nijk,nij->nik", R_q, outermost)
        slope = np.concatenate([by_position, by_quaternion], axis=2)
        return (np.abs(off) + np.abs(R) @ size) / half, slope * (side / half)[:, :, None]


def _sides(corners: np.ndarray) -> str:
    """Write the lengths [m] of the sides of a box between corners (2, 3) [m]."""
    return " x ".join(f"{side:.4g}" for side in corners[1] - corners[0])


def _rotations(q: np.ndarray) -> np.ndarray:
    """Compute rotations (n, 3, 3) from B to W by quaternions q (n, 4)."""
    return np.moveaxis(np.array(quaternion_to_matrix(q.T)), -1, 0)


def _rotation_curvature() -> np.ndarray:
    """Compute (3, 3, 4, 4) second derivatives of a rotation matrix with its quaternion, in which it
    is a quadratic form.
    """
    e = np.eye(4)
    sums = (e[:, None] + e).reshape(-1, 4)
    of_each = _rotations(e) - np.eye(3)
    of_sums = _rotations(sums).reshape(4, 4, 3, 3) - np.eye(3)
    return np.moveaxis(of_sums - of_each[:, None] - of_each, (0, 1), (2, 3))


_ROTATION_CURVATURE = _rotation_curvature()


def _are_sizes(values: np.ndarray) -> bool:
    """Check that values are positive and finite."""
    return bool(((values > 0.0) & (values < np.inf)).all())


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ExperimentTrajectory:
    """Simulated trajectory from rest, in steps of one length, with its sensitivities."""

    x: np.ndarray
    """(n + 1, n_x) [as `StageFunctions`] states."""
    u: np.ndarray
    """(n, n_u) [N, N m] commands as they act, late."""
    late: np.ndarray
    """(n, n_u) [N/s, N m/s] by which they change with the delay."""
    y: np.ndarray
    """(n + 1, 9) [as `StageFunctions.outputs`] outputs."""
    slopes: tuple[np.ndarray, ...]
    """A (n, n_x, n_x), B (n, n_x, n_p) and C (n, n_x, n_u) [any] of the steps."""
    S: np.ndarray
    """(n + 1, n_x, n_p) [any] how states change with the unknowns."""
    y_x: np.ndarray
    """(n + 1, 9, n_x) [any] slopes of the outputs with the states."""
    J: np.ndarray
    """(n + 1, 9, n_p) [any] slopes of the outputs with the unknowns."""


class TrajectorySimulator:
    """Simulator of a vehicle with unknowns p (n_p,) [as `Unknowns.start`], steps h [s], joints (3
    n_j,) [as `StageFunctions`].
    """

    def __init__(self, rollout: Rollout, p: np.ndarray, h: float, joints: np.ndarray) -> None:
        self._rollout = rollout
        self._stage = rollout.stage
        self._p = p
        self.h = h
        self._joints = joints
        self._buffered = dict[tuple[str, int], BufferedFunction]()
        delays, slopes = self._stage.delays(p)
        self.delay = float(np.asarray(delays)[0, 0])
        command_delay_slope, velocity_delay_slope = np.asarray(slopes)
        self._delay_slope = command_delay_slope
        """(n_p,) [s per unknown] how the delay of commands changes with the unknowns."""
        self._velocity_delay_slope = velocity_delay_slope
        """(n_p,) [s per unknown] how the delay of velocities changes with the unknowns."""

    def states(self, u: np.ndarray) -> np.ndarray:
        """Simulate states (n + 1, n_x) [as `StageFunctions`] after commands u (n, n_u) [N, N m] as
        they act.
        """
        n = len(u)
        begin = np.concatenate([_AT_REST, np.zeros(model.N_V + self._stage.n_u)])
        all_steps = self._rollout.many("step", self._rollout.step, n, 1)
        (after,) = self._outputs(("step", n), all_steps, begin, *self._arguments(u))
        return np.vstack([begin, after.T])

    def of(self, u: np.ndarray, late: np.ndarray) -> ExperimentTrajectory:
        """Simulate commands u (n, n_u) [N, N m] as they act, which change with the delay by late
        (n, n_u) [N/s, N m/s].
        """
        x = self.states(u)
        stage = self._stage
        A, B, C = self._mapped("slope", self._rollout.slope, x[:-1].T, *self._arguments(u))
        B += np.einsum("kij,kj->ki", C, late)[:, :, None] * self._delay_slope
        S = chained(A, B, np.zeros((stage.n_x, stage.n_p)))
        y, y_x, y_p = self._mapped("seen", stage.outputs, x.T, self._p)
        J = y_x @ S + y_p
        J[1:, :3] -= np.diff(y[:, :3], axis=0) / self.h * self._velocity_delay_slope
        return ExperimentTrajectory(
            x=x, u=u, late=late, y=y[:, :, 0], slopes=(A, B, C), S=S, y_x=y_x, J=J
        )

    def pulled(
        self, trajectory: ExperimentTrajectory, M: np.ndarray, with_x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the gradient of a criterion by u and late (n, n_u) [1/N, 1/(N m), and s times
        these] (adjoint method).

        M: (n + 1, 9, n_p) [1 / unit of J] is how it changes with J, with_x: (n + 1, n_x) [1 / unit
        of x] with x itself.
        """
        A, _, C = trajectory.slopes
        L = _backward(A, np.swapaxes(trajectory.y_x, 1, 2) @ M)[1:]
        with_late = L @ self._delay_slope
        weights = (
            L @ np.swapaxes(trajectory.S[:-1], 1, 2),
            L,
            with_late[:, :, None] * trajectory.late[:, None, :],
        )
        second_slopes = self._mapped(
            "bent",
            self._step_curvature,
            trajectory.x[:-1].T,
            *self._arguments(trajectory.u),
            *_wide(weights),
        )
        by_x = second_slopes[0][:, :, 0]
        by_u = second_slopes[1][:, :, 0]
        by_last_x = np.zeros(len(trajectory.x[0]))
        direct = with_x + self._by_outputs(trajectory, M) + np.vstack([by_x, by_last_x])
        adjoint = _backward(A, direct[:, :, None])[1:, :, 0]
        gradient = by_u + np.einsum("kij,ki->kj", C, adjoint)
        return gradient, np.einsum("kij,ki->kj", C, with_late)

    def _by_outputs(self, trajectory: ExperimentTrajectory, M: np.ndarray) -> np.ndarray:
        """Compute the second-order part of the gradient by x (n + 1, n_x), of the outputs."""
        weights = (M @ np.swapaxes(trajectory.S, 1, 2), M)
        (by_x,) = self._mapped(
            "bent seen", self._output_curvature, trajectory.x.T, self._p, *_wide(weights)
        )
        with_y = np.zeros_like(trajectory.y)
        rate = M[1:, :3] @ self._velocity_delay_slope[:, None] / self.h
        with_y[1:, :3] -= rate[:, :, 0]
        with_y[:-1, :3] += rate[:, :, 0]
        return np.asarray(by_x[:, :, 0] + np.einsum("kij,ki->kj", trajectory.y_x, with_y))

    @cached_property
    def _step_curvature(self) -> ca.Function:
        """Compiled ``x, u, joints, p, h, weights of A, B, C -> slopes of the weighted sum with x, u``."""
        stage = self._stage
        shapes = ((stage.n_x, 1), (stage.n_u, 1), (3 * stage.n_j, 1), (stage.n_p, 1), (1, 1))
        arguments = [ca.SX.sym("given", *shape) for shape in shapes]
        slopes = stage.slope(*arguments)
        return compile_function(_weighted_gradient("bent", arguments, slopes, arguments[:2]))

    @cached_property
    def _output_curvature(self) -> ca.Function:
        """``x, p, weights of dy/dx, dy/dp -> slope of the weighted sum with x``"""
        arguments = [ca.SX.sym("given", self._stage.n_x), ca.SX.sym("given", self._stage.n_p)]
        _, *slopes = self._stage.outputs(*arguments)
        return _weighted_gradient("bent_seen", arguments, slopes, arguments[:1])

    def _arguments(self, u: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return commands, joints, unknowns and step, as functions of the stage take them after
        states.
        """
        return u.T, self._joints, self._p, np.full(1, self.h)

    def _mapped(self, name: str, function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate outputs (n, rows, columns), where arguments[0] has n columns; an argument with
        one column is the same for all.
        """
        n = arguments[0].shape[1]
        all_steps = self._rollout.many(name, function, 0, n)
        by_step = []
        for output in self._outputs((name, n), all_steps, *arguments):
            blocks = output.reshape(len(output), n, -1).swapaxes(0, 1)
            by_step.append(np.ascontiguousarray(blocks))
        return by_step

    def _outputs(
        self, key: tuple[str, int], function: ca.Function, *arguments: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        if key not in self._buffered:
            self._buffered[key] = BufferedFunction(function)
        return self._buffered[key](*arguments)


def _wide(parts: tuple[np.ndarray, ...]) -> Iterator[np.ndarray]:
    """Yield arrays (rows, n columns), of parts (n, rows, columns) side by side."""
    for part in parts:
        yield part.transpose(1, 0, 2).reshape(part.shape[1], -1)


def _backward(A: np.ndarray, direct: np.ndarray) -> np.ndarray:
    """Solve (n + 1, n_x, k) ``L_k = direct_k + A_k' L_k+1``, from the end to the beginning."""
    L = direct.copy()
    for k in range(len(A) - 1, -1, -1):
        L[k] += A[k].T @ L[k + 1]
    return L


def _weighted_gradient(
    name: str, arguments: list[ca.SX], slopes: list[ca.SX], along: list[ca.SX]
) -> ca.Function:
    """Build ``arguments, weights of slopes -> gradients of the weighted sum of slopes along``."""
    weights = [ca.SX.sym("weights", *slope.shape) for slope in slopes]
    total = ca.SX(0)
    for weight, slope in zip(weights, slopes, strict=True):
        total += ca.dot(weight, slope)
    gradients = [ca.densify(ca.gradient(total, argument)) for argument in along]
    return ca.Function(name, [*arguments, *weights], gradients, {"cse": True})


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InformationCriterion:
    """Scalar criterion of the Fisher information of an experiment."""

    slopes: np.ndarray
    """(m, n_p) [units of numbers, per unknown] of the numbers that matter."""
    prior_information: np.ndarray
    """(n_p, n_p) [1 / unknowns^2] of priors, and of recordings that there are."""
    noise: output_error.Noise
    """Standard deviations of the sensors."""
    rate: float
    """[Hz] of the sensors."""

    def weights(self, h: float) -> np.ndarray:
        """Compute weights (9,) [1 / unit^2] of the outputs, in steps of h [s]."""
        sigma = np.repeat([self.noise.velocity, self.noise.rate, self.noise.vertical], 3)
        return self.rate * h / sigma**2

    def information(self, trajectory: ExperimentTrajectory, h: float) -> np.ndarray:
        """Compute the information (n_p, n_p) [1 / unknowns^2] of a trajectory alone, in steps h
        [s].
        """
        weighted = trajectory.J * np.sqrt(self.weights(h))[:, None]
        J = weighted.reshape(-1, trajectory.J.shape[-1])
        return np.asarray(J.T @ J)

    def figure(
        self, trajectory: ExperimentTrajectory, h: float, targets: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Compute the logarithm of the numbers' standard errors over targets (m,) [units of
        numbers], in which those farthest off count most.

        With its slope with J (n + 1, 9, n_p); steps h [s].
        """
        covariances = self.slopes @ self.covariance(self.information(trajectory, h))
        variances = np.maximum(np.einsum("ij,ij->i", covariances, self.slopes), 1e-300)
        value, share = _softly_largest(np.log(variances) / 2 - np.log(targets))
        by_information = -np.einsum(
            "ij,ik,i->jk", covariances, covariances, 0.5 * share / variances
        )
        return value, 2.0 * self.weights(h)[:, None] * (trajectory.J @ by_information)

    def deviations(self, information: np.ndarray) -> np.ndarray:
        """Compute standard errors (m,) [units of numbers] after recordings of some information
        (n_p, n_p) [1 / unknowns^2].
        """
        covariance = self.covariance(information)
        variances = np.einsum("ij,jk,ik->i", self.slopes, covariance, self.slopes)
        return np.asarray(np.sqrt(variances))

    def covariance(self, information: np.ndarray) -> np.ndarray:
        """Compute the covariance (n_p, n_p) [unknowns^2] after recordings of some information (n_p,
        n_p) [1 / unknowns^2].
        """
        known_of_all = _NOTHING * np.eye(len(self.prior_information))
        total = information + self.prior_information + known_of_all
        # Unknowns differ by powers of ten in what is known of them.
        scale = 1.0 / np.sqrt(np.diag(total))
        return np.asarray(scale[:, None] * np.linalg.inv(total * np.outer(scale, scale)) * scale)


def _softly_largest(values: np.ndarray) -> tuple[float, np.ndarray]:
    """Compute a smooth maximum of values (m,), between their mean and the largest, with its slope
    (m,).
    """
    largest = float(values.max())
    exponentials = np.exp(_SHARP * (values - largest))
    smooth_maximum = largest + float(np.log(exponentials.mean())) / _SHARP
    return smooth_maximum, exponentials / exponentials.sum()


class KnotCommands:
    """Piecewise linear commands that begin and end with 0, as sparse linear maps from knots
    (n_knots, n_u) [N, N m].
    """

    def __init__(self, duration: float, interval: float, step: float, delay: float) -> None:
        """Place knots about `interval` [s] apart in a duration [s]; commands are held for `step`
        [s] and act with a delay [s].
        """
        n = round(duration / step)
        inner = max(1, round(duration / interval) - 1)
        self.sent = _lines(n, inner, step * (inner + 1) / duration)
        """(n, n_knots) commands as they are sent, held for a step each."""
        # A command of one step only: what it does is the same at any time.
        pulse = recording.Channel(t=step * np.arange(n), values=np.eye(n, 1, -1))
        held = recording.ZeroOrderHold(pulse)
        edges = edges_of(n, step, delay)
        acting = _shifted(held.mean(edges)[:, 0])
        late = _shifted(-held.mean_slope(edges)[:, 0])
        self.acting = acting @ self.sent
        """(n, n_knots) commands as they act, late."""
        self.late = late @ self.sent
        """(n, n_knots) [1/s] how commands as they act change with the delay."""

    @property
    def n_knots(self) -> int:
        """Number of knots without those at both ends."""
        return int(self.sent.shape[1])

    def nearest(self, sent: np.ndarray) -> np.ndarray:
        """Knots (n_knots, n_u) [N, N m] whose commands are nearest to sent (n, n_u) [N, N m]."""
        from scipy.sparse.linalg import spsolve  # a tenth of a second

        square = (self.sent.T @ self.sent).tocsc()
        if np.linalg.matrix_rank(square.toarray(), hermitian=True) < self.n_knots:
            # Knots that no command shows stay at 0.
            return np.asarray(np.linalg.pinv(self.sent.toarray()) @ sent)
        return np.asarray(spsolve(square, self.sent.T @ sent)).reshape(self.n_knots, -1)


def edges_of(n: int, step: float, delay: float) -> np.ndarray:
    """Return the times (n + 1,) [s], from 0, of the commands that act in steps of `step` [s], where
    commands act by delay [s] late.
    """
    # Delays are often whole steps: rounding would decide, edge by edge, which of two commands
    # changes with them.
    return step * (np.arange(n + 1) + _WITHIN) - delay


def _lines(n: int, inner: int, spacing: float) -> Any:
    """Compute shares (n, inner) of knots in n samples that lie `spacing` knots apart; the first
    knot and the last are 0.
    """
    from scipy.sparse import csr_array

    place = spacing * np.arange(n)
    knot = np.minimum(place.astype(int), inner)
    share = place - knot
    rows = np.tile(np.arange(n), 2)
    columns = np.concatenate([knot, knot + 1])
    shares = np.concatenate([1.0 - share, share])
    with_ends = csr_array((shares, (rows, columns)), shape=(n, inner + 2))
    return with_ends[:, 1:-1]


def _shifted(response: np.ndarray) -> Any:
    """Build the map (n, n) [any] from commands to their effects, of which a command in the second
    step has the effect response (n,) [any].
    """
    from scipy.sparse import diags

    n = len(response)
    later = np.flatnonzero(response)
    return diags(response[later], 1 - later, shape=(n, n), format="csr")


def multisine(rng: np.random.Generator, n_knots: int, n_u: int, waves: float) -> np.ndarray:
    """Draw knots (n_knots, n_u) [-] of sines with random phases, at most 1; waves: number of waves
    of the fastest from begin to end.
    """
    orders = np.arange(1, max(1, round(waves)) + 1)
    turns = 2 * np.pi * orders[:, None] * np.linspace(0.0, 1.0, n_knots)
    phases = 2 * np.pi * rng.uniform(size=(len(turns), 1, n_u))
    sines = np.sin(turns[:, :, None] + phases).sum(axis=0)
    return np.asarray(sines / np.abs(sines).max(axis=0))
