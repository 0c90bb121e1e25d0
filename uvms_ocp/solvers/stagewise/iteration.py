"""From a start to the optimum, or to where an interior point cannot go on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.stagewise.interior_point import CannotFactor, InteriorPoint
from uvms_ocp.solvers.stagewise.point import Point, Residuals, resting
from uvms_ocp.solvers.stagewise.row_table import SIGNS, RowTable
from uvms_ocp.solvers.stagewise.solution import StageQpSolution, StageQpStatus

_STUCK = 1e-7  # share of a step that leads nowhere
_HOPELESS = 1e8  # by which multipliers grow where there is no point
_ENDLESS = 1e12  # variables beyond which a cost falls without end


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class End:
    """Of one run."""

    status: StageQpStatus
    point: Point
    residuals: Residuals
    iterations: int


def iterated(method: InteriorPoint, z: Array, warm: Point | None) -> End:
    """From z, where fixed variables have their values, or from a point nearby."""
    point = warm or resting(z, sum(method.stages.shape.n_x), len(method.table.norm))
    best = point, method.residuals(point)
    try:
        if warm is None:
            best = _within(method, *method.equalities_alone(z))
            if _is_enough(method, best[1]):
                return _end(method, StageQpStatus.SOLVED, best)
            point = cold(method, *best)
        return _descended(method, point)
    except CannotFactor as failure:
        return _end(method, failure.status, best)


def _within(method: InteriorPoint, p: Point, r: Residuals) -> tuple[Point, Residuals]:
    """With what is left to the bounds, as far as none is missed."""
    t = method.table
    p = replace(
        p, s=np.where(t.side, np.maximum(SIGNS * (r.value - t.bound), 0.0), 0.0), f=np.where(t.elastic, t.l1, 0.0)
    )
    return p, method.residuals(p)


def _end(method: InteriorPoint, status: StageQpStatus, at: tuple[Point, Residuals]) -> End:
    return End(status=status, point=at[0], residuals=at[1], iterations=method.iterations)


def _descended(method: InteriorPoint, point: Point) -> End:
    best, share, stuck = None, 1.0, 0
    first = method.residuals(point).scale[0]
    while True:
        r = method.residuals(point)
        if best is None or r.worst() < best[1].worst():
            best = point, r
        if r.worst() <= method.options.tolerance:
            return _end(method, StageQpStatus.SOLVED, best)
        if np.abs(point.z).max() > _ENDLESS:
            return _end(method, StageQpStatus.UNBOUNDED, best)
        stuck = stuck + 1 if share < _STUCK else 0
        hopeless = stuck > 2 or r.scale[0] > _HOPELESS * first or not np.isfinite(r.worst())
        if hopeless or method.iterations >= method.options.max_iterations:
            return _end(method, StageQpStatus.ITERATION_LIMIT, best)
        point, share = method.step(point, r)


def _is_enough(method: InteriorPoint, r: Residuals) -> bool:
    """Whether no inequality is missed where none is looked at."""
    gradient, variable = r.scale
    exact = max(r.kkt.stationarity / gradient, r.kkt.primal / variable) <= method.options.tolerance
    return exact and _missed(method.table, r) <= 0.0


def _missed(t: RowTable, r: Residuals) -> float:
    """Largest, relative to the norm of the row; < 0 where none is."""
    return float(np.where(t.side, -SIGNS * (r.value - t.bound) / t.norm, -np.inf).max(initial=-np.inf))


def cold(method: InteriorPoint, p: Point, r: Residuals) -> Point:
    """A start inside, from the optimum without inequalities."""
    t, v = method.table, max(_missed(method.table, r), 1e-3)
    s = np.where(t.side, np.maximum(SIGNS * (r.value - t.bound), v * t.norm), 0.0)
    return inside(method, replace(p, s=s), 0.1 * method.curvature * v * v, v)


def inside(method: InteriorPoint, p: Point, mu: float, missed: float) -> Point:
    t = method.table
    e = np.where(t.elastic, missed * t.norm, 0.0)
    multiplier = np.divide(mu, p.s, out=np.zeros_like(p.s), where=t.side)
    multiplier = np.where(t.elastic, np.minimum(multiplier, t.l1 / 2), multiplier)
    return replace(p, multiplier=multiplier, e=e, f=np.where(t.elastic, t.l1 - multiplier, 0.0))


def warm_point(method: InteriorPoint, warm: StageQpSolution, z: Array, mu: float) -> Point:
    """A start near a solution."""
    t = method.table
    flat = np.where(t.fixed, z, np.concatenate(warm.z))
    y = np.concatenate([*warm.y, *warm.y_z])
    value = np.concatenate([method.stages.values(flat), flat])
    multiplier = np.where(t.side, np.maximum(-SIGNS * y, 0.0), 0.0)
    room = np.sqrt(mu / method.curvature) * t.norm
    s = np.where(t.side, np.maximum(SIGNS * (value - t.bound), room), 0.0)
    multiplier = np.maximum(multiplier, np.divide(mu, s, out=np.zeros_like(s), where=t.side))
    multiplier = np.where(t.elastic, np.minimum(multiplier, 0.999 * t.l1), multiplier)
    f = np.where(t.elastic, t.l1 - multiplier, 0.0)
    e = np.maximum(
        np.where(t.elastic, -SIGNS * (value - t.bound), 0.0), np.divide(mu, f, out=np.zeros_like(s), where=t.elastic)
    )
    return Point(
        z=flat, costate=np.concatenate(warm.costate), y=np.where(t.equal, y, 0.0), s=s, multiplier=multiplier, e=e, f=f
    )
