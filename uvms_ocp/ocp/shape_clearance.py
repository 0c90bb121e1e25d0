"""Clearance of true shapes, as rows of an optimal control problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
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

_NEAR = 0.25
"""[m] beyond its margin up to which a pair has its first row before any other has its second: one
pair that is always near, with the eight corners of its shape, would leave none to those that come
near.
"""
_SIDES_FIRST = 1e6  # [m] off the heights of rows of sides, so that they are chosen before others
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
    """(n_pairs,) [m] distances that the pairs of the scene keep at least."""
    n_rows: AtLeastOne = 10
    """Rows of each node on pairs with what stands in the world."""
    n_own_rows: AtLeastOne = 6
    """Rows of each node on pairs of the robot's own links."""
    n_pair_rows: Count = 0
    """Rows of each node on each of these pairs instead, where it is not 0: simpler rows, for a
    scene of few pairs.
    """
    moving: Mapping[str, Place] = field(default_factory=dict)
    """Places of obstacles that move, by name."""

    def __post_init__(self) -> None:
        Term.__post_init__(self)
        scene = self.scene
        if np.shape(self.margins) != (scene.n_pairs,) or not np.isfinite(self.margins).all():
            raise InvalidInput(
                f"{self.name}: margins {np.shape(self.margins)}; give one finite number [m] for"
                f" each of {scene.n_pairs} pairs"
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
        """Distances by coal, with shapes that belong to this term alone where it moves them."""
        if not self.moving:
            return CoalDistances(self.scene)
        shapes = pin.GeometryModel(self.scene.geometry)
        return CoalDistances(replace(self.scene, geometry=shapes))

    def scenery(self, t: float) -> tuple[ObstacleMeta, ...]:
        """Describe the obstacles that have an end, as they are at time t [s]."""
        obstacles = []
        for i, item in enumerate(self.scene.geometry.geometryObjects):
            if not self.scene.is_obstacle(i):
                continue
            X_WO = item.placement
            if item.name in self.moving:
                X_WO = self.moving[item.name](t)
            obstacles.append(Obstacle(name=item.name, shape=item.geometry, X_WO=X_WO))
        return describe_obstacles(obstacles)

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        """Return the heights of points over planes less their offsets."""
        rows: list[ca.SX] = []
        first = 0
        for group in self._groups:
            stop = first + group.n_parameters
            rows += group.rows(stage.tick, parameters[first:stop])
            first = stop
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *rows), lower=0.0)

    @cached_property
    def _groups(self) -> tuple[PlaneRowGroup, ...]:
        """Return the row groups: with the world, between links, and of each pair of links."""
        pairs = self.scene.pairs
        joints = np.array([(pair.first_joint, pair.second_joint) for pair in pairs], dtype=int)
        joints = joints.reshape(-1, 2)
        is_with_world = joints[:, 0] == 0
        groups = []
        if is_with_world.any():
            groups.append(_group(joints, is_with_world, self.n_rows))
        if self.n_pair_rows:
            for k in np.flatnonzero(~is_with_world):
                groups.append(_group(joints, np.arange(len(pairs)) == k, self.n_pair_rows))
        elif not is_with_world.all():
            groups.append(_group(joints, ~is_with_world, self.n_own_rows))
        return tuple(groups)

    def n_parameters(self, robot: Robot) -> int:
        """Return the number of parameters of the rows."""
        return sum(group.n_parameters for group in self._groups)

    def reference(self, t: float) -> Array:
        """Return the parameters (n_parameters,) at time t [s], at the configuration in which the
        coordinates of the scene stay.
        """
        coordinates = self.scene.coordinates
        return self.references([t], coordinates.configurations(coordinates.reference[None]))[0]

    def references(
        self, times: Sequence[float], q: Configurations, tightened: NodeMargins | None = None
    ) -> Array:
        """Return the parameters (n, n_parameters) at times (n,) [s] and configurations q (n, n_q)
        [m, rad], with margins wider by what is asked of pairs beyond them, and planes on the sides
        that it says.
        """
        if tightened is None:
            margins = self._margins(len(q), None)
            sides: Sequence[Side] = ()
        else:
            margins = self._margins(len(q), tightened.below)
            sides = tightened.sides
        parts = [np.zeros((len(q), 0))]
        for group, chosen in zip(self._groups, self._chosen(times, q, margins, sides), strict=True):
            parameters = np.tile(group.nothing(), (len(q), 1))
            offset = chosen.offset + margins[chosen.sample, chosen.pair]
            group.write(parameters, chosen, offset)
            parts.append(parameters)
        return np.concatenate(parts, axis=1)

    def mismatch(self, times: Sequence[float], written: Configurations, q: Configurations) -> float:
        """Return by how much [m] rows written at configurations written (n, n_q) [m, rad] are off
        at q (n, n_q) [m, rad]: those that decide there by the difference from the true distance,
        those that leave a pair free by what it lacks of its margin.

        times (n,) [s].
        """
        poses = Poses.of(self.scene.coordinates.robot.model, q)
        true_distances = self.distances(times, q)
        by_rows = np.full(true_distances.shape, np.inf)
        for chosen in self._chosen(times, written, self._margins(len(q), None)):
            np.minimum.at(by_rows, (chosen.sample, chosen.pair), chosen.heights(poses))
        decides = by_rows - self.margins < _BINDING
        difference = np.abs(by_rows[decides] - true_distances[decides])
        overlooked = (self.margins - true_distances)[~decides]
        return float(np.concatenate([difference, overlooked]).max(initial=0.0))

    def _margins(self, n: int, tightened: Array | None) -> Array:
        """Return the margins (n, n_pairs) [m] at n nodes."""
        margins = self.margins if tightened is None else self.margins + tightened
        return np.broadcast_to(margins, (n, self.scene.n_pairs))

    def _chosen(
        self, times: Sequence[float], q: Array, margins: Array, sides: Sequence[Side] = ()
    ) -> list[Planes]:
        """Choose in every group as many as there is room for at configurations q (n, n_q): pair by
        pair the ones least beyond their margins, those of sides before others.
        """
        contacts = self._contacts(times, q)
        poses = Poses.of(self.scene.coordinates.robot.model, q)
        candidates = planes(self.scene, contacts, poses)
        beyond = candidates.heights(poses) - margins[candidates.sample, candidates.pair]
        if sides:
            side_planes = self._side_planes(times, sides)
            candidates = Planes.joined(side_planes, candidates)
            beyond = np.concatenate([side_planes.heights(poses) - _SIDES_FIRST, beyond])
        chosen = []
        for group in self._groups:
            rows = np.flatnonzero(group.pairs[candidates.pair])
            turn = _turns(candidates, rows, beyond)
            order = rows[np.lexsort((beyond[rows], turn, candidates.sample[rows]))]
            has_room = ranks(candidates.sample[order]) < group.n
            chosen.append(candidates.of(order[has_room]))
        return chosen

    def _side_planes(self, times: Sequence[float], sides: Sequence[Side]) -> Planes:
        """Return planes that part the pairs at moments between nodes, for the nodes that stay on
        their side; an obstacle that moves takes its plane along.
        """
        model = self.scene.coordinates.robot.model
        parts = []
        for side in sides:
            q = side.q[None]
            contacts = self._contacts([side.time], q)
            all_planes = planes(self.scene, contacts, Poses.of(model, q))
            pair_planes = all_planes.of(np.flatnonzero(all_planes.pair == side.row))
            moved = self._moved_with_obstacle(pair_planes, side, times[side.node])
            parts.append(replace(moved, sample=np.full(len(pair_planes.sample), side.node)))
        return Planes.joined(*parts)

    def _moved_with_obstacle(self, pair_planes: Planes, side: Side, t: float) -> Planes:
        """Return the planes of a side at time t [s], where their obstacle has moved."""
        pair = self.scene.pairs[side.row]
        name = self.scene.geometry.geometryObjects[pair.first].name
        if name not in self.moving:
            return pair_planes
        X = self.moving[name](t) * self.moving[name](side.time).inverse()
        normal = pair_planes.normal @ X.rotation.T
        offset = pair_planes.offset + normal @ X.translation
        return replace(pair_planes, normal=normal, offset=offset)

    def distances(
        self, times: Sequence[float], q: Configurations, chosen: ChosenPairs | None = None
    ) -> Array:
        """Return the distances (n, n_pairs) [m] of all pairs at times (n,) [s] and configurations q
        (n, n_q) [m, rad], by coal; infinite for those that are not chosen (n, n_pairs).
        """
        if not self.moving:
            return self._coal.distances_at(q, chosen)
        if chosen is None:
            chosen = np.ones((len(q), self.scene.n_pairs), dtype=bool)
        parts = [np.zeros((0, self.scene.n_pairs))]
        for t, configuration, pairs in zip(times, q, chosen, strict=True):
            coal = self._coal_at(t)
            parts.append(coal.distances_at(configuration[None], pairs[None]))
        return np.concatenate(parts)

    def obstacle_motion(
        self, times: Annotated[Array, Shape("n")], half: Annotated[Array, Shape("n")]
    ) -> Array:
        """Return how far [m] the obstacle of each pair moves (n, n_pairs) within half (n,) [s] of
        times (n,) [s], by its places there and at both ends.
        """
        shapes = self.scene.geometry.geometryObjects
        result = np.zeros((len(times), self.scene.n_pairs))
        for name, place in self.moving.items():
            (obstacle,) = [shape for shape in shapes if shape.name == name]
            columns = []
            for k, pair in enumerate(self.scene.pairs):
                if shapes[pair.first].name == name:
                    columns.append(k)
            obstacle.geometry.computeLocalAABB()
            centre = np.linalg.norm(np.array(obstacle.geometry.aabb_center))
            radius = float(centre + obstacle.geometry.aabb_radius)
            for row, t, delta in zip(result, times.tolist(), half.tolist(), strict=True):
                middle = place(t)
                before = _largest_way(middle, place(t - delta), radius)
                after = _largest_way(middle, place(t + delta), radius)
                row[columns] = max(before, after)
        return result

    def _contacts(self, times: Sequence[float], q: Array) -> Contacts:
        """Return where pairs are nearest at times (n,) [s] and configurations q (n, n_q)."""
        if not self.moving:
            return self._coal.contacts(q)
        parts = []
        for t, configuration in zip(times, q, strict=True):
            parts.append(self._coal_at(t).contacts(configuration[None]))
        return Contacts(
            sample=np.repeat(np.arange(len(q)), [len(part.sample) for part in parts]),
            pair=np.concatenate([part.pair for part in parts]),
            distance=np.concatenate([part.distance for part in parts]),
            normal=np.concatenate([part.normal for part in parts]),
            first=np.concatenate([part.first for part in parts]),
            second=np.concatenate([part.second for part in parts]),
        )

    def _coal_at(self, t: float) -> CoalDistances:
        """Return the distances with moving obstacles where they are at time t [s]."""
        for item in self._coal.scene.geometry.geometryObjects:
            if item.name in self.moving:
                item.placement = self.moving[item.name](t)
        return self._coal


def _turns(candidates: Planes, rows: Indices, beyond: Array) -> Indices:
    """Return the turn (n,) in which each of the rows (n,) is taken: the first for the nearest point
    of every pair, the next ones for its further points; the last for what is far; beyond (n_all,)
    [m].
    """
    n_pairs = int(candidates.pair.max(initial=0)) + 1
    pair_of_sample = candidates.sample[rows] * n_pairs + candidates.pair[rows]
    order = np.lexsort((beyond[rows], pair_of_sample))
    turn = np.empty(len(rows), dtype=np.intp)
    turn[order] = ranks(pair_of_sample[order])
    return np.where(beyond[rows] < _NEAR, turn, len(rows))


def _largest_way(first: pin.SE3, second: pin.SE3, radius: float) -> float:
    """Return how far [m] a point of a ball of that radius about the origin moves at most."""
    chord = np.linalg.norm(second.rotation - first.rotation)
    sine_of_half_turn = chord / np.sqrt(8.0)
    turn = 2.0 * np.arcsin(min(float(sine_of_half_turn), 1.0))
    return float(np.linalg.norm(second.translation - first.translation) + turn * radius)


def _group(joints: Indices, chosen: Mask, n: int) -> PlaneRowGroup:
    """Return the row group of the chosen of pairs (n_pairs, 2) of joints."""
    first = tuple(np.unique(joints[chosen, 0]).tolist())
    second = tuple(np.unique(joints[chosen, 1]).tolist())
    return PlaneRowGroup(pairs=chosen, n=n, first=first, second=second)
