"""Signed distances of a robot's shapes from obstacles and from each other, with gradients."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.axis_reach import shape_reach
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.coal_pairs import CoalPairs
from uvms_ocp.model.shapes.compiled_pairs import CompiledPairs
from uvms_ocp.model.shapes.distance_kernels.clear_pairs import distance_sizes, has_c_form, write_distances
from uvms_ocp.model.shapes.obstacles import Obstacle

_Engine: TypeAlias = CompiledPairs | CoalPairs


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances of all pairs at one configuration; negative where shapes overlap."""

    value: np.ndarray
    """(n_pairs,) [m]"""
    gradient: np.ndarray
    """(n_pairs, n_v) [-, m] rate of change of each distance per unit of each velocity."""


class CollisionModel:
    """Every shape of a robot against every obstacle, and its links against each other.

    Pairs of links that are neighbours, or overlap in the stowed posture, touch by design and are left out. Spheres, capsules,
    cylinders and boxes are measured in machine code, other shapes, and all where there is no compiler, by coal: the same to
    1e-6 m while they are apart. Of shapes that overlap coal tells some depth, machine code the smallest; coal takes a triangle
    mesh, which has no inside, and a depth that it does not find for a distance of 0. Holds working memory: not for two
    threads at once.
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
        self._model, self._geometry = robot.model, shapes_among(robot, obstacles)
        n_links, self.n_q, self.n_v = robot.collision_model.ngeoms, robot.n_q, robot.n_v
        names = [shape.name for shape in robot.collision_model.geometryObjects]
        checked = [names.index(name) for name in _known(links, names)]
        pairs = [(o, i) for o in range(n_links, self._geometry.ngeoms) for i in checked]
        self._pairs = pairs + (self_pairs(robot) if self_collision else [])
        shapes = self._geometry.geometryObjects
        self.pair_names = tuple(f"{shapes[a].name} - {shapes[b].name}" for a, b in self._pairs)
        self._reach = _pair_reach(robot, self._geometry, self._pairs)
        self._engines = _engines(robot.model, self._geometry, self._pairs)

    @property
    def n_pairs(self) -> int:
        return len(self.pair_names)

    @property
    def reach(self) -> np.ndarray:
        """(n_v,) [-, m] upper bound on the rate of any pair's distance per unit of each velocity, at any configuration."""
        return self._reach

    @property
    def by_coal(self) -> bool:
        """Whether coal measures any of the pairs."""
        return any(isinstance(engine, CoalPairs) for engine, _ in self._engines)

    @property
    def without_c_form(self) -> tuple[str, ...]:
        """Names of the shapes that only coal measures, such as meshes."""
        shapes = self._geometry.geometryObjects
        return tuple(shapes[k].name for k in _used(self._pairs) if not has_c_form(shapes[k].geometry))

    @property
    def n_solids(self) -> int:
        """Shapes [-] that are in some pair."""
        return len(_used(self._pairs))

    def is_of(self, robot: Robot) -> bool:
        """Whether its shapes are on a robot of the same joints."""
        return bool(self._model == robot.model)

    def memory_sizes(self) -> dict[str, Any]:
        """What `structure_of` a layout with a `DistanceMemory` of these pairs needs."""
        return distance_sizes(self._model, n_solids=self.n_solids, n_pairs=self.n_pairs)

    def write(self, memory: Any) -> None:
        """Into a `DistanceMemory` of those sizes, or larger: the pairs, in their order. Raises `InvalidInput` for a mesh."""
        if self.without_c_form:
            raise InvalidInput(
                f"shapes {', '.join(self.without_c_form)} have no form in C; give spheres, capsules, cylinders and boxes"
            )
        write_distances(memory, self._model, self._geometry.geometryObjects, self._pairs)

    def values(self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Distance (n_pairs,) [m] at q (n_q,) [m, rad] of all pairs, or (n,) of some, by their indices `pairs` (n,) [-].

        Each index once.
        """
        found = np.empty(self.n_pairs if pairs is None else len(pairs))
        for engine, rows, places in self._shared(pairs):
            found[rows] = engine.values(q, places)
        return found

    def distances(self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None) -> Distances:
        """Distances at q (n_q,) [m, rad], with gradients ``n . (v_2 - v_1)`` at the witness points.

        Of all pairs, or of some by their indices `pairs` (n,) [-], each once.
        """
        value = self.values(q, pairs)
        gradient = np.empty((len(value), self.n_v))
        for engine, rows, places in self._shared(pairs):
            gradient[rows] = engine.gradients(q, places)
        return Distances(value, gradient)

    def _shared(
        self, pairs: Sequence[int] | np.ndarray | None
    ) -> Iterator[tuple[_Engine, np.ndarray | slice, np.ndarray]]:
        """Who measures which of the `pairs`, by their rows here, and by their indices there."""
        for engine, place in self._engines:
            if len(self._engines) == 1:
                yield engine, slice(None), place if pairs is None else place[np.asarray(pairs, dtype=int)]
                return
            asked = place if pairs is None else place[np.asarray(pairs, dtype=int)]
            rows = np.flatnonzero(asked >= 0)
            if len(rows):
                yield engine, rows, asked[rows]


def _engines(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
) -> list[tuple[_Engine, np.ndarray]]:
    """Who measures the pairs, and the index (n_pairs,) there of each, -1 of others."""
    shapes = geometry.geometryObjects
    clear = np.array([all(has_c_form(shapes[k].geometry) for k in pair) for pair in pairs], dtype=bool)
    engines: list[tuple[_Engine, np.ndarray]] = []
    if clear.any():
        compiled = CompiledPairs(model, geometry, [pair for pair, has in zip(pairs, clear, strict=True) if has])
        if compiled.compiled:
            engines.append((compiled, _counted(clear)))
        else:
            clear[:] = False
    if not clear.all():
        rest = [pair for pair, has in zip(pairs, clear, strict=True) if not has]
        engines.append((CoalPairs(model, geometry, rest), _counted(~clear)))
    return engines


def _counted(chosen: np.ndarray) -> np.ndarray:
    return np.where(chosen, np.cumsum(chosen) - 1, -1)


def _used(pairs: Sequence[tuple[int, int]]) -> list[int]:
    return sorted({k for pair in pairs for k in pair})


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


def _pair_reach(robot: Robot, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]) -> np.ndarray:
    """(n_v,) largest over all pairs; an axis that carries both shapes of a pair does not change its distance."""
    reaches = [shape_reach(robot, shape) for shape in geometry.geometryObjects]
    both = [(reaches[a], reaches[b]) for a, b in pairs]
    moved = [np.where((a > 0) != (b > 0), np.maximum(a, b), 0.0) for a, b in both]
    return np.asarray(np.max([np.zeros(robot.n_v), *moved], axis=0))


def _known(links: Sequence[str] | None, names: Sequence[str]) -> Sequence[str]:
    unknown = sorted(set(links or ()) - set(names))
    if unknown:
        raise InvalidInput(f"shapes {unknown} to check for collision; allowed: {', '.join(names)}")
    return names if links is None else links
