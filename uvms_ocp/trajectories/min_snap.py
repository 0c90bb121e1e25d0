"""Minimum-snap (jerk, acceleration, ...) trajectories through way points, [Gao2022] eqs (59)-(75).

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments import checked
from uvms_ocp.arrays import Array, Mask
from uvms_ocp.shown.fielded import Fielded
from uvms_ocp.trajectories.free_derivatives import (
    Pieces,
    coefficients,
    cost_slopes,
    end_data,
    piece_costs,
    pieces_of,
    solve_free,
)
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.trajectories.specification import MINIMUM_SNAP, CurveSpecification, NodeProblem, node_problem


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CostGradients:
    """Derivatives of the optimal cost."""

    times: Array
    """(n + 1,) [axis^2/s^2k] by the time of each way point."""
    durations: Array
    """(n,) [axis^2/s^2k] by the duration of each piece, the others unchanged."""
    waypoints: Array
    """(n + 1, n_axes) [axis/s^(2k - 1)] by the position of each way point."""
    node_derivatives: Array
    """(k, n + 1, n_axes) [axis/s^(2k - 1 - d)] by every derivative at every way point; zero where it is free."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class MinSnap(Fielded):
    """A minimum-derivative trajectory and the data of its nodes."""

    trajectory: PiecewisePolynomial
    node_derivatives: Array
    """(k, n + 1, n_axes) [axis/s^d] derivatives 0 .. k - 1 at the way points."""
    cost: float
    """[axis^2/s^(2k - 1)] Integral of the squared k-th derivative, summed over the axes."""

    def gradients(self) -> CostGradients:
        """How the optimal cost changes with the data; linear in the number of pieces (envelope theorem)."""
        pieces = pieces_of(self.trajectory.durations, self.node_derivatives.shape[0])
        by_duration, by_node = cost_slopes(pieces, self.node_derivatives)
        by_time = np.concatenate([[0.0], by_duration]) - np.concatenate([by_duration, [0.0]])
        return CostGradients(times=by_time, durations=by_duration, waypoints=by_node[0], node_derivatives=by_node)


@checked
def min_snap(waypoints: ArrayLike, times: ArrayLike, specification: CurveSpecification = MINIMUM_SNAP) -> MinSnap:
    """Minimise the integral of the squared derivative through way points, in time linear in their number.

    waypoints (n + 1, n_axes) [axis]: positions, (n + 1,) for one axis. times (n + 1,) [s]: increasing. specification: which
    derivative, and what holds besides; by default snap, from rest to rest. Raises `InvalidInput` as `node_problem`, and
    where too little is fixed to determine the curve.
    """
    problem = node_problem(waypoints, times, specification)
    pieces = pieces_of(np.diff(problem.times), problem.k)
    return solution_of(problem.times, pieces, _solved(problem, pieces))


def solution_of(times: Array, pieces: Pieces, values: Array) -> MinSnap:
    """The trajectory through node derivatives: values (k, n + 1, n_axes) [axis/s^d] at times (n + 1,) [s]."""
    data = end_data(pieces, values)
    trajectory = PiecewisePolynomial(breaks=times, coefficients=coefficients(pieces, data, values))
    cost = float(piece_costs(pieces, data).sum())
    return MinSnap(trajectory=trajectory, node_derivatives=values, cost=cost)


def _solved(problem: NodeProblem, pieces: Pieces) -> Array:
    if (problem.fixed == problem.fixed[:, :, :1]).all():
        return solve_free(pieces, problem.values, problem.fixed[:, :, 0])
    values = problem.values.copy()
    for axes in _axes_with_one_pattern(problem.fixed):
        values[:, :, axes] = solve_free(pieces, values[:, :, axes], problem.fixed[:, :, axes[0]])
    return values


def _axes_with_one_pattern(fixed: Mask) -> Iterator[list[int]]:
    """Groups of axes that fix the same derivatives, and so share one factorisation."""
    groups: dict[bytes, list[int]] = {}
    for axis in range(fixed.shape[2]):
        groups.setdefault(fixed[:, :, axis].tobytes(), []).append(axis)
    yield from groups.values()
