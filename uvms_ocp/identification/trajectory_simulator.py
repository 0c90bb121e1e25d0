"""Simulate an experiment from rest, with its sensitivities, and the gradient of a criterion of them.

The gradient needs the second derivatives of the stage, but only in the one direction that adjoints
ask for: a trajectory costs a few simulations with slopes, whatever the number of commands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from uvms_ocp.codegen import BufferedFunction, compile_function
from uvms_ocp.identification import model
from uvms_ocp.identification.rollout import Rollout, chained

_AT_REST = np.array([0.0, 0, 0, 0, 0, 0, 1])  # pose: position, quaternion


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
        """(n_p,) [s per unknown] slope of the delay of commands."""
        self._velocity_delay_slope = velocity_delay_slope
        """(n_p,) [s per unknown] slope of the delay of velocities."""

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

    def criterion_gradient(
        self, trajectory: ExperimentTrajectory, M: np.ndarray, with_x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the gradient of a criterion by u and late (n, n_u) [1/N, 1/(N m), and s times
        these] (adjoint method).

        M: (n + 1, 9, n_p) [1 / unit of J] derivative of the criterion by J; with_x: (n + 1, n_x) [1 /
        unit of x] its derivative by x itself.
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
        """Function ``x, u, joints, p, h, weights of A, B, C -> slopes of the weighted sum with x, u``,
        compiled.
        """
        stage = self._stage
        shapes = ((stage.n_x, 1), (stage.n_u, 1), (3 * stage.n_j, 1), (stage.n_p, 1), (1, 1))
        arguments = [ca.SX.sym("given", *shape) for shape in shapes]
        slopes = stage.slope(*arguments)
        return compile_function(_weighted_gradient("bent", arguments, slopes, arguments[:2]))

    @cached_property
    def _output_curvature(self) -> ca.Function:
        """Function ``x, p, weights of dy/dx, dy/dp -> slope of the weighted sum with x``."""
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
        """Evaluate a function through memory that is kept by a key."""
        if key not in self._buffered:
            self._buffered[key] = BufferedFunction(function)
        return self._buffered[key](*arguments)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ExperimentTrajectory:
    """Simulated trajectory from rest, in steps of one length, with its sensitivities."""

    x: np.ndarray
    """(n + 1, n_x) [as `StageFunctions`] states."""
    u: np.ndarray
    """(n, n_u) [N, N m] commands as they act, after their delay."""
    late: np.ndarray
    """(n, n_u) [N/s, N m/s] slopes of these commands with the delay."""
    y: np.ndarray
    """(n + 1, 9) [as `StageFunctions.outputs`] outputs."""
    slopes: tuple[np.ndarray, ...]
    """Slopes of the steps: A (n, n_x, n_x), B (n, n_x, n_p) and C (n, n_x, n_u) [any], by states,
    unknowns and commands.
    """
    S: np.ndarray
    """(n + 1, n_x, n_p) [any] slopes of the states with the unknowns."""
    y_x: np.ndarray
    """(n + 1, 9, n_x) [any] slopes of the outputs with the states."""
    J: np.ndarray
    """(n + 1, 9, n_p) [any] slopes of the outputs with the unknowns."""


def _wide(parts: tuple[np.ndarray, ...]) -> Iterator[np.ndarray]:
    """Yield arrays (rows, n columns) of parts (n, rows, columns), put side by side."""
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
