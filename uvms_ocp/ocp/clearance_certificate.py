"""Certify that the motion of a plan is free of collision between its nodes too, by its own
interpolation.

Over a step the configuration is ``q_k (+) Omega(s)`` with ``Omega = s v + s^2/2 a``, where v is the
velocity of the node but for what integrators other than MIDPOINT make of it: a step ends at the
next node, or nothing would be known of the jump. A joint moves as fast as Omega' says. The vehicle
turns no faster than ``|Omega'_w|``, and its origin ``p_k + R_k int_0^1 exp(u Omega_w) du Omega_v``
moves no faster than ``|Omega'_v| + |Omega'_w| |Omega_v| / 2``: the bounds that conservative
advancement needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.trajectory import Trajectory, intervals_of
from uvms_ocp.planning.conservative_advancement import ClearanceReport, check_motion
from uvms_ocp.planning.scene import NearestPair
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.shape_pairs import links_without_shape
from uvms_ocp.robot.shapes.signed_distance import open_surfaces
from uvms_ocp.types import Array, Indices

_PER_STEP = 2  # intervals that are looked at first
_LOOKS = 8  # at each step, where nothing is to be proven
_CLOSER = (
    4,
    16,
    64,
)  # looks at each step for margins; more of them where a distance changes by as much as is left of it

_PARTS = (slice(0, 3), slice(3, 6))


def certificate(term: ShapeClearance, trajectory: Trajectory) -> ClearanceReport:
    """Check whether the pairs of the term's scene stay apart along a trajectory; never where
    obstacles move: their speed is unknown.
    """
    motion = SteppedMotion(term=term, trajectory=trajectory)
    if term.moving:
        return _unproven(motion)
    return check_motion(motion, term.scene)


def _unproven(motion: SteppedMotion) -> ClearanceReport:
    nearest = motion.nearest()
    return ClearanceReport(
        collision_free=False,
        undecided=nearest.distance > 0.0,
        nearest=nearest,
        n_samples=_LOOKS * len(motion.trajectory.a) + 1,
        unshaped=links_without_shape(motion.term.scene.coordinates.robot),
        surfaces=open_surfaces(motion.term.scene.geometry),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SteppedMotion:
    """A trajectory of constant accelerations as a `Motion` of the axes of a scene.

    Its bound on a vehicle stands in the columns of x and roll: a way in whatever direction reaches
    no farther.
    """

    term: ShapeClearance
    trajectory: Trajectory

    @property
    def robot(self) -> Robot:
        return self.term.scene.coordinates.robot

    @property
    def duration(self) -> float:
        return float(self.trajectory.t[-1])

    def intervals(self) -> tuple[Array, Array]:
        t = self.trajectory.t
        h = np.diff(t)[:, None]
        middle = t[:-1, None] + (np.arange(_PER_STEP) + 0.5) / _PER_STEP * h
        return middle.ravel(), np.broadcast_to(h / (2 * _PER_STEP), middle.shape).ravel()

    def distances(self, t: Array) -> Array:
        """(n, n_pairs) [m] at times t (n,) [s]."""
        return self.term.distances(t.tolist(), self.configurations(t))

    def nearest(self) -> NearestPair:
        """The least distance that is met, looked for at every node and between them."""
        path = self.trajectory
        t = np.interp(np.arange(_LOOKS * len(path.a) + 1) / _LOOKS, np.arange(len(path.t)), path.t)
        return self.term.scene.nearest(t, self.distances(t))

    def configurations(self, t: Array) -> Array:
        """(n, n_q) [m, rad] at times t (n,) [s]."""
        k, s = self._steps(t)
        path = self.trajectory
        model = self.robot.model
        moved = s * self._v[k] + s * s / 2 * path.a[k]
        q = [
            pin.integrate(model, path.q[i], step) for i, step in zip(k.tolist(), moved, strict=True)
        ]
        return np.array([pin.normalize(model, row) for row in q])

    def bounds(self, middle: Array, half: Array) -> Array:
        """(n, n_axes) [m, rad] by which axes move at most within half (n,) [s] of middle (n,)
        [s].
        """
        k, s = self._steps(middle)
        path = self.trajectory
        v = self._v
        n = min(self.robot.n_vehicle, 6)
        delta = half[:, None]
        speed = v[k] + s * path.a[k]
        a = path.a[k]
        result = np.abs(speed) * delta + np.abs(a) * delta**2 / 2
        if n:
            way, turn = (
                _norm(speed[:, part]) * half + _norm(a[:, part]) * half**2 / 2 for part in _PARTS
            )
            h = np.diff(path.t)[k]
            farthest = _norm(v[k, :3]) * h + _norm(a[:, :3]) * h**2 / 2
            result[:, :n] = 0.0
            result[:, 0] = way + turn * farthest / 2
            result[:, 3] = turn
        return result

    @cached_property
    def _v(self) -> Array:
        """(N, n_v) [m/s, rad/s] at the beginning of every step, with which it ends at the next
        node.
        """
        path = self.trajectory
        model = self.robot.model
        return np.array([path.leaving(model, k) for k in range(len(path.a))])

    def _steps(self, t: Array) -> tuple[Indices, Array]:
        """The step of each time, and the time (n, 1) [s] since it began."""
        path = self.trajectory
        k = intervals_of(path.t, t)
        return k, (t - path.t[k])[:, None]


def _norm(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x, axis=1))


def shortfall(term: ShapeClearance, trajectory: Trajectory, t0: float) -> Array:
    """(n_nodes, n_pairs) [m] By how much margins are missed in the steps beside each node; the
    first is at t0 [s].

    Steps in which a distance may come near its margin are looked at closely.
    """
    t = trajectory.t
    steps = np.arange(len(trajectory.a))
    n_pairs = len(term.margins)
    motion = SteppedMotion(term=term, trajectory=trajectory)
    of_steps = np.zeros((len(steps), n_pairs))
    for looks in _CLOSER:
        at = (t[steps, None] + np.arange(looks) / looks * np.diff(t)[steps, None]).ravel()
        left = (
            term.distances((t0 + at).tolist(), motion.configurations(at)) - term.margins
        ).reshape(-1, looks, n_pairs)
        least = left.min(axis=1)
        change = np.abs(np.diff(left, axis=1)).max(axis=1)
        of_steps[steps] = np.maximum(-least, 0.0)
        if not len(steps := steps[(least < change).any(axis=1)]):
            break
    return np.maximum(np.pad(of_steps, ((0, 1), (0, 0))), np.pad(of_steps, ((1, 0), (0, 0))))
