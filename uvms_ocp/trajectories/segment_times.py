"""Choose the times of way points: trapezoidal guess, scaling to limits, and the optimum of time plus snap.

`[axis]` is the unit of an axis, such as m or rad; derivatives of order d are [axis/s^d].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.trajectories.min_snap import MINIMUM_SNAP, CurveSpecification, MinSnap, checked_waypoints, min_snap
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Array, Count, Finite, Positive, Shape

_LARGEST_WEIGHT = 1e12  # beyond it the optimal durations are lost in rounding


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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
                raise InvalidInput(f"the {name} limit of axis {axis} is {limit.flat[axis]}; it must be positive.")
            limit.flags.writeable = False
            object.__setattr__(self, name, limit)

    def rows(self, n_axes: Count) -> Array:
        """(3, n_axes) [axis/s^d] limits of derivatives d = 1, 2, 3. Raises `InvalidInput` where they are of other shape."""
        given = (np.asarray(self.velocity), np.asarray(self.acceleration), np.asarray(self.jerk))
        for name, limit in zip(("velocity", "acceleration", "jerk"), given, strict=True):
            if limit.shape not in ((), (n_axes,)):
                raise InvalidInput(f"the {name} limit has shape {limit.shape}; allowed is () or ({n_axes},).")
        return np.stack([np.broadcast_to(limit, (n_axes,)) for limit in given])

    def ratio(self, trajectory: PiecewisePolynomial) -> float:
        """Largest ratio of a derivative to its limit; at most 1 when all limits are kept."""
        peaks = np.stack([trajectory.peak(d) for d in (1, 2, 3)])
        return float(np.max(peaks / self.rows(trajectory.n_axes)))


@checked
def trapezoidal_times(waypoints: ArrayLike, limits: MotionLimits) -> Array:
    """(n + 1,) [s] times at which every leg, from rest to rest, lasts as long as its slowest axis needs.

    waypoints (n + 1, n_axes) [axis], (n + 1,) for one axis. An axis needs a trapezoidal velocity profile within its velocity
    and acceleration limits. Raises `InvalidInput` for way points as `checked_waypoints`, and for an axis that moves without
    a finite limit.
    """
    points = checked_waypoints(waypoints)
    velocity, acceleration = limits.rows(points.shape[1])[:2]
    distance = np.abs(np.diff(points, axis=0))
    unlimited = (distance > 0.0).any(axis=0) & np.isinf(velocity) & np.isinf(acceleration)
    if unlimited.any():
        raise InvalidInput(f"axis {int(np.argmax(unlimited))} moves without a finite velocity or acceleration limit.")
    durations = np.max(_trapezoid(distance, velocity, acceleration), axis=1)
    return np.concatenate([[0.0], np.cumsum(durations)])


@checked
def scale_to_limits(trajectory: PiecewisePolynomial, limits: MotionLimits) -> PiecewisePolynomial:
    """The same path as fast as a uniform change of time allows: the largest ratio to a limit becomes 1.

    A trajectory that starts or ends in motion changes its end velocities with it. Raises `InvalidInput`
    where no finite limit concerns an axis that moves.
    """
    peaks = np.stack([trajectory.peak(d) for d in (1, 2, 3)])
    order = np.array([1.0, 2.0, 3.0])[:, None]
    factor = float(np.max((peaks / limits.rows(trajectory.n_axes)) ** (1.0 / order)))
    if factor == 0.0:
        raise InvalidInput("no finite limit concerns an axis that moves; give a limit, or keep the given times.")
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
    """Minimise ``time_weight * total time + cost`` over the durations and all free derivatives together.

    The derivatives are eliminated exactly for each set of durations, whose gradient is then linear in time; what is
    left is a smooth problem in the logarithms of the durations, solved by L-BFGS.

    waypoints (n + 1, n_axes) [axis]; times (n + 1,) [s]: first guess; time_weight [axis^2/s^2k]: k_T, the cost of one second;
    tolerance: largest slope of the cost, as a share of its first value, by the logarithm of a duration. Raises
    `InvalidInput` as ``min_snap``, and for a time weight that is not positive.
    """
    from scipy.optimize import minimize  # half a second, which few need

    if not 0.0 < time_weight <= _LARGEST_WEIGHT:
        raise InvalidInput(f"time_weight is {time_weight}; it must be positive, and at most {_LARGEST_WEIGHT:g}.")
    if not np.size(times):
        raise InvalidInput("times are empty; give one for each way point.")
    start = float(np.asarray(times, dtype=float).flat[0])

    def solution(log_durations: Array) -> MinSnap:
        knots = start + np.concatenate([[0.0], np.cumsum(np.exp(log_durations))])
        return min_snap(waypoints, knots, specification)

    def objective(log_durations: Array) -> tuple[float, Array]:
        found, h = solution(log_durations), np.exp(log_durations)
        value = time_weight * h.sum() + found.cost
        return float(value), (time_weight + found.gradients().durations) * h

    guess = min_snap(waypoints, times, specification)
    stretch = _best_stretch(guess, time_weight, specification.derivative)
    x = np.log(guess.trajectory.durations * stretch)
    scale = objective(x)[0]
    result = minimize(
        lambda y: tuple(part / scale for part in objective(y)),
        x,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": max_iterations, "ftol": 1e-15, "gtol": tolerance, "maxcor": 20},
    )
    return solution(result.x)


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
    return float(((2 * k - 1) * guess.cost / (time_weight * guess.trajectory.duration)) ** (1.0 / (2 * k)))
