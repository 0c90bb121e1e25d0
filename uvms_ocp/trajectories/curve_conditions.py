"""What a minimum-derivative curve must obey besides its way points and times, checked and laid out
node by node.

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Array, Mask, Range, read_only


@checked_dataclass(eq=False)
class Boundary:
    """Derivatives 1, 2, ... at both ends: a number for all of them (0 is rest), rows (n_given,
    n_axes), or None (free).

    Rows give velocity, acceleration, ... in this order; derivatives beyond the last row are free.
    """

    start: Annotated[ArrayLike, Range(open=True)] | None = 0.0
    """() or (n_given, n_axes) [axis/s^d]"""
    end: Annotated[ArrayLike, Range(open=True)] | None = 0.0
    """() or (n_given, n_axes) [axis/s^d]"""


@checked_dataclass(eq=False)
class Constraint:
    """One derivative fixed at one way point, for all axes or some of them."""

    node: int
    """Index of the way point; negative counts from the end."""
    derivative: int
    """1 .. k - 1."""
    value: Annotated[ArrayLike, Range(open=True)] = 0.0
    """() or (n_listed,) [axis/s^derivative]: for all axes concerned, or one per axis."""
    axes: tuple[int, ...] | None = None
    """Axes concerned; None is all of them."""


@checked_dataclass(eq=False)
class CurveSpecification:
    """Order of the derivative that is minimised, and conditions at the way points besides their
    positions.

    Raises `InvalidInput` for a derivative below 1.
    """

    derivative: int = 4
    """k: 4 is snap, 3 jerk, 2 acceleration. Pieces have degree 2k - 1."""
    boundary: Boundary = field(default_factory=Boundary)
    """Derivatives at both ends."""
    constraints: tuple[Constraint, ...] = ()
    """Derivatives fixed at way points."""
    free_positions: tuple[int, ...] = ()
    """Indices of way points whose position is free as well."""
    dwell: bool = False
    """Accept equal consecutive way points, where the curve stays near."""

    def __post_init__(self) -> None:
        if self.derivative < 1:
            raise InvalidInput(
                f"derivative is {self.derivative}; allowed is 1 or more (4 is snap)."
            )


MINIMUM_SNAP = CurveSpecification()
"""Minimum snap from rest to rest through all way points."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NodeProblem:
    """Conditions at the nodes, checked."""

    times: Array
    """(n + 1,) [s] times of the way points."""
    values: Array
    """(k, n + 1, n_axes) [axis/s^d] derivatives at the nodes; where not fixed, a starting guess."""
    fixed: Mask
    """(k, n + 1, n_axes) True for derivatives that are fixed."""

    @property
    def k(self) -> int:
        return self.values.shape[0]


def node_problem(
    waypoints: ArrayLike, times: ArrayLike, specification: CurveSpecification
) -> NodeProblem:
    """Lay out per node what is fixed.

    waypoints (n + 1, n_axes) [axis]: positions, (n + 1,) for one axis. times (n + 1,) [s]:
    increasing. Raises `InvalidInput` as `checked_waypoints` and `checked_times`, for a boundary of
    the wrong shape or not finite, and for a free position or constraint that does not exist or
    contradicts another.
    """
    points = checked_waypoints(waypoints, dwell=specification.dwell)
    knots = checked_times(times, points.shape[0])
    values = np.zeros((specification.derivative, *points.shape))
    values[0] = points
    fixed = np.zeros(values.shape, dtype=bool)
    fixed[0] = True
    for node in specification.free_positions:
        if not -knots.size <= node < knots.size:
            raise InvalidInput(
                f"the position of way point {node} is to be free; allowed are {-knots.size} to"
                f" {knots.size - 1}."
            )
        fixed[0, node] = False
    _set_end(values[1:, 0], fixed[1:, 0], specification.boundary.start, "start")
    _set_end(values[1:, -1], fixed[1:, -1], specification.boundary.end, "end")
    for index, constraint in enumerate(specification.constraints):
        _set_constraint(values, fixed, constraint, index)
    return NodeProblem(times=knots, values=values, fixed=fixed)


def checked_waypoints(waypoints: ArrayLike, *, dwell: bool = False) -> Array:
    """Return (n + 1, n_axes) [axis] from waypoints (n + 1, n_axes), or (n + 1,) for one axis [axis].

    Raises `InvalidInput` for another shape, fewer than two, numbers that are not finite, and,
    unless ``dwell``, for consecutive ones that are equal.
    """
    points = np.asarray(waypoints, dtype=float)
    if points.ndim == 1:
        points = points[:, None]
    if points.ndim != 2 or points.shape[0] < 2 or points.shape[1] < 1:
        raise InvalidInput(
            f"way points have shape {points.shape}; allowed is (n, n_axes) with n >= 2."
        )
    if not np.isfinite(points).all():
        index = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InvalidInput(f"way point {index} is {points[index]}; it must be finite.")
    equal = (points[1:] == points[:-1]).all(axis=1)
    if not dwell and equal.any():
        index = int(np.argmax(equal))
        raise InvalidInput(
            f"way points {index} and {index + 1} are equal; remove one, or give dwell=True to wait"
            " there."
        )
    return points


def checked_times(times: ArrayLike, n: int) -> Array:
    """Return times (n,) [s], read-only. Raises `InvalidInput` for another shape, and where they are not
    finite or do not increase.
    """
    knots = read_only(times, np.float64)
    if knots.shape != (n,):
        raise InvalidInput(f"times have shape {knots.shape}; {n} way points need ({n},) [s].")
    if not np.isfinite(knots).all():
        index = int(np.argmin(np.isfinite(knots)))
        raise InvalidInput(f"time {index} is {knots[index]}; it must be finite [s].")
    is_not_increasing = knots[1:] <= knots[:-1]
    if is_not_increasing.any():
        index = int(np.argmax(is_not_increasing)) + 1
        raise InvalidInput(
            f"time {index} is {knots[index]} after {knots[index - 1]}; times must increase [s]."
        )
    return knots


def _set_end(values: Array, fixed: Mask, boundary: ArrayLike | None, name: str) -> None:
    """Fix derivatives (k - 1, n_axes) of order 1, 2, ... at the first or last node."""
    if boundary is None:
        return
    rows = np.asarray(boundary, dtype=float)
    n_derivatives, n_axes = values.shape
    if rows.ndim == 0:
        n_given = n_derivatives
        is_allowed = True
    else:
        n_given = rows.shape[0]
        is_allowed = rows.ndim == 2 and n_given <= n_derivatives and rows.shape[1] == n_axes
    if not is_allowed:
        raise InvalidInput(
            f"the {name} boundary has shape {rows.shape}; allowed is a number or (n_given,"
            f" {n_axes}) with n_given <= {n_derivatives}."
        )
    values[:n_given] = rows
    fixed[:n_given] = True


def _set_constraint(values: Array, fixed: Mask, constraint: Constraint, index: int) -> None:
    """Fix one derivative among all (k, n + 1, n_axes)."""
    k, n_nodes, n_axes = values.shape
    node = constraint.node
    d = constraint.derivative
    if not -n_nodes <= node < n_nodes or not 1 <= d < k:
        problem = f"constraint {index} is on derivative {d} of way point {node}"
        raise InvalidInput(
            f"{problem}; allowed are derivatives 1 to {k - 1} of way points {-n_nodes} to"
            f" {n_nodes - 1}."
        )
    axes = list(range(n_axes) if constraint.axes is None else constraint.axes)
    if not set(axes) <= set(range(n_axes)):
        raise InvalidInput(
            f"constraint {index} is on axes {axes}; there are axes 0 to {n_axes - 1}."
        )
    value = np.asarray(constraint.value, dtype=float)
    if value.shape not in ((), (len(axes),)):
        raise InvalidInput(
            f"constraint {index} has value {value}; allowed is a number or one per axis."
        )
    if np.any(fixed[d, node, axes] & (values[d, node, axes] != value)):
        raise InvalidInput(
            f"constraint {index} contradicts another on derivative {d} of way point {node}."
        )
    values[d, node, axes] = value
    fixed[d, node, axes] = True
