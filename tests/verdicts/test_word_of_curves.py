"""Curves are given by a judge that does not trust their solver: way points, least cost, limits and
freedom of collision.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.planning import soft_collision
from uvms_ocp.planning.request import PlanRequest, PlanResult, PostureGoal, plan_path
from uvms_ocp.planning.soft_collision import PlanStatus
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.shapes.obstacles import Obstacle, obstacle
from uvms_ocp.trajectories import free_derivatives
from uvms_ocp.trajectories.coefficient_qp import Bound, _Qp, min_snap_qp
from uvms_ocp.trajectories.curve_judge import excess_over_limits
from uvms_ocp.trajectories.min_snap import MinSnap, min_snap
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.trajectories.segment_times import optimal_times

RNG = np.random.default_rng(0)
WAYPOINTS = RNG.normal(size=(6, 2))
TIMES = np.concatenate([[0.0], np.cumsum(RNG.uniform(1.0, 3.0, 5))])
Wrong = Callable[[np.ndarray, np.ndarray], np.ndarray]


def past_a_way_point(values: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    values[0, 2] += 1e-3
    return values


def at_rest_at_way_points(values: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """The identity of cost and slopes holds for it, too."""
    return np.where(fixed, values, 0.0)


def slightly_dearer(values: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    return np.where(fixed, values, 1.1 * values)


WRONG = [past_a_way_point, at_rest_at_way_points, slightly_dearer]


def as_wide(fixed: np.ndarray) -> np.ndarray:
    return fixed[..., None] if fixed.ndim == 2 else fixed


@pytest.mark.parametrize("wrong", WRONG)
def test_a_curve_that_a_wrong_solver_gives_is_refused(
    wrong: Wrong, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve_free = free_derivatives.solve_free

    def lying(pieces: Any, values: np.ndarray, fixed: np.ndarray) -> np.ndarray:
        return wrong(solve_free(pieces, values, fixed), as_wide(fixed))

    min_snap(WAYPOINTS, TIMES)
    monkeypatch.setattr(free_derivatives, "solve_free", lying)
    with pytest.raises(InvalidInput, match="rounding decides the curve"):
        min_snap(WAYPOINTS, TIMES)


@pytest.mark.parametrize("wrong", WRONG)
def test_so_is_one_that_a_wrong_quadratic_program_gives(
    wrong: Wrong, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve = _Qp.solve

    def lying(qp: _Qp, problem: Any, axis: int, lower: Any, upper: Any) -> np.ndarray:
        derivatives = solve(qp, problem, axis, lower, upper)
        return wrong(derivatives[:, :, None], problem.fixed[:, :, [axis]])[:, :, 0]

    min_snap_qp(WAYPOINTS, TIMES)
    monkeypatch.setattr(_Qp, "solve", lying)
    with pytest.raises(InvalidInput, match="rounding decides the curve"):
        min_snap_qp(WAYPOINTS, TIMES)


@pytest.mark.parametrize("beyond", [1e-3, -0.3])
def test_a_bound_that_is_broken_or_held_in_vain_is_seen(
    beyond: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A curve beyond its bound, and one that keeps away from it though it would be cheaper there."""
    free = min_snap(WAYPOINTS, TIMES)
    speed = free.node_derivatives[1, 2].max()
    bound = Bound(node=2, derivative=1, upper=speed - 0.2)
    assert min_snap_qp(WAYPOINTS, TIMES, bounds=[bound]).cost > free.cost
    solve = _Qp.solve

    def lying(qp: _Qp, problem: Any, axis: int, lower: Any, upper: Any) -> np.ndarray:
        derivatives = solve(qp, problem, axis, lower, upper).copy()
        derivatives[1, 2] += beyond
        return derivatives

    monkeypatch.setattr(_Qp, "solve", lying)
    with pytest.raises(InvalidInput, match="rounding decides the curve"):
        min_snap_qp(WAYPOINTS, TIMES, bounds=[bound])


@pytest.mark.parametrize("short", [1.0, 1e-1, 1e-2, 1e-3, 1e-4])
def test_both_solvers_give_the_least_cost_or_none(short: float) -> None:
    waypoints = np.array([0.0, 5.0, 5.0 + 0.05 * short**2, 10.0])
    times = np.cumsum([0.0, 12.0, short, 12.0])
    curves: list[MinSnap] = []
    for solver in (min_snap, min_snap_qp):
        with suppress(InvalidInput):
            curves.append(solver(waypoints, times))
    lowest_cost = 0.0789  # that of rational numbers where the short piece is as short as it can be
    for curve in curves:
        assert 0.05 < curve.cost <= lowest_cost


def test_how_far_a_curve_leaves_its_limits_is_what_dense_samples_find() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        curve = PiecewisePolynomial(
            breaks=[0.0, rng.uniform(0.1, 2.0)], coefficients=rng.normal(size=(8, 1, 3))
        )
        lower = rng.uniform(-3.0, 0.0, 3)
        upper = rng.uniform(0.0, 3.0, 3)
        upper[2] = np.inf
        x = curve.evaluate(np.linspace(curve.start, curve.end, 20_001))
        sampled = np.maximum(np.maximum(lower - x, x - upper).max(axis=0), 0.0)
        excess = excess_over_limits(curve, lower, upper)
        assert (excess >= sampled - 1e-12).all()
        np.testing.assert_allclose(excess, sampled, atol=1e-6)


def test_times_are_optimal_or_none_are_given() -> None:
    guess = 3.0 * TIMES
    best = optimal_times(WAYPOINTS, guess, time_weight=1.0)
    slopes = best.gradients().durations
    np.testing.assert_allclose(slopes, -1.0, rtol=1e-2)
    with pytest.raises(InvalidInput, match="raise max_iterations"):
        optimal_times(WAYPOINTS, guess, time_weight=1.0, max_iterations=1)


def drawn_request(seed: int) -> PlanRequest:
    """An arm from limits to limits, among balls."""
    rng = np.random.default_rng(seed)
    robot = load_robot("planar5")
    lower, upper = robot.limits.position_lower, robot.limits.position_upper

    def posture() -> np.ndarray:
        share = rng.uniform(0.0, 1.0, len(lower))
        share = np.where(rng.uniform(size=len(lower)) < 0.5, np.round(share), share)
        return lower + share * (upper - lower)

    start = robot.configuration(joints=posture())
    goal = PostureGoal(joints=dict(zip(robot.joint_names, posture().tolist(), strict=True)))
    balls = tuple(
        obstacle(f"b{k}", coal.Sphere(rng.uniform(0.1, 0.4)), rng.normal(size=3) * 0.8)
        for k in range(3)
    )
    return PlanRequest(robot=robot, start=start, goal=goal, obstacles=balls, axes="joints")


def farthest_outside(result: PlanResult) -> float:
    """[rad] beyond a limit, by samples."""
    assert result.plan is not None
    curve = result.plan.trajectory
    lower, upper = result.scene.coordinates.limits()
    x = curve.evaluate(np.linspace(curve.start, curve.end, 4000))
    return float(np.maximum(lower - x, x - upper).max())


def test_a_curve_past_the_limit_of_a_joint_is_not_called_free() -> None:
    result = plan_path(drawn_request(148))
    assert result.plan is not None
    assert farthest_outside(result) > 0.04
    assert result.collision_free
    assert result.plan.status is PlanStatus.BEYOND_LIMITS
    assert "limits" in result.plan.status.advice


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_what_is_called_free_keeps_limits_and_distances(seed: int) -> None:
    try:
        result = plan_path(drawn_request(seed))
    except InvalidInput:  # one that starts or ends in a ball
        return
    assert result.plan is not None
    if result.plan.status is PlanStatus.FREE:
        assert farthest_outside(result) < 1e-5


WALL = obstacle("wall", coal.Box(20.0, 0.1, 20.0), [0.0, 0.9, 0.0])


def straight_request(*obstacles: Obstacle) -> PlanRequest:
    robot = load_robot("bluerov2_alpha5")
    return PlanRequest(
        robot=robot,
        start=robot.configuration(position=(0.0, -1.0, 0.0)),
        goal=PostureGoal(position=(0.0, 2.5, 0.0)),
        obstacles=obstacles,
    )


def test_a_curve_through_a_wall_is_not_called_free_whatever_the_optimiser_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem_class = soft_collision._PathProblem
    solve = problem_class.solve

    def content(problem: Any, start: np.ndarray, options: Any) -> Any:
        """Says that the straight curve is converged and costs nothing."""
        result = solve(problem, problem.start, options)
        return replace(result, variables=problem.start, converged=True)

    monkeypatch.setattr(problem_class, "solve", content)
    monkeypatch.setattr(soft_collision, "sampled_waypoints", lambda *_: None)
    free = plan_path(straight_request()).plan
    assert free is not None
    assert free.status is PlanStatus.FREE
    through = plan_path(straight_request(WALL)).plan
    assert through is not None
    assert through.status is PlanStatus.COLLIDING
    assert not through.collision_free
