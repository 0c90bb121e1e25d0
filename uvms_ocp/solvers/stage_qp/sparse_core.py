"""Solve a QP of stages as one sparse QP by PIQP, a proximal interior point method: the oracle of the
solver in C, which it replaces where there is no compiler.

The variables are z, stage after stage, and two slacks e >= 0 for every row that may be violated,
which cost ``l1 e + l2 e^2 / 2``. Results are judged by the optimality conditions, not by the status
of PIQP. A run counts as one iteration, as PIQP does not tell how many it took.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.stage_qp import problem, tolerances
from uvms_ocp.solvers.stage_qp.options import StageQpOptions
from uvms_ocp.types import Array, Indices, Mask

_PLUGIN = "piqp"
_ACCURACIES = ("abs", "rel", "duality_gap_abs", "duality_gap_rel")
_SHARPER = 1e3
"""Factor by which the accuracy of PIQP is sharper than the tolerance: a bound that barely binds is
missed by the root of its accuracy.
"""
_REGULARIZATIONS = (1e-7, 1e-10)
"""Least regularizations of the KKT matrix, tried in turn: a small one lets its factors be noise over
long horizons, a large one keeps steps short where rows depend on each other.
"""


class _SparseQp(NamedTuple):
    """QP to minimise ``1/2 x' H x + g' x`` with ``lba <= A x <= uba`` and ``lbx <= x <= ubx``; the
    fields are CasADi's names.
    """

    h: ca.DM
    g: Array
    a: ca.DM
    lba: Array
    uba: Array
    lbx: Array
    ubx: Array


class SparseCore:
    """Solver of QPs of one shape."""

    def __init__(self, shape: problem.StageShape) -> None:
        """Raises `InvalidInput` where CasADi lacks PIQP."""
        if not ca.has_conic(_PLUGIN):
            raise InvalidInput(
                f"this CasADi has no QP solver {_PLUGIN!r}; install a C compiler, or CasADi from"
                " PyPI"
            )
        self._shape = shape
        self._next_states = _next_states(shape)
        """Matrix that picks the states that steps lead to."""
        self._solvers: dict[tuple[object, ...], ca.Function] = {}

    def solve(
        self,
        qp: problem.StageQp,
        options: StageQpOptions,
        warm_start: problem.WarmStart | None,
    ) -> problem.FlatSolution:
        """Solve from a point at rest, or from z of a warm start; NOT_A_NUMBER where entries of the QP
        are not finite.
        """
        table = problem.row_table(qp)
        if not problem.is_valid(qp):
            return self._unsolved(qp, table, problem.StageQpStatus.NOT_A_NUMBER)
        z = table.rest(qp) if warm_start is None else warm_start.z
        return self.run(qp, table, z, options, phase_one=False)

    def run(
        self,
        qp: problem.StageQp,
        table: problem.RowTable,
        z: Array,
        options: StageQpOptions,
        *,
        phase_one: bool,
    ) -> problem.FlatSolution:
        """Run PIQP from z (n,) [unit of z] with the rows of a table; phase_one: without the cost."""
        Q, q = _cost(qp, costless=phase_one)
        if not self._is_convex(qp, table, Q):
            return self._unsolved(qp, table, problem.StageQpStatus.NOT_CONVEX)
        soft = table.elastic.any(axis=0) | (table.compliance > 0.0)
        m = len(qp.flat["lower"])
        is_constrained = table.side.any(axis=0) | table.equal
        hard = np.concatenate([is_constrained[:m], table.fixed])
        rows = np.flatnonzero(soft | hard)
        sparse = self._assembled(qp, table, Q, q, soft, rows)
        ends = list[problem.FlatSolution]()
        for regularization in _REGULARIZATIONS:
            primal_dual, infeasible = self._solved(sparse, z, options, regularization)
            end = self._judged(qp, table, sparse, rows, primal_dual)
            worst = np.inf if infeasible else end.worst
            if worst <= options.tolerance:
                ends.append(replace(end, status=problem.StageQpStatus.SOLVED, worst=worst))
                break
            ends.append(replace(end, status=problem.StageQpStatus.ITERATION_LIMIT, worst=worst))
        return min(ends, key=lambda end: end.worst)

    def _judged(
        self,
        qp: problem.StageQp,
        table: problem.RowTable,
        sparse: _SparseQp,
        rows: Indices,
        primal_dual: tuple[Array, ...],
    ) -> problem.FlatSolution:
        """Return the solution with its residuals of the optimality conditions, from x and the
        multipliers of rows and variables.
        """
        x, y_a, y_x = primal_dual
        n = len(table.fixed)
        m = len(qp.flat["lower"])
        n_b = len(qp.flat["b"])
        z = x[:n]
        y = np.concatenate([np.zeros(m), y_x[:n]])
        y[rows] = y_a[n_b:]
        value = problem.row_values(qp, z)
        Ax = (sparse.a @ x).full().ravel()
        slope = (sparse.h @ x).full().ravel() + sparse.g
        lagrangian_gradient = slope + (sparse.a.T @ y_a).full().ravel() + y_x
        defect = np.abs(Ax - sparse.lba)[:n_b].max(initial=0.0)
        kkt = problem.kkt_residual(
            stationarity=float(np.abs(lagrangian_gradient).max()),
            primal=float(max(defect, table.violation(value))),
            complementarity=max(
                _complementarity(y_a, Ax, sparse.lba, sparse.uba),
                _complementarity(y_x, x, sparse.lbx, sparse.ubx),
            ),
        )
        curvature = float(np.abs(sparse.h[:n, :n].nonzeros()).max(initial=0.0))
        gradient_terms = (
            np.abs(slope[:n]).max(),
            np.abs(y * table.norm).max(),
            tolerances.LEAST_SIZE * curvature,
            1e-300,
        )
        gradient = float(max(gradient_terms))
        variable = 1.0 + float(np.abs(z).max())
        worst = max(
            kkt.stationarity / gradient,
            kkt.primal / variable,
            kkt.complementarity / (gradient * variable),
        )
        # Without a feasible point multipliers grow without end, and residuals are small beside them.
        smallest_gradient = max(np.abs(sparse.g).max(), tolerances.LEAST_SIZE * curvature, 1e-300)
        if gradient > tolerances.HOPELESS * smallest_gradient:
            worst = np.inf
        return self._ended(
            qp,
            z,
            status=problem.StageQpStatus.ITERATION_LIMIT,
            costate=np.concatenate([np.zeros(self._shape.n_x[0]), y_a[:n_b]]),
            y=y,
            value=value,
            kkt=kkt,
            worst=worst,
            iterations=1,
        )

    def _unsolved(
        self, qp: problem.StageQp, table: problem.RowTable, status: problem.StageQpStatus
    ) -> problem.FlatSolution:
        """Return the point at rest with the status of a QP that was not solved."""
        z = table.rest(qp)
        n_rows = len(table.norm)
        costate = np.zeros(sum(self._shape.n_x))
        kkt = problem.kkt_residual(stationarity=np.inf, primal=np.inf, complementarity=np.inf)
        return self._ended(
            qp,
            z,
            status=status,
            costate=costate,
            y=np.zeros(n_rows),
            kkt=kkt,
            iterations=0,
            value=np.full(n_rows, np.nan),
            worst=np.inf,
        )

    def _ended(self, qp: problem.StageQp, z: Array, **fields: Any) -> problem.FlatSolution:
        """Return the solution z with these other fields."""
        return problem.FlatSolution(z=z, shape=self._shape, products=self.products(qp, z), **fields)

    def _assembled(
        self,
        qp: problem.StageQp,
        table: problem.RowTable,
        Q: list[Array],
        q: Array,
        soft: Mask,
        rows: Indices,
    ) -> _SparseQp:
        """Build the sparse QP with the dynamics and these rows, of which the soft ones have two
        slacks each.
        """
        n = len(q)
        m = len(qp.flat["lower"])
        n_soft = int(soft.sum())
        n_slacks = 2 * n_soft
        last_stage = ca.DM(len(qp.flat["b"]), self._shape.n_z[-1])
        steps = ca.horzcat(_block_diagonal(qp.dynamics), last_stage) - self._next_states
        row_matrix = ca.vertcat(_block_diagonal(qp.C), ca.DM.eye(n))[rows.tolist(), :]
        soft_rows = np.flatnonzero(soft[rows]).tolist()
        slack = ca.DM.triplet(soft_rows, list(range(n_soft)), ca.DM.ones(n_soft), len(rows), n_soft)
        A = ca.vertcat(
            ca.horzcat(steps, ca.DM(steps.shape[0], n_slacks)),
            ca.horzcat(row_matrix, -slack, slack),
        )
        compliance = table.compliance[soft]
        is_quadratic = compliance > 0.0
        l1 = table.l1[soft]
        l2 = np.where(is_quadratic, 1.0 / np.where(is_quadratic, compliance, 1.0), table.l2[soft])
        H = ca.diagcat(_block_diagonal(Q), ca.diag(ca.DM([*l2, *l2])))
        endless = [[-np.inf], [np.inf]]
        inequalities = np.where(table.side, table.bound, endless)
        lower, upper = np.where(table.equal, table.target, inequalities)
        # Between equal bounds there is no interior: fixed variables become rows.
        is_row = soft[m:] | table.fixed
        z_lower, z_upper = np.where(is_row, endless, [lower[m:], upper[m:]])
        fixed_values = qp.flat["z_lower"][table.fixed]
        lower[m:][table.fixed] = fixed_values
        upper[m:][table.fixed] = fixed_values
        return _SparseQp(
            h=H,
            g=np.concatenate([q, l1, l1]),
            a=A,
            lba=np.concatenate([-qp.flat["b"], lower[rows]]),
            uba=np.concatenate([-qp.flat["b"], upper[rows]]),
            lbx=np.concatenate([z_lower, np.zeros(n_slacks)]),
            ubx=np.concatenate([z_upper, np.full(n_slacks, np.inf)]),
        )

    def _solved(
        self, sparse: _SparseQp, z: Array, options: StageQpOptions, regularization: float
    ) -> tuple[tuple[Array, ...], bool]:
        """Return x and the multipliers of A x and of x, all zeros where a number is not finite; and
        whether PIQP finds the QP infeasible.
        """
        solver = self._solver(sparse, options, regularization)
        n_slacks = len(sparse.g) - len(z)
        result = solver(**sparse._asdict(), x0=np.concatenate([z, np.zeros(n_slacks)]))
        parts = tuple(np.array(result[name]).ravel() for name in ("x", "lam_a", "lam_x"))
        infeasible = "infeasible" in solver.stats()["return_status"]
        if not all(np.isfinite(part).all() for part in parts):
            parts = tuple(np.zeros_like(part) for part in parts)
        return parts, infeasible

    def _solver(
        self, sparse: _SparseQp, options: StageQpOptions, regularization: float
    ) -> ca.Function:
        """Return the solver for the sparsity of a QP and these options; each is made once."""
        H = sparse.h.sparsity()
        A = sparse.a.sparsity()
        sparsity = (H.nnz(), *A.row(), *A.colind())
        key = (*sparsity, options.tolerance, options.max_iterations, regularization)
        if key not in self._solvers:
            piqp_options: dict[str, object] = {
                f"eps_{name}": options.tolerance / _SHARPER for name in _ACCURACIES
            }
            piqp_options["reg_lower_limit"] = regularization
            piqp_options["max_iter"] = options.max_iterations
            plugin_options = {_PLUGIN: piqp_options, "error_on_fail": False}
            self._solvers[key] = ca.conic("stages", _PLUGIN, {"h": H, "a": A}, plugin_options)
        return self._solvers[key]

    def _is_convex(self, qp: problem.StageQp, table: problem.RowTable, Q: list[Array]) -> bool:
        """Check by a Riccati recursion whether the cost is convex where dynamics and equalities
        hold.
        """
        if not qp.flat["H"].any() and (qp.flat["damping"] >= 0.0).all():
            return True
        largest = max(np.abs(Q_k).max(initial=0.0) for Q_k in Q)
        m = len(qp.flat["lower"])
        weight = np.where(table.equal, largest / (tolerances.ELASTICITY * table.norm**2), 0.0)
        P = np.zeros((0, 0))
        for k in range(self._shape.N, -1, -1):
            C = qp.C[k]
            z = problem.slices(self._shape.n_z)[k]
            fixed = table.fixed[z]
            n = self._shape.n_x[k] if k else 0
            row_weight = weight[problem.slices(self._shape.n_c)[k], None]
            M = Q[k] + C.T @ (row_weight * C) + np.diag(weight[m:][z])
            if k < self._shape.N:
                M += qp.dynamics[k].T @ P @ qp.dynamics[k]
            M[fixed] = 0.0
            M[:, fixed] = 0.0
            smallest_pivot = tolerances.SMALLEST_CURVATURE * largest
            pivot_margin = tolerances.INDEFINITE * (np.abs(np.diag(M)) + smallest_pivot)
            M += np.diag(np.where(fixed, 1.0, pivot_margin))
            try:
                W = np.linalg.solve(np.linalg.cholesky(M[n:, n:]), M[n:, :n])
            except np.linalg.LinAlgError:
                return False
            P = M[:n, :n] - W.T @ W
        return True

    def stationarity(self, qp: problem.StageQp, warm_start: problem.WarmStart) -> float:
        """Return the largest entry [1/unit of z] of the gradient of a QP's Lagrangian at 0, with the
        multipliers of a warm start and without fixed variables.
        """
        _, gradient = _cost(qp)
        m = len(qp.flat["lower"])
        N = self._shape.N
        costate = [warm_start.costate[stage] for stage in problem.slices(self._shape.n_x)]
        y_rows = [warm_start.y[stage] for stage in problem.slices(self._shape.n_c)]
        y_z = warm_start.y[m:]
        for k, stage in enumerate(problem.slices(self._shape.n_z)):
            gradient[stage] += y_rows[k] @ qp.C[k] + y_z[stage]
            if k > 0:
                gradient[stage][: len(costate[k])] -= costate[k]
            if k < N:
                gradient[stage] += costate[k + 1] @ qp.dynamics[k]
        gradient[problem.row_table(qp).fixed] = 0.0
        return float(np.abs(gradient).max(initial=0.0))

    def steepest(self, qp: problem.StageQp) -> float:
        """Return the largest entry [1/unit of z] of the gradient of the residuals' half square, at
        0.
        """
        gradients = [r @ J for J, r in zip(qp.J, qp.r, strict=True)]
        return float(max(np.abs(gradient).max(initial=0.0) for gradient in gradients))

    @np.errstate(invalid="ignore")  # of what is not a number
    def products(self, qp: problem.StageQp, z: Array) -> problem.ResidualProducts:
        """Return the products of the residuals' rows along z (n,) [unit of z]."""
        stages = problem.parts(z, self._shape.n_z)
        along = [J @ z_k for J, z_k in zip(qp.J, stages, strict=True)]
        changes = [np.abs(part @ J).max(initial=0.0) for J, part in zip(qp.J, along, strict=True)]
        residual_change = np.concatenate(along)
        return problem.ResidualProducts(
            slope=float(qp.flat["r"] @ residual_change),
            square=float(residual_change @ residual_change),
            change=float(max(changes)),
        )


def _cost(qp: problem.StageQp, *, costless: bool = False) -> tuple[list[Array], Array]:
    """Return the Hessian of every stage and the gradient (n,) at 0; costless: a tiny curvature and
    no gradient.
    """
    n_z = qp.shape.n_z
    if costless:
        return [tolerances.PHASE_ONE * np.eye(n) for n in n_z], np.zeros(sum(n_z))
    hessians = list[Array]()
    for J, H, damping in zip(qp.J, qp.H, qp.damping, strict=True):
        hessians.append(J.T @ J + np.tril(H) + np.tril(H, -1).T + np.diag(damping))
    gradients = [J.T @ r + g for J, r, g in zip(qp.J, qp.r, qp.g, strict=True)]
    return hessians, np.concatenate(gradients)


def _next_states(shape: problem.StageShape) -> ca.DM:
    """Return the matrix (sum of n_x without the first, n) that picks the states of all stages after
    the first from z.
    """
    first = problem.offsets(shape.n_z)
    columns = list[int]()
    for start, n_x in zip(first[1:-1], shape.n_x[1:], strict=True):
        columns += range(start, start + n_x)
    m = len(columns)
    return ca.DM.triplet(list(range(m)), columns, ca.DM.ones(m), m, first[-1])


def _block_diagonal(blocks: Sequence[Array]) -> ca.DM:
    """Return a block diagonal matrix."""
    return ca.diagcat(*[ca.DM(block) for block in blocks])


def _complementarity(y: Array, value: Array, lower: Array, upper: Array) -> float:
    """Return the largest product of a multiplier and the distance from its bound."""
    gap = np.abs(np.where(y > 0.0, upper, lower) - value)
    return float(np.abs(y * np.where(np.isfinite(gap), gap, 0.0)).max(initial=0.0))
