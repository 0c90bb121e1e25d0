"""Minimum-snap (jerk, acceleration, ...) trajectories through way points, [Gao2022] eqs (59)-(75).

`min_snap` solves for the free derivatives; `min_snap_qp` states the same problem as a QP in
coefficients, which takes bounds too.

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].

Slower than the free-derivative form and used to check it; it takes bounds on derivatives at way
points as well. `[axis]` is the unit of an axis, such as m or rad.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import FieldTable
from uvms_ocp.trajectories import curve_judge, free_derivatives
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Array, Count, Finite, Mask, Positive, Range, Shape, read_only

_QUIET = dict.fromkeys(("print_header", "print_iter", "print_info", "error_on_fail"), False)

_STATIONARY = 1e-4  # largest slope of the cost, relative, by the logarithm of a duration
_LARGEST_WEIGHT = 1e12  # beyond it the optimal durations are lost in rounding


# What a minimum-snap curve must obey besides its way points and times, checked and laid out node by
# node.


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
    """(n + 1,) [s]"""
    values: Array
    """(k, n + 1, n_axes) [axis/s^d] derivatives at the nodes; where not fixed, a starting guess."""
    fixed: Mask
    """(k, n + 1, n_axes)"""

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
    """(n + 1, n_axes) [axis] from waypoints (n + 1, n_axes), or (n + 1,) for one axis [axis].

    Raises `InvalidInput` for another shape, fewer than two, numbers that are not finite, and,
    unless ``dwell``, for consecutive ones that are equal.
    """
    points = np.asarray(waypoints, dtype=float)
    points = points[:, None] if points.ndim == 1 else points
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
    """Times (n,) [s], read-only. Raises `InvalidInput` for another shape, and where they are not
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
    if boundary is None:
        return
    rows = np.asarray(boundary, dtype=float)
    n_given = values.shape[0] if rows.ndim == 0 else rows.shape[0]
    if (
        rows.ndim not in (0, 2)
        or n_given > values.shape[0]
        or (rows.ndim and rows.shape[1] != values.shape[1])
    ):
        problem = f"the {name} boundary has shape {rows.shape}"
        raise InvalidInput(
            f"{problem}; allowed is a number or (n_given, {values.shape[1]}) with n_given <="
            f" {values.shape[0]}."
        )
    values[:n_given] = rows
    fixed[:n_given] = True


def _set_constraint(values: Array, fixed: Mask, constraint: Constraint, index: int) -> None:
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


@checked_dataclass(eq=False, repr=False)
class MinSnap(FieldTable):
    """A minimum-derivative trajectory and the data of its nodes."""

    trajectory: PiecewisePolynomial
    node_derivatives: Array
    """(k, n + 1, n_axes) [axis/s^d] derivatives 0 .. k - 1 at the way points."""
    cost: float
    """[axis^2/s^(2k - 1)] Integral of the squared k-th derivative, summed over the axes."""

    def gradients(self) -> CostGradients:
        """Compute the gradients of the optimal cost in the data; linear in the number of pieces
        (envelope theorem).
        """
        pieces = free_derivatives.pieces_of(
            self.trajectory.durations, self.node_derivatives.shape[0]
        )
        by_duration, by_node = free_derivatives.cost_slopes(pieces, self.node_derivatives)
        by_time = np.concatenate([[0.0], by_duration]) - np.concatenate([by_duration, [0.0]])
        return CostGradients(
            times=by_time, durations=by_duration, waypoints=by_node[0], node_derivatives=by_node
        )


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
    curve, problem, pieces = _least(waypoints, times, specification)
    slopes = free_derivatives.cost_slopes(pieces, curve.node_derivatives)[1]
    _require_accurate(curve, problem, slopes)
    _require_proven(curve, problem, pieces, *_fixed_bounds(problem), slopes)
    return curve


def _least(
    waypoints: ArrayLike, times: ArrayLike, specification: CurveSpecification
) -> tuple[MinSnap, NodeProblem, free_derivatives.Pieces]:
    problem = node_problem(waypoints, times, specification)
    pieces = free_derivatives.pieces_of(np.diff(problem.times), problem.k)
    return solution_of(problem.times, pieces, _solved(problem, pieces)), problem, pieces


def _require_proven(
    curve: MinSnap,
    problem: NodeProblem,
    pieces: free_derivatives.Pieces,
    lower: Array,
    upper: Array,
    slopes: Array,
) -> None:
    """Let the judge look at a curve: it keeps its conditions, and none beside it is cheaper.

    lower, upper (k, n + 1, n_axes) [axis/s^d]: bounds on the node derivatives. slopes (k, n + 1,
    n_axes): of the cost by them.
    """
    curvature = free_derivatives.cost_curvature(pieces)
    gain = curve_judge.achievable_gain(slopes, curvature, curve.node_derivatives, lower, upper)
    missed = curve_judge.largest_miss(curve.trajectory, lower, upper)
    if missed > curve_judge.KEPT or gain > curve_judge.CHEAPEST * _scale_of_cost(curve, problem):
        raise InvalidInput(_rounding_decides(problem))


def _require_accurate(curve: MinSnap, problem: NodeProblem, slopes: Array) -> None:
    """Check the cost by another way: where the slope by all that is free vanishes, it is half the
    sum of slope times value over what is fixed.
    """
    cost_of_fixed = float((slopes * curve.node_derivatives)[problem.fixed].sum()) / 2.0
    scale = _scale_of_cost(curve, problem)
    if not abs(curve.cost - cost_of_fixed) <= curve_judge.CHEAPEST * scale:
        raise InvalidInput(_rounding_decides(problem))


def _scale_of_cost(curve: MinSnap, problem: NodeProblem) -> float:
    """The cost; what ordinary pieces cost by themselves, where that is next to nothing."""
    durations = np.diff(problem.times)
    steps = (np.diff(curve.node_derivatives[0], axis=0) ** 2).sum(axis=1)
    usual = np.median(steps / durations ** (2 * problem.k - 1)) * durations.size
    return max(curve.cost, float(usual))


def _rounding_decides(problem: NodeProblem) -> str:
    durations = np.diff(problem.times)
    short = int(np.argmin(durations))
    cause = (
        f"way points {short} and {short + 1} are {durations[short]:.3g} s apart, of"
        f" {durations.sum():.3g} s in all"
    )
    return (
        f"{cause}: rounding decides the curve; merge way points that nearly coincide, or give"
        " them more time."
    )


def _fixed_bounds(problem: NodeProblem) -> tuple[Array, Array]:
    lower = np.where(problem.fixed, problem.values, -np.inf)
    upper = np.where(problem.fixed, problem.values, np.inf)
    return lower, upper


def solution_of(times: Array, pieces: free_derivatives.Pieces, values: Array) -> MinSnap:
    """The trajectory through node derivatives: values (k, n + 1, n_axes) [axis/s^d] at times (n +
    1,) [s].
    """
    data = free_derivatives.end_data(pieces, values)
    trajectory = PiecewisePolynomial(
        breaks=times, coefficients=free_derivatives.coefficients(pieces, data, values)
    )
    return MinSnap(
        trajectory=trajectory,
        node_derivatives=values,
        cost=float(free_derivatives.piece_costs(pieces, data).sum()),
    )


def _solved(problem: NodeProblem, pieces: free_derivatives.Pieces) -> Array:
    if (problem.fixed == problem.fixed[:, :, :1]).all():
        return free_derivatives.solve_free(pieces, problem.values, problem.fixed[:, :, 0])
    values = problem.values.copy()
    for axes in _axes_with_one_pattern(problem.fixed):
        values[:, :, axes] = free_derivatives.solve_free(
            pieces, values[:, :, axes], problem.fixed[:, :, axes[0]]
        )
    return values


def _axes_with_one_pattern(fixed: Mask) -> Iterator[list[int]]:
    """Groups of axes that fix the same derivatives, and so share one factorisation."""
    groups: dict[bytes, list[int]] = {}
    for axis in range(fixed.shape[2]):
        groups.setdefault(fixed[:, :, axis].tobytes(), []).append(axis)
    yield from groups.values()


# The same minimum-derivative problem as an equality-constrained QP in coefficients, [Gao2022] eqs
# (74)-(75).


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
    limits = [qp.limits(problem, axis) for axis in range(problem.values.shape[2])]
    lower = np.stack([low for low, _ in limits], axis=2)
    upper = np.stack([high for _, high in limits], axis=2)
    solved = [qp.solve(problem, axis, *limits[axis]) for axis in range(len(limits))]
    solution = solution_of(problem.times, pieces, np.stack(solved, axis=2))
    slopes = free_derivatives.cost_slopes(pieces, solution.node_derivatives)[1]
    _require_proven(solution, problem, pieces, lower, upper, slopes)
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
        self.H = ca.diagcat(
            *[ca.DM(2.0 * t ** (1 - 2 * k) * free_derivatives.monomial_cost(k)) for t in self.tau]
        )
        self.A = self._rows()
        self.solver = ca.conic(
            "min_snap", "qrqp", {"h": self.H.sparsity(), "a": self.A.sparsity()}, _QUIET
        )

    def solve(self, problem: NodeProblem, axis: int, lower: Array, upper: Array) -> Array:
        """(k, n + 1) optimal node derivatives of one axis within `limits`."""
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
        ends = np.asarray(self.A[: self.k * (self.n + 1), :] @ ca.DM(coefficients.ravel()))
        nodes = ends.reshape(self.n + 1, self.k).T / self.unit ** np.arange(self.k)[:, None]
        return np.where(problem.fixed[:, :, axis], problem.values[:, :, axis], nodes)

    def _rows(self) -> ca.DM:
        """Derivatives 0 .. k - 1 at every node (end of the last piece for the last), then their
        continuity.
        """
        starts = self._end_rows(0.0)
        ends = self._end_rows(1.0)
        nodes = ca.diagcat(*starts[:-1], ca.vertcat(starts[-1], ends[-1]))
        if self.n == 1:
            return nodes
        end_rows_of_piece = ca.horzcat(
            ca.diagcat(*ends[:-1]), ca.DM(self.k * (self.n - 1), 2 * self.k)
        )
        start_rows_of_next = ca.horzcat(
            ca.DM(self.k * (self.n - 1), 2 * self.k), ca.diagcat(*starts[1:])
        )
        return ca.vertcat(nodes, end_rows_of_piece - start_rows_of_next)

    def _end_rows(self, u: float) -> list[ca.DM]:
        """Derivatives 0 .. k - 1 at unit time u of each piece, by its coefficients."""
        rows = [free_derivatives.monomial_row(u, d, 2 * self.k) for d in range(self.k)]
        matrix = ca.DM(np.stack(rows))
        return [ca.sparsify(ca.diag(t ** -np.arange(self.k)) @ matrix) for t in self.tau]

    def limits(self, problem: NodeProblem, axis: int) -> tuple[Array, Array]:
        """Bounds (k, n + 1) [axis/s^d] on the node derivatives of one axis."""
        fixed = problem.fixed[:, :, axis]
        values = problem.values[:, :, axis]
        lower = np.where(fixed, values, -np.inf)
        upper = np.where(fixed, values, np.inf)
        for index, bound in enumerate(self.bounds):
            if not 0 <= bound.derivative < self.k or not -self.n - 1 <= bound.node <= self.n:
                mismatch = (
                    f"bound {index} is on derivative {bound.derivative} of way point {bound.node}"
                )
                raise InvalidInput(
                    f"{mismatch}; allowed are derivatives 0 to {self.k - 1} of way points 0 to"
                    f" {self.n}."
                )
            lower[bound.derivative, bound.node] = max(
                lower[bound.derivative, bound.node], bound.lower
            )
            upper[bound.derivative, bound.node] = min(
                upper[bound.derivative, bound.node], bound.upper
            )
        crossed = (lower > upper).any(axis=0)
        if crossed.any():
            raise InvalidInput(
                f"the bounds of way point {int(np.argmax(crossed))} leave no solution; relax one."
            )
        return lower, upper


# Choose the times of way points: trapezoidal guess, scaling to limits, and the optimum of time plus
# snap.


@checked_dataclass(eq=False)
class MotionLimits:
    """Largest absolute derivatives, a number or one per axis; infinity is no limit.

    Raises `InvalidInput` for a limit of zero, negative or NaN (the axis is named).
    """

    velocity: ArrayLike = np.inf
    """() or (n_axes,) [axis/s]"""
    acceleration: ArrayLike = np.inf
    """() or (n_axes,) [axis/s2]"""
    jerk: ArrayLike = np.inf
    """() or (n_axes,) [axis/s3]"""

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration", "jerk"):
            limit = np.array(getattr(self, name), dtype=float)
            if limit.ndim > 1 or not np.all(limit > 0.0):
                axis = int(np.argmin(np.atleast_1d(limit > 0.0)))
                raise InvalidInput(
                    f"the {name} limit of axis {axis} is {limit.flat[axis]}; it must be positive."
                )
            limit.flags.writeable = False
            object.__setattr__(self, name, limit)

    def rows(self, n_axes: Count) -> Array:
        """(3, n_axes) [axis/s^d] limits of derivatives d = 1, 2, 3. Raises `InvalidInput` where
        they are of other shape.
        """
        limits = (np.asarray(self.velocity), np.asarray(self.acceleration), np.asarray(self.jerk))
        for name, limit in zip(("velocity", "acceleration", "jerk"), limits, strict=True):
            if limit.shape not in ((), (n_axes,)):
                raise InvalidInput(
                    f"the {name} limit has shape {limit.shape}; allowed is () or ({n_axes},)."
                )
        return np.stack([np.broadcast_to(limit, (n_axes,)) for limit in limits])

    def ratios(self, trajectory: PiecewisePolynomial) -> Array:
        """(3, n_axes) peaks of derivatives d = 1, 2, 3 as shares of their limits."""
        return np.stack([trajectory.peak(d) for d in (1, 2, 3)]) / self.rows(trajectory.n_axes)

    def ratio(self, trajectory: PiecewisePolynomial) -> float:
        """Largest ratio of a derivative to its limit; at most 1 when all limits are kept."""
        return float(np.max(self.ratios(trajectory)))


@checked
def trapezoidal_times(waypoints: ArrayLike, limits: MotionLimits) -> Array:
    """(n + 1,) [s] times at which every leg, from rest to rest, lasts as long as its slowest axis
    needs.

    waypoints (n + 1, n_axes) [axis], (n + 1,) for one axis. An axis needs a trapezoidal velocity
    profile within its velocity and acceleration limits. Raises `InvalidInput` for way points as
    `checked_waypoints`, and for an axis that moves without a finite limit.
    """
    points = checked_waypoints(waypoints)
    velocity, acceleration = limits.rows(points.shape[1])[:2]
    distance = np.abs(np.diff(points, axis=0))
    unlimited = (distance > 0.0).any(axis=0) & np.isinf(velocity) & np.isinf(acceleration)
    if unlimited.any():
        raise InvalidInput(
            f"axis {int(np.argmax(unlimited))} moves without a finite velocity or acceleration"
            " limit."
        )
    return np.concatenate(
        [[0.0], np.cumsum(np.max(_trapezoid(distance, velocity, acceleration), axis=1))]
    )


@checked
def scale_to_limits(trajectory: PiecewisePolynomial, limits: MotionLimits) -> PiecewisePolynomial:
    """Return the path as fast as a uniform change of time allows: the largest ratio to a limit
    becomes 1.

    A trajectory that starts or ends in motion changes its end velocities with it. Raises
    `InvalidInput` where no finite limit concerns an axis that moves.
    """
    factor = float(np.max(limits.ratios(trajectory) ** (1.0 / np.array([1.0, 2.0, 3.0])[:, None])))
    if factor == 0.0:
        raise InvalidInput(
            "no finite limit concerns an axis that moves; give a limit, or keep the given times."
        )
    return trajectory.scaled(factor)


@checked
def optimal_times(
    waypoints: ArrayLike,
    times: Annotated[ArrayLike, Shape("n")],
    specification: CurveSpecification = MINIMUM_SNAP,
    *,
    time_weight: Finite,
    tolerance: Positive = 1e-9,
    max_iterations: int = 500,
) -> MinSnap:
    """Minimise ``time_weight * total time + cost`` over the durations and all free derivatives
    together.

    The derivatives are eliminated exactly for each set of durations, whose gradient is then linear
    in time; what is left is a smooth problem in the logarithms of the durations, solved by L-BFGS.

    waypoints (n + 1, n_axes) [axis]; times (n + 1,) [s]: first guess; time_weight [axis^2/s^2k]:
    k_T, the cost of one second; tolerance: largest slope of the cost, as a share of its first
    value, by the logarithm of a duration. Raises `InvalidInput` as ``min_snap``, for a time weight
    that is not positive, and where the search ends before the optimum.
    """
    from scipy.optimize import minimize  # half a second, which few need

    if not 0.0 < time_weight <= _LARGEST_WEIGHT:
        raise InvalidInput(
            f"time_weight is {time_weight}; it must be positive, and at most {_LARGEST_WEIGHT:g}."
        )
    if not np.size(times):
        raise InvalidInput("times are empty; give one for each way point.")
    start = float(np.asarray(times, dtype=float).flat[0])

    def knots(log_durations: Array) -> Array:
        return start + np.concatenate([[0.0], np.cumsum(np.exp(log_durations))])

    def objective(log_durations: Array) -> tuple[float, Array]:
        curve = _least(waypoints, knots(log_durations), specification)[0]
        h = np.exp(log_durations)
        return float(time_weight * h.sum() + curve.cost), (
            time_weight + curve.gradients().durations
        ) * h

    guess = min_snap(waypoints, times, specification)
    x = np.log(
        guess.trajectory.durations * _best_stretch(guess, time_weight, specification.derivative)
    )
    scale = objective(x)[0]
    result = minimize(
        lambda y: tuple(part / scale for part in objective(y)),
        x,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": max_iterations, "ftol": 1e-15, "gtol": tolerance, "maxcor": 20},
    )
    cost, slopes = objective(result.x)
    if not np.abs(slopes).max() <= _STATIONARY * cost:
        raise InvalidInput(
            f"after {result.nit} iterations one of the durations still changes the cost by"
            f" {np.abs(slopes).max() / cost:.2g} of it; raise max_iterations, or give other times."
        )
    return min_snap(waypoints, knots(result.x), specification)


def _trapezoid(distance: Array, velocity: Array, acceleration: Array) -> Array:
    """Time from rest to rest over a distance; below v^2/a the profile is a triangle."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ramp = np.where(np.isinf(acceleration), 0.0, velocity / acceleration)
        cruise = np.where(np.isinf(velocity), np.inf, distance / velocity + ramp)
        triangle = np.where(np.isinf(acceleration), 0.0, 2.0 * np.sqrt(distance / acceleration))
        return np.where(distance >= velocity * ramp, cruise, triangle)


def _best_stretch(guess: MinSnap, time_weight: float, k: int) -> float:
    """Uniform stretch that is optimal from rest to rest, where k_T T = (2k - 1) cost."""
    if guess.cost == 0.0:
        return 1.0
    return float(
        ((2 * k - 1) * guess.cost / (time_weight * guess.trajectory.duration)) ** (1.0 / (2 * k))
    )
