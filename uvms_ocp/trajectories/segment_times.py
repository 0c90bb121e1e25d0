"""Times of way points: a trapezoidal guess, scaling to limits, and the optimum of time plus snap.

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.trajectories.curve_conditions import (
    MINIMUM_SNAP,
    CurveSpecification,
    checked_waypoints,
)
from uvms_ocp.trajectories.min_snap import MinSnap, least_curve, min_snap
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Array, Count, Finite, Positive, Shape

_STATIONARY = 1e-4  # largest slope of the cost, relative, by the logarithm of a duration
_LARGEST_WEIGHT = 1e12  # beyond it the optimal durations are lost in rounding


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
        """Return (3, n_axes) [axis/s^d] limits of derivatives d = 1, 2, 3. Raises `InvalidInput`
        where they are of other shape.
        """
        rows = []
        for name in ("velocity", "acceleration", "jerk"):
            limit = np.asarray(getattr(self, name))
            if limit.shape not in ((), (n_axes,)):
                raise InvalidInput(
                    f"the {name} limit has shape {limit.shape}; allowed is () or ({n_axes},)."
                )
            rows.append(np.broadcast_to(limit, (n_axes,)))
        return np.stack(rows)

    def ratios(self, trajectory: PiecewisePolynomial) -> Array:
        """Return (3, n_axes) peaks of derivatives d = 1, 2, 3 as shares of their limits."""
        peaks = np.stack([trajectory.peak(d) for d in (1, 2, 3)])
        return peaks / self.rows(trajectory.n_axes)

    def ratio(self, trajectory: PiecewisePolynomial) -> float:
        """Return the largest ratio of a derivative to its limit; at most 1 when all limits are
        kept.
        """
        return float(np.max(self.ratios(trajectory)))


@checked
def trapezoidal_times(waypoints: ArrayLike, limits: MotionLimits) -> Array:
    """Return (n + 1,) [s] times at which every leg, from rest to rest, lasts as long as its slowest
    axis needs.

    waypoints (n + 1, n_axes) [axis], (n + 1,) for one axis. An axis needs a trapezoidal velocity
    profile within its velocity and acceleration limits. Raises `InvalidInput` for way points as
    `checked_waypoints`, and for an axis that moves without a finite limit.
    """
    points = checked_waypoints(waypoints)
    velocity, acceleration, _ = limits.rows(points.shape[1])
    distance = np.abs(np.diff(points, axis=0))
    is_unlimited = np.isinf(velocity) & np.isinf(acceleration)
    unlimited = (distance > 0.0).any(axis=0) & is_unlimited
    if unlimited.any():
        raise InvalidInput(
            f"axis {int(np.argmax(unlimited))} moves without a finite velocity or acceleration"
            " limit."
        )
    durations = np.max(_trapezoid_time(distance, velocity, acceleration), axis=1)
    return np.concatenate([[0.0], np.cumsum(durations)])


def _trapezoid_time(distance: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the time [s] from rest to rest over a distance; below v^2/a the profile is a triangle.

    distance (n, n_axes) [axis]; velocity (n_axes,) [axis/s]; acceleration (n_axes,) [axis/s2].
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        ramp = np.where(np.isinf(acceleration), 0.0, velocity / acceleration)
        cruise = np.where(np.isinf(velocity), np.inf, distance / velocity + ramp)
        triangle = np.where(np.isinf(acceleration), 0.0, 2.0 * np.sqrt(distance / acceleration))
        return np.where(distance >= velocity * ramp, cruise, triangle)


@checked
def scale_to_limits(trajectory: PiecewisePolynomial, limits: MotionLimits) -> PiecewisePolynomial:
    """Return the path as fast as a uniform change of time allows: the largest ratio to a limit
    becomes 1.

    A trajectory that starts or ends in motion changes its end velocities with it. Raises
    `InvalidInput` where no finite limit concerns an axis that moves.
    """
    orders = np.array([1.0, 2.0, 3.0])[:, None]  # a derivative of order d falls with factor^d
    factor = float(np.max(limits.ratios(trajectory) ** (1.0 / orders)))
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
        curve, _, _ = least_curve(waypoints, knots(log_durations), specification)
        durations = np.exp(log_durations)
        cost = float(time_weight * durations.sum() + curve.cost)
        slopes_by_duration = time_weight + curve.gradients().durations
        return cost, slopes_by_duration * durations

    guess = min_snap(waypoints, times, specification)
    stretch = _best_stretch(guess, time_weight, specification.derivative)
    log_guess = np.log(guess.trajectory.durations * stretch)
    first_cost, _ = objective(log_guess)

    def relative_objective(log_durations: Array) -> tuple[float, Array]:
        cost, slopes = objective(log_durations)
        return cost / first_cost, slopes / first_cost

    result = minimize(
        relative_objective,
        log_guess,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": max_iterations, "ftol": 1e-15, "gtol": tolerance, "maxcor": 20},
    )
    cost, slopes = objective(result.x)
    largest_slope = np.abs(slopes).max()
    if not largest_slope <= _STATIONARY * cost:
        raise InvalidInput(
            f"after {result.nit} iterations one of the durations still changes the cost by"
            f" {largest_slope / cost:.2g} of it; raise max_iterations, or give other times."
        )
    return min_snap(waypoints, knots(result.x), specification)


def _best_stretch(guess: MinSnap, time_weight: float, k: int) -> float:
    """Return the uniform stretch that is optimal from rest to rest, where k_T T = (2k - 1) cost."""
    if guess.cost == 0.0:
        return 1.0
    cost_of_time = time_weight * guess.trajectory.duration
    return float(((2 * k - 1) * guess.cost / cost_of_time) ** (1.0 / (2 * k)))
