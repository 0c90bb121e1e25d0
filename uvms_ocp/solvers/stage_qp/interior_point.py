"""One iteration of the interior-point method on Riccati factors in NumPy; keep in step with riccati.c and interior_point.c.

Primal-dual interior point with predictor and corrector [Mehrotra1992], around a factor of the stages. A hard row has a little
compliance in every step, which the next one takes back (proximal method of multipliers): so equalities may depend on each
other, and each of them only adds a weight to rows that exist anyway.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.solvers.stage_qp import tolerances
from uvms_ocp.solvers.stage_qp.problem import (
    SIGNS,
    IterationResult,
    KktResidual,
    PrimalDualPoint,
    ResidualProducts,
    RowTable,
    StageQp,
    StageQpOptions,
    StageQpStatus,
    StageShape,
    StartMode,
    WarmStart,
    hold_active,
    is_valid,
    kkt_residual,
    no_result,
    point_at,
    predict_active,
    row_table,
    slices,
    update_active,
)
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


# Iterate the interior-point method from a start to the optimum in NumPy; keep in step with iteration.c.

_WRONG = {1: StageQpStatus.NOT_CONVEX, 2: StageQpStatus.NOT_A_NUMBER}
_WRONG_LATER = {-1.0: StageQpStatus.NOT_CONVEX, -2.0: StageQpStatus.ITERATION_LIMIT}


class NumpyCore:
    """The solver of one shape."""

    def __init__(self, shape: StageShape) -> None:
        self._stages = NumpyStages(shape)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def run(
        self,
        qp: StageQp,
        table: RowTable,
        point: PrimalDualPoint,
        options: StageQpOptions,
        *,
        start: StartMode,
        costless: bool,
        damped: bool,
    ) -> IterationResult:
        """Run from a point, without the cost if ``costless``, with steps that are ``damped`` in directions without curvature."""
        self._stages.fixed[:] = table.fixed
        curvature = self._stages.load(qp, costless=costless)
        method = InteriorPoint(self._stages, table, 1.0 if costless else curvature, options, damped=damped)
        if start in (StartMode.EQUALITIES, StartMode.ACTIVE):
            return _from_equalities(method, point, alone=start is StartMode.ACTIVE)
        begin = _warm(method, point) if start is StartMode.WARM else _cold(method, point)
        return _descended(method, begin)

    def solve(self, qp: StageQp, options: StageQpOptions, near: WarmStart | None) -> IterationResult:
        """Solve from nothing but the QP, or from the solution of one nearby; NOT_A_NUMBER where entries are none."""
        table = row_table(qp)
        rest = rest_point(qp, table)
        if not is_valid(qp):
            return no_result(rest)
        if near is None:
            return self._finished(qp, table, self._run(qp, table, rest, options, StartMode.EQUALITIES), options)
        warm = replace(rest, costate=near.costate, y=near.y)
        if not table.elastic.any():
            found = self._active(qp, table, warm, predict_active(table, near.y, near.costate), options)
            if found is not None:
                return found
        warm = replace(warm, z=np.where(table.fixed, qp.flat["z_lower"], near.z))
        return self._finished(qp, table, self._run(qp, table, warm, options, StartMode.WARM), options)

    def _finished(self, qp: StageQp, table: RowTable, end: IterationResult, options: StageQpOptions) -> IterationResult:
        """Polish the end of an interior-point run to all digits: solve with the sides that it approaches as equalities."""
        rough = options.tolerance > tolerances.FINISHED or end.approached is None
        if rough or table.elastic.any() or end.status is not StageQpStatus.SOLVED:
            return end
        assert end.approached is not None
        start = replace(end.point, y=end.point.row_multipliers())
        found = self._active(qp, table, start, end.approached, options)
        return end if found is None else replace(found, iterations=end.iterations + found.iterations)

    def _active(
        self, qp: StageQp, table: RowTable, point: PrimalDualPoint, active: Mask, options: StageQpOptions
    ) -> IterationResult | None:
        """The optimum where the bounds that it reaches are found soon, starting with active ones, from a point."""
        fewest, spent, vain = table.side.size, 0, 0
        while True:
            end = self._run(qp, hold_active(table, active), point, options, StartMode.ACTIVE)
            spent += end.iterations
            if end.status is not StageQpStatus.SOLVED:
                break
            better = update_active(table, active, end.point.y, end.value, options.tolerance)
            changes = int((better != active).sum())
            if changes == 0:
                return replace(end, iterations=spent)
            vain = 0 if changes < fewest else vain + 1
            if vain > (0 if changes > tolerances.MANY_CHANGES else tolerances.VAIN_CHANGES):
                break
            active, fewest, point = better, min(fewest, changes), end.point
        return None

    def _run(
        self, qp: StageQp, table: RowTable, point: PrimalDualPoint, options: StageQpOptions, start: StartMode
    ) -> IterationResult:
        return self.run(qp, table, point, options, start=start, costless=False, damped=False)

    def stationarity(self, qp: StageQp, near: WarmStart) -> float:
        """Largest entry [1/unit of z] of the gradient of a QP's Lagrangian at 0 with the multipliers of another, but for what
        is fixed."""
        m, stages = len(qp.flat["lower"]), self._stages
        stages.load(qp)
        zero = np.zeros_like(near.z)
        grad, *_ = stages.evaluate(zero, near.costate, near.y[:m], near.y[m:])
        return float(np.abs(np.where(stages.fixed > 0.0, 0.0, grad)).max(initial=0.0))

    def steepest(self, qp: StageQp) -> float:
        """Largest entry [1/unit of z] of the gradient of the residuals' half square, at 0."""
        return float(max(np.abs(r @ J).max(initial=0.0) for J, r in zip(qp.J, qp.r, strict=True)))

    def products(self, qp: StageQp, z: Array) -> ResidualProducts:
        """At z (n,) [unit of z]."""
        parts = [z[own] for own in slices(qp.shape.n_z)]
        along = [J @ own for J, own in zip(qp.J, parts, strict=True)]
        changes = [np.abs(own @ J).max(initial=0.0) for J, own in zip(qp.J, along, strict=True)]
        whole = np.concatenate(along)
        return ResidualProducts(
            slope=float(qp.flat["r"] @ whole), square=float(whole @ whole), change=float(max(changes))
        )


def rest_point(qp: StageQp, table: RowTable) -> PrimalDualPoint:
    """Fixed variables where they are to be, all others at 0."""
    z = np.where(table.fixed, qp.flat["z_lower"], 0.0)
    return point_at(z, sum(qp.shape.n_x), len(table.norm))


def _from_equalities(method: InteriorPoint, point: PrimalDualPoint, *, alone: bool) -> IterationResult:
    p, wrong = _equalities_alone(method, point if alone else method.rest(point.z))
    r = method.residuals(p)
    if wrong:
        return _end(method, _WRONG[wrong], p, r)
    tolerance = method.options.tolerance
    exact = r.kkt.stationarity <= tolerance * r.gradient and r.kkt.primal <= tolerance * r.variable
    if exact and not _missed(method, r) > 0.0:
        return _end(method, StageQpStatus.SOLVED, p, r)
    if alone:
        return _end(method, StageQpStatus.ITERATION_LIMIT, p, r)
    return _descended(method, _cold(method, point))


def _equalities_alone(method: InteriorPoint, point: PrimalDualPoint) -> tuple[PrimalDualPoint, int]:
    """The optimum without inequalities: one factor, and corrections; what is wrong with the factor.

    From z, costates and the multipliers of equalities.
    """
    t, before = method.table, np.inf
    p = replace(method.rest(point.z), costate=point.costate, y=np.where(t.equal, point.y, 0.0))
    wrong = method.factor(None)
    if wrong:
        return p, wrong
    for k in range(tolerances.MOST_CORRECTIONS + 1):
        r = method.residuals(p)
        equal = np.max(np.abs(np.concatenate([r.equal / t.norm, r.defect])))
        left = np.max([np.abs(r.grad).max() / r.gradient, equal / r.variable])
        if k == tolerances.MOST_CORRECTIONS or _is_enough(left, before, method.options.tolerance):
            break
        before = left
        r = replace(r, row=np.zeros_like(r.row), dual=np.zeros_like(r.dual))
        p = p.moved(method.direction(p, r), 1.0)
    return replace(p, s=np.maximum(method.beyond(r.value), 0.0), f=np.where(t.elastic, t.l1, 0.0)), 0


def _is_enough(left: float, before: float, tolerance: float) -> bool:
    """Check whether corrections may end: below the tolerance, once one takes less than half of what is left."""
    return not left > tolerances.EXACT * tolerance or bool(left <= 0.1 * tolerance and not left <= 0.5 * before)


def _missed(method: InteriorPoint, r: Residuals) -> float:
    """Largest violation of a side relative to the norm of its row; -1 where there is none."""
    t = method.table
    return float(np.where(t.side, SIGNS * (t.bound - r.value) / t.norm, -1.0).max(initial=-1.0))


def _cold(method: InteriorPoint, point: PrimalDualPoint) -> PrimalDualPoint:
    """A start inside, from z alone."""
    t, p = method.table, method.rest(point.z)
    r = method.residuals(p)
    missed = max(_missed(method, r), tolerances.LEAST_MISSED)
    mu = method.options.cold_mu * missed * max(method.curvature * missed, r.kkt.stationarity)
    s = np.where(t.side, np.maximum(method.beyond(r.value), missed * t.norm), 0.0)
    multiplier = np.divide(mu, s, out=np.zeros_like(s), where=t.side)
    multiplier = np.where(t.elastic, np.minimum(multiplier, 0.5 * t.l1), multiplier)
    e, f = np.where(t.elastic, missed * t.norm, 0.0), np.where(t.elastic, t.l1 - multiplier, 0.0)
    return replace(p, s=s, multiplier=multiplier, e=e, f=f)


def _warm(method: InteriorPoint, p: PrimalDualPoint) -> PrimalDualPoint:
    """A start near the optimum; a cold one where bounds are hard and the point is far from it."""
    t, y, r, warm_mu = method.table, p.y, method.residuals(p), method.options.warm_mu
    if not t.elastic.any():
        far, nearer = _far(method, r), tolerances.NEARER
        if far > tolerances.FAR:
            return _cold(method, replace(p, z=np.where(t.fixed, p.z, 0.0)))
        warm_mu = float(np.clip(far**2, warm_mu / nearer, warm_mu * nearer))
    mu, beyond = warm_mu * method.curvature, method.beyond(r.value)
    s = np.where(t.side, np.maximum(beyond, np.sqrt(warm_mu) * t.norm), 0.0)
    multiplier = np.maximum(-SIGNS * y, np.divide(mu, s, out=np.zeros_like(s), where=t.side))
    multiplier = np.where(t.side, multiplier, 0.0)
    multiplier = np.where(t.elastic, np.minimum(multiplier, 0.999 * t.l1), multiplier)
    f = np.where(t.elastic, t.l1 - multiplier, 0.0)
    e = np.where(t.elastic, np.maximum(-beyond, np.divide(mu, f, out=np.zeros_like(s), where=t.elastic)), 0.0)
    return replace(p, y=np.where(t.equal, y, 0.0), s=s, multiplier=multiplier, e=e, f=f)


def _far(method: InteriorPoint, r: Residuals) -> float:
    """Return the relative residual of the conditions, sides aside that are kept."""
    missed = max(_missed(method, r), float(np.abs(r.defect).max(initial=0.0)))
    return max(r.kkt.stationarity / r.gradient, missed / r.variable)


def _descended(method: InteriorPoint, p: PrimalDualPoint) -> IterationResult:
    """Iterate from an interior start to the optimum, or to where it cannot go on, which leaves the best point."""
    r, share, approached = method.residuals(p), 1.0, None
    progress = _Progress(p, r)
    while True:
        status = progress.update(method, p, r, share)
        if status is not None:
            return replace(_end(method, status, *progress.best), approached=approached)
        last = p
        p, share = method.advance(p, r)
        if share < 0.0:
            return _end(method, _WRONG_LATER[share], *progress.best)
        approached = method.table.side & (p.s * last.multiplier < p.multiplier * last.s)
        before, r = r, method.residuals(p)
        method.corrections = min(3, method.corrections + _is_inexact(method, before, r, share))


def _is_inexact(method: InteriorPoint, before: Residuals, r: Residuals, share: float) -> bool:
    """Check whether a step has left a larger residual than it should have."""
    left, least = 2.0 * (1.0 - share), 0.1 * method.options.tolerance
    gradient = r.kkt.stationarity > left * before.kkt.stationarity + least * r.gradient
    return gradient or r.kkt.primal > left * before.kkt.primal + least * r.variable


class _Progress:
    """Progress of a descent that begins at p."""

    def __init__(self, p: PrimalDualPoint, r: Residuals) -> None:
        self.best = p, r
        self._first, self._lowest = r.gradient, np.inf
        self._vain, self._high, self._stuck = -1, 0, 0

    def update(self, method: InteriorPoint, p: PrimalDualPoint, r: Residuals, share: float) -> StageQpStatus | None:
        """Why to end at p, where the last step was taken by a share; None for going on."""
        self._vain, self._high = self._vain + 1, self._high + 1
        if r.worst < self.best[1].worst:
            self.best, self._vain = (p, r), 0
        if r.kkt.primal < 0.9 * self._lowest:
            self._lowest, self._high = r.kkt.primal, 0
        self._stuck = self._stuck + 1 if share < tolerances.STUCK else 0
        if r.worst <= method.options.tolerance:
            return StageQpStatus.SOLVED
        # Where a direction has no curvature, steps are endless long before the point is.
        if max(r.variable, method.stride if self._stuck > 2 else 0.0) > tolerances.ENDLESS:
            return StageQpStatus.UNBOUNDED
        return StageQpStatus.ITERATION_LIMIT if self._is_over(method, r) else None

    def _is_over(self, method: InteriorPoint, r: Residuals) -> bool:
        most, tolerance = tolerances.MOST_VAIN, method.options.tolerance
        high = self._high > tolerances.MOST_HIGH and self._lowest > tolerance * r.variable
        usable = self.best[1].worst <= tolerances.INEXACT_TOLERANCES * tolerance
        hopeless = self._stuck > 2 or r.gradient > tolerances.HOPELESS * self._first or not r.worst < np.inf
        return high or (usable and self._vain > most) or hopeless or method.iterations >= method.options.max_iterations


def _end(method: InteriorPoint, status: StageQpStatus, p: PrimalDualPoint, r: Residuals) -> IterationResult:
    return IterationResult(
        status=status, point=p, value=r.value, held=r.held, kkt=r.kkt, worst=r.worst, iterations=method.iterations
    )
