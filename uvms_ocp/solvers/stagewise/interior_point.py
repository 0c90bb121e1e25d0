"""Primal-dual interior point with predictor and corrector [Mehrotra1992], around a factor of the stages.

A hard row has a little compliance in every step, which the next one takes back (proximal method of multipliers): so equalities
may depend on each other, and each of them only adds a weight to rows that exist anyway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.stagewise.options import StageQpOptions
from uvms_ocp.solvers.stagewise.point import Point, Residuals, largest_of, resting
from uvms_ocp.solvers.stagewise.riccati import NumpyStages
from uvms_ocp.solvers.stagewise.row_table import SIGNS, RowTable
from uvms_ocp.solvers.stagewise.solution import KktResidual, StageQpStatus
from uvms_ocp.solvers.stagewise.stages import CompiledStages
from uvms_ocp.solvers.stagewise.tolerances import STAGE_TOLERANCES


class InteriorPoint:
    """One QP whose data are loaded."""

    def __init__(
        self, stages: CompiledStages | NumpyStages, table: RowTable, curvature: float, options: StageQpOptions
    ):
        self.stages, self.table, self.options = stages, table, options
        self.curvature = curvature
        self.free = ~table.fixed
        self.n_rows = len(table.norm) - len(table.fixed)
        self.elasticity = STAGE_TOLERANCES.elasticity * table.norm**2 / curvature
        self.iterations = 0

    def residuals(self, p: Point) -> Residuals:
        t, m = self.table, self.n_rows
        y = p.y + p.multiplier[1] - p.multiplier[0]
        grad, defect, value, largest = self.stages.evaluate(p.z, p.costate, y[:m], y[m:])
        grad, held = np.where(self.free, grad, 0.0), np.where(self.free, 0.0, grad)
        value = np.concatenate([value, p.z])
        row = np.where(t.side, SIGNS * (value - t.bound) + p.e + t.compliance * p.multiplier - p.s, 0.0)
        equal = np.where(t.equal, value - t.target - t.compliance * p.y, 0.0)
        dual = np.where(t.elastic, t.l1 + t.l2 * p.e - p.multiplier - p.f, 0.0)
        scale = max(largest, largest_of(y * t.norm), _LEAST * self.curvature), 1.0 + largest_of(p.z)
        kkt = KktResidual(
            stationarity=max(largest_of(grad), largest_of(dual * t.norm)),
            primal=max(
                largest_of(defect), largest_of(row / t.norm), largest_of(equal / t.norm), self.violation(t, value)
            ),
            complementarity=max(largest_of(p.s * p.multiplier), largest_of(p.e * p.f)),
        )
        return Residuals(
            grad=grad, defect=defect, value=value, row=row, equal=equal, dual=dual, kkt=kkt, scale=scale, held=held
        )

    @staticmethod
    def violation(t: RowTable, value: Array) -> float:
        """Largest, of hard rows relative to their norm; value (M,)."""
        hard = t.compliance == 0.0
        missed = np.where(t.side & ~t.elastic & hard, -SIGNS * (value - t.bound), 0.0).max(initial=0.0, axis=0)
        return largest_of((missed + np.where(t.equal & hard, np.abs(value - t.target), 0.0)) / t.norm)

    def equalities_alone(self, z: Array) -> tuple[Point, Residuals]:
        """The optimum without inequalities, from z: one factor, and corrections."""
        p = resting(z, sum(self.stages.shape.n_x), len(self.table.norm))
        self._factor(np.zeros_like(self.table.bound))
        for _ in range(_CORRECTIONS):
            r = self.residuals(p)
            gradient, variable = r.scale
            equal = (np.abs(r.equal) / self.table.norm).max(initial=0.0)
            if (
                max(largest_of(r.grad) / gradient, max(largest_of(r.defect), equal) / variable)
                <= self.options.tolerance / 10
            ):
                break
            p = p.moved(self._direction(p, r, _Targets.none(p), np.zeros_like(p.s)), 1.0)
        return p, r

    def step(self, p: Point, r: Residuals) -> tuple[Point, float]:
        """One iteration, and the share of the step that was taken."""
        t = self.table
        weight = self._weights(p)
        self._factor(weight)
        mu, count = self.mu(p), max(1, int(t.side.sum() + t.elastic.sum()))
        affine = self._direction(p, r, _Targets(-p.s * p.multiplier, -p.e * p.f), weight)
        share = self._share(p, affine, 1.0)
        after = p.moved(affine, share)
        centre = mu * (float((after.s * after.multiplier).sum() + (after.e * after.f).sum()) / count / mu) ** 3
        targets = _Targets(
            np.where(t.side, centre - affine.s * affine.multiplier - p.s * p.multiplier, 0.0),
            np.where(t.elastic, centre - affine.e * affine.f - p.e * p.f, 0.0),
        )
        step = self._direction(p, r, targets, weight)
        share = self._share(p, step, STAGE_TOLERANCES.to_boundary)
        return p.moved(step, share), share

    def mu(self, p: Point) -> float:
        """Mean complementarity."""
        count = self.table.side.sum() + self.table.elastic.sum()
        return float((p.s * p.multiplier).sum() + (p.e * p.f).sum()) / max(1, int(count))

    def _share(self, p: Point, step: Point, most: float) -> float:
        """Of a step after which nothing is negative."""
        share = 1.0
        for value, change in ((p.s, step.s), (p.multiplier, step.multiplier), (p.e, step.e), (p.f, step.f)):
            falls = change < 0.0
            share = min(share, most * float((-value[falls] / change[falls]).min(initial=1.0 / most)))
        return share

    def _soft(self, p: Point) -> Array:
        """(2, M) by how much e follows the multiplier."""
        return np.divide(p.e, p.f + p.e * self.table.l2, out=np.zeros_like(p.e), where=p.f > 0.0)

    def _weights(self, p: Point) -> Array:
        """(2, M) of the sides."""
        t = self.table
        give = self.elasticity + t.compliance + self._soft(p)
        return np.divide(p.multiplier, p.multiplier * give + p.s, out=np.zeros_like(p.s), where=p.multiplier > 0.0)

    def _factor(self, weight: Array) -> None:
        self.iterations += 1
        t = self.table
        total = weight.sum(axis=0) + np.where(t.equal, 1.0 / (self.elasticity + t.compliance), 0.0)
        failed = self.stages.factor(total[: self.n_rows], np.ascontiguousarray(total[self.n_rows :]))
        if failed:
            raise CannotFactor(StageQpStatus.NOT_CONVEX if failed == 1 else StageQpStatus.NOT_A_NUMBER)

    def _direction(self, p: Point, r: Residuals, targets: _Targets, weight: Array) -> Point:
        """Of Newton's method, towards products that differ by `targets` from those at p."""
        t, m = self.table, self.n_rows
        give, stiff = self._soft(p), 1.0 / (self.elasticity + t.compliance)
        left = np.divide(targets.elastic - p.e * r.dual, p.f + p.e * t.l2, out=np.zeros_like(p.e), where=p.f > 0.0)
        gap = r.row + left - np.divide(targets.side, p.multiplier, out=np.zeros_like(p.s), where=p.multiplier > 0.0)
        pull = (SIGNS * weight * gap).sum(axis=0) + np.where(t.equal, r.equal * stiff, 0.0)
        grad = self.stages.add_transposed(pull[:m], np.ascontiguousarray(pull[m:]), r.grad)
        dz, costate = self.stages.solve(grad, r.defect)
        value = np.concatenate([self.stages.values(dz), dz])
        multiplier = -weight * (SIGNS * value + gap)
        s = np.divide(targets.side - p.s * multiplier, p.multiplier, out=np.zeros_like(p.s), where=p.multiplier > 0.0)
        e = give * multiplier + left
        f = np.divide(targets.elastic - p.f * e, p.e, out=np.zeros_like(p.e), where=p.e > 0.0)
        y = np.where(t.equal, (value + r.equal) * stiff, 0.0)
        return Point(z=dz, costate=costate, y=y, s=s, multiplier=multiplier, e=e, f=f)


@dataclass(frozen=True, slots=True, eq=False)
class _Targets:
    """By how much products of a multiplier and what is left shall change."""

    side: Array
    elastic: Array

    @staticmethod
    def none(p: Point) -> _Targets:
        return _Targets(np.zeros_like(p.s), np.zeros_like(p.s))


class CannotFactor(Exception):  # inside this room only
    def __init__(self, status: StageQpStatus) -> None:
        super().__init__(status.advice)
        self.status = status


_CORRECTIONS = 10
_LEAST = 1e-3  # size of variables below which stationarity counts no more
