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

_DISTANCE_ERROR = 1e-7
"""[m] Error of distances by coal. Those of shapes apart moved by up to 1e-8 m when its tolerance was
tightened tenfold (865,000 pairs).
"""
_SHORTEST = 1e-5
"""Share of the duration below which an interval is not halved."""


class PairDistances(Protocol):
    """Signed distances of all pairs of a scene."""

    @property
    def scene(self) -> CollisionScene:
        """The pairs, and the coordinates x."""
        ...

    def distances(self, x: Array) -> Array:
        """Return the distances (n, n_pairs) [m] at x (n, n_axes) [m, rad]."""
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
    """Times at which distances were measured."""
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
    shortest: Positive = _SHORTEST,
) -> ClearanceReport:
    """Check all pairs of a scene along a trajectory of its coordinates, until the first collision.

    `per_piece` intervals of each piece are checked to begin with; shortest is the share of the
    duration below which an interval is not halved.
    """
    curve = _Curve(
        trajectory=trajectory,
        measure=distances,
        per_piece=per_piece,
        acceleration=_acceleration_bounds(trajectory),
    )
    return check_motion(curve, distances.scene, shortest=shortest)


def _acceleration_bounds(trajectory: PiecewisePolynomial) -> Array:
    """Bound |acceleration| (n_pieces, n_axes) [m/s2, rad/s2]: a polynomial is within its Bernstein
    coefficients.
    """
    coefficients = trajectory.derivative(2).coefficients
    degree = coefficients.shape[0] - 1
    to_bernstein = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        for j in range(i + 1):
            to_bernstein[i, j] = comb(i, j) / comb(degree, j)
    return np.asarray(np.abs(np.tensordot(to_bernstein, coefficients, axes=1)).max(axis=0))


class BoundedMotion(Protocol):
    """A motion of whatever interpolation, whose distances are measured and whose axes move by
    bounded ways.
    """

    @property
    def duration(self) -> float:
        """[s]"""
        ...

    def intervals(self) -> tuple[Array, Array]:
        """Return middle and half length (n,) [s] of the first intervals; they cover all of it."""
        ...

    def distances(self, t: Array) -> Array:
        """Return the distances (n, n_pairs) [m] at times t (n,) [s]."""
        ...

    def bounds(self, middle: Array, half: Array) -> Array:
        """Return by how much (n, n_axes) [m, rad] axes move at most within `half` (n,) [s] of
        `middle` (n,) [s].
        """
        ...


def check_motion(
    motion: BoundedMotion, scene: CollisionScene, *, shortest: float = _SHORTEST
) -> ClearanceReport:
    """Check all pairs of a scene along a motion, until the first collision.

    shortest: share of the duration below which an interval is not halved.
    """
    middle, half = motion.intervals()
    nearest = NearestPair(distance=np.inf, time=0.0, pair="")
    n_samples = 0
    has_undecided = False
    while middle.size:
        distances = motion.distances(middle)
        n_samples += middle.size
        candidate = scene.nearest(middle, distances)
        nearest = min(nearest, candidate, key=lambda pair: (pair.distance, pair.time))
        if nearest.distance <= 0.0:
            break
        smallest = distances - largest_change(scene.reach, motion.bounds(middle, half))
        is_clear = (smallest > _DISTANCE_ERROR).all(axis=1)
        is_short = half < shortest * motion.duration
        has_undecided |= bool((~is_clear & is_short).any())
        is_halved = ~is_clear & ~is_short
        half = half[is_halved] / 2.0
        middle = np.concatenate([middle[is_halved] - half, middle[is_halved] + half])
        half = np.concatenate([half, half])
    no_sample_collides = nearest.distance > 0.0
    return ClearanceReport(
        collision_free=no_sample_collides and not has_undecided,
        undecided=no_sample_collides and has_undecided,
        nearest=nearest,
        n_samples=n_samples,
        unshaped=links_without_shape(scene.coordinates.robot),
        surfaces=open_surfaces(scene.geometry),
    )


@checked
def clearance_along(
    distances: PairDistances, trajectory: PiecewisePolynomial, n_samples: Count = 500
) -> tuple[Array, Array]:
    """Return times (n,) [s] and the distance of every pair at them (n, n_pairs) [m], for figures."""
    times = np.linspace(trajectory.start, trajectory.end, n_samples)
    return times, distances.distances(trajectory.evaluate(times))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Curve:
    """A trajectory of the scene's coordinates, as a `BoundedMotion`."""

    trajectory: PiecewisePolynomial
    measure: PairDistances
    per_piece: int
    """Intervals of each piece that are looked at first."""
    acceleration: Array
    """(n_pieces, n_axes) [m/s2, rad/s2] upper bounds of |acceleration|."""

    @property
    def duration(self) -> float:
        return self.trajectory.duration

    def intervals(self) -> tuple[Array, Array]:
        offsets = (np.arange(self.per_piece) + 0.5) / self.per_piece
        durations = self.trajectory.durations[:, None]
        middle = self.trajectory.breaks[:-1, None] + offsets * durations
        half = np.broadcast_to(durations / (2 * self.per_piece), middle.shape)
        return middle.ravel(), half.ravel()

    def distances(self, t: Array) -> Array:
        return self.measure.distances(self.trajectory.evaluate(t))

    def bounds(self, middle: Array, half: Array) -> Array:
        breaks = self.trajectory.breaks
        last = self.trajectory.n_pieces - 1
        piece = np.clip(np.searchsorted(breaks, middle, side="right") - 1, 0, last)
        speed = np.abs(self.trajectory.evaluate(middle, 1))
        by_speed = speed * half[:, None]
        by_acceleration = 0.5 * self.acceleration[piece] * half[:, None] ** 2
        return by_speed + by_acceleration
