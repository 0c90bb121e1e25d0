"""Laws of the times of way points."""

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.trajectories import min_snap
from uvms_ocp.trajectories.curve_conditions import MINIMUM_SNAP, CurveSpecification
from uvms_ocp.trajectories.segment_times import (
    MotionLimits,
    optimal_times,
    scale_to_limits,
    trapezoidal_times,
)

LIMITS = MotionLimits(velocity=0.8, acceleration=2.0)


def random_waypoints(n: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n + 1, 7))


def test_a_trapezoid_cruises_and_a_triangle_does_not() -> None:
    long = trapezoidal_times([0.0, 8.0], LIMITS)
    short = trapezoidal_times([0.0, 0.02], LIMITS)
    assert long[1] == pytest.approx(8.0 / 0.8 + 0.8 / 2.0)
    assert short[1] == pytest.approx(2.0 * np.sqrt(0.02 / 2.0))


@pytest.mark.parametrize(
    "limits", [LIMITS, MotionLimits(jerk=0.5), MotionLimits(velocity=np.linspace(0.1, 1, 7))]
)
@pytest.mark.parametrize("n", [1, 20])
def test_scaling_makes_the_largest_ratio_exactly_one(n: int, limits: MotionLimits) -> None:
    waypoints = random_waypoints(n)
    scaled = scale_to_limits(min_snap(waypoints, np.arange(n + 1.0)).trajectory, limits)
    assert limits.ratio(scaled) == pytest.approx(1.0, abs=1e-9)
    t = np.linspace(scaled.start, scaled.end, 20001)
    sampled_ratio = max(
        np.max(np.abs(scaled.evaluate(t, d)) / limits.rows(7)[d - 1]) for d in (1, 2, 3)
    )
    assert 0.99 < sampled_ratio <= 1.0 + 1e-6


@pytest.mark.parametrize("n", [1, 5, 40])
def test_at_optimal_times_the_cost_of_time_is_seven_times_the_snap(n: int) -> None:
    waypoints = random_waypoints(n)
    optimum = optimal_times(waypoints, trapezoidal_times(waypoints, LIMITS), time_weight=10.0)
    assert 10.0 * optimum.trajectory.duration == pytest.approx(7.0 * optimum.cost, rel=1e-5)
    np.testing.assert_allclose(optimum.gradients().durations, -10.0, rtol=1e-4)


def test_optimal_times_beat_the_guess_at_any_uniform_speed() -> None:
    waypoints = random_waypoints(10)
    guess = trapezoidal_times(waypoints, LIMITS)
    best = optimal_times(waypoints, guess, time_weight=1.0)
    for stretch in np.geomspace(0.2, 5.0, 20):
        stretched = min_snap(waypoints, guess * stretch)
        assert (
            best.trajectory.duration + best.cost <= stretched.trajectory.duration + stretched.cost
        )


def test_times_and_a_free_way_point_are_best_together() -> None:
    waypoints = random_waypoints(4)
    guess = trapezoidal_times(waypoints, LIMITS)
    free = CurveSpecification(free_positions=(2,))
    through, past = (
        optimal_times(waypoints, guess, specification, time_weight=1.0)
        for specification in (MINIMUM_SNAP, free)
    )
    np.testing.assert_allclose(past.gradients().durations, -1.0, rtol=1e-4)
    np.testing.assert_allclose(past.gradients().waypoints[2], 0.0, atol=1e-6)
    assert past.trajectory.duration + past.cost < through.trajectory.duration + through.cost


def test_bad_limits_are_refused_with_the_offending_axis() -> None:
    with pytest.raises(InvalidInput, match="velocity limit of axis 1 is 0"):
        MotionLimits(velocity=[1.0, 0.0])
    with pytest.raises(InvalidInput, match="jerk limit of axis 0 is nan"):
        MotionLimits(jerk=np.nan)
    with pytest.raises(InvalidInput, match="axis 0 moves without"):
        trapezoidal_times([0.0, 1.0], MotionLimits(jerk=1.0))
    with pytest.raises(InvalidInput, match="equal"):
        trapezoidal_times([1.0, 1.0], LIMITS)
    with pytest.raises(InvalidInput, match="no finite limit"):
        scale_to_limits(min_snap([0.0, 1.0], [0.0, 1.0]).trajectory, MotionLimits())
    with pytest.raises(InvalidInput, match="allowed is"):
        trapezoidal_times([0.0, 1.0], MotionLimits(velocity=[1.0, 1.0]))
    with pytest.raises(InvalidInput, match="time_weight"):
        optimal_times([0.0, 1.0], [0.0, 1.0], time_weight=0.0)
