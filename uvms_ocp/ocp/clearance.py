"""Clearance of balls and shapes as path constraints, and certificates of what is clear between
nodes.

What moves two bodies alike says nothing of how they are to each other: it is left out of their
poses, and so of the derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.ocp.separating_planes import Planes, Poses, planes
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.ocp.trajectory import Trajectory, intervals_of
from uvms_ocp.planning.conservative_advancement import ClearanceReport, check_motion
from uvms_ocp.planning.distances import CoalDistances, Configurations, Contacts
from uvms_ocp.planning.scene import CollisionScene, NearestPair
from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import links_without_shape
from uvms_ocp.robot.shapes.obstacles import Obstacle, describe_obstacles
from uvms_ocp.robot.symbolic_bodies import SymbolicPose
from uvms_ocp.tasks.goals import VectorReference, evaluate_vector
from uvms_ocp.tasks.task import Residual, TickSymbols, bounded_residual
from uvms_ocp.types import Array, AtLeastOne, Count, Finite, Indices, Magnitude, Mask, Shape

# Clearance between balls, for robots and obstacles that a few of them describe, as rows of an
# optimal control problem.


@checked_dataclass(eq=False)
class Ball:
    """A ball fixed to a frame of the robot or, without a frame, to the world.

    Raises `InvalidInput` for numbers that are not finite, and for a negative radius.
    """

    centre: tuple[Finite, Finite, Finite] | VectorReference = (0.0, 0.0, 0.0)
    """[m] in the frame; of an obstacle also a function of time, ``t -> (position, velocity)``."""
    radius: Magnitude
    """[m]"""
    frame: str | None = None

    def centre_at(self, t: float) -> np.ndarray:
        """(3,) [m] in the frame at time t [s]. Raises `InvalidInput` for a reference that is not
        finite there.
        """
        goal = self.centre if callable(self.centre) else np.array(self.centre, dtype=float)
        centre = evaluate_vector("ball", goal, t)[0]
        if centre.shape != (3,):
            raise InvalidInput(f"ball: centre {centre} at t = {t} s; give three numbers [m]")
        return centre

    def placed(self, symbols: TickSymbols, centre: ca.SX) -> ca.SX:
        """In W (3,) [m], for a centre (3,) [m] in the frame."""
        if self.frame is None:
            return centre
        R, p = symbols.kinematics.pose(self.frame)
        return p + R @ centre


@checked_dataclass(eq=False)
class BallClearance(Term):
    """Every ball of the robot stays `margin` away from every obstacle: one row per pair, signed
    distance [m] >= 0.

    Raises `InvalidInput` for a ball of the robot whose centre moves by itself.
    """

    name = "clearance"
    at: At = At.PATH
    robot_balls: tuple[Ball, ...]
    obstacles: tuple[Ball, ...]
    margin: Finite = 0.05
    """[m]"""

    def __post_init__(self) -> None:
        Term.__post_init__(self)
        if any(callable(ball.centre) for ball in self.robot_balls):
            raise InvalidInput(
                "a ball of the robot has a centre that moves; move its frame, only obstacles move"
                " on their own"
            )

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        pairs = [(ball, i) for ball in self.robot_balls for i in range(len(self.obstacles))]
        places = ca.reshape(parameters, 4, len(self.obstacles))
        gaps = [self._gap(ball, self.obstacles[i], places[:, i], stage.tick) for ball, i in pairs]
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *gaps), lower=0.0)

    def _gap(self, ball: Ball, other: Ball, place: ca.SX, symbols: TickSymbols) -> ca.SX:
        d = ball.placed(symbols, ca.SX(ca.DM(ball.centre_at(0.0)))) - other.placed(
            symbols, place[:3]
        )
        return ca.sqrt(ca.sumsqr(d) + 1e-12) - ball.radius - place[3]

    def n_parameters(self, robot: Robot) -> int:
        return 4 * len(self.obstacles)

    def reference(self, t: float) -> np.ndarray:
        """Centre of every obstacle at time t [s], and its radius with the margin [m]."""
        return np.array(
            [(*ball.centre_at(t), ball.radius + self.margin) for ball in self.obstacles]
        ).ravel()

    def scenery(self, t: float) -> tuple[ObstacleMeta, ...]:
        """Return the balls that are fixed to the world, as they are at time t [s], as spheres;
        radii of 0 have nothing to draw.
        """
        balls = [ball for ball in self.obstacles if ball.frame is None and ball.radius > 0]
        return tuple(
            ObstacleMeta(
                name=name,
                shape="sphere",
                size=(ball.radius,),
                position=tuple(ball.centre_at(t).tolist()),
            )
            for name, ball in zip(
                (f"obstacle {i}" for i in range(1, len(balls) + 1)), balls, strict=True
            )
        )


# Rows that keep a point beyond a plane. A joint that moves both bodies alike does not change their
# distance: it is left out of their poses, and so of the derivatives.

_PLANE = 3 + 3 + 1  # normal, point, offset
_NOTHING_NEAR = -1.0  # [m] offset of a row without a plane


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlaneRowGroup:
    """Rows of one node that serve the same pairs, whichever of them are nearest."""

    pairs: Mask
    """(n_pairs,) True for those."""
    n: int
    """Rows."""
    first: tuple[int, ...]
    """Joints in ascending order of which one carries the plane; 0 is the world."""
    second: tuple[int, ...]
    """Joints in ascending order of which one carries the point."""

    @property
    def size(self) -> int:
        """Parameters of a row: the shares of the joints where there are several, then the plane and
        the point.
        """
        return sum(_n_shares(joints) for joints in (self.second, self.first)) + _PLANE

    @property
    def n_parameters(self) -> int:
        return self.n * self.size

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> list[ca.SX]:
        """Heights of the points over their planes [m], less offsets, for parameters
        (n_parameters,).
        """
        bodies, n = self._bodies(symbols), self.size
        first, second = (_columns(bodies, joints) for joints in (self.first, self.second))
        return [self._height(first, second, parameters[n * i : n * (i + 1)]) for i in range(self.n)]

    def _height(self, first: ca.SX, second: ca.SX, row: ca.SX) -> ca.SX:
        n = _n_shares(self.second)
        normal, centre, offset = ca.vertsplit(row[-_PLANE:], [0, 3, 6, 7])
        plane = _mixed(first, row[n : n + _n_shares(self.first)])
        point = _mixed(second, row[:n])
        return ca.dot(plane.R @ normal, point.p - plane.p + point.R @ centre) - offset

    def _bodies(self, symbols: TickSymbols) -> Sequence[SymbolicPose]:
        """Poses of all joints, relative to the last one that carries all of the group."""
        tree = symbols.kinematics.model
        shared = set.intersection(
            *(set(tree.model.supports[joint]) for joint in (*self.first, *self.second))
        ) - {0}
        if not shared:
            return symbols.kinematics.joint_poses
        local = tree.local_poses(symbols.q)
        return tree.joint_poses(
            [SymbolicPose.identity() if i in shared else pose for i, pose in enumerate(local)]
        )

    def write(self, result: Array, found: Planes, offset: Array) -> None:
        """Into parameters of nothing near, those of planes.

        result (n_samples, n_parameters) [unit of the parameter], offset (n,) [m].
        """
        k = found.sample
        slot = self.size * ranks(found.sample)
        place = slot
        for side, joints in ((1, self.second), (0, self.first)):
            if _n_shares(joints):
                result[k, place + np.searchsorted(joints, found.joints[:, side])] = 1.0
            place = place + _n_shares(joints)
        result[k[:, None], place[:, None] + np.arange(_PLANE)] = np.column_stack(
            [found.normal, found.centre, offset]
        )

    def nothing(self) -> Array:
        """(n_parameters,) of rows that are wide of their bounds."""
        return np.tile(np.r_[np.zeros(self.size - 1), _NOTHING_NEAR], self.n)


def ranks(sample: Indices) -> Indices:
    """(n,) How many rows of its sample are before each; the samples are in their order."""
    return np.arange(len(sample)) - np.searchsorted(sample, sample)


def _n_shares(joints: Sequence[int]) -> int:
    return len(joints) if len(joints) > 1 else 0


def _columns(bodies: Sequence[SymbolicPose], joints: Sequence[int]) -> ca.SX:
    """Rotation and place of each of the joints (12, n) [-, m]."""
    return ca.horzcat(*(ca.vertcat(ca.vec(bodies[joint].R), bodies[joint].p) for joint in joints))


def _mixed(columns: ca.SX, shares: ca.SX) -> SymbolicPose:
    """The pose whose share is one."""
    column = columns @ shares if shares.numel() else columns
    return SymbolicPose(R=ca.reshape(column[:9], 3, 3), p=column[9:])


# Clearance of true shapes, as rows of an optimal control problem.

_BINDING = 5e-3  # [m] beyond the margin within which a row decides

Wider = Annotated[Array, Shape("n", "self.scene.n_pairs")]
Place = Callable[[float], pin.SE3]
"""X_WO at time t [s]."""


@checked_dataclass(slots=False, eq=False)
class ShapeClearance(Term):
    """The pairs of a scene stay apart by their margins: rows of signed distance less margin [m] >=
    0.

    Rows are the planes and points of `uvms_ocp.ocp.separating_planes`, for the nearest pairs of
    every node at the motion that a solve begins with. As a constraint they keep the distances of
    convex shapes, wherever the planes are; in a level the squares of what is missing add up. Raises
    `InvalidInput` for margins of the wrong number or not finite, a scene whose axes are not all
    planned, and `NameNotFound` for the motion of an obstacle that there is not.
    """

    name = "clearance"
    at: At = At.PATH
    scene: CollisionScene
    margins: Array
    """(n_pairs,) [m] of the pairs of the scene."""
    n_rows: AtLeastOne = 10
    """Per node on pairs with what stands in the world."""
    n_own_rows: AtLeastOne = 6
    """Per node on pairs of the robot's own links."""
    n_pair_rows: Count = 0
    """Per node on each of these pairs instead, where it is not 0: simpler rows, for a scene of few
    pairs.
    """
    moving: Mapping[str, Place] = field(default_factory=dict)
    """Places of obstacles that move, by name."""

    def __post_init__(self) -> None:
        Term.__post_init__(self)
        scene = self.scene
        if np.shape(self.margins) != (scene.n_pairs,) or not np.isfinite(self.margins).all():
            given = f"{self.name}: margins {np.shape(self.margins)}"
            raise InvalidInput(
                f"{given}; give one finite number [m] for each of {scene.n_pairs} pairs"
            )
        if scene.coordinates.n_axes != scene.coordinates.robot.n_v:
            raise InvalidInput(
                f"{self.name}: the scene plans {scene.coordinates.names}; give one that plans all"
                " axes"
            )
        names = [item.name for item in scene.geometry.geometryObjects]
        for name in self.moving:
            require_known("moving obstacle", name, names)

    @cached_property
    def _coal(self) -> CoalDistances:
        """With shapes of its own where it moves them."""
        scene = self.scene
        return CoalDistances(
            replace(scene, geometry=pin.GeometryModel(scene.geometry)) if self.moving else scene
        )

    def scenery(self, t: float) -> tuple[ObstacleMeta, ...]:
        """Obstacles that have an end, as they are at time t [s]."""
        shapes = [
            item
            for i, item in enumerate(self.scene.geometry.geometryObjects)
            if self.scene.is_obstacle(i)
        ]
        places = [
            self.moving[item.name](t) if item.name in self.moving else item.placement
            for item in shapes
        ]
        pairs = zip(shapes, places, strict=True)
        return describe_obstacles(
            Obstacle(name=item.name, shape=item.geometry, X_WO=X) for item, X in pairs
        )

    # --- rows -------------------------------------------------------------------------------------

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        ends = np.cumsum([0, *(group.n_parameters for group in self._groups)]).tolist()
        parts = [parameters[first:stop] for first, stop in pairwise(ends)]
        rows = [
            group.rows(stage.tick, part) for group, part in zip(self._groups, parts, strict=True)
        ]
        return bounded_residual(
            ca.vertcat(ca.SX(0, 1), *(row for part in rows for row in part)), lower=0.0
        )

    @cached_property
    def _groups(self) -> tuple[PlaneRowGroup, ...]:
        """Return the row groups: with the world, between links, and of each pair of links."""
        pairs = self.scene.pairs
        carried = np.array(
            [(pair.first_joint, pair.second_joint) for pair in pairs], dtype=int
        ).reshape(-1, 2)
        world = carried[:, 0] == 0
        n = self.n_pair_rows
        groups = [(world, self.n_rows)]
        groups += (
            [(np.arange(len(pairs)) == k, n) for k in np.flatnonzero(~world)]
            if n
            else [(~world, self.n_own_rows)]
        )
        return tuple(_group(carried, chosen, rows) for chosen, rows in groups if chosen.any())

    # --- parameters -------------------------------------------------------------------------------

    def n_parameters(self, robot: Robot) -> int:
        return sum(group.n_parameters for group in self._groups)

    def reference(self, t: float) -> Array:
        """At the configuration in which the coordinates of the scene stay, at time t [s]."""
        coordinates = self.scene.coordinates
        return self.references([t], coordinates.configurations(coordinates.reference[None]))[0]

    def references(
        self, times: Sequence[float], q: Configurations, tightened: Wider | None = None
    ) -> Array:
        """At times (n,) [s] and configurations q (n, n_q) [m, rad], with margins wider by tightened
        (n, n_pairs) [m].
        """
        margins = self._margins(len(q), tightened)
        parts = []
        for group, found in zip(self._groups, self._chosen(times, q, margins), strict=True):
            parts.append(np.tile(group.nothing(), (len(q), 1)))
            group.write(parts[-1], found, found.offset + margins[found.sample, found.pair])
        return np.concatenate([np.zeros((len(q), 0)), *parts], axis=1)

    def mismatch(self, times: Sequence[float], written: Configurations, q: Configurations) -> float:
        """[m] By how much rows that decide at q (n, n_q) [m, rad], written at configurations
        written (n, n_q) [m, rad], are off.

        times (n,) [s].
        """
        poses = Poses.of(self.scene.coordinates.robot.model, q)
        true = self.distances(times, q)
        least = np.full(true.shape, np.inf)
        for found in self._chosen(times, written, self._margins(len(q), None)):
            np.minimum.at(least, (found.sample, found.pair), found.heights(poses))
        return float(np.abs(least - true)[least - self.margins < _BINDING].max(initial=0.0))

    def _margins(self, n: int, tightened: Array | None) -> Array:
        """(n, n_pairs) [m]"""
        return np.broadcast_to(
            self.margins if tightened is None else self.margins + tightened, (n, self.scene.n_pairs)
        )

    def _chosen(self, times: Sequence[float], q: Array, margins: Array) -> list[Planes]:
        """Choose in every group as many as there is room for at configurations q (n, n_q): the ones
        least beyond their margins.
        """
        contacts = self._contacts(times, q)
        poses = Poses.of(self.scene.coordinates.robot.model, q)
        found = planes(self.scene, contacts, poses)
        beyond = found.heights(poses) - margins[found.sample, found.pair]
        kept = []
        for group in self._groups:
            rows = np.flatnonzero(group.pairs[found.pair])
            order = rows[np.lexsort((beyond[rows], found.sample[rows]))]
            kept.append(found.of(order[ranks(found.sample[order]) < group.n]))
        return kept

    # --- distances --------------------------------------------------------------------------------

    def distances(self, times: Sequence[float], q: Configurations) -> Array:
        """(n, n_pairs) [m] of all pairs at times (n,) [s] and configurations q (n, n_q) [m, rad],
        by coal.
        """
        if not self.moving:
            return self._coal.distances_at(q)
        return np.concatenate(
            [self._placed(t).distances_at(row[None]) for t, row in zip(times, q, strict=True)]
        )

    def _contacts(self, times: Sequence[float], q: Array) -> Contacts:
        if not self.moving:
            return self._coal.contacts(q)
        found = [self._placed(t).contacts(row[None]) for t, row in zip(times, q, strict=True)]
        sample = np.repeat(np.arange(len(q)), [len(one.sample) for one in found])
        names = ("pair", "distance", "normal", "first", "second")
        return Contacts(
            sample=sample,
            **{name: np.concatenate([getattr(one, name) for one in found]) for name in names},
        )

    def _placed(self, t: float) -> CoalDistances:
        for item in self._coal.scene.geometry.geometryObjects:
            if item.name in self.moving:
                item.placement = self.moving[item.name](t)
        return self._coal


def _group(carried: Indices, chosen: Mask, n: int) -> PlaneRowGroup:
    """Return the row group of the chosen of pairs (n_pairs, 2) of joints."""
    first, second = (tuple(np.unique(carried[chosen, side]).tolist()) for side in (0, 1))
    return PlaneRowGroup(pairs=chosen, n=n, first=first, second=second)


# Certify that the motion of a plan is free of collision between its nodes too, by its own
# interpolation.
#
# Over a step the configuration is ``q_k (+) Omega(s)`` with ``Omega = s v + s^2/2 a``, where v is
# the velocity of the node but for what integrators other than MIDPOINT make of it: a step ends at
# the next node, or nothing would be known of the jump. A joint moves as fast as Omega' says. The
# vehicle turns no faster than ``|Omega'_w|``, and its origin ``p_k + R_k int_0^1 exp(u Omega_w) du
# Omega_v`` moves no faster than ``|Omega'_v| + |Omega'_w| |Omega_v| / 2``: the bounds that
# conservative advancement needs.

_PER_STEP = 2  # intervals that are looked at first
_LOOKS = 8  # at each step, where nothing is to be proven
_CLOSER = (
    4,
    16,
    64,
)  # looks at each step for margins; more of them where a distance changes by as much as is left of it


@checked
def certificate(term: ShapeClearance, trajectory: Trajectory) -> ClearanceReport:
    """Check whether the pairs of the term's scene stay apart along a trajectory; never where
    obstacles move: their speed is unknown.
    """
    motion = SteppedMotion(term=term, trajectory=trajectory)
    return _unproven(motion) if term.moving else check_motion(motion, term.scene)


def _unproven(motion: SteppedMotion) -> ClearanceReport:
    nearest = motion.nearest()
    return ClearanceReport(
        collision_free=False,
        undecided=nearest.distance > 0.0,
        nearest=nearest,
        n_samples=_LOOKS * len(motion.trajectory.a) + 1,
        unshaped=links_without_shape(motion.term.scene.coordinates.robot),
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
            result[:, 0], result[:, 3] = way + turn * farthest / 2, turn
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


_PARTS = (slice(0, 3), slice(3, 6))


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
