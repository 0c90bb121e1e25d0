"""What commands lead to, with what it tells of the unknowns, and how both change with the commands.

The information is that of sensors which see every step; its derivative needs the second derivatives of the stage, but only
in the one direction that adjoints ask for: a course costs a few simulations with slopes, whatever the number of commands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.functions.compile import compile_function
from uvms_ocp.identification.methods.rollout import Rollout, chained
from uvms_ocp.identification.models.stage import N_V, Stage

_AT_REST = np.array([0.0, 0, 0, 0, 0, 0, 1])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Course:
    """From rest, in steps of one length."""

    x: np.ndarray
    """(n + 1, n_x) [as `Stage`]"""
    u: np.ndarray
    """(n, n_u) [N, N m] commands as they act, late."""
    late: np.ndarray
    """(n, n_u) [N/s, N m/s] by which they change with the delay."""
    y: np.ndarray
    """(n + 1, 9) [as `Stage.seen`]"""
    slopes: tuple[np.ndarray, ...]
    """A (n, n_x, n_x), B (n, n_x, n_p) and C (n, n_x, n_u) [any] of the steps."""
    S: np.ndarray
    """(n + 1, n_x, n_p) [any] how states change with the unknowns."""
    y_x: np.ndarray
    """(n + 1, 9, n_x) [any]"""
    J: np.ndarray
    """(n + 1, 9, n_p) [any] how what is seen changes with the unknowns."""


class Courses:
    """Of one vehicle with unknowns p (n_p,) [as `Unknowns.start`], in steps h [s], with joints (3 n_j,) [as `Stage`]."""

    def __init__(self, rollout: Rollout, p: np.ndarray, h: float, joints: np.ndarray) -> None:
        self._rollout, self._stage, self._p, self.h = rollout, rollout.stage, p, h
        self._joints, self._called = joints, dict[tuple[str, int], BufferedFunction]()
        delays, slopes = (np.asarray(one) for one in self._stage.delays(p))
        self.delay, self._late, self._seen_late = float(delays[0, 0]), slopes[0], slopes[1]

    def states(self, u: np.ndarray) -> np.ndarray:
        """(n + 1, n_x) [as `Stage`] after commands u (n, n_u) [N, N m] as they act."""
        x = np.concatenate([_AT_REST, np.zeros(N_V + self._stage.n_u)])
        whole = self._rollout.many("step", self._rollout.step, len(u), 1)
        (after,) = self._outputs(("step", len(u)), whole, x, *self._given(u))
        return np.vstack([x, after.T])

    def of(self, u: np.ndarray, late: np.ndarray) -> Course:
        """Simulate commands u (n, n_u) [N, N m] as they act, which change with the delay by late (n, n_u) [N/s, N m/s]."""
        x, stage = self.states(u), self._stage
        A, B, C = self._mapped("slope", self._rollout.slope, x[:-1].T, *self._given(u))
        B += np.einsum("kij,kj->ki", C, late)[:, :, None] * self._late
        S = chained(A, B, np.zeros((stage.n_x, stage.n_p)))
        y, y_x, y_p = self._mapped("seen", stage.seen, x.T, self._p)
        J = y_x @ S + y_p
        J[1:, :3] -= np.diff(y[:, :3], axis=0) / self.h * self._seen_late
        return Course(x=x, u=u, late=late, y=y[:, :, 0], slopes=(A, B, C), S=S, y_x=y_x, J=J)

    def pulled(self, one: Course, M: np.ndarray, with_x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How a figure [-] changes with u and late (n, n_u) [1/N, 1/(N m), and s times these].

        M: (n + 1, 9, n_p) [1 / unit of J] is how it changes with J, with_x: (n + 1, n_x) [1 / unit of x] with x itself.
        """
        A, _, C = one.slopes
        direct = np.swapaxes(one.y_x, 1, 2) @ M
        L = _backward(A, direct)[1:]
        late = L @ self._late
        weights = L @ np.swapaxes(one.S[:-1], 1, 2), L, late[:, :, None] * one.late[:, None, :]
        bent_x, bent_u = self._bent(one, weights)
        own = with_x + self._bent_seen(one, M) + np.vstack([bent_x, np.zeros(len(one.x[0]))])
        adjoint = _backward(A, own[:, :, None])[1:, :, 0]
        return bent_u + np.einsum("kij,ki->kj", C, adjoint), np.einsum("kij,ki->kj", C, late)

    def _bent(self, one: Course, weights: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
        found = self._mapped("bent", self._functions[0], one.x[:-1].T, *self._given(one.u), *_wide(weights))
        return found[0][:, :, 0], found[1][:, :, 0]

    def _bent_seen(self, one: Course, M: np.ndarray) -> np.ndarray:
        """With x (n + 1, n_x), by what is seen."""
        weights = M @ np.swapaxes(one.S, 1, 2), M
        (found,) = self._mapped("bent seen", self._functions[1], one.x.T, self._p, *_wide(weights))
        with_y = np.zeros_like(one.y)
        rate = M[1:, :3] @ self._seen_late[:, None] / self.h
        with_y[1:, :3] -= rate[:, :, 0]
        with_y[:-1, :3] += rate[:, :, 0]
        return np.asarray(found[:, :, 0] + np.einsum("kij,ki->kj", one.y_x, with_y))

    @cached_property
    def _functions(self) -> tuple[ca.Function, ca.Function]:
        return compile_function(_bent_step(self._stage)), _bent_seen(self._stage)

    def _given(self, u: np.ndarray) -> tuple[np.ndarray, ...]:
        return u.T, self._joints, self._p, np.full(1, self.h)

    def _mapped(self, name: str, function: ca.Function, *given: np.ndarray) -> list[np.ndarray]:
        """Outputs (n, rows, columns), where given[0] has n columns; what has one is the same for all."""
        n = given[0].shape[1]
        found = self._outputs((name, n), self._rollout.many(name, function, 0, n), *given)
        return [np.ascontiguousarray(one.reshape(len(one), n, -1).swapaxes(0, 1)) for one in found]

    def _outputs(self, key: tuple[str, int], function: ca.Function, *given: np.ndarray) -> tuple[np.ndarray, ...]:
        if key not in self._called:
            self._called[key] = BufferedFunction(function)
        return self._called[key](*given)


def _wide(parts: tuple[np.ndarray, ...]) -> Iterator[np.ndarray]:
    """(rows, n columns), of parts (n, rows, columns) side by side."""
    return (part.transpose(1, 0, 2).reshape(part.shape[1], -1) for part in parts)


def _backward(A: np.ndarray, direct: np.ndarray) -> np.ndarray:
    """(n + 1, n_x, k) ``L_k = direct_k + A_k' L_k+1``"""
    L = direct.copy()
    for k in range(len(A) - 1, -1, -1):
        L[k] += A[k].T @ L[k + 1]
    return L


def _bent_step(stage: Stage) -> ca.Function:
    """``x, u, joints, p, h, weights of A, B, C -> slopes of the weighted sum with x and u``"""
    shapes = (stage.n_x, 1), (stage.n_u, 1), (3 * stage.n_j, 1), (stage.n_p, 1), (1, 1)
    given = [ca.SX.sym("given", *shape) for shape in shapes]
    return _bent("bent", given, stage.slope(*given), given[:2])


def _bent_seen(stage: Stage) -> ca.Function:
    """``x, p, weights of dy/dx, dy/dp -> slope of the weighted sum with x``"""
    given = [ca.SX.sym("given", stage.n_x), ca.SX.sym("given", stage.n_p)]
    return _bent("bent_seen", given, stage.seen(*given)[1:], given[:1])


def _bent(name: str, given: list[ca.SX], slopes: list[ca.SX], along: list[ca.SX]) -> ca.Function:
    weights = [ca.SX.sym("weights", *one.shape) for one in slopes]
    total = sum((ca.dot(w, one) for w, one in zip(weights, slopes, strict=True)), ca.SX(0))
    return ca.Function(name, [*given, *weights], [ca.densify(ca.gradient(total, one)) for one in along], {"cse": True})
