"""Plan trajectories around obstacles by a soft collision cost, [Gao2022] eqs (76)-(82), and verify
them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import AdvisedStatus, InvalidInput
from uvms_ocp.planning.conservative_advancement import (
    ClearanceReport,
    PairDistances,
    check_clearance,
)
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.path_cost import CostParts, CostWeights, DistanceSource, PathCost
from uvms_ocp.planning.rrt_connect import ONE_THREAD, SamplingOptions, sampled_waypoints
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.planning.trust_region import Descent, DescentProblem, DescentSolver, TrustRegion
from uvms_ocp.trajectories import (
    MotionLimits,
    PiecewisePolynomial,
    free_derivatives,
    scale_to_limits,
    trapezoidal_times,
)
from uvms_ocp.trajectories.curve_judge import excess_over_limits
from uvms_ocp.trajectories.min_snap import min_snap, solution_of
from uvms_ocp.types import (
    Array,
    AtLeastOne,
    Count,
    Indices,
    Magnitude,
    Mask,
)

_NEGLIGIBLE_COLLISION_COST = 1e-3  # cost of collision below which the rest counts, too
_LIMIT_TOLERANCE = (
    1e-6  # [m or rad] beyond a limit, above what rounding makes of a curve that ends there
)


class PlanStatus(AdvisedStatus):
    """Outcome of a plan.

    FREE: `check_clearance` has proven the whole curve free of collision, and it leaves no limit of
    position by more than a millionth of a metre or radian, anywhere.
    """

    FREE = "free of collision", "none needed."
    UNDECIDED = (
        "no collision found, not certified",
        "the path all but touches something; plan again with a larger clearance.",
    )
    BEYOND_LIMITS = (
        "free of collision, beyond a limit of position",
        "give way points within the limits, more pieces or restarts.",
    )
    COLLIDING = (
        "still in collision",
        "give way points around the obstacle (see sampled_waypoints), more pieces or restarts.",
    )


@checked_dataclass()
class SoftCollisionOptions:
    """Settings of ``plan_soft_collision``."""

    pieces: AtLeastOne = 10
    weights: CostWeights = field(default_factory=CostWeights)
    solver: DescentSolver = field(default_factory=TrustRegion)
    """Solver on the banded structure; or another one, which may take joint limits as hard bounds on
    the nodes.
    """
    restarts: Count = 2
    """Further attempts, from randomly bent starts, while the result collides."""
    sampling: SamplingOptions | None = field(default_factory=SamplingOptions)
    """Then one attempt through way points found by sampling, unless None or way points are kept."""
    bend: Magnitude = 0.5
    """[m or rad] size of the first bend; it grows with each attempt."""
    free_waypoints: bool = True
    """Move interior way points too; otherwise only their derivatives."""
    seed: Count = 0


@checked_dataclass(eq=False)
class CollisionPlan:
    """A trajectory of the scene's coordinates and how clear of collision it is."""

    trajectory: PiecewisePolynomial
    status: PlanStatus
    clearance: ClearanceReport
    cost: CostParts
    iterations: int
    attempts: int
    solve_time: float
    """[s] time of the search."""

    @property
    def collision_free(self) -> bool:
        return self.clearance.collision_free


@checked
def plan_soft_collision(
    scene: CollisionScene,
    waypoints: ArrayLike,
    *,
    limits: MotionLimits,
    times: ArrayLike | None = None,
    options: SoftCollisionOptions | None = None,
    distances: DistanceSource | None = None,
) -> CollisionPlan:
    """Bend a minimum-snap trajectory away from collisions, then verify it.

    waypoints (n, n_axes) [m, rad]: of the scene's coordinates, end points included; two are a
    straight start. times (n,) [s]: of the way points, kept unless they break the limits; by default
    as fast as the limits allow. distances: for the optimisation, by default coal's, which the
    verification always uses. Raises `InvalidInput` for an end point in collision or outside the
    position limits, and as ``min_snap``.
    """
    began = perf_counter()
    settings = options or SoftCollisionOptions()
    exact = CoalDistances(scene)
    _check_ends(scene, exact, np.asarray(waypoints, dtype=float))
    start = straight_guess(waypoints, limits, times)
    # Of small matrices, on which threads cost eight times what they gain.
    with ONE_THREAD, threadpool_limits(limits=1, user_api="blas"):
        path_problem = _PathProblem.of(
            distances or exact, start, limits, settings, timed=times is not None
        )
        attempts = _attempts(path_problem, start, exact, settings)
        plans = (
            _verified(problem, problem.solve(guess, settings), exact) for problem, guess in attempts
        )
        best, n_attempts = _first_free(plans)
    return replace(best, attempts=n_attempts, solve_time=perf_counter() - began)


def _first_free(plans: Iterator[CollisionPlan]) -> tuple[CollisionPlan, int]:
    """Return the first plan that is free of collision and within limits, or else the clearest, and
    how many were made.
    """
    best = next(plans)
    n = 1
    if best.status is PlanStatus.FREE:
        return best, n
    for plan in plans:
        best = max(best, plan, key=_rank)
        n = n + 1
        if best.status is PlanStatus.FREE:
            break
    return best, n


def _rank(plan: CollisionPlan) -> tuple[bool, bool, float]:
    is_free = plan.status is PlanStatus.FREE
    return is_free, plan.collision_free, plan.clearance.nearest.distance


def straight_guess(
    waypoints: ArrayLike, limits: MotionLimits, times: ArrayLike | None = None
) -> PiecewisePolynomial:
    """Make the minimum-snap curve through waypoints (n, n_axes) [m, rad], at times (n,) [s] or as
    fast as the limits allow.
    """
    if times is not None:
        return min_snap(waypoints, times).trajectory
    return scale_to_limits(
        min_snap(waypoints, trapezoidal_times(waypoints, limits)).trajectory, limits
    )


def _attempts(
    problem: _PathProblem,
    start: PiecewisePolynomial,
    exact: CoalDistances,
    options: SoftCollisionOptions,
) -> Iterator[tuple[_PathProblem, Array]]:
    """Yield problems and where to start them: as given, bent at random, through sampled way
    points.
    """
    yield problem, problem.start
    for bent in problem.bent_starts(options):
        yield problem, bent
    if options.sampling is not None and options.free_waypoints:
        ends = start.evaluate([start.start, start.end])
        waypoints = sampled_waypoints(exact, ends[0], ends[1], options.sampling)
        if waypoints is not None:
            cost = problem.cost
            detour = _PathProblem.of(
                cost.distances,
                straight_guess(waypoints, cost.limits),
                cost.limits,
                options,
                timed=False,
            )
            yield detour, detour.start


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _PathProblem:
    """Cost of a path, its start in scaled variables, and which variables are free."""

    cost: PathCost
    breaks: Array
    """(n_nodes,) [s] times of the nodes."""
    start: Array
    """(n_nodes, k n_axes) [m, rad] variables of the cost."""
    free: Mask
    """(n_nodes, k n_axes) True for variables that may change."""
    timed: bool
    """Times were given."""

    @staticmethod
    def of(
        distances: DistanceSource,
        start: PiecewisePolynomial,
        limits: MotionLimits,
        options: SoftCollisionOptions,
        *,
        timed: bool,
    ) -> _PathProblem:
        breaks, is_waypoint = _refined(start.breaks, options.pieces)
        values = np.stack([start.evaluate(breaks, d) for d in range(4)])
        pieces = free_derivatives.pieces_of(np.diff(breaks), 4)
        cost = PathCost(distances=distances, pieces=pieces, weights=options.weights, limits=limits)
        free = np.ones(values.shape, dtype=bool)
        free[0, is_waypoint] = options.free_waypoints
        free[:, [0, -1]] = False
        return _PathProblem(
            cost=cost,
            breaks=breaks,
            start=cost.variables(values),
            free=free.transpose(1, 0, 2).reshape(len(breaks), -1),
            timed=timed,
        )

    def bent_starts(self, options: SoftCollisionOptions) -> Iterator[Array]:
        """Smooth random bends of the start: noise whose covariance is the inverse of the snap
        Hessian.
        """
        rng = np.random.default_rng(options.seed)
        factor = self.cost.smoothness_hessian.pinned(self.free).cholesky()
        if factor is None:
            return
        for attempt in range(options.restarts):
            noise = factor.back(rng.normal(size=self.start.shape) * self.free)
            size = np.abs(self.cost.values(noise)[0]).max()
            yield self._within_limits(
                self.start + noise * (options.bend * (1.0 + 0.5 * attempt) / size)
            )

    def solve(self, start: Array, options: SoftCollisionOptions) -> Descent:
        """Minimise the cost of collision until nothing touches, then the whole cost."""
        low, high = self.cost.distances.scene.coordinates.limits()
        lower = np.full(self.start.shape, -np.inf)
        upper = np.full(self.start.shape, np.inf)
        # positions are the first of the variables of a node
        lower[:, : low.size] = low
        upper[:, : high.size] = high
        full_problem = DescentProblem(
            model=self.cost.model,
            start=start,
            free=self.free,
            metric=self.cost.smoothness_hessian.scaled(
                1.0 / max(options.weights.smoothness, 1e-12)
            ),
            lower=lower,
            upper=upper,
        )
        first = options.solver.minimise(
            replace(
                full_problem,
                model=lambda y: self.cost.model(y, collision_only=True),
                enough=lambda model: model.parts.collision <= _NEGLIGIBLE_COLLISION_COST,
            )
        )
        second = options.solver.minimise(replace(full_problem, start=first.variables))
        return replace(second, iterations=first.iterations + second.iterations)

    def trajectory(self, variables: Array) -> PiecewisePolynomial:
        """At the given times unless they break the limits; as fast as the limits allow where none
        were given.
        """
        fitted = solution_of(self.breaks, self.cost.pieces, self.cost.values(variables)).trajectory
        if self.timed and self.cost.limits.ratio(fitted) <= 1.0:
            return fitted
        return scale_to_limits(fitted, self.cost.limits)

    def _within_limits(self, variables: Array) -> Array:
        values = self.cost.values(variables)
        values[0] = np.clip(values[0], *self.cost.distances.scene.coordinates.limits())
        return np.where(self.free, self.cost.variables(values), self.start)


def _refined(breaks: Array, pieces: int) -> tuple[Array, Indices]:
    """Return the breaks split evenly into at least ``pieces`` pieces, and which of them were breaks
    before.
    """
    each = max(1, -(-pieces // (breaks.size - 1)))
    parts = [np.linspace(a, b, each, endpoint=False) for a, b in itertools.pairwise(breaks)]
    return np.concatenate([*parts, breaks[-1:]]), np.arange(0, each * (breaks.size - 1) + 1, each)


def _check_ends(scene: CollisionScene, distances: PairDistances, waypoints: Array) -> None:
    if waypoints.ndim != 2 or waypoints.shape[1] != scene.coordinates.n_axes:
        problem = f"way points have shape {waypoints.shape}"
        raise InvalidInput(
            f"{problem}; allowed is (n, {scene.coordinates.n_axes}), one column per axis."
        )
    lower, upper = scene.coordinates.limits()
    for index, name in ((0, "start"), (len(waypoints) - 1, "goal")):
        outside = (waypoints[index] < lower - 1e-9) | (waypoints[index] > upper + 1e-9)
        if outside.any():
            axis = int(np.argmax(outside))
            problem = (
                f"way point {index} (the {name}) has {scene.coordinates.names[axis]} ="
                f" {waypoints[index, axis]:.6g}"
            )
            raise InvalidInput(f"{problem}; allowed is {lower[axis]:.6g} to {upper[axis]:.6g}.")
        scene.check_no_overlap(
            distances.distances(waypoints[index : index + 1])[0], f"way point {index} (the {name})"
        )


def _verified(problem: _PathProblem, descent: Descent, exact: CoalDistances) -> CollisionPlan:
    trajectory = problem.trajectory(descent.variables)
    report = check_clearance(exact, trajectory)
    beyond = excess_over_limits(trajectory, *exact.scene.coordinates.limits())
    if report.undecided:
        status = PlanStatus.UNDECIDED
    elif not report.collision_free:
        status = PlanStatus.COLLIDING
    elif beyond.max(initial=0.0) > _LIMIT_TOLERANCE:
        status = PlanStatus.BEYOND_LIMITS
    else:
        status = PlanStatus.FREE
    return CollisionPlan(
        trajectory=trajectory,
        status=status,
        clearance=report,
        cost=descent.model.parts,
        iterations=descent.iterations,
        attempts=1,
        solve_time=0.0,
    )
