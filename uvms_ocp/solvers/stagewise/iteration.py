"""The algorithm of interior_point.c in NumPy: from a start to the optimum, or to where it cannot go on; keep both in step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uvms_ocp.solvers.stagewise.interior_point import InteriorPoint, Residuals
from uvms_ocp.solvers.stagewise.options import STAGE_TOLERANCES, StageQpOptions
from uvms_ocp.solvers.stagewise.point import End, Point, Start
from uvms_ocp.solvers.stagewise.riccati import NumpyStages
from uvms_ocp.solvers.stagewise.row_table import SIGNS, RowTable
from uvms_ocp.solvers.stagewise.shape import StageShape
from uvms_ocp.solvers.stagewise.solution import StageQpStatus
from uvms_ocp.solvers.stagewise.stage_qp import StageQp

_WRONG = {1: StageQpStatus.NOT_CONVEX, 2: StageQpStatus.NOT_A_NUMBER}


class NumpyCore:
    """The solver of one shape."""

    def __init__(self, shape: StageShape) -> None:
        self._stages = NumpyStages(shape)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def run(
        self, qp: StageQp, table: RowTable, point: Point, options: StageQpOptions, *, start: Start, costless: bool
    ) -> End:
        """From a point, without the cost if ``costless``."""
        self._stages.fixed[:] = table.fixed
        curvature = self._stages.load(qp, costless=costless)
        method = InteriorPoint(self._stages, table, 1.0 if costless else curvature, options)
        if start is Start.EQUALITIES:
            return _from_equalities(method, point)
        begin = _warm(method, point) if start is Start.WARM else _cold(method, method.rest(point.z))
        return _descended(method, begin)


def _from_equalities(method: InteriorPoint, point: Point) -> End:
    p, wrong = _equalities_alone(method, point)
    r = method.residuals(p)
    if wrong:
        return _end(method, _WRONG[wrong], p, r)
    tolerance = method.options.tolerance
    exact = r.kkt.stationarity <= tolerance * r.gradient and r.kkt.primal <= tolerance * r.variable
    if exact and not _missed(method, r) > 0.0:
        return _end(method, StageQpStatus.SOLVED, p, r)
    return _descended(method, _cold(method, p if r.linear <= STAGE_TOLERANCES.far else method.rest(point.z)))


def _equalities_alone(method: InteriorPoint, point: Point) -> tuple[Point, int]:
    """The optimum without inequalities: one factor, and corrections; as `NumpyStages.factor` where there is none."""
    p, t = method.rest(point.z), method.table
    wrong = method.factor(None)
    if wrong:
        return p, wrong
    for k in range(STAGE_TOLERANCES.most_corrections + 1):
        r = method.residuals(p)
        equal = np.max(np.abs(np.concatenate([r.equal / t.norm, r.defect])))
        left = np.max([np.abs(r.grad).max() / r.gradient, equal / r.variable])
        if k == STAGE_TOLERANCES.most_corrections or not left > 0.1 * method.options.tolerance:
            break
        r = replace(r, row=np.zeros_like(r.row), dual=np.zeros_like(r.dual))
        p = p.moved(method.direction(p, r), 1.0)
    return replace(p, s=np.maximum(method.beyond(r.value), 0.0), f=np.where(t.elastic, t.l1, 0.0)), 0


def _missed(method: InteriorPoint, r: Residuals) -> float:
    """Largest violation of a side relative to the norm of its row; -1 where there is none."""
    t = method.table
    return float(np.where(t.side, SIGNS * (t.bound - r.value) / t.norm, -1.0).max(initial=-1.0))


def _cold(method: InteriorPoint, p: Point) -> Point:
    """A start inside."""
    t, r = method.table, method.residuals(p)
    missed = max(_missed(method, r), 1e-3)
    mu = 0.1 * method.curvature * missed * missed
    s = np.where(t.side, np.maximum(method.beyond(r.value), missed * t.norm), 0.0)
    multiplier = np.divide(mu, s, out=np.zeros_like(s), where=t.side)
    multiplier = np.where(t.elastic, np.minimum(multiplier, 0.5 * t.l1), multiplier)
    e, f = np.where(t.elastic, missed * t.norm, 0.0), np.where(t.elastic, t.l1 - multiplier, 0.0)
    return replace(p, s=s, multiplier=multiplier, e=e, f=f)


def _warm(method: InteriorPoint, p: Point) -> Point:
    """A start near the optimum."""
    t, y, mu = method.table, p.y, method.options.warm_mu * method.curvature
    beyond = method.beyond(method.residuals(p).value)
    s = np.where(t.side, np.maximum(beyond, np.sqrt(method.options.warm_mu) * t.norm), 0.0)
    multiplier = np.maximum(-SIGNS * y, np.divide(mu, s, out=np.zeros_like(s), where=t.side))
    multiplier = np.where(t.side, multiplier, 0.0)
    multiplier = np.where(t.elastic, np.minimum(multiplier, 0.999 * t.l1), multiplier)
    f = np.where(t.elastic, t.l1 - multiplier, 0.0)
    e = np.where(t.elastic, np.maximum(-beyond, np.divide(mu, f, out=np.zeros_like(s), where=t.elastic)), 0.0)
    return replace(p, y=np.where(t.equal, y, 0.0), s=s, multiplier=multiplier, e=e, f=f)


def _descended(method: InteriorPoint, p: Point) -> End:
    """From a start inside to the optimum, or to where it cannot go on, which leaves the best point."""
    r, share, stuck = method.residuals(p), 1.0, 0
    best, first = (p, r), r.gradient
    while True:
        best = (p, r) if r.worst < best[1].worst else best
        stuck = stuck + 1 if share < STAGE_TOLERANCES.stuck else 0
        status = _status(method, r, first, stuck)
        if status is not None:
            return _end(method, status, *best)
        p, share = method.advance(p, r)
        if share < 0.0:
            return _end(method, StageQpStatus.NOT_CONVEX if share == -1.0 else StageQpStatus.ITERATION_LIMIT, *best)
        before, r = r.linear, method.residuals(p)
        if r.linear > 2.0 * (1.0 - share) * before + 0.1 * method.options.tolerance:
            method.corrections = min(3, method.corrections + 1)


def _status(method: InteriorPoint, r: Residuals, first: float, stuck: int) -> StageQpStatus | None:
    """Why to end, if at all."""
    if r.worst <= method.options.tolerance:
        return StageQpStatus.SOLVED
    # Where a direction has no curvature, steps are endless long before the point is.
    if max(r.variable, method.stride if stuck > 2 else 0.0) > STAGE_TOLERANCES.endless:
        return StageQpStatus.UNBOUNDED
    hopeless = stuck > 2 or r.gradient > STAGE_TOLERANCES.hopeless * first or not r.worst < np.inf
    over = method.iterations >= method.options.max_iterations
    return StageQpStatus.ITERATION_LIMIT if hopeless or over else None


def _end(method: InteriorPoint, status: StageQpStatus, p: Point, r: Residuals) -> End:
    return End(status=status, point=p, held=r.held, kkt=r.kkt, worst=r.worst, iterations=method.iterations)
