"""QPs of stages by an interior point: with a factor per iteration, and one only where no bound is reached."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.stagewise.interior_point import InteriorPoint
from uvms_ocp.solvers.stagewise.iteration import End, iterated, warm_point
from uvms_ocp.solvers.stagewise.options import StageQpOptions
from uvms_ocp.solvers.stagewise.point import resting
from uvms_ocp.solvers.stagewise.riccati import NumpyStages
from uvms_ocp.solvers.stagewise.row_table import RowTable, row_table
from uvms_ocp.solvers.stagewise.shape import StageShape, slices
from uvms_ocp.solvers.stagewise.solution import KktResidual, StageQpSolution, StageQpStatus
from uvms_ocp.solvers.stagewise.stage_qp import StageQp
from uvms_ocp.solvers.stagewise.stages import compiled_stages

_MISSED = 1e-6  # relative violation that no point does without
_INEXACT = 1e3  # tolerances


@checked
class StageQpSolver:
    """Solves QPs of one shape; memory is made once, here.

    In C where there is a compiler, in NumPy otherwise, with the same results to rounding.
    """

    def __init__(self, shape: StageShape, options: StageQpOptions | None = None) -> None:
        self.shape, self.options = shape, options or StageQpOptions()
        self._stages = (compiled_stages(shape) if self.options.compiled else None) or NumpyStages(shape)

    @late
    def solve(self, qp: StageQp, warm: StageQpSolution | None = None) -> StageQpSolution:
        """The optimum; where there is none, what `StageQpStatus` says. No numbers raise anything.

        warm: the solution of a QP nearby, of the same shape. Raises `InvalidInput` for a QP of another shape.
        """
        if qp.shape != self.shape:
            raise InvalidInput("the QP has another shape than the solver; make a solver for it")
        table = row_table(qp)
        if not _is_finite(qp):
            return self._solution(qp, None, StageQpStatus.NOT_A_NUMBER, 0)
        end = self._run(qp, table, warm)
        if end.status in (StageQpStatus.SOLVED, StageQpStatus.NOT_CONVEX, StageQpStatus.UNBOUNDED):
            return self._solution(qp, end, end.status, end.iterations)
        return self._judged(qp, table, end)

    def _judged(self, qp: StageQp, table: RowTable, failed: End) -> StageQpSolution:
        """What it means that no optimum was found: phase one tells whether there is a point at all."""
        least = self._run(qp, row_table(qp, phase_one=True), None, costless=True)
        iterations = failed.iterations + least.iterations
        value = np.concatenate([self._stages.values(least.point.z), least.point.z])
        missed = InteriorPoint.violation(table, value)
        if least.status is StageQpStatus.SOLVED and missed > _MISSED * (1.0 + np.abs(least.point.z).max()):
            return self._solution(qp, least, StageQpStatus.INFEASIBLE, iterations)
        near = failed.residuals.worst() <= _INEXACT * self.options.tolerance
        return self._solution(qp, failed, StageQpStatus.INEXACT if near else failed.status, iterations)

    def _run(self, qp: StageQp, table: RowTable, warm: StageQpSolution | None, *, costless: bool = False) -> End:
        self._stages.fixed[:] = table.fixed
        curvature = self._stages.load(qp, costless=costless) or 1.0
        method = InteriorPoint(self._stages, table, 1.0 if costless else curvature, self.options)
        z = np.where(table.fixed, qp.flat["z_lower"], 0.0)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            start = None if warm is None else warm_point(method, warm, z, self.options.warm_mu * curvature)
            return iterated(method, z, start)

    def _solution(self, qp: StageQp, end: End | None, status: StageQpStatus, iterations: int) -> StageQpSolution:
        shape, m = self.shape, len(qp.flat["lower"])
        n = sum(shape.n_z)
        point = resting(np.zeros(n), sum(shape.n_x), m + n) if end is None else end.point
        kkt = (
            KktResidual(stationarity=np.inf, primal=np.inf, complementarity=np.inf)
            if end is None
            else end.residuals.kkt
        )
        y, z = point.y + point.multiplier[1] - point.multiplier[0], _split(point.z, shape.n_z)
        if end is not None:
            y[m:] -= end.residuals.held
        value = np.concatenate([C @ own for C, own in zip(qp.C, z, strict=True)])
        return StageQpSolution(
            status=status,
            z=z,
            x=tuple(own[:n] for own, n in zip(z, shape.n_x, strict=True)),
            u=tuple(own[n:] for own, n in zip(z[:-1], shape.n_x, strict=False)),
            costate=_split(point.costate, shape.n_x),
            y=_split(y[:m], shape.n_c),
            y_z=_split(y[m:], shape.n_z),
            excess=_split(value - np.clip(value, qp.flat["lower"], qp.flat["upper"]), shape.n_c),
            iterations=iterations,
            kkt=kkt,
            cost=_cost(qp, z),
        )


def _split(flat: Array, sizes: tuple[int, ...]) -> tuple[Array, ...]:
    return tuple(flat[own] for own in slices(sizes))


def _is_finite(qp: StageQp) -> bool:
    """Infinite bounds and weights of slack aside."""
    bounds = ("lower", "upper", "l1", "z_lower", "z_upper", "z_l1")
    numbers = all(np.isfinite(array).all() for name, array in qp.flat.items() if name not in bounds)
    return numbers and not any(np.isnan(qp.flat[name]).any() for name in bounds)


def _cost(qp: StageQp, z: tuple[Array, ...]) -> float:
    """Without what soft rows cost."""
    total = 0.0
    for k, own in enumerate(z):
        residual = qp.J[k] @ own + qp.r[k]
        H = np.tril(qp.H[k]) + np.tril(qp.H[k], -1).T
        total += float(residual @ residual / 2 + own @ (H @ own + qp.damping[k] * own) / 2 + qp.g[k] @ own)
    return total
