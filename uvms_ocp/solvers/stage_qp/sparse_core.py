"""Solve a QP of stages as one sparse QP by the proximal interior point PIQP: the oracle of the
solver in C, and in its place where there is no compiler.

The variables are z, stage after stage, and two slacks e >= 0 for every row that may be missed,
which cost ``l1 e + l2 e^2 / 2``. What a run ends with is judged by the optimality conditions,
whatever the solver says of itself; it counts as one iteration, as PIQP does not tell how many it
took.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.stage_qp import problem, tolerances
from uvms_ocp.types import Array, Indices, Mask

_PLUGIN = "piqp"
_ACCURACIES = ("abs", "rel", "duality_gap_abs", "duality_gap_rel")
# than the tolerance asks for: a bound that only just binds is missed by the root of what is left of
# it
_SHARPER = 1e3
_REGULARIZATIONS = (1e-7, 1e-10)
"""Regularizations of the KKT matrix, tried one after the other: with less its factors are noise
over long horizons, with more rows that depend on each other keep steps short.
"""


class _SparseQp(NamedTuple):
    """Min ``1/2 x' H x + g' x`` with ``lba <= A x <= uba`` and ``lbx <= x <= ubx``, by their names
    in CasADi.
    """

    h: ca.DM
    g: Array
    a: ca.DM
    lba: Array
    uba: Array
    lbx: Array
    ubx: Array


class SparseCore:
    """The solver of one shape."""

    def __init__(self, shape: problem.StageShape) -> None:
        """Raises `InvalidInput` where CasADi lacks PIQP."""
        if not ca.has_conic(_PLUGIN):
            raise InvalidInput(
                f"this CasADi has no QP solver {_PLUGIN!r}; install a C compiler, or CasADi from"
                " PyPI"
            )
        self._shape = shape
        first = problem.offsets(shape.n_z)
        after = [
            start + i for start, n in zip(first[1:-1], shape.n_x[1:], strict=True) for i in range(n)
        ]
        self._after = ca.DM.triplet(
            list(range(len(after))), after, ca.DM.ones(len(after)), len(after), first[-1]
        )
        """Picks the states that steps lead to."""
        self._solvers: dict[tuple[object, ...], ca.Function] = {}

    def solve(
        self, qp: problem.StageQp, options: problem.StageQpOptions, near: problem.WarmStart | None
    ) -> problem.FlatSolution:
        """Solve from nothing but the QP, or from z of a QP nearby; NOT_A_NUMBER where entries are
        none.
        """
        table = problem.row_table(qp)
        if not problem.is_valid(qp):
            return self._nothing(qp, table, problem.StageQpStatus.NOT_A_NUMBER)
        return self.run(
            qp, table, table.rest(qp) if near is None else near.z, options, phase_one=False
        )

    def run(
        self,
        qp: problem.StageQp,
        table: problem.RowTable,
        z: Array,
        options: problem.StageQpOptions,
        *,
        phase_one: bool,
    ) -> problem.FlatSolution:
        """Run from z (n,) [unit of z] with the rows of a table, without the cost in phase one; PIQP
        damps all its steps.
        """
        Q, q = _cost(qp, costless=phase_one)
        if not self._is_convex(qp, table, Q):
            return self._nothing(qp, table, problem.StageQpStatus.NOT_CONVEX)
        soft = table.elastic.any(axis=0) | (table.compliance > 0.0)
        hard = np.concatenate(
            [(table.side.any(axis=0) | table.equal)[: len(qp.flat["lower"])], table.fixed]
        )
        rows = np.flatnonzero(soft | hard)
        sparse = self._assembled(qp, table, Q, q, soft, rows)
        ends = list[problem.FlatSolution]()
        for regularization in _REGULARIZATIONS:
            (x, y_a, y_x), infeasible = self._solved(sparse, z, options, regularization)
            end = self._judged(qp, table, sparse, rows, (x, y_a, y_x))
            worst = np.inf if infeasible else end.worst
            solved = (
                problem.StageQpStatus.SOLVED
                if worst <= options.tolerance
                else problem.StageQpStatus.ITERATION_LIMIT
            )
            ends.append(replace(end, status=solved, worst=worst))
            if worst <= options.tolerance:
                break
        return min(ends, key=lambda end: end.worst)

    def _judged(
        self,
        qp: problem.StageQp,
        table: problem.RowTable,
        sparse: _SparseQp,
        rows: Indices,
        primal_dual: tuple[Array, Array, Array],
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
        value = np.concatenate(
            [*(C @ z_k for C, z_k in zip(qp.C, problem.parts(z, self._shape.n_z), strict=True)), z]
        )
        values = (sparse.a @ x).full().ravel()
        slope = (sparse.h @ x).full().ravel() + sparse.g
        kkt = problem.kkt_residual(
            stationarity=float(np.abs(slope + (sparse.a.T @ y_a).full().ravel() + y_x).max()),
            primal=float(
                max(np.abs(values - sparse.lba)[:n_b].max(initial=0.0), table.violation(value))
            ),
            complementarity=max(
                _left(y_a, values, sparse.lba, sparse.uba), _left(y_x, x, sparse.lbx, sparse.ubx)
            ),
        )
        curvature = float(np.abs(sparse.h[:n, :n].nonzeros()).max(initial=0.0))
        gradient = float(
            max(
                np.abs(slope[:n]).max(),
                np.abs(y * table.norm).max(),
                tolerances.LEAST_SIZE * curvature,
                1e-300,
            )
        )
        variable = 1.0 + float(np.abs(z).max())
        worst = max(
            kkt.stationarity / gradient,
            kkt.primal / variable,
            kkt.complementarity / (gradient * variable),
        )
        # Where there is no point multipliers grow without end, and all else is small beside them.
        smallest_gradient = max(np.abs(sparse.g).max(), tolerances.LEAST_SIZE * curvature, 1e-300)
        return self._ended(
            qp,
            z,
            status=problem.StageQpStatus.ITERATION_LIMIT,
            costate=np.concatenate([np.zeros(self._shape.n_x[0]), y_a[:n_b]]),
            y=y,
            value=value,
            kkt=kkt,
            worst=np.inf if gradient > tolerances.HOPELESS * smallest_gradient else worst,
            iterations=1,
        )

    def _nothing(
        self, qp: problem.StageQp, table: problem.RowTable, status: problem.StageQpStatus
    ) -> problem.FlatSolution:
        z = table.rest(qp)
        m = len(table.norm)
        costate = np.zeros(sum(self._shape.n_x))
        kkt = problem.kkt_residual(stationarity=np.inf, primal=np.inf, complementarity=np.inf)
        none = np.full(m, np.nan)
        return self._ended(
            qp,
            z,
            status=status,
            costate=costate,
            y=np.zeros(m),
            kkt=kkt,
            iterations=0,
            value=none,
            worst=np.inf,
        )

    def _ended(self, qp: problem.StageQp, z: Array, **fields: Any) -> problem.FlatSolution:
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
        n = len(q)
        m = len(qp.flat["lower"])
        k = int(soft.sum())
        steps = (
            ca.horzcat(
                ca.diagcat(*map(ca.DM, qp.dynamics)), ca.DM(len(qp.flat["b"]), self._shape.n_z[-1])
            )
            - self._after
        )
        row_matrix = ca.vertcat(ca.diagcat(*map(ca.DM, qp.C)), ca.DM.eye(n))[rows.tolist(), :]
        slack = ca.DM.triplet(
            np.flatnonzero(soft[rows]).tolist(), list(range(k)), ca.DM.ones(k), len(rows), k
        )
        bent = table.compliance[soft] > 0.0
        l2 = np.where(bent, 1.0 / np.where(bent, table.compliance[soft], 1.0), table.l2[soft])
        lower, upper = np.where(
            table.equal, table.target, np.where(table.side, table.bound, [[-np.inf], [np.inf]])
        )
        # Between two bounds that are one there is no interior: what is fixed is a row.
        low, up = np.where(soft[m:] | table.fixed, [[-np.inf], [np.inf]], [lower[m:], upper[m:]])
        lower[m:][table.fixed] = upper[m:][table.fixed] = qp.flat["z_lower"][table.fixed]
        return _SparseQp(
            h=ca.diagcat(*map(ca.DM, Q), ca.diag(ca.DM([*l2, *l2]))),
            g=np.concatenate([q, table.l1[soft], table.l1[soft]]),
            a=ca.vertcat(
                ca.horzcat(steps, ca.DM(steps.shape[0], 2 * k)),
                ca.horzcat(row_matrix, -slack, slack),
            ),
            lba=np.concatenate([-qp.flat["b"], lower[rows]]),
            uba=np.concatenate([-qp.flat["b"], upper[rows]]),
            lbx=np.concatenate([low, np.zeros(2 * k)]),
            ubx=np.concatenate([up, np.full(2 * k, np.inf)]),
        )

    def _solved(
        self, sparse: _SparseQp, z: Array, options: problem.StageQpOptions, regularization: float
    ) -> tuple[list[Array], bool]:
        """Return x, the multipliers of A x and of x, zeros where any of these is no number; and
        whether PIQP finds the QP infeasible.
        """
        H = sparse.h.sparsity()
        A = sparse.a.sparsity()
        key = (
            H.nnz(),
            *A.row(),
            *A.colind(),
            options.tolerance,
            options.max_iterations,
            regularization,
        )
        if key not in self._solvers:
            accuracy = dict.fromkeys(
                (f"eps_{name}" for name in _ACCURACIES), options.tolerance / _SHARPER
            )
            plugin_options = {
                _PLUGIN: {
                    **accuracy,
                    "reg_lower_limit": regularization,
                    "max_iter": options.max_iterations,
                },
                "error_on_fail": False,
            }
            self._solvers[key] = ca.conic("stages", _PLUGIN, {"h": H, "a": A}, plugin_options)
        solver = self._solvers[key]
        result = solver(
            **sparse._asdict(), x0=np.concatenate([z, np.zeros(len(sparse.g) - len(z))])
        )
        parts = [np.array(result[name]).ravel() for name in ("x", "lam_a", "lam_x")]
        finite = all(np.isfinite(part).all() for part in parts)
        infeasible = "infeasible" in solver.stats()["return_status"]
        return parts if finite else [np.zeros_like(part) for part in parts], infeasible

    def _is_convex(self, qp: problem.StageQp, table: problem.RowTable, Q: list[Array]) -> bool:
        """Check by a Riccati recursion whether the cost bends upwards along the dynamics and all
        equalities.
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
            n = self._shape.n_x[k] if k else 0
            M = (
                Q[k]
                + C.T @ (weight[problem.slices(self._shape.n_c)[k], None] * C)
                + np.diag(weight[m:][z])
            )
            if k < self._shape.N:
                M += qp.dynamics[k].T @ P @ qp.dynamics[k]
            M[table.fixed[z]] = 0.0
            M[:, table.fixed[z]] = 0.0
            pivot_margin = tolerances.INDEFINITE * (
                np.abs(np.diag(M)) + tolerances.SMALLEST_CURVATURE * largest
            )
            M += np.diag(np.where(table.fixed[z], 1.0, pivot_margin))
            try:
                W = np.linalg.solve(np.linalg.cholesky(M[n:, n:]), M[n:, :n])
            except np.linalg.LinAlgError:
                return False
            P = M[:n, :n] - W.T @ W
        return True

    def stationarity(self, qp: problem.StageQp, near: problem.WarmStart) -> float:
        """Largest entry [1/unit of z] of the gradient of a QP's Lagrangian at 0 with the
        multipliers of another, but for what is fixed.
        """
        (_, grad) = _cost(qp)
        m = len(qp.flat["lower"])
        N = self._shape.N
        costate = [near.costate[stage] for stage in problem.slices(self._shape.n_x)]
        y = near.y[m:]
        for k, stage in enumerate(problem.slices(self._shape.n_z)):
            grad[stage] += near.y[problem.slices(self._shape.n_c)[k]] @ qp.C[k] + y[stage]
            grad[stage][: len(costate[k])] -= costate[k] if k else 0.0
            grad[stage] += costate[k + 1] @ qp.dynamics[k] if k < N else 0.0
        return float(np.abs(np.where(problem.row_table(qp).fixed, 0.0, grad)).max(initial=0.0))

    def steepest(self, qp: problem.StageQp) -> float:
        """Largest entry [1/unit of z] of the gradient of the residuals' half square, at 0."""
        return float(max(np.abs(r @ J).max(initial=0.0) for J, r in zip(qp.J, qp.r, strict=True)))

    @np.errstate(invalid="ignore")  # of what is not a number
    def products(self, qp: problem.StageQp, z: Array) -> problem.ResidualProducts:
        """Return the products of the residuals' rows along z (n,) [unit of z]."""
        along = [J @ part for J, part in zip(qp.J, problem.parts(z, self._shape.n_z), strict=True)]
        changes = [np.abs(part @ J).max(initial=0.0) for J, part in zip(qp.J, along, strict=True)]
        residual_change = np.concatenate(along)
        return problem.ResidualProducts(
            slope=float(qp.flat["r"] @ residual_change),
            square=float(residual_change @ residual_change),
            change=float(max(changes)),
        )


def _cost(qp: problem.StageQp, *, costless: bool = False) -> tuple[list[Array], Array]:
    """Hessian of every stage and gradient (n,) at 0; next to no curvature, and nothing else, for
    ``costless``.
    """
    if costless:
        return [tolerances.PHASE_ONE * np.eye(n) for n in qp.shape.n_z], np.zeros(sum(qp.shape.n_z))
    Q = [
        J.T @ J + np.tril(H) + np.tril(H, -1).T + np.diag(damping)
        for J, H, damping in zip(qp.J, qp.H, qp.damping, strict=True)
    ]
    return Q, np.concatenate([J.T @ r + g for J, r, g in zip(qp.J, qp.r, qp.g, strict=True)])


def _left(y: Array, value: Array, lower: Array, upper: Array) -> float:
    """Return the largest product of a multiplier and the distance from its bound."""
    gap = np.abs(np.where(y > 0.0, upper, lower) - value)
    return float(np.abs(y * np.where(np.isfinite(gap), gap, 0.0)).max(initial=0.0))
