"""The same minimum-derivative problem as an equality-constrained QP in coefficients, [Gao2022] eqs (74)-(75).

Slower than the free-derivative form and used to check it; it takes bounds on derivatives at way points as well.
`[axis]` is the unit of an axis, such as m or rad.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments import checked
from uvms_ocp.arrays import Array, Mask
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.trajectories.free_derivatives import pieces_of
from uvms_ocp.trajectories.hermite import monomial_cost, monomial_row
from uvms_ocp.trajectories.min_snap import MinSnap, solution_of
from uvms_ocp.trajectories.specification import MINIMUM_SNAP, CurveSpecification, NodeProblem, node_problem


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Bound:
    """Limits on one derivative at one way point, for all axes."""

    node: int
    """Index of the way point; negative counts from the end."""
    derivative: int
    """0 .. k - 1."""
    lower: float = -np.inf
    """[axis/s^derivative]"""
    upper: float = np.inf
    """[axis/s^derivative]"""


@checked
def min_snap_qp(
    waypoints: ArrayLike,
    times: ArrayLike,
    specification: CurveSpecification = MINIMUM_SNAP,
    *,
    bounds: Sequence[Bound] = (),
    plugin: str = "qrqp",
    options: Mapping[str, object] | None = None,
) -> MinSnap:
    """As ``min_snap``, by a CasADi ``conic`` plugin: waypoints (n + 1, n_axes) [axis] at times (n + 1,) [s].

    Raises `InvalidInput` as ``min_snap``, for a bound that does not exist, and where the solver finds no solution, as with
    bounds that contradict each other.
    """
    if not (plugin.isidentifier() and ca.has_conic(plugin)):
        raise InvalidInput(f"plugin = {plugin!r}; give a QP solver that CasADi has, such as {' or '.join(_QUIET)}")
    problem = node_problem(waypoints, times, specification)
    qp = _Qp(problem.k, np.diff(problem.times), tuple(bounds), plugin, dict(options or _QUIET.get(plugin, {})))
    values = np.stack([qp.solve(problem, axis) for axis in range(problem.values.shape[2])], axis=2)
    return solution_of(problem.times, pieces_of(np.diff(problem.times), problem.k), values)


_QUIET: dict[str, dict[str, object]] = {
    "qrqp": {"print_header": False, "print_iter": False, "print_info": False, "error_on_fail": False},
    "qpoases": {"printLevel": "none", "error_on_fail": False},
}


class _Qp:
    """Matrices of one axis: unknowns are the unit-interval coefficients of all pieces, time in units of ``unit``."""

    def __init__(
        self, k: int, durations: Array, bounds: tuple[Bound, ...], plugin: str, options: dict[str, object]
    ) -> None:
        self.k, self.n = k, durations.size
        self.unit = float(np.exp(np.mean(np.log(durations))))
        self.tau = durations / self.unit
        self.bounds = bounds
        self.H = ca.diagcat(*[ca.DM(2.0 * t ** (1 - 2 * k) * monomial_cost(k)) for t in self.tau])
        self.A = self._rows()
        structure = {"h": self.H.sparsity(), "a": self.A.sparsity()}
        try:
            self.solver = ca.conic("min_snap", plugin, structure, options)
        except RuntimeError as error:
            raise InvalidInput(f"options of {plugin} = {options}: it takes no such options") from error

    def solve(self, problem: NodeProblem, axis: int) -> Array:
        """(k, n + 1) optimal node derivatives of one axis."""
        lower, upper = self._limits(problem.values[:, :, axis], problem.fixed[:, :, axis])
        solution = self.solver(h=self.H, g=0, a=self.A, lba=lower, uba=upper)
        if not self.solver.stats()["success"]:
            raise InvalidInput(f"the QP of axis {axis} has no solution; check its bounds and constraints.")
        coefficients = np.asarray(solution["x"]).reshape(self.n, 2 * self.k)
        return self._node_values(coefficients, problem.values[:, :, axis], problem.fixed[:, :, axis])

    def _rows(self) -> ca.DM:
        """Derivatives 0 .. k - 1 at every node (end of the last piece for the last), then their continuity."""
        at_start = ca.DM(np.stack([monomial_row(0.0, d, 2 * self.k) for d in range(self.k)]))
        at_end = ca.DM(np.stack([monomial_row(1.0, d, 2 * self.k) for d in range(self.k)]))
        starts = [self._per_time(at_start, t) for t in self.tau]
        ends = [self._per_time(at_end, t) for t in self.tau]
        nodes = ca.diagcat(*starts[:-1], ca.vertcat(starts[-1], ends[-1]))
        if self.n == 1:
            return nodes
        before = ca.horzcat(ca.diagcat(*ends[:-1]), ca.DM(self.k * (self.n - 1), 2 * self.k))
        after = ca.horzcat(ca.DM(self.k * (self.n - 1), 2 * self.k), ca.diagcat(*starts[1:]))
        return ca.vertcat(nodes, before - after)

    def _per_time(self, rows: ca.DM, tau: float) -> ca.DM:
        return ca.sparsify(ca.diag(tau ** -np.arange(self.k)) @ rows)

    def _limits(self, values: Array, fixed: Mask) -> tuple[Array, Array]:
        scale = self.unit ** np.arange(self.k)[:, None]
        lower, upper = np.where(fixed, values, -np.inf), np.where(fixed, values, np.inf)
        for index, bound in enumerate(self.bounds):
            if not 0 <= bound.derivative < self.k or not -self.n - 1 <= bound.node <= self.n:
                raise InvalidInput(
                    f"bound {index} is on derivative {bound.derivative} of way point {bound.node}; allowed are "
                    f"derivatives 0 to {self.k - 1} of way points 0 to {self.n}."
                )
            lower[bound.derivative, bound.node] = max(lower[bound.derivative, bound.node], bound.lower)
            upper[bound.derivative, bound.node] = min(upper[bound.derivative, bound.node], bound.upper)
        crossed = (lower > upper).any(axis=0)
        if crossed.any():
            raise InvalidInput(f"the bounds of way point {int(np.argmax(crossed))} leave no solution; relax one.")
        continuous = np.zeros(self.k * (self.n - 1))
        return (
            np.concatenate([(lower * scale).T.ravel(), continuous]),
            np.concatenate([(upper * scale).T.ravel(), continuous]),
        )

    def _node_values(self, coefficients: Array, values: Array, fixed: Mask) -> Array:
        ends = np.asarray(self.A[: self.k * (self.n + 1), :] @ ca.DM(coefficients.ravel()))
        nodes = ends.reshape(self.n + 1, self.k).T / self.unit ** np.arange(self.k)[:, None]
        return np.where(fixed, values, nodes)
