"""One iteration of the interior-point method on Riccati factors in NumPy; keep in step with riccati.c and interior_point.c.

Primal-dual interior point with predictor and corrector [Mehrotra1992], around a factor of the stages. A hard row has a little
compliance in every step, which the next one takes back (proximal method of multipliers): so equalities may depend on each
other, and each of them only adds a weight to rows that exist anyway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.solvers.stage_qp import tolerances
from uvms_ocp.solvers.stage_qp.problem import KktResidual, StageQp, StageQpOptions, StageShape, kkt_residual, slices
from uvms_ocp.solvers.stage_qp.rows import SIGNS, PrimalDualPoint, RowTable, point_at
from uvms_ocp.types import Array, Mask

# The linear algebra of riccati.c in NumPy, for machines without a C compiler; keep both in step.


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
            self._Q, self.q[:] = [tolerances.PHASE_ONE * np.eye(n) for n in self.shape.n_z], 0.0
            self._least = tolerances.SMALLEST_CURVATURE * tolerances.PHASE_ONE
            return tolerances.PHASE_ONE
        self._Q = [
            J.T @ J + np.tril(H) + np.tril(H, -1).T + np.diag(damping)
            for J, H, damping in zip(qp.J, qp.H, qp.damping, strict=True)
        ]
        self.q[:] = np.concatenate([J.T @ r + g for J, r, g in zip(qp.J, qp.r, qp.g, strict=True)])
        most = max(np.diag(Q).max(initial=0.0) for Q in self._Q)
        most = most if most > 0.0 else 1.0
        self._least = tolerances.SMALLEST_CURVATURE * most
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
    L, n = M.copy(), len(M)
    given, inverse = np.diag(M).copy(), np.zeros(n)
    for k in range(n - 1, state - 1, -1):
        pivot = L[k, k]
        if not np.isfinite(pivot):
            return L, inverse, 2
        if pivot < -tolerances.INDEFINITE * (abs(given[k]) + least):
            return L, inverse, 1
        if pivot <= tolerances.ROUNDING * given[k] + tolerances.TINY:
            pivot = tolerances.DAMPED * max(given[k], least)
        inverse[k] = 1.0 / np.sqrt(pivot)
        L[k, :k] *= inverse[k]
        L[k, k] = pivot * inverse[k]
        L[:k, :k] -= np.outer(L[k, :k], L[k, :k])
    return L, inverse, 0


# The algorithm of interior_point.c in NumPy, for machines without a C compiler: one iteration; keep both in step.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Residuals:
    """Residuals of the optimality conditions at a point; units are theirs."""

    grad: Array
    """(n,) [1/unit of z] of the Lagrangian, 0 for fixed variables."""
    held: Array
    """(n,) [1/unit of z] the same of fixed variables, 0 for others."""
    defect: Array
    """(n_x,) [unit of x] of the dynamics."""
    value: Array
    """(M,) [unit of the row] of rows."""
    row: Array
    """(2, M) [unit of the row] of what is left to the bounds."""
    equal: Array
    """(M,) [unit of the row] of equalities."""
    dual: Array
    """(2, M) [1/unit of the row] of elastic rows."""
    kkt: KktResidual
    """All of it."""
    gradient: float
    """[1/unit of z] largest term of the gradient."""
    variable: float
    """[unit of z] largest variable, and 1."""
    linear: float
    """Largest residual of all conditions but complementarity, relative to the two."""

    @property
    def worst(self) -> float:
        """Return the largest of all residuals."""
        complementarity = tolerances.SHARPER * self.kkt.complementarity / (self.gradient * self.variable)
        return _larger(self.kkt.stationarity / self.gradient, self.kkt.primal / self.variable, complementarity)


class InteriorPoint:
    """One QP whose data are loaded; curvature [1/unit of z^2]: its largest."""

    def __init__(
        self, stages: NumpyStages, table: RowTable, curvature: float, options: StageQpOptions, *, damped: bool
    ) -> None:
        self._slow = tolerances.SLOW if damped else 0.0
        self.stages, self.table, self.options, self.curvature = stages, table, options, curvature
        self.iterations, self.corrections, self.stride = 0, 0, 0.0
        self._free, self._m = ~table.fixed, len(table.norm) - len(table.fixed)
        self._elasticity = tolerances.ELASTICITY * table.norm**2 / curvature
        self._weight = np.zeros_like(table.bound)
        self._soft = np.zeros_like(table.bound)

    def rest(self, z: Array) -> PrimalDualPoint:
        """At z (n,) [unit of z], with nothing else."""
        return point_at(z, sum(self.stages.shape.n_x), len(self.table.norm))

    def beyond(self, value: Array) -> Array:
        """(2, M) [unit of the row] from the bounds to the value (M,) [unit of the row] inwards, 0 where there is no side."""
        return np.where(self.table.side, SIGNS * (value - self.table.bound), 0.0)

    def residuals(self, p: PrimalDualPoint) -> Residuals:
        """At a point."""
        t, m, y = self.table, self._m, p.row_multipliers()
        grad, defect, value, largest = self.stages.evaluate(p.z, p.costate, y[:m], y[m:])
        value = np.concatenate([value, p.z])
        row = np.where(t.side, self.beyond(value) + p.e + t.compliance * p.multiplier - p.s, 0.0)
        equal = np.where(t.equal, value - t.target - t.compliance * p.y, 0.0)
        dual = np.where(t.elastic, t.l1 + t.l2 * p.e - p.multiplier - p.f, 0.0)
        free = np.where(self._free, grad, 0.0)
        linear = _larger(_largest(row / t.norm), _largest(equal / t.norm), _largest(defect))
        stationarity = _larger(_largest(free), _largest(dual * t.norm))
        gradient = _larger(largest, _largest(y * t.norm), tolerances.LEAST_SIZE * self.curvature)
        variable = 1.0 + _largest(p.z)
        return Residuals(
            grad=free,
            held=grad - free,
            defect=defect,
            value=value,
            row=row,
            equal=equal,
            dual=dual,
            kkt=kkt_residual(
                stationarity=stationarity,
                primal=_larger(linear, t.violation(value)),
                complementarity=_larger(_largest(p.s * p.multiplier), _largest(p.e * p.f)),
            ),
            gradient=gradient,
            variable=variable,
            linear=_larger(stationarity / gradient, linear / variable),
        )

    def factor(self, p: PrimalDualPoint | None, r: Residuals | None = None) -> int:
        """With the weights of the sides at a point with its residuals, or without sides; as `NumpyStages.factor`."""
        t, self._weight, self._soft = self.table, np.zeros_like(self._weight), np.zeros_like(self._soft)
        self.iterations += 1
        if p is not None:
            self._soft = _ratio(p.e, p.f + p.e * t.l2, p.f > 0.0)
            give = tolerances.SIDE_ELASTICITY * self._elasticity + t.compliance + self._soft
            self._weight = _ratio(p.multiplier, p.multiplier * give + p.s, p.multiplier > 0.0)
        total = self._weight.sum(axis=0) + np.where(t.equal, 1.0 / (self._elasticity + t.compliance), 0.0)
        slow = 0.0 if r is None else self._slow * r.gradient / r.variable
        return self.stages.factor(total[: self._m], total[self._m :] + slow)

    def direction(
        self, p: PrimalDualPoint, r: Residuals, side: Array | float = 0.0, elastic: Array | float = 0.0
    ) -> PrimalDualPoint:
        """Compute Newton's direction towards products that differ by ``side`` and ``elastic`` (2, M) from those at p."""
        t, m, stiff = self.table, self._m, 1.0 / (self._elasticity + self.table.compliance)
        held, soft = p.multiplier > 0.0, self._soft
        left = _ratio(elastic - p.e * r.dual, p.f + p.e * t.l2, p.f > 0.0)
        gap = r.row + left - _ratio(side, p.multiplier, held)
        pull = (SIGNS * self._weight * gap).sum(axis=0) + np.where(t.equal, r.equal * stiff, 0.0)
        dz, costate = self.stages.solve(self.stages.add_transposed(pull[:m], pull[m:], r.grad), r.defect)
        value = np.concatenate([self.stages.values(dz), dz])
        multiplier = -self._weight * (SIGNS * value + gap)
        e = soft * multiplier + left
        return PrimalDualPoint(
            z=dz,
            costate=costate,
            y=np.where(t.equal, (value + r.equal) * stiff, 0.0),
            s=_ratio(side - p.s * multiplier, p.multiplier, held),
            multiplier=multiplier,
            e=e,
            f=_ratio(elastic - p.f * e, p.e, p.e > 0.0),
        )

    def advance(self, p: PrimalDualPoint, r: Residuals) -> tuple[PrimalDualPoint, float]:
        """One iteration, and the share of the step that was taken, or minus what is wrong with the factor.

        Weights of later iterations hide whether the cost is convex.
        """
        wrong = self.factor(p, r)
        if wrong == 2 or (wrong and self.iterations == 1):
            return p, -wrong
        mu = max(self._mu(p), 1e-300)
        least = tolerances.FLOOR * self.options.tolerance * r.gradient * r.variable
        affine = self.direction(p, r, *self._aim(p, None, 0.0, 0.0))
        share = _share(p, affine, 1.0)
        centre = max(least, mu * (self._mu(p.moved(affine, share)) / mu) ** 3)
        step = self.direction(p, r, *self._aim(p, affine, centre, share))
        if _share(p, step, 1.0) < tolerances.SHORT_STEP:
            step = self.direction(p, r, *self._aim(p, None, mu, 0.0))
        step = self._corrected(p, step)
        self.stride, share = _largest(step.z), _share(p, step, tolerances.TO_BOUNDARY)
        return p.moved(step, share), share

    def _corrected(self, p: PrimalDualPoint, step: PrimalDualPoint) -> PrimalDualPoint:
        """A step from p whose linear equations hold better, where it needs that."""
        if self.corrections == 0:
            return step
        left = self.residuals(p.moved(step, 1.0))
        for _ in range(self.corrections):
            better = step.moved(self.direction(p, left), 1.0)
            before, left = left.linear, self.residuals(p.moved(better, 1.0))
            if not left.linear <= 0.5 * before:
                break
            step = better
        return step

    def _mu(self, p: PrimalDualPoint) -> float:
        """Mean complementarity."""
        count = int(self.table.side.sum() + self.table.elastic.sum())
        return float((p.s * p.multiplier).sum() + (p.e * p.f).sum()) / max(1, count)

    def _aim(
        self, p: PrimalDualPoint, affine: PrimalDualPoint | None, centre: float, trust: float
    ) -> tuple[Array, Array]:
        """Compute the changes of products towards `centre`; trust: share of the second order of `affine`."""
        side, elastic = centre - p.s * p.multiplier, centre - p.e * p.f
        if affine is not None:
            side, elastic = side - trust * affine.s * affine.multiplier, elastic - trust * affine.e * affine.f
        return np.where(self.table.side, side, 0.0), np.where(self.table.elastic, elastic, 0.0)


def _share(p: PrimalDualPoint, step: PrimalDualPoint, most: float) -> float:
    """Return the largest share of a step after which nothing is negative."""
    share = 1.0
    for value, change in ((p.s, step.s), (p.multiplier, step.multiplier), (p.e, step.e), (p.f, step.f)):
        falls = change < 0.0
        share = min(share, float((most * value[falls] / -change[falls]).min(initial=1.0)))
    return share


def _ratio(a: Array | float, b: Array, where: Mask) -> Array:
    """0 elsewhere."""
    return np.divide(a, b, out=np.zeros_like(b), where=where)


def _larger(*numbers: float) -> float:
    """NaN wins, so that it is noticed."""
    return float(np.max(numbers))


def _largest(a: Array) -> float:
    return float(np.abs(a).max(initial=0.0))
