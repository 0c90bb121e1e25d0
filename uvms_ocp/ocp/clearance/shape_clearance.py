"""Clearance of true shapes, as rows of an optimal control problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import AtLeastOne, Shape, checked
from uvms_ocp.arrays import Array, Indices, Mask
from uvms_ocp.collision.coal_distances import CoalDistances, Configurations, Contacts
from uvms_ocp.collision.collision_scene import CollisionScene
from uvms_ocp.collision.obstacle_file import describe_obstacle
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.obstacles import Obstacle
from uvms_ocp.model.symbolic.bodies import Pose
from uvms_ocp.obstacle_data import ObstacleData
from uvms_ocp.ocp.clearance.planes import Planes, Poses, planes
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.tasks.task import Residual, bounded_residual

_N_PLANE = 3 + 3 + 1  # normal, point, offset
_NOTHING_NEAR = -1.0  # [m] offset of a row without a plane
_BINDING = 5e-3  # [m] beyond the margin within which a row decides

Wider = Annotated[Array, Shape("n", "self.scene.n_pairs")]
Place = Callable[[float], pin.SE3]
"""X_WO at time t [s]."""


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class ShapeClearance(Term):
    """The pairs of a scene stay apart by their margins: rows of signed distance less margin [m] >= 0.

    Rows are the planes and points of `uvms_ocp.ocp.clearance.planes`, for the nearest pairs of every node at the motion that a
    solve begins with. As a constraint they keep the distances of convex shapes, wherever the planes are; in a level the
    squares of what is missing add up. Raises `InvalidInput` for margins of the wrong number or not finite, a scene whose
    axes are not all planned, and `NameNotFound` for the motion of an obstacle that there is not.
    """

    follows_guess: ClassVar[bool] = True
    at: At = At.PATH
    scene: CollisionScene
    margins: Array
    """(n_pairs,) [m] of the pairs of the scene."""
    n_rows: AtLeastOne = 10
    """[-] per node on pairs with what stands in the world."""
    n_own_rows: AtLeastOne = 6
    """[-] per node on pairs of the robot's own links."""
    moving: Mapping[str, Place] = field(default_factory=dict)
    """Where obstacles are that do not stand still, by name."""

    def __post_init__(self) -> None:
        Term.__post_init__(self)
        scene = self.scene
        if np.shape(self.margins) != (scene.n_pairs,) or not np.isfinite(self.margins).all():
            raise InvalidInput(
                f"{self.name}: margins {np.shape(self.margins)}; give one finite number [m] for each of "
                f"{scene.n_pairs} pairs"
            )
        if scene.coordinates.n_axes != scene.coordinates.robot.n_v:
            raise InvalidInput(f"{self.name}: the scene plans {scene.coordinates.names}; give one that plans all axes")
        names = [item.name for item in scene.geometry.geometryObjects]
        for name in self.moving:
            if name not in names:
                raise NameNotFound("moving obstacle", name, names)

    @cached_property
    def _coal(self) -> CoalDistances:
        """With shapes of its own where it moves them."""
        scene = self.scene
        return CoalDistances(replace(scene, geometry=pin.GeometryModel(scene.geometry)) if self.moving else scene)

    @property
    def name(self) -> str:
        return "clearance"

    def scenery(self, t: float) -> tuple[ObstacleData, ...]:
        """Obstacles that have an end, as they are at time t [s]."""
        shapes = [item for i, item in enumerate(self.scene.geometry.geometryObjects) if self.scene.is_obstacle(i)]
        places = [self.moving[item.name](t) if item.name in self.moving else item.placement for item in shapes]
        pairs = zip(shapes, places, strict=True)
        found = [describe_obstacle(Obstacle(name=item.name, shape=item.geometry, X_WO=X)) for item, X in pairs]
        return tuple(item for item in found if item is not None)

    # --- rows -------------------------------------------------------------------------------------

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        poses, joints = stage.tick.kinematics.joint_poses, self._joints
        bodies, sizes = [poses[joint] for joint in joints], self._sizes
        ends = np.cumsum([0, *sizes]).tolist()
        parts = [parameters[first:stop] for first, stop in pairwise(ends)]
        rows = [_height(bodies, part) for part in parts]
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *rows), lower=0.0)

    @property
    def _joints(self) -> list[int]:
        """Joints that carry shapes, without the world."""
        pairs = self.scene.pairs
        return sorted({joint for pair in pairs for joint in (pair.first_joint, pair.second_joint)} - {0})

    @property
    def _of_world(self) -> Mask:
        """(n_pairs,) [-] True for a pair with what stands in the world."""
        return np.array([pair.first_joint == 0 for pair in self.scene.pairs], dtype=bool)

    @property
    def _counts(self) -> tuple[int, int]:
        """Rows with the world, and between links."""
        world = self._of_world
        return self.n_rows if world.any() else 0, self.n_own_rows if (~world).any() else 0

    @property
    def _sizes(self) -> list[int]:
        """Parameters of each row: which joint carries the point, which one the plane unless it is the world's."""
        (world, own), n = self._counts, len(self._joints)
        return [n + _N_PLANE] * world + [2 * n + _N_PLANE] * own

    # --- parameters -------------------------------------------------------------------------------

    def n_parameters(self, robot: Robot) -> int:
        return sum(self._sizes)

    def reference(self, t: float) -> Array:
        """At the configuration in which the coordinates of the scene stay, at time t [s]."""
        coordinates = self.scene.coordinates
        return self.references([t], coordinates.configurations(coordinates.reference[None]))[0]

    def references(self, times: Sequence[float], q: Configurations, tightened: Wider | None = None) -> Array:
        """At times (n,) [s] and configurations q (n, n_q) [m, rad], with margins wider by tightened (n, n_pairs) [m]."""
        margins = self._margins(len(q), tightened)
        chosen = self._chosen(times, q, margins)
        offset = chosen.offset + margins[chosen.sample, chosen.pair]
        world, n = self._counts[0], len(self._joints)
        columns = (chosen.normal, chosen.centre, offset)
        result = np.tile(self._nothing(), (len(q), 1))
        place = np.searchsorted(self._joints, chosen.joints)
        begin = np.cumsum([0, *self._sizes])
        for rows, first, width in ((self._of_world[chosen.pair], 0, 0), (~self._of_world[chosen.pair], world, n)):
            k, slot = chosen.sample[rows], begin[first + _ranks(chosen.sample[rows])]
            result[k, slot + place[rows, 1]] = 1.0
            if width:
                result[k, slot + n + place[rows, 0]] = 1.0
            plane = np.column_stack([column[rows] for column in columns])
            result[k[:, None], (slot + n + width)[:, None] + np.arange(_N_PLANE)] = plane
        return result

    def _nothing(self) -> Array:
        parts = [np.r_[np.zeros(size - 1), _NOTHING_NEAR] for size in self._sizes]
        return np.concatenate([np.zeros(0), *parts])

    def mismatch(self, times: Sequence[float], written: Configurations, q: Configurations) -> float:
        """[m] By how much rows that decide at q (n, n_q) [m, rad], written at configurations written (n, n_q) [m, rad], are off.

        times (n,) [s].
        """
        chosen = self._chosen(times, written, self._margins(len(q), None))
        heights, true = chosen.heights(Poses.of(self.scene.coordinates.robot.model, q)), self.distances(times, q)
        least = np.full(true.shape, np.inf)
        np.minimum.at(least, (chosen.sample, chosen.pair), heights)
        decides = least - self.margins < _BINDING
        return float(np.abs(least - true)[decides].max(initial=0.0))

    def _margins(self, n: int, tightened: Array | None) -> Array:
        """(n, n_pairs) [m]"""
        return np.broadcast_to(self.margins if tightened is None else self.margins + tightened, (n, self.scene.n_pairs))

    def _chosen(self, times: Sequence[float], q: Array, margins: Array) -> Planes:
        """The rows that there is room for at configurations q (n, n_q): those least beyond their margins."""
        contacts, poses = self._contacts(times, q), Poses.of(self.scene.coordinates.robot.model, q)
        found = planes(self.scene, contacts, poses)
        beyond, world = found.heights(poses) - margins[found.sample, found.pair], self._of_world[found.pair]
        kept = []
        for rows, room in zip((np.flatnonzero(world), np.flatnonzero(~world)), self._counts, strict=True):
            order = rows[np.lexsort((beyond[rows], found.sample[rows]))]
            kept.append(order[_ranks(found.sample[order]) < room])
        return found.of(np.concatenate(kept))

    # --- distances --------------------------------------------------------------------------------

    def distances(self, times: Sequence[float], q: Configurations) -> Array:
        """(n, n_pairs) [m] of all pairs at times (n,) [s] and configurations q (n, n_q) [m, rad], by coal."""
        if not self.moving:
            return self._coal.distances_at(q)
        return np.concatenate([self._placed(t).distances_at(row[None]) for t, row in zip(times, q, strict=True)])

    def _contacts(self, times: Sequence[float], q: Array) -> Contacts:
        if not self.moving:
            return self._coal.contacts(q)
        found = [self._placed(t).contacts(row[None]) for t, row in zip(times, q, strict=True)]
        sample = np.repeat(np.arange(len(q)), [len(one.sample) for one in found])
        names = ("pair", "distance", "normal", "first", "second")
        parts = {name: np.concatenate([getattr(one, name) for one in found]) for name in names}
        return Contacts(sample=sample, **parts)

    def _placed(self, t: float) -> CoalDistances:
        for item in self._coal.scene.geometry.geometryObjects:
            if item.name in self.moving:
                item.placement = self.moving[item.name](t)
        return self._coal


def _ranks(sample: Indices) -> Indices:
    """(n,) How many rows of its sample are before each; the samples are in their order."""
    return np.arange(len(sample)) - np.searchsorted(sample, sample)


def _height(bodies: Sequence[Pose], row: ca.SX) -> ca.SX:
    """Of the point over the plane; see `Planes`."""
    n, plane = len(bodies), row[-_N_PLANE:]
    normal, centre, offset = ca.vertsplit(plane, [0, 3, 6, 7])
    R, p = _mixed(bodies, row[:n])
    if row.numel() > n + _N_PLANE:
        R_plane, p_plane = _mixed(bodies, row[n : 2 * n])
        normal, p = R_plane @ normal, p - p_plane
    return ca.dot(normal, p + R @ centre) - offset


def _mixed(bodies: Sequence[Pose], shares: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The pose whose share is one."""
    R = sum((shares[i] * body.R for i, body in enumerate(bodies)), ca.SX(3, 3))
    p = sum((shares[i] * body.p for i, body in enumerate(bodies)), ca.SX(3, 1))
    return R, p
