"""Clearance of true shapes, as rows of an optimal control problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.ocp.node_margins import NodeMargins, Side
from uvms_ocp.ocp.plane_rows import PlaneRowGroup, ranks
from uvms_ocp.ocp.separating_planes import Planes, Poses, planes
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.planning.distances import ChosenPairs, CoalDistances, Configurations, Contacts
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle, describe_obstacles
from uvms_ocp.tasks.task import Residual, bounded_residual
from uvms_ocp.types import Array, AtLeastOne, Count, Indices, Mask, Shape

_IN_TURN = 0.25
"""[m] beyond its margin up to which a pair has its first row before any other has its second: one pair
that is always near, with the eight corners of its shape, would leave none to those that come near.
"""
_BEFORE = 1e6  # [m] so that rows of sides come first
_BINDING = 5e-3  # [m] beyond the margin within which a row decides

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

    has_sides: ClassVar[bool] = True
    rows_are_quantities: ClassVar[bool] = False
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
        self, times: Sequence[float], q: Configurations, tightened: NodeMargins | None = None
    ) -> Array:
        """At times (n,) [s] and configurations q (n, n_q) [m, rad], with margins wider by what is
        asked of pairs beyond them, and planes on the sides that it says.
        """
        wider = None if tightened is None else tightened.below
        sides = () if tightened is None else tightened.sides
        margins = self._margins(len(q), wider)
        parts = []
        for group, found in zip(self._groups, self._chosen(times, q, margins, sides), strict=True):
            parts.append(np.tile(group.nothing(), (len(q), 1)))
            group.write(parts[-1], found, found.offset + margins[found.sample, found.pair])
        return np.concatenate([np.zeros((len(q), 0)), *parts], axis=1)

    def mismatch(self, times: Sequence[float], written: Configurations, q: Configurations) -> float:
        """[m] By how much rows written at configurations written (n, n_q) [m, rad] are off at q
        (n, n_q) [m, rad]: those that decide there by the difference from the true distance, those
        that leave a pair free by what it lacks of its margin.

        times (n,) [s].
        """
        poses = Poses.of(self.scene.coordinates.robot.model, q)
        true = self.distances(times, q)
        by_rows = np.full(true.shape, np.inf)
        for chosen in self._chosen(times, written, self._margins(len(q), None)):
            np.minimum.at(by_rows, (chosen.sample, chosen.pair), chosen.heights(poses))
        decides = by_rows - self.margins < _BINDING
        difference = np.abs(by_rows[decides] - true[decides])
        overlooked = (self.margins - true)[~decides]
        return float(np.concatenate([difference, overlooked]).max(initial=0.0))

    def _margins(self, n: int, tightened: Array | None) -> Array:
        """(n, n_pairs) [m]"""
        return np.broadcast_to(
            self.margins if tightened is None else self.margins + tightened, (n, self.scene.n_pairs)
        )

    def _chosen(
        self, times: Sequence[float], q: Array, margins: Array, sides: Sequence[Side] = ()
    ) -> list[Planes]:
        """Choose in every group as many as there is room for at configurations q (n, n_q): pair by
        pair the ones least beyond their margins, those of sides before others.
        """
        contacts = self._contacts(times, q)
        poses = Poses.of(self.scene.coordinates.robot.model, q)
        found = planes(self.scene, contacts, poses)
        beyond = found.heights(poses) - margins[found.sample, found.pair]
        if sides:
            aside = self._aside(times, sides)
            found = Planes.joined(aside, found)
            first = aside.heights(poses) - _BEFORE
            beyond = np.concatenate([first, beyond])
        kept = []
        for group in self._groups:
            rows = np.flatnonzero(group.pairs[found.pair])
            turn = _turns(found, rows, beyond)
            order = rows[np.lexsort((beyond[rows], turn, found.sample[rows]))]
            kept.append(found.of(order[ranks(found.sample[order]) < group.n]))
        return kept

    def _aside(self, times: Sequence[float], sides: Sequence[Side]) -> Planes:
        """Planes that part the pairs at moments between nodes, for the nodes that stay on their
        side; an obstacle that moves takes its plane along.
        """
        model = self.scene.coordinates.robot.model
        found = []
        for side in sides:
            q = side.q[None]
            contacts = self._contacts([side.time], q)
            own = planes(self.scene, contacts, Poses.of(model, q))
            own = own.of(np.flatnonzero(own.pair == side.row))
            found.append(
                replace(
                    self._carried(own, side, times[side.node]),
                    sample=np.full(len(own.sample), side.node),
                )
            )
        return Planes.joined(*found)

    def _carried(self, own: Planes, side: Side, t: float) -> Planes:
        """The planes of a side at time t [s], to where their obstacle has moved."""
        pair = self.scene.pairs[side.row]
        name = self.scene.geometry.geometryObjects[pair.first].name
        if name not in self.moving:
            return own
        X = self.moving[name](t) * self.moving[name](side.time).inverse()
        normal = own.normal @ X.rotation.T
        return replace(own, normal=normal, offset=own.offset + normal @ X.translation)

    # --- distances --------------------------------------------------------------------------------

    def distances(
        self, times: Sequence[float], q: Configurations, chosen: ChosenPairs | None = None
    ) -> Array:
        """(n, n_pairs) [m] of all pairs at times (n,) [s] and configurations q (n, n_q) [m, rad],
        by coal; infinite for those that are not chosen (n, n_pairs).
        """
        if not self.moving:
            return self._coal.distances_at(q, chosen)
        if chosen is None:
            wanted = np.ones((len(q), self.scene.n_pairs), dtype=bool)
        else:
            wanted = chosen
        parts = [
            self._placed(t).distances_at(row[None], asked[None])
            for t, row, asked in zip(times, q, wanted, strict=True)
        ]
        return np.concatenate([np.zeros((0, self.scene.n_pairs)), *parts])

    def obstacle_motion(
        self, times: Annotated[Array, Shape("n")], half: Annotated[Array, Shape("n")]
    ) -> Array:
        """(n, n_pairs) [m] How far the obstacle of each pair moves within half (n,) [s] of times
        (n,) [s], by its places there and at both ends.
        """
        shapes = self.scene.geometry.geometryObjects
        result = np.zeros((len(times), self.scene.n_pairs))
        for name, place in self.moving.items():
            (item,) = (item for item in shapes if item.name == name)
            own = [k for k, pair in enumerate(self.scene.pairs) if shapes[pair.first].name == name]
            item.geometry.computeLocalAABB()
            centre = np.linalg.norm(np.array(item.geometry.aabb_center))
            radius = float(centre + item.geometry.aabb_radius)
            for row, t, delta in zip(result, times.tolist(), half.tolist(), strict=True):
                here = place(t)
                row[own] = max(_way(here, place(t + side), radius) for side in (-delta, delta))
        return result

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


def _turns(found: Planes, rows: Indices, beyond: Array) -> Indices:
    """(n,) Turn in which each of the chosen rows (n,) is taken: the first for the nearest point of
    every pair, the next ones for its further points; the last for what is far; beyond (n_all,) [m].
    """
    pair = found.sample[rows] * (int(found.pair.max(initial=0)) + 1) + found.pair[rows]
    order = np.lexsort((beyond[rows], pair))
    place = np.empty(len(rows), dtype=np.intp)
    place[order] = ranks(pair[order])
    return np.where(beyond[rows] < _IN_TURN, place, len(rows))


def _way(one: pin.SE3, other: pin.SE3, radius: float) -> float:
    """[m] How far a point of a ball of that radius about the origin moves at most."""
    chord = np.linalg.norm(other.rotation - one.rotation) / np.sqrt(8.0)  # sine of half the turn
    turn = 2.0 * np.arcsin(min(float(chord), 1.0))
    return float(np.linalg.norm(other.translation - one.translation) + turn * radius)


def _group(carried: Indices, chosen: Mask, n: int) -> PlaneRowGroup:
    """Return the row group of the chosen of pairs (n_pairs, 2) of joints."""
    first, second = (tuple(np.unique(carried[chosen, side]).tolist()) for side in (0, 1))
    return PlaneRowGroup(pairs=chosen, n=n, first=first, second=second)
