"""Prove that a trajectory is free of collision, between its samples too, by conservative
advancement.

Around a time t_m the distance of a pair cannot change by more than
``sum_a reach_a |x_a(t) - x_a(t_m)|``, and the motion of an axis within delta of t_m is at most
``|v| delta + A delta^2 / 2`` with A a bound on its acceleration. Intervals in which some pair could
touch are halved until it cannot, a collision is found, or they are too short (conservative
advancement).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Protocol

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.planning.scene import CollisionScene, NearestPair
from uvms_ocp.robot.kinematics import largest_change
from uvms_ocp.robot.shapes.shape_pairs import links_without_shape
from uvms_ocp.robot.shapes.signed_distance import open_surfaces
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Array, Count, Positive

# [m] Error of distances by coal. Separated ones moved by up to 1e-8 m when its tolerance was
# tightened tenfold (865,000 pairs).
_DISTANCE_ERROR = 1e-7


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
    """Result of the check."""

    collision_free: bool
    """No sample collides and no motion between samples can."""
    undecided: bool
    """No collision was found, but intervals too short to halve could not be excluded."""
    nearest: NearestPair
    """The smallest distance at any sample; negative in collision."""
    n_samples: int
    unshaped: tuple[str, ...] = ()
    """Links with a mass but no collision shape: nothing of this holds for them."""
    surfaces: tuple[str, ...] = ()
    """Shapes that are open meshes: of what is behind them nothing is told."""


@checked
def check_clearance(
    distances: PairDistances,
    trajectory: PiecewisePolynomial,
    *,
    per_piece: int = 16,
    shortest: Positive = 1e-5,
) -> ClearanceReport:
    """Check all pairs of a scene along a trajectory of its coordinates, until the first collision.

    `per_piece` intervals of each piece are checked to begin with; shortest is the share of the
    duration below which an interval is not halved.
    """
    c = trajectory.derivative(2).coefficients
    n = c.shape[0] - 1
    to_bernstein = np.array(
        [[comb(i, j) / comb(n, j) if j <= i else 0.0 for j in range(n + 1)] for i in range(n + 1)]
    )
    bound = np.abs(np.tensordot(to_bernstein, c, axes=1)).max(axis=0)
    curve = _Curve(
        trajectory=trajectory, measure=distances, per_piece=per_piece, acceleration=bound
    )
    return check_motion(curve, distances.scene, shortest=shortest)


class BoundedMotion(Protocol):
    """A motion of whatever interpolation, whose distances are measured and whose axes move by
    bounded ways.
    """

    @property
    def duration(self) -> float:
        """[s]"""
        ...

    def intervals(self) -> tuple[Array, Array]:
        """Middle and half length (n,) [s] of the intervals that are looked at first; they cover all
        of it.
        """
        ...

    def distances(self, t: Array) -> Array:
        """(n, n_pairs) [m] at times t (n,) [s]."""
        ...

    def bounds(self, middle: Array, half: Array) -> Array:
        """(n, n_axes) [m, rad] by which axes move at most within `half` (n,) [s] of `middle` (n,)
        [s].
        """
        ...


def check_motion(
    motion: BoundedMotion, scene: CollisionScene, *, shortest: float = 1e-5
) -> ClearanceReport:
    """Check all pairs of a scene along a motion; see `check_clearance` for shortest."""
    middle, half = motion.intervals()
    worst = NearestPair(distance=np.inf, time=0.0, pair="")
    n_samples = 0
    undecided = False
    while middle.size:
        d = motion.distances(middle)
        n_samples += middle.size
        worst = min(worst, scene.nearest(middle, d), key=lambda pair: (pair.distance, pair.time))
        if worst.distance <= 0.0:
            break
        open_ = ~(
            d - largest_change(scene.reach, motion.bounds(middle, half)) > _DISTANCE_ERROR
        ).all(axis=1)
        short = open_ & (half < shortest * motion.duration)
        undecided |= bool(short.any())
        middle = middle[open_ & ~short]
        half = half[open_ & ~short] / 2.0
        middle = np.concatenate([middle - half, middle + half])
        half = np.concatenate([half, half])
    return ClearanceReport(
        collision_free=worst.distance > 0.0 and not undecided,
        undecided=worst.distance > 0.0 and undecided,
        nearest=worst,
        n_samples=n_samples,
        unshaped=links_without_shape(scene.coordinates.robot),
        surfaces=open_surfaces(scene.geometry),
    )


@checked
def clearance_along(
    distances: PairDistances, trajectory: PiecewisePolynomial, n_samples: Count = 500
) -> tuple[Array, Array]:
    """Times (n,) [s] and the distance of every pair at them (n, n_pairs) [m], for figures."""
    times = np.linspace(trajectory.start, trajectory.end, n_samples)
    return times, distances.distances(trajectory.evaluate(times))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Curve:
    """A trajectory of the scene's coordinates, as a `BoundedMotion`."""

    trajectory: PiecewisePolynomial
    measure: PairDistances
    per_piece: int
    acceleration: Array
    """(n_pieces, n_axes) [m/s2, rad/s2]"""

    @property
    def duration(self) -> float:
        return self.trajectory.duration

    def intervals(self) -> tuple[Array, Array]:
        offsets = (np.arange(self.per_piece) + 0.5) / self.per_piece
        h = self.trajectory.durations[:, None]
        middle = self.trajectory.breaks[:-1, None] + offsets * h
        return middle.ravel(), np.broadcast_to(h / (2 * self.per_piece), middle.shape).ravel()

    def distances(self, t: Array) -> Array:
        return self.measure.distances(self.trajectory.evaluate(t))

    def bounds(self, middle: Array, half: Array) -> Array:
        breaks = self.trajectory.breaks
        last = self.trajectory.n_pieces - 1
        piece = np.clip(np.searchsorted(breaks, middle, side="right") - 1, 0, last)
        return (
            np.abs(self.trajectory.evaluate(middle, 1)) * half[:, None]
            + 0.5 * self.acceleration[piece] * half[:, None] ** 2
        )
