"""The minimum-derivative problem of `min_snap` as an equality-constrained QP in coefficients, [Gao2022]
eqs (74)-(75).

Slower than the form in free derivatives and used to check it; it takes bounds on derivatives at way
points as well. `[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.trajectories import free_derivatives, hermite_pieces
from uvms_ocp.trajectories.curve_conditions import (
    MINIMUM_SNAP,
    CurveSpecification,
    NodeProblem,
    node_problem,
)
from uvms_ocp.trajectories.min_snap import MinSnap, require_proven, solution_of
from uvms_ocp.types import Array

_QUIET = dict.fromkeys(("print_header", "print_iter", "print_info", "error_on_fail"), False)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Bound:
    """Limits on one derivative at one way point, for all axes."""

    node: int
    """Index of the way point; negative counts from the end."""
    derivative: int
    """0 .. k - 1."""
    lower: float = -np.inf
    """[axis/s^derivative] lower bound."""
    upper: float = np.inf
    """[axis/s^derivative] upper bound."""


@checked
def min_snap_qp(
    waypoints: ArrayLike,
    times: ArrayLike,
    specification: CurveSpecification = MINIMUM_SNAP,
    *,
    bounds: Sequence[Bound] = (),
) -> MinSnap:
    """Solve as ``min_snap`` by CasADi's QP solver ``qrqp``: waypoints (n + 1, n_axes) [axis] at
    times (n + 1,) [s].

    Raises `InvalidInput` as ``min_snap``, for a bound that does not exist, and where the solver
    finds no solution, as with bounds that contradict each other, or none that keeps all conditions
    at the least cost.
    """
    problem = node_problem(waypoints, times, specification)
    pieces = free_derivatives.pieces_of(np.diff(problem.times), problem.k)
    qp = _Qp(problem.k, np.diff(problem.times), bounds)
    lower = np.empty(problem.values.shape)
    upper = np.empty(problem.values.shape)
    n_axes = problem.values.shape[2]
    for axis in range(n_axes):
        lower[:, :, axis], upper[:, :, axis] = qp.limits(problem, axis)
    values = np.empty(problem.values.shape)
    for axis in range(n_axes):
        values[:, :, axis] = qp.solve(problem, axis, lower[:, :, axis], upper[:, :, axis])
    solution = solution_of(problem.times, pieces, values)
    _, slopes = free_derivatives.cost_slopes(pieces, solution.node_derivatives)
    require_proven(solution, problem, pieces, lower, upper, slopes)
    return solution


class _Qp:
    """Matrices of one axis: unknowns are the unit-interval coefficients of all pieces, time in
    units of ``unit``.
    """

    def __init__(self, k: int, durations: Array, bounds: Sequence[Bound]) -> None:
        self.k = k
        self.n = durations.size
        self.unit = float(np.exp(np.mean(np.log(durations))))
        self.tau = durations / self.unit
        self.bounds = bounds
        unit_cost = hermite_pieces.monomial_cost(k)
        self.H = ca.diagcat(*[ca.DM(2.0 * t ** (1 - 2 * k) * unit_cost) for t in self.tau])
        self.A = self._rows()
        sparsities = {"h": self.H.sparsity(), "a": self.A.sparsity()}
        self.solver = ca.conic("min_snap", "qrqp", sparsities, _QUIET)

    def solve(self, problem: NodeProblem, axis: int, lower: Array, upper: Array) -> Array:
        """Return (k, n + 1) [axis/s^d] optimal node derivatives of one axis within `limits`."""
        scale = self.unit ** np.arange(self.k)[:, None]
        continuous = np.zeros(self.k * (self.n - 1))
        solution = self.solver(
            h=self.H,
            g=0,
            a=self.A,
            lba=np.concatenate([(lower * scale).T.ravel(), continuous]),
            uba=np.concatenate([(upper * scale).T.ravel(), continuous]),
        )
        if not self.solver.stats()["success"]:
            raise InvalidInput(
                f"the QP of axis {axis} has no solution; check its bounds and constraints."
            )
        coefficients = np.asarray(solution["x"]).reshape(self.n, 2 * self.k)
        node_rows = self.A[: self.k * (self.n + 1), :]
        ends = np.asarray(node_rows @ ca.DM(coefficients.ravel()))
        nodes = ends.reshape(self.n + 1, self.k).T / scale
        return np.where(problem.fixed[:, :, axis], problem.values[:, :, axis], nodes)

    def _rows(self) -> ca.DM:
        """Build the derivatives 0 .. k - 1 at every node (end of the last piece for the last), then
        their continuity.
        """
        starts = self._end_rows(0.0)
        ends = self._end_rows(1.0)
        nodes = ca.diagcat(*starts[:-1], ca.vertcat(starts[-1], ends[-1]))
        if self.n == 1:
            return nodes
        no_piece = ca.DM(self.k * (self.n - 1), 2 * self.k)
        end_rows_of_piece = ca.horzcat(ca.diagcat(*ends[:-1]), no_piece)
        start_rows_of_next = ca.horzcat(no_piece, ca.diagcat(*starts[1:]))
        return ca.vertcat(nodes, end_rows_of_piece - start_rows_of_next)

    def _end_rows(self, u: float) -> list[ca.DM]:
        """Build the derivatives 0 .. k - 1 at unit time u of each piece, by its coefficients."""
        rows = [hermite_pieces.monomial_row(u, d, 2 * self.k) for d in range(self.k)]
        matrix = ca.DM(np.stack(rows))
        orders = np.arange(self.k)
        return [ca.sparsify(ca.diag(t**-orders) @ matrix) for t in self.tau]

    def limits(self, problem: NodeProblem, axis: int) -> tuple[Array, Array]:
        """Return bounds (k, n + 1) [axis/s^d] on the node derivatives of one axis."""
        fixed = problem.fixed[:, :, axis]
        values = problem.values[:, :, axis]
        lower = np.where(fixed, values, -np.inf)
        upper = np.where(fixed, values, np.inf)
        for index, bound in enumerate(self.bounds):
            place = (bound.derivative, bound.node)
            if not 0 <= bound.derivative < self.k or not -self.n - 1 <= bound.node <= self.n:
                raise InvalidInput(
                    f"bound {index} is on derivative {bound.derivative} of way point {bound.node};"
                    f" allowed are derivatives 0 to {self.k - 1} of way points 0 to {self.n}."
                )
            lower[place] = max(lower[place], bound.lower)
            upper[place] = min(upper[place], bound.upper)
        crossed = (lower > upper).any(axis=0)
        if crossed.any():
            raise InvalidInput(
                f"the bounds of way point {int(np.argmax(crossed))} leave no solution; relax one."
            )
        return lower, upper
