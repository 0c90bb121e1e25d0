"""Minimum-snap (jerk, acceleration, ...) trajectories through way points, [Gao2022] eqs (59)-(75)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arrays import Array, Mask
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.trajectories.free_derivatives import (
    Pieces,
    coefficients,
    cost_slopes,
    end_data,
    piece_costs,
    pieces_of,
    solve_free,
)
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial, frozen


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Boundary:
    """Derivatives 1, 2, ... at both ends: a number for all of them (0 is rest), rows (n_given, n_axes), or None (free).

    Rows give velocity, acceleration, ... in this order; derivatives beyond the last row are free.
    """

    start: ArrayLike | None = 0.0
    end: ArrayLike | None = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Constraint:
    """One derivative fixed at one way point, for all axes or some of them."""

    node: int
    """Index of the way point; negative counts from the end."""
    derivative: int
    """1 .. k - 1."""
    value: ArrayLike = 0.0
    """Number or one per axis listed."""
    axes: tuple[int, ...] | None = None
    """Axes concerned; None is all of them."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NodeProblem:
    """What is fixed at the nodes, checked."""

    times: Array
    """(n + 1,) [s]"""
    values: Array
    """(k, n + 1, n_axes) derivatives at the nodes; where not fixed, a starting guess."""
    fixed: Mask
    """(k, n + 1, n_axes)"""

    @property
    def k(self) -> int:
        return self.values.shape[0]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CostGradients:
    """Derivatives of the optimal cost."""

    times: Array
    """(n + 1,) by the time of each way point."""
    durations: Array
    """(n,) by the duration of each piece, the others unchanged."""
    waypoints: Array
    """(n + 1, n_axes) by the position of each way point."""
    node_derivatives: Array
    """(k, n + 1, n_axes) by every derivative at every way point; zero where it is free."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MinSnap:
    """A minimum-derivative trajectory and the data of its nodes."""

    trajectory: PiecewisePolynomial
    node_derivatives: Array
    """(k, n + 1, n_axes) derivatives 0 .. k - 1 at the way points."""
    cost: float
    """Integral of the squared k-th derivative, summed over the axes."""

    def gradients(self) -> CostGradients:
        """How the optimal cost changes with the data; linear in the number of pieces (envelope theorem)."""
        pieces = pieces_of(self.trajectory.durations, self.node_derivatives.shape[0])
        by_duration, by_node = cost_slopes(pieces, self.node_derivatives)
        by_time = np.concatenate([[0.0], by_duration]) - np.concatenate([by_duration, [0.0]])
        return CostGradients(times=by_time, durations=by_duration, waypoints=by_node[0], node_derivatives=by_node)


_REST = Boundary()


def min_snap(
    waypoints: ArrayLike,
    times: ArrayLike,
    *,
    derivative: int = 4,
    boundary: Boundary = _REST,
    constraints: Sequence[Constraint] = (),
    free_positions: Sequence[int] = (),
    dwell: bool = False,
) -> MinSnap:
    """Minimise the integral of the squared derivative through way points, in time linear in their number.

    Args:
        waypoints: (n + 1, n_axes) positions; (n + 1,) is one axis.
        times: (n + 1,) [s] increasing times of the way points.
        derivative: k: 4 is snap, 3 jerk, 2 acceleration. Pieces have degree 2k - 1.
        boundary: Derivatives at both ends.
        constraints: Derivatives fixed at way points.
        free_positions: Indices of way points whose position is free as well.
        dwell: Accept equal consecutive way points, where the curve stays near.

    Raises:
        InvalidInput: wrong shapes, NaN, times that do not increase, equal consecutive way points, a constraint that
            does not exist or contradicts another, or too little fixed to determine the curve.
    """
    problem = node_problem(
        waypoints,
        times,
        derivative=derivative,
        boundary=boundary,
        constraints=constraints,
        free_positions=free_positions,
        dwell=dwell,
    )
    pieces = pieces_of(np.diff(problem.times), derivative)
    return solution_of(problem.times, pieces, _solved(problem, pieces))


def solution_of(times: Array, pieces: Pieces, values: Array) -> MinSnap:
    """The trajectory with the given node derivatives (k, n + 1, n_axes)."""
    data = end_data(pieces, values)
    trajectory = PiecewisePolynomial(breaks=times, coefficients=coefficients(pieces, data, values))
    cost = float(piece_costs(pieces, data).sum())
    return MinSnap(trajectory=trajectory, node_derivatives=values, cost=cost)


def node_problem(
    waypoints: ArrayLike,
    times: ArrayLike,
    *,
    derivative: int = 4,
    boundary: Boundary = _REST,
    constraints: Sequence[Constraint] = (),
    free_positions: Sequence[int] = (),
    dwell: bool = False,
) -> NodeProblem:
    """Check the arguments of ``min_snap`` and lay them out per node."""
    points = checked_waypoints(waypoints, dwell=dwell)
    knots = checked_times(times, points.shape[0])
    if derivative < 1:
        raise InvalidInput(f"derivative is {derivative}; allowed is 1 or more (4 is snap).")
    values = np.zeros((derivative, *points.shape))
    values[0] = points
    fixed = np.zeros(values.shape, dtype=bool)
    fixed[0] = True
    fixed[0, list(free_positions)] = False
    _set_end(values[1:, 0], fixed[1:, 0], boundary.start, "start")
    _set_end(values[1:, -1], fixed[1:, -1], boundary.end, "end")
    for index, constraint in enumerate(constraints):
        _set_constraint(values, fixed, constraint, index)
    return NodeProblem(times=knots, values=values, fixed=fixed)


def checked_waypoints(waypoints: ArrayLike, *, dwell: bool = False) -> Array:
    """(n + 1, n_axes) finite, at least two, consecutive ones different unless ``dwell``."""
    points = np.asarray(waypoints, dtype=float)
    points = points[:, None] if points.ndim == 1 else points
    if points.ndim != 2 or points.shape[0] < 2 or points.shape[1] < 1:
        raise InvalidInput(f"way points have shape {points.shape}; allowed is (n, n_axes) with n >= 2.")
    if not np.isfinite(points).all():
        index = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InvalidInput(f"way point {index} is {points[index]}; it must be finite.")
    equal = (points[1:] == points[:-1]).all(axis=1)
    if not dwell and equal.any():
        index = int(np.argmax(equal))
        raise InvalidInput(
            f"way points {index} and {index + 1} are equal; remove one, or pass dwell=True to wait there."
        )
    return points


def checked_times(times: ArrayLike, n: int) -> Array:
    """(n,) [s] finite and increasing."""
    knots = frozen(times)
    if knots.shape != (n,):
        raise InvalidInput(f"times have shape {knots.shape}; {n} way points need ({n},) [s].")
    if not np.isfinite(knots).all():
        index = int(np.argmin(np.isfinite(knots)))
        raise InvalidInput(f"time {index} is {knots[index]}; it must be finite [s].")
    wrong = knots[1:] <= knots[:-1]
    if wrong.any():
        index = int(np.argmax(wrong)) + 1
        raise InvalidInput(f"time {index} is {knots[index]} after {knots[index - 1]}; times must increase [s].")
    return knots


def _set_end(values: Array, fixed: Mask, given: ArrayLike | None, name: str) -> None:
    if given is None:
        return
    rows = np.asarray(given, dtype=float)
    n_given = values.shape[0] if rows.ndim == 0 else rows.shape[0]
    if rows.ndim not in (0, 2) or n_given > values.shape[0] or (rows.ndim and rows.shape[1] != values.shape[1]):
        raise InvalidInput(
            f"the {name} boundary has shape {rows.shape}; allowed is a number or (n_given, {values.shape[1]}) "
            f"with n_given <= {values.shape[0]}."
        )
    if not np.isfinite(rows).all():
        raise InvalidInput(f"the {name} boundary is not finite; use None or fewer rows for free derivatives.")
    values[:n_given] = rows
    fixed[:n_given] = True


def _set_constraint(values: Array, fixed: Mask, constraint: Constraint, index: int) -> None:
    k, n_nodes, n_axes = values.shape
    node, d = constraint.node, constraint.derivative
    if not -n_nodes <= node < n_nodes or not 1 <= d < k:
        raise InvalidInput(
            f"constraint {index} is on derivative {d} of way point {node}; allowed are derivatives 1 to {k - 1} "
            f"of way points {-n_nodes} to {n_nodes - 1}."
        )
    axes = list(range(n_axes) if constraint.axes is None else constraint.axes)
    if not set(axes) <= set(range(n_axes)):
        raise InvalidInput(f"constraint {index} is on axes {axes}; there are axes 0 to {n_axes - 1}.")
    given = np.asarray(constraint.value, dtype=float)
    if given.shape not in ((), (len(axes),)) or not np.isfinite(given).all():
        raise InvalidInput(f"constraint {index} has value {given}; allowed is a finite number or one per axis.")
    if np.any(fixed[d, node, axes] & (values[d, node, axes] != given)):
        raise InvalidInput(f"constraint {index} contradicts another on derivative {d} of way point {node}.")
    values[d, node, axes] = given
    fixed[d, node, axes] = True


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
