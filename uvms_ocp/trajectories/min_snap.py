"""Minimum-snap (jerk, acceleration, ...) trajectories through way points, [Gao2022] eqs (59)-(75).

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import FieldTable
from uvms_ocp.trajectories import curve_judge, free_derivatives
from uvms_ocp.trajectories.curve_conditions import (
    MINIMUM_SNAP,
    CurveSpecification,
    NodeProblem,
    node_problem,
)
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Array, Mask


@checked
def min_snap(
    waypoints: ArrayLike, times: ArrayLike, specification: CurveSpecification = MINIMUM_SNAP
) -> MinSnap:
    """Minimise the integral of the squared derivative through way points, in time linear in their
    number.

    waypoints (n + 1, n_axes) [axis]: positions, (n + 1,) for one axis. times (n + 1,) [s]:
    increasing. specification: which derivative, and what holds besides; by default snap, from rest
    to rest. Raises `InvalidInput` as `node_problem`, where too little is fixed to determine the
    curve, and where rounding decides it, as by pieces too short beside the others.
    """
    curve, problem, pieces = least_curve(waypoints, times, specification)
    _, slopes = free_derivatives.cost_slopes(pieces, curve.node_derivatives)
    lower = np.where(problem.fixed, problem.values, -np.inf)
    upper = np.where(problem.fixed, problem.values, np.inf)
    _require_accurate(curve, problem, slopes)
    require_proven(curve, problem, pieces, lower, upper, slopes)
    return curve


@checked_dataclass(eq=False, repr=False)
class MinSnap(FieldTable):
    """A minimum-derivative trajectory and the data of its nodes."""

    trajectory: PiecewisePolynomial
    """The curve, of time [s]."""
    node_derivatives: Array
    """(k, n + 1, n_axes) [axis/s^d] derivatives 0 .. k - 1 at the way points."""
    cost: float
    """[axis^2/s^(2k - 1)] Integral of the squared k-th derivative, summed over the axes."""

    def gradients(self) -> CostGradients:
        """Compute the gradients of the optimal cost in the data; linear in the number of pieces
        (envelope theorem).
        """
        k = self.node_derivatives.shape[0]
        pieces = free_derivatives.pieces_of(self.trajectory.durations, k)
        by_duration, by_node = free_derivatives.cost_slopes(pieces, self.node_derivatives)
        by_time = np.concatenate([[0.0], by_duration]) - np.concatenate([by_duration, [0.0]])
        return CostGradients(
            times=by_time, durations=by_duration, waypoints=by_node[0], node_derivatives=by_node
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CostGradients:
    """Derivatives of the optimal cost."""

    times: Array
    """(n + 1,) [axis^2/s^2k] slope by the time of each way point."""
    durations: Array
    """(n,) [axis^2/s^2k] slope by the duration of each piece, the others unchanged."""
    waypoints: Array
    """(n + 1, n_axes) [axis/s^(2k - 1)] slope by the position of each way point."""
    node_derivatives: Array
    """(k, n + 1, n_axes) [axis/s^(2k - 1 - d)] slope by every derivative at every way point; zero
    where it is free.
    """


def least_curve(
    waypoints: ArrayLike, times: ArrayLike, specification: CurveSpecification
) -> tuple[MinSnap, NodeProblem, free_derivatives.Pieces]:
    """Compute the curve of `min_snap`, unchecked, with its conditions and its pieces."""
    problem = node_problem(waypoints, times, specification)
    pieces = free_derivatives.pieces_of(np.diff(problem.times), problem.k)
    node_derivatives = _optimal_node_derivatives(problem, pieces)
    return solution_of(problem.times, pieces, node_derivatives), problem, pieces


def require_proven(
    curve: MinSnap,
    problem: NodeProblem,
    pieces: free_derivatives.Pieces,
    lower: Array,
    upper: Array,
    slopes: Array,
) -> None:
    """Check that a curve keeps its conditions, and that none beside it is cheaper.

    lower, upper (k, n + 1, n_axes) [axis/s^d]: bounds on the node derivatives. slopes (k, n + 1,
    n_axes): of the cost by them. Raises `InvalidInput` where it does not: rounding decides it then.
    """
    curvature = free_derivatives.cost_curvature(pieces)
    gain = curve_judge.achievable_gain(slopes, curvature, curve.node_derivatives, lower, upper)
    largest_gain = curve_judge.CHEAPEST * _scale_of_cost(curve, problem)
    miss = curve_judge.largest_miss(curve.trajectory, lower, upper)
    if miss > curve_judge.KEPT or gain > largest_gain:
        raise _rounding_decides(problem)


def _require_accurate(curve: MinSnap, problem: NodeProblem, slopes: Array) -> None:
    """Check the cost by another way: where the slope by all that is free vanishes, it is half the
    sum of slope times value over what is fixed.
    """
    cost_of_fixed = float((slopes * curve.node_derivatives)[problem.fixed].sum()) / 2.0
    scale = _scale_of_cost(curve, problem)
    if not abs(curve.cost - cost_of_fixed) <= curve_judge.CHEAPEST * scale:
        raise _rounding_decides(problem)


def _scale_of_cost(curve: MinSnap, problem: NodeProblem) -> float:
    """Return the size that rounding of a cost is relative to: the cost, or that of ordinary pieces
    where it is next to nothing.
    """
    durations = np.diff(problem.times)
    squared_steps = (np.diff(curve.node_derivatives[0], axis=0) ** 2).sum(axis=1)
    usual_cost = np.median(squared_steps / durations ** (2 * problem.k - 1)) * durations.size
    return max(curve.cost, float(usual_cost))


def _rounding_decides(problem: NodeProblem) -> InvalidInput:
    durations = np.diff(problem.times)
    shortest = int(np.argmin(durations))
    cause = (
        f"way points {shortest} and {shortest + 1} are {durations[shortest]:.3g} s apart, of"
        f" {durations.sum():.3g} s in all"
    )
    return InvalidInput(
        f"{cause}: rounding decides the curve; merge way points that nearly coincide, or give"
        " them more time."
    )


def solution_of(times: Array, pieces: free_derivatives.Pieces, values: Array) -> MinSnap:
    """Return the trajectory through node derivatives: values (k, n + 1, n_axes) [axis/s^d] at times
    (n + 1,) [s].
    """
    data = free_derivatives.end_data(pieces, values)
    coefficients = free_derivatives.coefficients(pieces, data, values)
    cost = float(free_derivatives.piece_costs(pieces, data).sum())
    return MinSnap(
        trajectory=PiecewisePolynomial(breaks=times, coefficients=coefficients),
        node_derivatives=values,
        cost=cost,
    )


def _optimal_node_derivatives(problem: NodeProblem, pieces: free_derivatives.Pieces) -> Array:
    """Return (k, n + 1, n_axes) [axis/s^d] derivatives at the way points, the free ones at the
    optimum.
    """
    if (problem.fixed == problem.fixed[:, :, :1]).all():
        return free_derivatives.solve_free(pieces, problem.values, problem.fixed[:, :, 0])
    values = problem.values.copy()
    for axes in _axes_by_pattern(problem.fixed):
        fixed = problem.fixed[:, :, axes[0]]
        values[:, :, axes] = free_derivatives.solve_free(pieces, values[:, :, axes], fixed)
    return values


def _axes_by_pattern(fixed: Mask) -> list[list[int]]:
    """Return groups of axes that fix the same derivatives, and so share one factorisation."""
    groups: dict[bytes, list[int]] = {}
    for axis in range(fixed.shape[2]):
        pattern = fixed[:, :, axis].tobytes()
        groups.setdefault(pattern, []).append(axis)
    return list(groups.values())
