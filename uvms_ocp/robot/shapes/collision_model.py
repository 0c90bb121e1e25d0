"""Signed distances of a robot's shapes from obstacles and from each other, with gradients: by
kernels, or by coal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import kinematics
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.robot import Robot, require_normalized
from uvms_ocp.robot.shapes import distance_kernels
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.robot.shapes.pair_distances import CoalPairs, CompiledPairs
from uvms_ocp.robot.shapes.shape_pairs import self_pairs, shapes_among, shapes_in

_Engine: TypeAlias = CompiledPairs | CoalPairs


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances of all pairs at one configuration; negative where shapes overlap."""

    value: np.ndarray
    """(n_pairs,) [m] distances."""
    gradient: np.ndarray
    """(n_pairs, n_v) [-, m] rate of change of each distance per unit of each velocity."""


class CollisionModel:
    """Every shape of a robot against every obstacle, and its links against each other.

    Pairs of links that are neighbours, or overlap in the stowed posture, touch by design and are
    left out. Spheres, capsules, cylinders and boxes are measured in machine code; other shapes, and
    all where there is no compiler, by coal. Both agree to 1e-6 m while shapes are apart. Where
    shapes overlap, machine code gives the smallest depth, coal any depth; one that coal does not
    find counts as a distance of 0. Closed triangle meshes are solids, open ones surfaces. Holds
    working memory: not for two threads at once.
    """

    def __init__(
        self,
        robot: Robot,
        obstacles: Sequence[Obstacle] = (),
        *,
        self_collision: bool = True,
        links: Sequence[str] | None = None,
    ) -> None:
        """links: names of the shapes that are checked against obstacles, all by default. Raises
        `InvalidInput`.
        """
        self._model = robot.model
        self._geometry = shapes_among(robot, obstacles)
        n_links = robot.collision_model.ngeoms
        self.n_q = robot.n_q
        self.n_v = robot.n_v
        names = [shape.name for shape in robot.collision_model.geometryObjects]
        link_indices = [names.index(name) for name in _checked_names(links, names)]
        obstacle_indices = range(n_links, self._geometry.ngeoms)
        self._pairs = [*product(obstacle_indices, link_indices)]
        if self_collision:
            self._pairs += self_pairs(robot)
        shapes = self._geometry.geometryObjects
        self.pair_names = tuple(f"{shapes[a].name} - {shapes[b].name}" for a, b in self._pairs)
        self.reach = _pair_reach(robot, self._geometry, self._pairs)
        """(n_v,) [-, m] upper bound on the rate of any pair's distance per unit of each velocity,
        at any configuration.
        """
        self._engines = _engines(robot.model, self._geometry, self._pairs)

    @property
    def n_pairs(self) -> int:
        return len(self.pair_names)

    @property
    def by_coal(self) -> bool:
        """True where coal measures any of the pairs."""
        return any(isinstance(engine, CoalPairs) for engine, _ in self._engines)

    @property
    def without_c_form(self) -> tuple[str, ...]:
        """Names of the shapes that only coal measures, such as meshes."""
        names = list[str]()
        for k in sorted(shapes_in(self._pairs)):
            shape = self._geometry.geometryObjects[k]
            if not distance_kernels.has_kernel(shape.geometry):
                names.append(shape.name)
        return tuple(names)

    @property
    def n_solids(self) -> int:
        """Number of shapes that are in some pair."""
        return len(shapes_in(self._pairs))

    def is_of(self, robot: Robot) -> bool:
        """Check for a robot of the same joints as the one that the shapes are on."""
        return bool(self._model == robot.model)

    def write(self, memory: distance_kernels.DistanceMemory) -> None:
        """Write the pairs, in their order, into a `DistanceMemory` that has room for them. Raises
        `InvalidInput` for a mesh.
        """
        if self.without_c_form:
            names = ", ".join(self.without_c_form)
            raise InvalidInput(
                f"shapes {names} have no form in C; give spheres, capsules, cylinders and boxes"
            )
        distance_kernels.write_distances(
            memory, self._model, self._geometry.geometryObjects, self._pairs
        )

    def values(self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Return the distance (n_pairs,) [m] at q (n_q,) [m, rad] of all pairs, or (n,) of some, by
        their indices `pairs` (n,), each once.
        """
        require_normalized(self._model, q)
        distances = np.empty(self.n_pairs if pairs is None else len(pairs))
        for engine, rows, places in self._shared(pairs):
            distances[rows] = engine.values(q, places)
        return distances

    def distances(
        self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None
    ) -> Distances:
        """Return distances at q (n_q,) [m, rad], with gradients ``n . (v_2 - v_1)`` at the witness
        points.

        Of all pairs, or of some by their indices `pairs` (n,), each once.
        """
        value = self.values(q, pairs)
        gradient = np.empty((len(value), self.n_v))
        for engine, rows, places in self._shared(pairs):
            gradient[rows] = engine.gradients(q, places)
        return Distances(value, gradient)

    def _shared(
        self, pairs: Sequence[int] | np.ndarray | None
    ) -> Iterator[tuple[_Engine, np.ndarray | slice, np.ndarray]]:
        """Yield each engine with the rows of `pairs` that it measures and the engine's own indices
        of those pairs.
        """
        for engine, places in self._engines:
            if pairs is not None:
                places = places[np.asarray(pairs, dtype=int)]
            if len(self._engines) == 1:
                yield engine, slice(None), places
                continue
            rows = np.flatnonzero(places >= 0)
            if len(rows):
                yield engine, rows, places[rows]


def _engines(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
) -> list[tuple[_Engine, np.ndarray]]:
    """Return the engines that measure the pairs, each with its own index (n_pairs,) of every pair,
    -1 for pairs that it does not measure.
    """
    shapes = geometry.geometryObjects
    has_kernel = [distance_kernels.has_kernel(shape.geometry) for shape in shapes]
    in_machine_code = np.array([has_kernel[a] and has_kernel[b] for a, b in pairs], dtype=bool)
    engines: list[tuple[_Engine, np.ndarray]] = []
    if in_machine_code.any():
        compiled_pairs = [pairs[k] for k in np.flatnonzero(in_machine_code).tolist()]
        compiled = CompiledPairs(model, geometry, compiled_pairs)
        if compiled.compiled:
            engines.append((compiled, _counted(in_machine_code)))
        else:
            in_machine_code[:] = False
    if not in_machine_code.all():
        coal_pairs = [pairs[k] for k in np.flatnonzero(~in_machine_code).tolist()]
        engines.append((CoalPairs(model, geometry, coal_pairs), _counted(~in_machine_code)))
    return engines


def _counted(chosen: np.ndarray) -> np.ndarray:
    """Number the chosen (n,) from 0; -1 for those that are not chosen."""
    return np.where(chosen, np.cumsum(chosen) - 1, -1)


def _pair_reach(
    robot: Robot, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
) -> np.ndarray:
    """Compute `CollisionModel.reach`; an axis that carries both shapes of a pair alike does not
    change their distance.
    """
    reaches = [kinematics.shape_reach(robot, shape) for shape in geometry.geometryObjects]
    leading = [robot.joint(name).idx_v for name in robot.leading_joints]
    leads_others = np.isin(np.arange(robot.n_v), leading)
    largest = np.zeros(robot.n_v)
    for a, b in pairs:
        first = reaches[a]
        second = reaches[b]
        moves_either = (first > 0) != (second > 0)
        alone = np.where(moves_either, np.maximum(first, second), 0.0)
        reach = np.where(leads_others, first + second, alone)
        largest = np.maximum(largest, reach)
    return largest


def _checked_names(links: Sequence[str] | None, names: Sequence[str]) -> Sequence[str]:
    """Return the names in links, or all where that is `None`. Raises `InvalidInput` for unknown
    ones.
    """
    unknown = sorted(set(links or ()) - set(names))
    if unknown:
        raise InvalidInput(f"shapes {unknown} to check for collision; allowed: {', '.join(names)}")
    return names if links is None else links


def in_c(model: CollisionModel, robot: Robot | None) -> bool:
    """Check whether machine code measures all pairs of a model, which must be on this robot."""
    return robot is not None and not model.by_coal and model.is_of(robot)


def with_any_distances(
    dimensions: Dimensions, models: Iterable[CollisionModel], robot: Robot | None
) -> Dimensions:
    """Return the dimensions with those of a `DistanceMemory` for any of the models; Python measures
    those not `in_c`.
    """
    all_models = list(models)
    n_pairs = max((model.n_pairs for model in all_models), default=0)
    n_solids = [model.n_solids for model in all_models if in_c(model, robot)]
    if robot is not None and n_solids:
        return distance_kernels.with_distances(
            dimensions, robot.model, n_solids=max(n_solids), n_pairs=n_pairs
        )
    # Room for all axes, also where none is looked at: compilers see what a kernel could read.
    return replace(dimensions, n_placements=12, n_axes=dimensions.n_v, n_solids=1, n_pairs=n_pairs)


def any_places(models: Iterable[CollisionModel], robot: Robot | None) -> ca.Function:
    """Return the function `places` of a `DistanceMemory` for any of the models."""
    if robot is not None and any(in_c(model, robot) for model in models):
        return distance_kernels.places_function(robot.model)
    return _no_places()


def without_c_form(model: CollisionModel, robot: Robot | None) -> str:
    """Describe why kernels cannot measure the pairs even where there is a compiler; empty where
    they can.
    """
    if model.without_c_form:
        return (
            f"distances of {', '.join(model.without_c_form)}; spheres, capsules, cylinders and"
            " boxes have"
        )
    if robot is None or not model.is_of(robot):
        return "distances of another robot"
    return ""


@cache
def _no_places() -> ca.Function:
    return ca.Function("places", [ca.SX.sym("q")], [ca.SX(ca.DM.zeros(1)), ca.SX(ca.DM.zeros(1))])
