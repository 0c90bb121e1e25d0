"""QPs of stages by an interior point: with a factor per iteration, and one only where no bound is reached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.intervals import distance
from uvms_ocp.solvers.stagewise.compiled import compiled_core
from uvms_ocp.solvers.stagewise.iteration import NumpyCore
from uvms_ocp.solvers.stagewise.options import STAGE_TOLERANCES, StageQpOptions
from uvms_ocp.solvers.stagewise.point import End, Point, Start, nothing, resting
from uvms_ocp.solvers.stagewise.row_table import RowTable, held, mended, reached, row_table
from uvms_ocp.solvers.stagewise.second_look.residual_rows import own_rows, with_residuals_as_rows
from uvms_ocp.solvers.stagewise.second_look.ways_down import leads_down, may_fall_endlessly, ways_down
from uvms_ocp.solvers.stagewise.solution import StageQpSolution, StageQpStatus, stage_qp_solution
from uvms_ocp.solvers.stagewise.stage_qp import StageQp, StageShape, slices

_MISSED = 1e-5  # relative violation that no point does without
_ROUGH = 1e-6  # tolerance of phase one


@checked
class StageQpSolver:
    """Solves QPs of one shape, one at a time; memory is made once, here.

    In C where there is a compiler, without holding the interpreter's lock; in NumPy otherwise, with the same results to rounding.
    """

    def __init__(self, shape: StageShape, options: StageQpOptions | None = None) -> None:
        self.shape, self.options = shape, options or StageQpOptions()
        self._core = (compiled_core(shape) if self.options.compiled else None) or NumpyCore(shape)

    @late
    def solve(self, qp: StageQp, warm: StageQpSolution | None = None) -> StageQpSolution:
        """The optimum; where there is none, what `StageQpStatus` says. No numbers raise anything.

        warm: the solution of a QP nearby, of the same shape. Raises `InvalidInput` for a QP of another shape.
        """
        if qp.shape != self.shape:
            raise InvalidInput("the QP has another shape than the solver; make a solver for it")
        table = row_table(qp)
        if not _is_valid(qp):
            return self._solution(qp, nothing(self._rest(qp, table)))
        if warm is None:
            end = self._run(qp, table, self._rest(qp, table))
        else:
            end = self._guessed(qp, table, warm) or self._run(qp, table, self._near(qp, table, warm), Start.WARM)
        if end.status in (StageQpStatus.ITERATION_LIMIT, StageQpStatus.UNBOUNDED):
            end = self._judged(qp, table, end)
        return self._solution(qp, end)

    def _guessed(self, qp: StageQp, table: RowTable, near: StageQpSolution) -> End | None:
        """The optimum where the bounds that it reaches are found soon, starting with those of a QP nearby."""
        active, spent, before = reached(table, near), 0, table.side.size
        while self.options.guess and not table.elastic.any():
            end = self._run(qp, held(table, active), self._rest(qp, table), Start.ACTIVE)
            spent += end.iterations
            if end.status is not StageQpStatus.SOLVED:
                break
            better = mended(table, active, end.point.y, _values(qp, end.point.z), self.options.tolerance)
            changes = int((better != active).sum())
            if changes == 0:
                return replace(end, iterations=spent)
            if changes >= before:
                break
            active, before = better, changes
        return None

    def _judged(self, qp: StageQp, table: RowTable, failed: End) -> End:
        """What it means that no optimum was found: phase one tells whether there is a point at all, and where."""
        if failed.worst <= self._inexact and failed.status is StageQpStatus.ITERATION_LIMIT:
            return replace(failed, status=StageQpStatus.INEXACT)
        least = self._run(qp, row_table(qp, phase_one=True), self._rest(qp, table), costless=True)
        spent = failed.iterations + least.iterations
        missed = table.violation(_values(qp, least.point.z))
        if least.status is StageQpStatus.SOLVED and missed > _MISSED * (1.0 + np.abs(least.point.z).max()):
            return replace(least, status=StageQpStatus.INFEASIBLE, iterations=spent)
        if self._is_endless(qp):
            return replace(failed, status=StageQpStatus.UNBOUNDED, iterations=spent)
        again = self._run_slowly(qp, least.point)
        best = min(failed, again, key=lambda end: end.worst)
        return replace(best, status=self._last_word(best), iterations=spent + again.iterations)

    @property
    def _inexact(self) -> float:
        return self.options.tolerance * STAGE_TOLERANCES.inexact_tolerances

    def _last_word(self, best: End) -> StageQpStatus:
        """Endless steps alone prove nothing."""
        if best.status is StageQpStatus.SOLVED:
            return best.status
        endless = best.status is StageQpStatus.UNBOUNDED
        status = StageQpStatus.ITERATION_LIMIT if endless else best.status
        return StageQpStatus.INEXACT if best.worst <= self._inexact else status

    def _is_endless(self, qp: StageQp) -> bool:
        """Whether there is a way along which the cost falls for ever."""
        if not may_fall_endlessly(qp):
            return False
        other = ways_down(qp)
        way = StageQpSolver(other.shape, self.options).solve(other)
        return way.status.usable and leads_down(other, way.z)

    def _run_slowly(self, qp: StageQp, start: Point) -> End:
        """With residuals as rows, and some curvature for directions that have none, from the z of a start."""
        other = with_residuals_as_rows(qp)
        table, own = row_table(other), own_rows(qp.shape, other.shape)
        slow = StageQpSolver(other.shape, self.options)
        point = replace(slow._rest(other, table), z=start.z)
        end = slow._run(other, table, point, Start.COLD, damped=True)
        return replace(end, point=end.point.of_rows(own))

    def _run(
        self,
        qp: StageQp,
        table: RowTable,
        point: Point,
        start: Start = Start.EQUALITIES,
        *,
        costless: bool = False,
        damped: bool = False,
    ) -> End:
        # With next to no curvature phase one loses digits, and needs few.
        options = replace(self.options, tolerance=max(self.options.tolerance, _ROUGH)) if costless else self.options
        return self._core.run(qp, table, point, options, start=start, costless=costless, damped=damped)

    def _rest(self, qp: StageQp, table: RowTable) -> Point:
        z = np.where(table.fixed, qp.flat["z_lower"], 0.0)
        return resting(z, sum(self.shape.n_x), len(table.norm))

    def _near(self, qp: StageQp, table: RowTable, solution: StageQpSolution) -> Point:
        z = np.where(table.fixed, qp.flat["z_lower"], np.concatenate(solution.z))
        y = np.concatenate([*solution.y, *solution.y_z])
        return replace(self._rest(qp, table), z=z, y=y, costate=np.concatenate(solution.costate))

    @np.errstate(over="ignore", invalid="ignore")  # of what is not a number there is no cost
    def _solution(self, qp: StageQp, end: End) -> StageQpSolution:
        shape, m, y = self.shape, sum(self.shape.n_c), end.point.row_multipliers()
        z, value = _split(end.point.z, shape.n_z), _values(qp, end.point.z)[:m]
        return stage_qp_solution(
            status=end.status,
            z=z,
            x=tuple(own[:n] for own, n in zip(z, shape.n_x, strict=True)),
            u=tuple(own[n:] for own, n in zip(z[:-1], shape.n_x, strict=False)),
            costate=_split(end.point.costate, shape.n_x),
            y=_split(y[:m], shape.n_c),
            y_z=_split(y[m:] - end.held, shape.n_z),
            excess=_split(distance(value, qp.flat["lower"], qp.flat["upper"]), shape.n_c),
            iterations=end.iterations,
            kkt=end.kkt,
            cost=_cost(qp, z),
        )


def _split(flat: Array, sizes: tuple[int, ...]) -> tuple[Array, ...]:
    return tuple(flat[own] for own in slices(sizes))


def _values(qp: StageQp, z: Array) -> Array:
    """(M,) of rows and variables."""
    return np.concatenate([*(C @ own for C, own in zip(qp.C, _split(z, qp.shape.n_z), strict=True)), z])


def _is_valid(qp: StageQp) -> bool:
    """Finite but for bounds that there are not; slack costs something."""
    flat = qp.flat
    bounds = ("lower", "upper", "l1", "z_lower", "z_upper", "z_l1")
    numbers = all(np.isfinite(array).all() for name, array in flat.items() if name not in bounds)
    sides = all((flat[f"{z}lower"] < np.inf).all() and (flat[f"{z}upper"] > -np.inf).all() for z in ("", "z_"))
    return numbers and sides and all((flat[name] >= 0.0).all() for name in ("l1", "l2", "z_l1", "z_l2"))


def _cost(qp: StageQp, z: tuple[Array, ...]) -> float:
    residual = np.concatenate([J @ own for J, own in zip(qp.J, z, strict=True)]) + qp.flat["r"]
    flat = np.concatenate(z)
    total = residual @ residual / 2 + flat @ (qp.flat["damping"] * flat / 2 + qp.flat["g"])
    if qp.flat["H"].any():
        total += sum(own @ H @ own / 2 for H, own in zip(qp.H, z, strict=True))
    return float(total)
