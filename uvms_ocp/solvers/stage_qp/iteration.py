"""Iterate the interior-point method from a start to the optimum in NumPy; keep in step with iteration.c."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uvms_ocp.solvers.stage_qp import tolerances
from uvms_ocp.solvers.stage_qp.interior_point import InteriorPoint, NumpyStages, Residuals
from uvms_ocp.solvers.stage_qp.problem import (
    ResidualProducts,
    StageQp,
    StageQpOptions,
    StageQpStatus,
    StageShape,
    WarmStart,
    is_valid,
    slices,
)
from uvms_ocp.solvers.stage_qp.rows import (
    SIGNS,
    IterationResult,
    PrimalDualPoint,
    RowTable,
    StartMode,
    hold_active,
    no_result,
    point_at,
    predict_active,
    row_table,
    update_active,
)
from uvms_ocp.types import Array, Mask

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
