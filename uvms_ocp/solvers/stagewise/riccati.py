"""The linear algebra of riccati.c in NumPy, for machines without a C compiler; keep both in step."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.stagewise.options import STAGE_TOLERANCES
from uvms_ocp.solvers.stagewise.stage_qp import StageQp, StageShape, slices


class NumpyStages:
    """The stages of one QP."""

    def __init__(self, shape: StageShape) -> None:
        self.shape = shape
        self._x, self._z, self._c = slices(shape.n_x), slices(shape.n_z), slices(shape.n_c)
        self.fixed, self.q = np.zeros(sum(shape.n_z)), np.zeros(sum(shape.n_z))
        self._Q: list[Array] = []
        self._L = [np.zeros((n, n)) for n in shape.n_z]
        """The cost-to-go of the state, and below it the rows of the factor of the rest; of stages before one that failed, those
        of the factor before, with which later iterations go on."""
        self._inverse = [np.zeros(n) for n in shape.n_z]
        self._least = 1.0
        self._qp: StageQp

    def load(self, qp: StageQp, *, costless: bool = False) -> float:
        """Take the data over and make the Hessian, without the cost of `costless`; the largest curvature [1/unit of z^2]."""
        self._qp = qp
        if costless:
            self._Q, self.q[:] = [STAGE_TOLERANCES.phase_one * np.eye(n) for n in self.shape.n_z], 0.0
            self._least = STAGE_TOLERANCES.smallest_curvature * STAGE_TOLERANCES.phase_one
            return STAGE_TOLERANCES.phase_one
        self._Q = [
            J.T @ J + np.tril(H) + np.tril(H, -1).T + np.diag(damping)
            for J, H, damping in zip(qp.J, qp.H, qp.damping, strict=True)
        ]
        self.q[:] = np.concatenate([J.T @ r + g for J, r, g in zip(qp.J, qp.r, qp.g, strict=True)])
        most = max(np.diag(Q).max(initial=0.0) for Q in self._Q)
        most = most if most > 0.0 else 1.0
        self._least = STAGE_TOLERANCES.smallest_curvature * most
        return float(most)

    def factor(self, weight: Array, weight_z: Array) -> int:
        """With a weight (n_c,) [1/unit of the row^2] on rows, and weight_z (n,) [1/unit of z^2] on variables.

        0, or 1 where the cost is not convex, 2 where it is not a number.
        """
        for k in range(self.shape.N, -1, -1):
            C = self._qp.C[k]
            M = self._Q[k] + C.T @ (weight[self._c[k], None] * C) + np.diag(weight_z[self._z[k]])
            if k < self.shape.N:
                after, F = self.shape.n_x[k + 1], self._qp.dynamics[k]
                M += F.T @ self._L[k + 1][:after, :after] @ F
            fixed = self.fixed[self._z[k]] > 0.0
            M[fixed], M[:, fixed] = 0.0, 0.0
            M[fixed, fixed] = 1.0
            L, inverse, failed = _eliminated(M, self.shape.n_x[k] if k else 0, self._least)
            self._L[k], self._inverse[k] = L, inverse
            if failed:
                return failed
        return 0

    def solve(self, g: Array, d: Array) -> tuple[Array, Array]:
        """The step that minimises ``1/2 dz' Q dz + g' dz`` along ``dx_+ = F dz + d``, and its costates.

        g (n,) [1/unit of z]; d (n_x,) [unit of x], of which that of the first stage is not read.
        """
        h = [np.where(self.fixed[z] > 0.0, 0.0, g[z]) for z in self._z]
        for k in range(self.shape.N, -1, -1):
            n_x, L, n = self.shape.n_x[k], self._L[k], self.shape.n_z[k]
            if k < self.shape.N:
                p = self._times_P(k + 1, d[self._x[k + 1]]) + h[k + 1][: self.shape.n_x[k + 1]]
                h[k] = h[k] + p @ self._qp.dynamics[k]
                h[k][self.fixed[self._z[k]] > 0.0] = 0.0
            for i in range(n - 1, (n_x if k else 0) - 1, -1):
                h[k][i] *= self._inverse[k][i]
                h[k][:i] -= h[k][i] * L[i, :i]
        return self._forward(h, d)

    def _forward(self, h: list[Array], d: Array) -> tuple[Array, Array]:
        costate = np.zeros(sum(self.shape.n_x))
        for k in range(self.shape.N + 1):
            n_x, L, v = self.shape.n_x[k], self._L[k], h[k]
            if k:
                p = v[:n_x].copy()
                v[:n_x] = self._qp.dynamics[k - 1] @ h[k - 1] + d[self._x[k]]
                costate[self._x[k]] = p + self._times_P(k, v[:n_x])
            for i in range(n_x if k else 0, len(v)):
                v[i] = -(v[i] + L[i, :i] @ v[:i]) * self._inverse[k][i]
        return np.concatenate(h), costate

    def _times_P(self, k: int, v: Array) -> Array:
        n = self.shape.n_x[k]
        return np.asarray(self._L[k][:n, :n] @ v)

    def evaluate(self, z: Array, costate: Array, y: Array, y_z: Array) -> tuple[Array, Array, Array, float]:
        """Gradient of the Lagrangian, defects, values of rows, and the largest entry of the cost's gradient.

        z (n,) [unit of z]; costate (n_x,) [1/unit of x]; y (n_c,) [1/unit of the row]; y_z (n,) [1/unit of z].
        """
        grad = self.q + np.concatenate([Q @ z[own] for Q, own in zip(self._Q, self._z, strict=True)])
        largest, defect = float(np.abs(grad).max(initial=0.0)), np.zeros(len(costate))
        for k in range(self.shape.N):
            F, n_x = self._qp.dynamics[k], self.shape.n_x[k + 1]
            grad[self._z[k]] += costate[self._x[k + 1]] @ F
            after = self._z[k + 1].start
            grad[after : after + n_x] -= costate[self._x[k + 1]]
            defect[self._x[k + 1]] = F @ z[self._z[k]] + self._qp.b[k] - z[after : after + n_x]
        return self.add_transposed(y, y_z, grad), defect, self.values(z), largest

    def values(self, z: Array) -> Array:
        """(n_c,) of rows at z (n,) [unit of z]."""
        return np.concatenate([C @ z[own] for C, own in zip(self._qp.C, self._z, strict=True)])

    def add_transposed(self, y: Array, y_z: Array, grad: Array) -> Array:
        """(n,) grad + C' y + y_z; y (n_c,) [1/unit of the row], y_z (n,) [1/unit of z], grad (n,) [1/unit of z]."""
        return np.asarray(grad + y_z + np.concatenate([y[own] @ C for C, own in zip(self._qp.C, self._c, strict=True)]))


def _eliminated(M: Array, state: int, least: float) -> tuple[Array, Array, int]:
    """The rows of L from `state` on and what they leave above, 1 / L_kk, and 0, or what was wrong as in blocks.c; M = L' L."""
    L, n, tolerances = M.copy(), len(M), STAGE_TOLERANCES
    given, inverse = np.diag(M).copy(), np.zeros(n)
    for k in range(n - 1, state - 1, -1):
        pivot = L[k, k]
        if not np.isfinite(pivot):
            return L, inverse, 2
        if pivot < -tolerances.indefinite * (abs(given[k]) + least):
            return L, inverse, 1
        if pivot <= tolerances.rounding * given[k] + tolerances.tiny:
            pivot = tolerances.damped * max(given[k], least)
        inverse[k] = 1.0 / np.sqrt(pivot)
        L[k, :k] *= inverse[k]
        L[k, k] = pivot * inverse[k]
        L[:k, :k] -= np.outer(L[k, :k], L[k, :k])
    return L, inverse, 0
