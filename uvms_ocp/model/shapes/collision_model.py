"""Signed distances of a robot's shapes from obstacles and from each other, with gradients, by coal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.axis_reach import shape_reach
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.obstacles import Obstacle

_DISTANCE_TOLERANCE = 1e-9  # coal's default of 1e-6 shows as noise in the gradients
_MAX_ITERATIONS = 512
_FAILED = -1e3  # [m] what coal reports below it is no distance but a search that failed


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances of all pairs at one configuration; negative where shapes overlap."""

    value: np.ndarray
    """(n_pairs,) [m]"""
    gradient: np.ndarray
    """(n_pairs, n_v) [-, m] rate of change of each distance per unit of each velocity."""


class CollisionModel:
    """Every shape of a robot against every obstacle, and its links against each other.

    Pairs of links that are neighbours, or overlap in the stowed posture, touch by design and are left out. A triangle
    mesh has no inside: overlap with it counts as a distance of 0. Holds working memory: not for two threads at once.
    """

    def __init__(
        self,
        robot: Robot,
        obstacles: Sequence[Obstacle] = (),
        *,
        self_collision: bool = True,
        links: Sequence[str] | None = None,
    ) -> None:
        """links: names of the shapes that are checked against obstacles, all by default. Raises `InvalidInput`."""
        self._model, self._data, self.n_v = robot.model, robot.model.createData(), robot.n_v
        self._geometry, n_links = shapes_among(robot, obstacles), robot.collision_model.ngeoms
        names = [shape.name for shape in robot.collision_model.geometryObjects]
        checked = [names.index(name) for name in _known(links, names)]
        pairs = [(o, i) for o in range(n_links, self._geometry.ngeoms) for i in checked]
        pairs += self_pairs(robot) if self_collision else []
        for first, second in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))
        shapes = self._geometry.geometryObjects
        self.pair_names = tuple(f"{shapes[a].name} - {shapes[b].name}" for a, b in pairs)
        self._joints = [(int(shapes[a].parentJoint), int(shapes[b].parentJoint)) for a, b in pairs]
        self._reach = _pair_reach(robot, self._geometry)
        self._geometry_data = self._geometry.createData()
        for request in self._geometry_data.distanceRequests:
            request.gjk_tolerance, request.gjk_max_iterations = _DISTANCE_TOLERANCE, _MAX_ITERATIONS

    @property
    def n_pairs(self) -> int:
        return len(self.pair_names)

    @property
    def reach(self) -> np.ndarray:
        """(n_v,) [-, m] upper bound on the rate of any pair's distance per unit of each velocity, at any configuration."""
        return self._reach

    def values(self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Distance (n_pairs,) [m] at q (n_q,) [m, rad] of all pairs, or (n,) of some, by their indices `pairs` (n,) [-]."""
        if pairs is None:
            pin.computeDistances(self._model, self._data, self._geometry, self._geometry_data, q)
            results = self._geometry_data.distanceResults
            found = np.array([results[k].min_distance for k in range(self.n_pairs)])
        else:
            pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
            single = [pin.computeDistance(self._geometry, self._geometry_data, int(k)) for k in pairs]
            found = np.array([result.min_distance for result in single])
        return np.where(found < _FAILED, 0.0, found)

    def distances(self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None) -> Distances:
        """Distances at q (n_q,) [m, rad], with gradients ``n . (v_2 - v_1)`` at the witness points.

        Of all pairs, or of some by their indices `pairs` (n,) [-].
        """
        return Distances(self.values(q, pairs), self._gradients(q, range(self.n_pairs) if pairs is None else pairs))

    def _gradients(self, q: np.ndarray, pairs: Sequence[int] | range | np.ndarray) -> np.ndarray:
        """The distances must have been computed at q."""
        pin.computeJointJacobians(self._model, self._data, q)
        return np.array([self._gradient(int(k)) for k in pairs]).reshape(-1, self.n_v)

    def _gradient(self, pair: int) -> np.ndarray:
        result = self._geometry_data.distanceResults[pair]
        (nx, ny, nz), (x, y, z) = result.normal, result.getNearestPoint1()
        wrench = np.array([nx, ny, nz, y * nz - z * ny, z * nx - x * nz, x * ny - y * nx])
        first, second = self._joints[pair]
        row = np.zeros(self.n_v)
        for joint, sign in ((first, -1.0), (second, 1.0)):
            if joint:
                row += sign * wrench @ pin.getJointJacobian(self._model, self._data, joint, pin.WORLD)
        return row


def shapes_among(robot: Robot, obstacles: Sequence[Obstacle]) -> pin.GeometryModel:
    """The robot's collision shapes, then the obstacles, and no pairs yet."""
    geometry = pin.GeometryModel(robot.collision_model)
    geometry.removeAllCollisionPairs()
    for item in obstacles:
        geometry.addGeometryObject(pin.GeometryObject(item.name, 0, item.X_WO, item.shape))
    return geometry


def self_pairs(robot: Robot) -> list[tuple[int, int]]:
    """Pairs of shapes on links that are no neighbours and stay apart in the stowed posture: others are built to touch."""
    geometry = shapes_among(robot, ())
    joints = [int(shape.parentJoint) for shape in geometry.geometryObjects]
    parents = list(robot.model.parents)
    far = [
        (a, b)
        for a in range(len(joints))
        for b in range(a + 1, len(joints))
        if joints[a] != joints[b] and parents[joints[a]] != joints[b] and parents[joints[b]] != joints[a]
    ]
    for a, b in far:
        geometry.addCollisionPair(pin.CollisionPair(a, b))
    data = geometry.createData()
    pin.computeDistances(robot.model, robot.model.createData(), geometry, data, robot.configuration())
    return [pair for k, pair in enumerate(far) if data.distanceResults[k].min_distance > 0.0]


def _pair_reach(robot: Robot, geometry: pin.GeometryModel) -> np.ndarray:
    """(n_v,) largest over all pairs; an axis that carries both shapes of a pair does not change its distance."""
    reaches = [shape_reach(robot, shape) for shape in geometry.geometryObjects]
    pairs = [(reaches[pair.first], reaches[pair.second]) for pair in geometry.collisionPairs]
    moved = [np.where((a > 0) != (b > 0), np.maximum(a, b), 0.0) for a, b in pairs]
    return np.asarray(np.max([np.zeros(robot.n_v), *moved], axis=0))


def _known(links: Sequence[str] | None, names: Sequence[str]) -> Sequence[str]:
    unknown = sorted(set(links or ()) - set(names))
    if unknown:
        raise InvalidInput(f"shapes {unknown} to check for collision; allowed: {', '.join(names)}")
    return names if links is None else links
