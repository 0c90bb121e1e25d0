"""Is a trajectory free of collision, between the samples too?

Around a time t_m the distance of a pair cannot change by more than ``sum_a reach_a |x_a(t) - x_a(t_m)|``, and the
motion of an axis within delta of t_m is at most ``|v| delta + A delta^2 / 2`` with A a bound on its acceleration.
Intervals in which some pair could touch are halved until it cannot, a collision is found, or they are too short
(conservative advancement).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Protocol

import numpy as np

from uvms_ocp.arguments import Count, Positive, checked
from uvms_ocp.arrays import Array
from uvms_ocp.collision.collision_scene import CollisionScene, Nearest
from uvms_ocp.model.axis_reach import largest_change
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial


class PairDistances(Protocol):
    """Signed distances of all pairs of a scene."""

    @property
    def scene(self) -> CollisionScene:
        """The pairs, and the coordinates x."""
        ...

    def distances(self, x: Array) -> Array:
        """(n, n_pairs) [m] at x (n, n_axes) [m, rad]."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ClearanceReport:
    """What the check found."""

    collision_free: bool
    """No sample collides and no motion between samples can."""
    undecided: bool
    """No collision was found, but intervals too short to halve could not be excluded."""
    nearest: Nearest
    """The smallest distance at any sample; negative in collision."""
    n_samples: int


@checked
def check_clearance(
    distances: PairDistances,
    trajectory: PiecewisePolynomial,
    *,
    per_piece: int = 16,
    shortest: Positive = 1e-5,
    all_collisions: bool = False,
) -> ClearanceReport:
    """Check all pairs of a scene along a trajectory of its coordinates.

    `per_piece` intervals of each piece are checked to begin with; shortest [-] is the share of the duration below which an
    interval is not halved. all_collisions: go on after the first collision, for the true smallest clearance.
    """
    middle, half = _first_intervals(trajectory, per_piece)
    acceleration = _acceleration_bounds(trajectory)
    worst, n_samples, undecided = Nearest(distance=np.inf, time=0.0, pair=""), 0, False
    while middle.size:
        d = distances.distances(trajectory.evaluate(middle))
        n_samples += middle.size
        worst = min(worst, distances.scene.nearest(middle, d), key=lambda near: (near.distance, near.time))
        if worst.distance <= 0.0 and not all_collisions:
            break
        move = _motion_bound(trajectory, middle, half, acceleration)
        open_ = ~(d - largest_change(distances.scene.reach, move) > _TOLERANCE).all(axis=1)
        short = open_ & (half < shortest * trajectory.duration)
        undecided |= bool(short.any())
        middle, half = _halved(middle[open_ & ~short], half[open_ & ~short])
    return ClearanceReport(
        collision_free=worst.distance > 0.0 and not undecided,
        undecided=worst.distance > 0.0 and undecided,
        nearest=worst,
        n_samples=n_samples,
    )


# Separated distances moved by up to 1e-8 m when coal's tolerance was tightened tenfold (865,000 pairs).
_TOLERANCE = 1e-7


@checked
def clearance_along(
    distances: PairDistances, trajectory: PiecewisePolynomial, n_samples: Count = 500
) -> tuple[Array, Array]:
    """Times (n,) [s] and the distance of every pair at them (n, n_pairs) [m], for figures."""
    times = np.linspace(trajectory.start, trajectory.end, n_samples)
    return times, distances.distances(trajectory.evaluate(times))


def _first_intervals(trajectory: PiecewisePolynomial, per_piece: int) -> tuple[Array, Array]:
    offsets = (np.arange(per_piece) + 0.5) / per_piece
    h = trajectory.durations[:, None]
    middle = trajectory.breaks[:-1, None] + offsets * h
    return middle.ravel(), np.broadcast_to(h / (2 * per_piece), middle.shape).ravel()


def _acceleration_bounds(trajectory: PiecewisePolynomial) -> Array:
    """(n_pieces, n_axes): no polynomial exceeds its largest Bernstein coefficient."""
    c = trajectory.derivative(2).coefficients
    n = c.shape[0] - 1
    to_bernstein = np.array([[comb(i, j) / comb(n, j) if j <= i else 0.0 for j in range(n + 1)] for i in range(n + 1)])
    return np.abs(np.tensordot(to_bernstein, c, axes=1)).max(axis=0)


def _motion_bound(trajectory: PiecewisePolynomial, middle: Array, half: Array, acceleration: Array) -> Array:
    piece = np.clip(np.searchsorted(trajectory.breaks, middle, side="right") - 1, 0, trajectory.n_pieces - 1)
    speed = np.abs(trajectory.evaluate(middle, 1))
    return speed * half[:, None] + 0.5 * acceleration[piece] * half[:, None] ** 2


def _halved(middle: Array, half: Array) -> tuple[Array, Array]:
    quarter = half / 2.0
    return np.concatenate([middle - quarter, middle + quarter]), np.concatenate([quarter, quarter])
