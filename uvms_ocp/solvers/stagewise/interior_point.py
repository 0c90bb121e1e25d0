"""The algorithm of interior_point.c in NumPy, for machines without a C compiler: one iteration; keep both in step.

Primal-dual interior point with predictor and corrector [Mehrotra1992], around a factor of the stages. A hard row has a little
compliance in every step, which the next one takes back (proximal method of multipliers): so equalities may depend on each
other, and each of them only adds a weight to rows that exist anyway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.arrays import Array, Mask
from uvms_ocp.solvers.stagewise.options import STAGE_TOLERANCES, StageQpOptions
from uvms_ocp.solvers.stagewise.point import Point, resting
from uvms_ocp.solvers.stagewise.riccati import NumpyStages
from uvms_ocp.solvers.stagewise.row_table import SIGNS, RowTable
from uvms_ocp.solvers.stagewise.solution import KktResidual, kkt_residual


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Residuals:
    """By how much the conditions fail at a point; units are theirs."""

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
    """[-] of all conditions but complementarity, relative to the two."""

    @property
    def worst(self) -> float:
        """[-] of all of them."""
        complementarity = STAGE_TOLERANCES.sharper * self.kkt.complementarity / (self.gradient * self.variable)
        return _larger(self.kkt.stationarity / self.gradient, self.kkt.primal / self.variable, complementarity)


class InteriorPoint:
    """One QP whose data are loaded; curvature [1/unit of z^2]: its largest."""

    def __init__(
        self, stages: NumpyStages, table: RowTable, curvature: float, options: StageQpOptions, *, damped: bool
    ) -> None:
        self._slow = STAGE_TOLERANCES.slow if damped else 0.0
        self.stages, self.table, self.options, self.curvature = stages, table, options, curvature
        self.iterations, self.corrections, self.stride = 0, 0, 0.0
        self._free, self._m = ~table.fixed, len(table.norm) - len(table.fixed)
        self._elasticity = STAGE_TOLERANCES.elasticity * table.norm**2 / curvature
        self._weight = np.zeros_like(table.bound)
        self._soft = np.zeros_like(table.bound)

    def rest(self, z: Array) -> Point:
        """At z (n,) [unit of z], with nothing else."""
        return resting(z, sum(self.stages.shape.n_x), len(self.table.norm))

    def beyond(self, value: Array) -> Array:
        """(2, M) [unit of the row] from the bounds to the value (M,) [unit of the row] inwards, 0 where there is no side."""
        return np.where(self.table.side, SIGNS * (value - self.table.bound), 0.0)

    def residuals(self, p: Point) -> Residuals:
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
        gradient = _larger(largest, _largest(y * t.norm), STAGE_TOLERANCES.least_size * self.curvature)
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

    def factor(self, p: Point | None, r: Residuals | None = None) -> int:
        """With the weights of the sides at a point with its residuals, or without sides; as `NumpyStages.factor`."""
        t, self._weight, self._soft = self.table, np.zeros_like(self._weight), np.zeros_like(self._soft)
        self.iterations += 1
        if p is not None:
            self._soft = _ratio(p.e, p.f + p.e * t.l2, p.f > 0.0)
            give = STAGE_TOLERANCES.side_elasticity * self._elasticity + t.compliance + self._soft
            self._weight = _ratio(p.multiplier, p.multiplier * give + p.s, p.multiplier > 0.0)
        total = self._weight.sum(axis=0) + np.where(t.equal, 1.0 / (self._elasticity + t.compliance), 0.0)
        slow = 0.0 if r is None else self._slow * r.gradient / r.variable
        return self.stages.factor(total[: self._m], total[self._m :] + slow)

    def direction(self, p: Point, r: Residuals, side: Array | float = 0.0, elastic: Array | float = 0.0) -> Point:
        """Of Newton's method, towards products that differ by ``side`` and ``elastic`` (2, M) [-] from those at p."""
        t, m, stiff = self.table, self._m, 1.0 / (self._elasticity + self.table.compliance)
        held, soft = p.multiplier > 0.0, self._soft
        left = _ratio(elastic - p.e * r.dual, p.f + p.e * t.l2, p.f > 0.0)
        gap = r.row + left - _ratio(side, p.multiplier, held)
        pull = (SIGNS * self._weight * gap).sum(axis=0) + np.where(t.equal, r.equal * stiff, 0.0)
        dz, costate = self.stages.solve(self.stages.add_transposed(pull[:m], pull[m:], r.grad), r.defect)
        value = np.concatenate([self.stages.values(dz), dz])
        multiplier = -self._weight * (SIGNS * value + gap)
        e = soft * multiplier + left
        return Point(
            z=dz,
            costate=costate,
            y=np.where(t.equal, (value + r.equal) * stiff, 0.0),
            s=_ratio(side - p.s * multiplier, p.multiplier, held),
            multiplier=multiplier,
            e=e,
            f=_ratio(elastic - p.f * e, p.e, p.e > 0.0),
        )

    def advance(self, p: Point, r: Residuals) -> tuple[Point, float]:
        """One iteration, and the share [-] of the step that was taken, or minus what is wrong with the factor.

        Weights of later iterations hide whether the cost is convex.
        """
        wrong = self.factor(p, r)
        if wrong == 2 or (wrong and self.iterations == 1):
            return p, -wrong
        mu = max(self._mu(p), 1e-300)
        least = STAGE_TOLERANCES.floor * self.options.tolerance * r.gradient * r.variable
        affine = self.direction(p, r, *self._aim(p, None, 0.0, 0.0))
        share = _share(p, affine, 1.0)
        centre = max(least, mu * (self._mu(p.moved(affine, share)) / mu) ** 3)
        step = self.direction(p, r, *self._aim(p, affine, centre, share))
        if _share(p, step, 1.0) < STAGE_TOLERANCES.short_step:
            step = self.direction(p, r, *self._aim(p, None, mu, 0.0))
        step = self._corrected(p, step)
        self.stride, share = _largest(step.z), _share(p, step, STAGE_TOLERANCES.to_boundary)
        return p.moved(step, share), share

    def _corrected(self, p: Point, step: Point) -> Point:
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

    def _mu(self, p: Point) -> float:
        """Mean complementarity."""
        count = int(self.table.side.sum() + self.table.elastic.sum())
        return float((p.s * p.multiplier).sum() + (p.e * p.f).sum()) / max(1, count)

    def _aim(self, p: Point, affine: Point | None, centre: float, trust: float) -> tuple[Array, Array]:
        """By how much products change on the way to `centre`; trust: in what `affine` says of the second order."""
        side, elastic = centre - p.s * p.multiplier, centre - p.e * p.f
        if affine is not None:
            side, elastic = side - trust * affine.s * affine.multiplier, elastic - trust * affine.e * affine.f
        return np.where(self.table.side, side, 0.0), np.where(self.table.elastic, elastic, 0.0)


def _share(p: Point, step: Point, most: float) -> float:
    """Of a step after which nothing is negative."""
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
