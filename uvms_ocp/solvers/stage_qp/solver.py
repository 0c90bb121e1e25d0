"""Solve QPs of stages by an interior point [Mehrotra1992]: one factorisation per iteration, and one
where no bound is reached.

Where there is a QP nearby, bounds that are reached are guessed from it: they are equalities and all
others are none, until both prove right [Hintermueller2002].

A QP that a first run has not solved is looked at again: with its residuals as rows, and for
recession directions, along which its cost falls without end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from uvms_ocp.checks import checked_constructor
from uvms_ocp.codegen.elementwise import interval_excess
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.stage_qp import compiled, problem, sparse_core, tolerances
from uvms_ocp.solvers.stage_qp.options import StageQpOptions
from uvms_ocp.types import Array

_DIRECTION_TOLERANCE = 1e-7  # relative violation with which a direction keeps bounds and rows
_SMALLEST_DESCENT = 1e-6  # smallest descent along a direction, relative to the gradient
_SIDES = (("lower", -np.inf), ("upper", np.inf))
_UNEXPLAINED = (problem.StageQpStatus.ITERATION_LIMIT, problem.StageQpStatus.UNBOUNDED)
_INFEASIBLE_VIOLATION = 1e-5  # relative violation of the best point that proves a QP infeasible
_PHASE_ONE_TOLERANCE = 1e-6  # of the run that looks for a feasible point
_COPIED = ("dynamics", "b", "H", "g", "damping", "z_lower", "z_upper", "z_l1", "z_l2")
_ROWS = ("C", "lower", "upper", "l1", "l2")


def with_residuals_as_rows(qp: problem.StageQp) -> problem.StageQp:
    """Return the QP with every residual as a row behind the others, missed at the same cost.

    Where a Hessian is the sum of stiff and weak residuals, the weak ones are lost to rounding.
    """
    converted = with_rows(qp, qp.J)
    for name in _COPIED:
        converted.flat[name][:] = qp.flat[name]
    for k, (J, r) in enumerate(zip(qp.J, qp.r, strict=True)):
        n = qp.shape.n_c[k]
        norm = problem.norms(J)
        converted.lower[k][n:] = -r / norm
        converted.upper[k][n:] = -r / norm
        converted.l1[k][n:] = 0.0
        converted.l2[k][n:] = norm**2
    return converted


def original_rows(shape: problem.StageShape, larger: problem.StageShape) -> Array:
    """Return the indices (M,) of the rows and variables of a QP among those of one that has more
    rows behind them in each stage.
    """
    rows = problem.leading(larger.n_c, shape.n_c)
    variables = sum(larger.n_c) + np.arange(sum(shape.n_z))
    return np.concatenate([rows, variables])


def with_rows(qp: problem.StageQp, rows: Sequence[Array]) -> problem.StageQp:
    """Return the QP without its cost, and with more `rows` (m, n_z) [any] behind its own, scaled to
    a largest entry of 1, that are to be 0.
    """
    n_c = tuple(n + len(added) for n, added in zip(qp.shape.n_c, rows, strict=True))
    extended = problem.StageQp(replace(qp.shape, n_r=(0,) * len(n_c), n_c=n_c))
    for k, (n, added) in enumerate(zip(qp.shape.n_c, rows, strict=True)):
        for name in _ROWS:
            getattr(extended, name)[k][:n] = getattr(qp, name)[k]
        extended.C[k][n:] = added / problem.norms(added)[:, None]
        extended.lower[k][n:] = 0.0
        extended.upper[k][n:] = 0.0
    return extended


def may_be_unbounded(qp: problem.StageQp) -> bool:
    """Check whether some variable has neither curvature of its own nor two bounds."""
    flat = qp.flat
    has_two_bounds = np.isfinite(flat["z_lower"]) & np.isfinite(flat["z_upper"])
    is_bounded = has_two_bounds & (flat["z_l1"] == np.inf)
    return bool((~is_bounded & (flat["damping"] == 0.0)).any())


def recession_problem(qp: problem.StageQp) -> problem.StageQp:
    """Return the QP whose optimum is the steepest of all directions along which no cost but the
    linear one changes, and no hard row breaks.

    Directions form a cone, and the optimum is the projection of the negative gradient on it: 0 where
    there is no such direction.
    """
    curved = [H[np.abs(H).any(axis=1)] for H in qp.H]
    recession = with_rows(qp, [np.vstack(pair) for pair in zip(qp.J, curved, strict=True)])
    steepest = max(np.abs(qp.flat["g"]).max(), 1e-300)
    recession.flat["dynamics"][:] = qp.flat["dynamics"]
    recession.flat["damping"][:] = 1.0
    recession.flat["g"][:] = qp.flat["g"] / steepest
    for name in ("z_lower", "z_upper", "z_l1", "z_l2"):
        recession.flat[name][:] = qp.flat[name]
    for z in ("", "z_"):
        _make_cone(recession, z, steepest)
    is_damped = qp.flat["damping"] > 0.0
    recession.flat["z_lower"][is_damped] = 0.0
    recession.flat["z_upper"][is_damped] = 0.0
    recession.flat["z_l1"][is_damped] = np.inf
    return recession


def _make_cone(qp: problem.StageQp, z: str, steepest: float) -> None:
    """Set every finite bound to 0, and make rows with a quadratic penalty hard: its cost would grow
    without end along a direction that misses them.
    """
    for side, endless in _SIDES:
        bound = qp.flat[f"{z}{side}"]
        bound[bound != endless] = 0.0
    l1 = qp.flat[f"{z}l1"]
    l2 = qp.flat[f"{z}l2"]
    l1 /= steepest
    l1[l2 > 0.0] = np.inf
    l2[:] = 0.0


def is_recession_direction(recession: problem.StageQp, z: tuple[Array, ...]) -> bool:
    """Check whether the optimum z (n_z,) [unit of z] of `recession_problem` is a recession
    direction, by its own numbers.
    """
    longest = max(np.abs(z_k).max(initial=0.0) for z_k in z)
    if not 0.0 < longest < np.inf:
        return False
    direction = [z_k / longest for z_k in z]
    worst = 0.0
    rise = 0.0
    for k, d in enumerate(direction):
        excess = interval_excess(recession.C[k] @ d, recession.lower[k], recession.upper[k])
        excess_z = interval_excess(d, recession.z_lower[k], recession.z_upper[k])
        for l1, missed, norm in (
            (recession.l1[k], excess, problem.norms(recession.C[k])),
            (recession.z_l1[k], excess_z, 1.0),
        ):
            worst = max(worst, (missed / norm)[l1 == np.inf].max(initial=0.0))
            soft = l1 < np.inf
            rise += float(l1[soft] @ missed[soft])
        rise += float(recession.g[k] @ d)
        if k > 0:
            defect = recession.dynamics[k - 1] @ direction[k - 1] - d[: recession.shape.n_x[k]]
            worst = max(worst, np.abs(defect).max(initial=0.0))
    return bool(worst <= _DIRECTION_TOLERANCE and rise <= -_SMALLEST_DESCENT)


@checked_constructor
class StageQpSolver:
    """Solves QPs of one shape, one at a time; memory is made once, here.

    In C where there is a compiler, without holding the interpreter's lock; otherwise by PIQP, which
    finds the same optimum, and starts every QP anew.
    """

    def __init__(self, shape: problem.StageShape, options: StageQpOptions | None = None) -> None:
        self.shape = shape
        self.options = options or StageQpOptions()
        library = compiled.qp_library() if self.options.compiled else None
        self._core: sparse_core.SparseCore | compiled.CompiledCore
        if library is None:
            self._core = sparse_core.SparseCore(shape)
        else:
            self._core = compiled.CompiledCore(library, shape)

    def solve(
        self, qp: problem.StageQp, warm: problem.StageQpSolution | None = None
    ) -> problem.StageQpSolution:
        """Return the optimum; where there is none, `StageQpStatus` tells why. Numbers of any kind
        raise nothing.

        warm: the solution of a QP nearby, of the same shape. Raises `InvalidInput` for a QP of
        another shape.
        """
        warm_start = None if warm is None else _flat_start(warm)
        return _split(qp, self.solve_flat(qp, warm_start))

    def solve_flat(
        self,
        qp: problem.StageQp,
        warm_start: problem.WarmStart | None = None,
        *,
        tolerance: float | None = None,
        max_iterations: int | None = None,
        explained: bool = True,
    ) -> problem.FlatSolution:
        """Solve, with the solution in arrays that hold stage after stage.

        warm_start: the solution of a QP nearby. tolerance, max_iterations: instead of those of the
        options. explained: False takes less time where no optimum is found, and does not tell
        infeasible from unbounded. Raises `InvalidInput` as `solve` does.
        """
        if qp.shape is not self.shape and qp.shape != self.shape:
            raise InvalidInput("the QP has another shape than the solver; make a solver for it")
        options = _changed_options(self.options, tolerance, max_iterations)
        end = self._core.solve(qp, options, warm_start)
        if explained and (end.status in _UNEXPLAINED or _only_rounding(qp, end)):
            end = self._explain(qp, problem.row_table(qp), end)
        return end

    def steepest(self, qp: problem.StageQp) -> float:
        """Return the largest entry [1/unit of z] of the gradient of the residuals' half square, at
        0.
        """
        return self._core.steepest(qp)

    def error(self, qp: problem.StageQp, solution: problem.WarmStart) -> float:
        """Compute by how much the multipliers of the QP solved last miss the optimality conditions
        of another one at 0.

        Largest entry [1/unit of z] of the gradient of its Lagrangian, or product with the distance
        to a bound.
        """
        active = np.flatnonzero(solution.y)
        y = solution.y[active]
        flat = qp.flat
        lower = np.concatenate([flat["lower"], flat["z_lower"]])[active]
        upper = np.concatenate([flat["upper"], flat["z_upper"]])[active]
        products = y * np.where(y > 0.0, upper, lower)
        complementarity = float(np.abs(products).max(initial=0.0))
        return max(self._core.stationarity(qp, solution), complementarity)

    def _explain(
        self, qp: problem.StageQp, table: problem.RowTable, failed: problem.FlatSolution
    ) -> problem.FlatSolution:
        """Explain a failed run: phase one finds whether there is a feasible point at all, and
        where.
        """
        is_nearly_solved = failed.worst <= self._inexact
        if is_nearly_solved and failed.status is problem.StageQpStatus.ITERATION_LIMIT:
            return replace(failed, status=problem.StageQpStatus.INEXACT)
        # With next to no curvature phase one loses digits, and needs few.
        rough = replace(self.options, tolerance=max(self.options.tolerance, _PHASE_ONE_TOLERANCE))
        phase_one = self._core.run(
            qp, problem.row_table(qp, phase_one=True), table.rest(qp), rough, phase_one=True
        )
        spent = failed.iterations + phase_one.iterations
        violation = table.violation(problem.row_values(qp, phase_one.z))
        proving_violation = _INFEASIBLE_VIOLATION * (1.0 + np.abs(phase_one.z).max())
        is_optimal = phase_one.status is problem.StageQpStatus.SOLVED
        if is_optimal and violation > proving_violation:
            return replace(phase_one, status=problem.StageQpStatus.INFEASIBLE, iterations=spent)
        if self._is_unbounded(qp):
            return replace(failed, status=problem.StageQpStatus.UNBOUNDED, iterations=spent)
        damped = self._run_damped(qp, phase_one.z)
        best = min(failed, damped, key=lambda end: end.worst)
        return replace(best, status=self._final_status(best), iterations=spent + damped.iterations)

    @property
    def _inexact(self) -> float:
        """Return the relative residual up to which a solution is called inexact."""
        return self.options.tolerance * tolerances.INEXACT_TOLERANCES

    def _final_status(self, best: problem.FlatSolution) -> problem.StageQpStatus:
        """Return the status of the better of two runs; steps without end and rounding prove nothing,
        and count as an iteration limit.
        """
        if best.status is problem.StageQpStatus.SOLVED:
            return best.status
        if best.worst <= self._inexact:
            return problem.StageQpStatus.INEXACT
        if best.status is problem.StageQpStatus.NOT_A_NUMBER:
            return best.status
        return problem.StageQpStatus.ITERATION_LIMIT

    def _is_unbounded(self, qp: problem.StageQp) -> bool:
        """Check whether there is a direction along which the cost falls for ever."""
        if not may_be_unbounded(qp):
            return False
        recession = recession_problem(qp)
        steepest = StageQpSolver(recession.shape, self.options).solve(recession)
        return steepest.status.usable and is_recession_direction(recession, steepest.z)

    def _run_damped(self, qp: problem.StageQp, z: Array) -> problem.FlatSolution:
        """Solve the QP with residuals as rows, and some curvature for directions that have none,
        from z.
        """
        converted = with_residuals_as_rows(qp)
        table = problem.row_table(converted)
        original = original_rows(qp.shape, converted.shape)
        solver = StageQpSolver(converted.shape, self.options)
        end = solver._core.run(converted, table, z, self.options, phase_one=False)
        products = self._core.products(qp, end.z)
        return replace(
            end, y=end.y[original], value=end.value[original], shape=self.shape, products=products
        )


def _only_rounding(qp: problem.StageQp, end: problem.FlatSolution) -> bool:
    """Check whether a cost that is a sum of squares, and so convex, was taken for not convex."""
    if end.status is not problem.StageQpStatus.NOT_CONVEX:
        return False
    return not qp.flat["H"].any() and bool((qp.flat["damping"] >= 0.0).all())


def _split(qp: problem.StageQp, flat: problem.FlatSolution) -> problem.StageQpSolution:
    shape = qp.shape
    m = len(qp.flat["lower"])
    z = problem.parts(flat.z, shape.n_z)
    x = tuple(z_k[:n_x] for z_k, n_x in zip(z, shape.n_x, strict=True))
    u = tuple(z_k[n_x:] for z_k, n_x in zip(z[:-1], shape.n_x, strict=False))
    return problem.stage_qp_solution(
        status=flat.status,
        z=z,
        x=x,
        u=u,
        costate=problem.parts(flat.costate, shape.n_x),
        y=problem.parts(flat.y[:m], shape.n_c),
        y_z=problem.parts(flat.y[m:], shape.n_z),
        excess=problem.parts(flat.excess(qp), shape.n_c),
        iterations=flat.iterations,
        kkt=flat.kkt,
        cost=_cost(qp, flat),
    )


def _flat_start(solution: problem.StageQpSolution) -> problem.WarmStart:
    y = np.concatenate([*solution.y, *solution.y_z])
    return problem.WarmStart(
        z=np.concatenate(solution.z), costate=np.concatenate(solution.costate), y=y
    )


@np.errstate(over="ignore", invalid="ignore")  # of what is not a number there is no cost
def _cost(qp: problem.StageQp, solution: problem.FlatSolution) -> float:
    flat = qp.flat
    r = flat["r"]
    z = solution.z
    products = solution.products
    linear = products.slope + z @ flat["g"]
    stages = problem.parts(z, qp.shape.n_z)
    curvature = sum(z_k @ H @ z_k for H, z_k in zip(qp.H, stages, strict=True))
    damping = z @ (flat["damping"] * z)
    return float((r @ r + products.square + curvature + damping) / 2 + linear)


@lru_cache(maxsize=64)
def _changed_options(
    options: StageQpOptions, tolerance: float | None, max_iterations: int | None
) -> StageQpOptions:
    """Return options with another tolerance or limit of iterations, where these are not None."""
    if tolerance is not None:
        options = replace(options, tolerance=tolerance)
    if max_iterations is not None:
        options = replace(options, max_iterations=max_iterations)
    return options
