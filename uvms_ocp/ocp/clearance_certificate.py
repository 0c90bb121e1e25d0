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

_FIRST_INTERVALS = 2  # intervals of each step that are looked at first
_SAMPLES = 8  # of each step, where nothing is to be proven
# samples of each step for margins; more of them where a distance changes by as much as remains of it
_MARGIN_SAMPLES = (4, 16, 64)

_LINEAR = slice(0, 3)
_ANGULAR = slice(3, 6)


def certificate(term: ShapeClearance, trajectory: Trajectory) -> ClearanceReport:
    """Check whether the pairs of the term's scene stay apart along a trajectory; never where
    obstacles move: their speed is unknown.
    """
    motion = SteppedMotion(term=term, trajectory=trajectory)
    if term.moving:
        return _unproven(motion)
    return check_motion(motion, term.scene)


def _unproven(motion: SteppedMotion) -> ClearanceReport:
    """Return the report of a motion of which only samples are known."""
    nearest = motion.nearest()
    return ClearanceReport(
        collision_free=False,
        undecided=nearest.distance > 0.0,
        nearest=nearest,
        n_samples=_SAMPLES * len(motion.trajectory.a) + 1,
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
        """Robot that moves."""
        return self.term.scene.coordinates.robot

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.trajectory.t[-1])

    def intervals(self) -> tuple[Array, Array]:
        """Return the middle (n,) and half the length (n,) [s] of the intervals that are looked at
        first.
        """
        t = self.trajectory.t
        h = np.diff(t)[:, None]
        middle = t[:-1, None] + (np.arange(_FIRST_INTERVALS) + 0.5) / _FIRST_INTERVALS * h
        half = np.broadcast_to(h / (2 * _FIRST_INTERVALS), middle.shape)
        return middle.ravel(), half.ravel()

    def distances(self, t: Array) -> Array:
        """Return the distances (n, n_pairs) [m] at times t (n,) [s]."""
        return self.term.distances(t.tolist(), self.configurations(t))

    def nearest(self) -> NearestPair:
        """Return the smallest distance of samples at every node and between them."""
        path = self.trajectory
        step = np.arange(_SAMPLES * len(path.a) + 1) / _SAMPLES
        t = np.interp(step, np.arange(len(path.t)), path.t)
        return self.term.scene.nearest(t, self.distances(t))

    def configurations(self, t: Array) -> Array:
        """Return the configurations (n, n_q) [m, rad] at times t (n,) [s]."""
        k, s = self._steps(t)
        path = self.trajectory
        model = self.robot.model
        ways = s * self._v[k] + s * s / 2 * path.a[k]
        configurations = []
        for i, way in zip(k.tolist(), ways, strict=True):
            q = pin.integrate(model, path.q[i], way)
            configurations.append(pin.normalize(model, q))
        return np.array(configurations)

    def bounds(self, middle: Array, half: Array) -> Array:
        """Return by how much (n, n_axes) [m, rad] axes move at most within half (n,) [s] of middle
        (n,) [s].
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
            way = _norm(speed[:, _LINEAR]) * half + _norm(a[:, _LINEAR]) * half**2 / 2
            turn = _norm(speed[:, _ANGULAR]) * half + _norm(a[:, _ANGULAR]) * half**2 / 2
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
        """Return the step of each time, and the time (n, 1) [s] since it began."""
        path = self.trajectory
        k = intervals_of(path.t, t)
        return k, (t - path.t[k])[:, None]


def _norm(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x, axis=1))


def shortfall(term: ShapeClearance, trajectory: Trajectory, t0: float) -> Array:
    """Return by how much (n_nodes, n_pairs) [m] margins are missed in the steps beside each node;
    the first is at t0 [s].

    Steps in which a distance may come near its margin are looked at closely.
    """
    t = trajectory.t
    steps = np.arange(len(trajectory.a))
    n_pairs = len(term.margins)
    motion = SteppedMotion(term=term, trajectory=trajectory)
    of_steps = np.zeros((len(steps), n_pairs))
    for n_samples in _MARGIN_SAMPLES:
        share = np.arange(n_samples) / n_samples
        times = (t[steps, None] + share * np.diff(t)[steps, None]).ravel()
        distances = term.distances((t0 + times).tolist(), motion.configurations(times))
        slack = (distances - term.margins).reshape(-1, n_samples, n_pairs)
        smallest = slack.min(axis=1)
        change = np.abs(np.diff(slack, axis=1)).max(axis=1)
        of_steps[steps] = np.maximum(-smallest, 0.0)
        steps = steps[(smallest < change).any(axis=1)]
        if not len(steps):
            break
    of_step_after = np.pad(of_steps, ((0, 1), (0, 0)))
    of_step_before = np.pad(of_steps, ((1, 0), (0, 0)))
    return np.maximum(of_step_after, of_step_before)
