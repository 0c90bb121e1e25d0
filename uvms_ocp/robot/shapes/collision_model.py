"""Signed distances of a robot's shapes from obstacles and from each other, with gradients: by
kernels, or by coal.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.codegen.kernel_layout import structure_of, view
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import kinematics, unknowns
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes import distance_kernels
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.robot.shapes.signed_distance import PairContact, SignedDistances

# coal's default of 1e-6 shows as noise in finite differences. 1e-12 made 4 of 264,000 distances
# fail or be wrong by centimetres; 1e-9 none of 2.6 million. The penetration solver keeps its
# default: with less it fails often, with it once in 10,000 overlaps, and then reports -1e308.
_DISTANCE_TOLERANCE = 1e-9
_MAX_ITERATIONS = 512
FAILED = -1e3
"""[m] What coal reports below it is no distance but a search that failed."""


# Links of which no clearance tells.


def links_without_shape(robot: Robot) -> tuple[str, ...]:
    """Return the names of the links that have a mass and no collision shape, in the order of the
    robot's frames.
    """
    shaped = {
        robot.model.frames[shape.parentFrame].name
        for shape in robot.collision_model.geometryObjects
    }
    return tuple(
        name
        for name, mass in unknowns.link_masses(robot.model).items()
        if mass > 0.0 and name not in shaped
    )


# Distances of pairs of shapes by coal: of any shapes, and the oracle of those in machine code.


def distance_data(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Memory for distances of the pairs of shapes, which coal finds as exactly as their gradients
    need it.
    """
    data = geometry.createData()
    for request in data.distanceRequests:
        request.gjk_tolerance = _DISTANCE_TOLERANCE
        request.gjk_max_iterations = _MAX_ITERATIONS
    return data


def with_pairs(shapes: pin.GeometryModel, pairs: Iterable[tuple[int, int]]) -> pin.GeometryModel:
    """A copy of the shapes whose pairs are these (by index) alone."""
    geometry = pin.GeometryModel(shapes)
    geometry.removeAllCollisionPairs()
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry


def stowed_distances(robot: Robot, geometry: pin.GeometryModel) -> np.ndarray:
    """Distance (n_pairs,) [m] of every pair of the shapes in the stowed posture."""
    data = geometry.createData()
    pin.computeDistances(
        robot.model, robot.model.createData(), geometry, data, robot.configuration()
    )
    return np.array([result.min_distance for result in data.distanceResults])


class CoalPairs:
    """Some pairs of the shapes of a robot and its obstacles. Not for two threads at once.

    Closed triangle meshes are solids, open ones surfaces; a depth that coal does not find counts as
    a distance of 0.
    """

    def __init__(
        self, model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
    ) -> None:
        """geometry: the shapes, whose pairs (by index) become these."""
        self._model = model
        self._data = model.createData()
        self._geometry = with_pairs(geometry, pairs)
        shapes = geometry.geometryObjects
        self._joints = [(int(shapes[a].parentJoint), int(shapes[b].parentJoint)) for a, b in pairs]
        self._geometry_data = distance_data(self._geometry)
        self._signed = SignedDistances(self._geometry)
        self._contacts: dict[int, PairContact] = {}

    def values(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Distance (n,) [m] of each of the `pairs` (n,) at q (n_q,) [m, rad]."""
        pin.updateGeometryPlacements(
            self._model, self._data, self._geometry, self._geometry_data, q
        )
        for k in pairs:
            self._contacts[int(k)] = self._signed.contact(self._geometry_data, int(k))
        distances = np.array([self._contacts[int(k)].distance for k in pairs])
        return np.where(distances < FAILED, 0.0, distances)

    def gradients(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Gradient (n, n_v) [-, m] of each of the `pairs` (n,); their values were asked for last,
        at q (n_q,) [m, rad].
        """
        pin.computeJointJacobians(self._model, self._data, q)
        return np.array([self._gradient(int(k)) for k in pairs]).reshape(-1, self._model.nv)

    def nearest_points(self, pairs: np.ndarray) -> np.ndarray:
        """Both points (n, 6) [m] in W where the `pairs` (n,) are nearest, of each as it was asked
        for last.
        """
        results = [self._contacts[int(k)] for k in pairs]
        return np.array([[*result.first, *result.second] for result in results]).reshape(-1, 6)

    def _gradient(self, pair: int) -> np.ndarray:
        result = self._contacts[pair]
        (nx, ny, nz) = result.normal
        (x, y, z) = result.first
        wrench = np.array([nx, ny, nz, y * nz - z * ny, z * nx - x * nz, x * ny - y * nx])
        first, second = self._joints[pair]
        row = np.zeros(self._model.nv)
        for joint, sign in ((first, -1.0), (second, 1.0)):
            if joint:
                row += (
                    sign * wrench @ pin.getJointJacobian(self._model, self._data, joint, pin.WORLD)
                )
        return row


# Distances of pairs of shapes in machine code, from Python.


class CompiledPairs:
    """Some pairs of shapes that have a form in C. Not for two threads at once."""

    def __init__(
        self, model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
    ) -> None:
        """geometry: the shapes, of which those of the pairs (by index) are measured."""
        n_solids = len({k for pair in pairs for k in pair})
        sizes = distance_kernels.distance_sizes(model, n_solids=n_solids, n_pairs=len(pairs))
        self._memory, (self._distances, self._gradients) = make_memory(
            structure_of(distance_kernels.DistanceMemory, **sizes),
            (distance_kernels.chosen_distances, distance_kernels.chosen_gradients),
        )
        self.compiled = self._distances is not distance_kernels.chosen_distances
        """True where there is a compiler: without, this is slower than coal."""
        distance_kernels.write_distances(self._memory, model, geometry.geometryObjects, pairs)
        self._q: Any = (ctypes.c_double * model.nq)()
        self._configuration, self._chosen = view(self._q), view(self._memory.chosen)
        self._value, self._gradient = view(self._memory.value), view(self._memory.gradient)

    def values(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Distance (n,) [m] of each of the `pairs` (n,) at q (n_q,) [m, rad]."""
        self._configuration[:] = q
        self._choose(pairs)
        self._distances(self._memory, self._q)
        return np.asarray(self._value[pairs])

    def gradients(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Gradient (n, n_v) [-, m] of each of the `pairs` (n,); their values were asked for last,
        at q (n_q,) [m, rad].
        """
        self._choose(pairs)
        self._gradients(self._memory)
        return np.array(self._gradient[: len(pairs)])

    def _choose(self, pairs: np.ndarray) -> None:
        self._memory.n_chosen = len(pairs)
        self._chosen[: len(pairs)] = pairs


# Signed distances of a robot's shapes from obstacles and from each other, with gradients.

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

    Pairs of links that are neighbours, or overlap in the stowed posture, touch by design and are
    left out. Spheres, capsules, cylinders and boxes are measured in machine code, other shapes, and
    all where there is no compiler, by coal: the same to 1e-6 m while they are apart. Of shapes that
    overlap coal tells some depth, machine code the smallest; a depth that coal does not find is
    taken for a distance of 0. Closed triangle meshes are solids, open ones surfaces. Holds working
    memory: not for two threads at once.
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
        checked = [names.index(name) for name in _known(links, names)]
        pairs = [(o, i) for o in range(n_links, self._geometry.ngeoms) for i in checked]
        self._pairs = pairs + (self_pairs(robot) if self_collision else [])
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
        shapes = self._geometry.geometryObjects
        return tuple(
            shapes[k].name
            for k in _used(self._pairs)
            if not distance_kernels.has_kernel(shapes[k].geometry)
        )

    @property
    def n_solids(self) -> int:
        """Shapes that are in some pair."""
        return len(_used(self._pairs))

    def is_of(self, robot: Robot) -> bool:
        """True where its shapes are on a robot of the same joints."""
        return bool(self._model == robot.model)

    def write(self, memory: distance_kernels.DistanceMemory) -> None:
        """Into a `DistanceMemory` of those sizes, or larger: the pairs, in their order. Raises
        `InvalidInput` for a mesh.
        """
        if self.without_c_form:
            given = f"shapes {', '.join(self.without_c_form)} have no form in C"
            raise InvalidInput(f"{given}; give spheres, capsules, cylinders and boxes")
        distance_kernels.write_distances(
            memory, self._model, self._geometry.geometryObjects, self._pairs
        )

    def values(self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Distance (n_pairs,) [m] at q (n_q,) [m, rad] of all pairs, or (n,) of some, by their
        indices `pairs` (n,).

        Each index once.
        """
        found = np.empty(self.n_pairs if pairs is None else len(pairs))
        for engine, rows, places in self._shared(pairs):
            found[rows] = engine.values(q, places)
        return found

    def distances(
        self, q: np.ndarray, pairs: Sequence[int] | np.ndarray | None = None
    ) -> Distances:
        """Distances at q (n_q,) [m, rad], with gradients ``n . (v_2 - v_1)`` at the witness points.

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
        """Find which model measures which of the `pairs`: rows here, indices there."""
        for engine, place in self._engines:
            asked = place if pairs is None else place[np.asarray(pairs, dtype=int)]
            if len(self._engines) == 1:
                yield engine, slice(None), asked
            elif len(rows := np.flatnonzero(asked >= 0)):
                yield engine, rows, asked[rows]


def _engines(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
) -> list[tuple[_Engine, np.ndarray]]:
    """Models that measure the pairs, and the index (n_pairs,) there of each, -1 of others."""
    shapes = geometry.geometryObjects
    clear = np.array(
        [all(distance_kernels.has_kernel(shapes[k].geometry) for k in pair) for pair in pairs],
        dtype=bool,
    )
    engines: list[tuple[_Engine, np.ndarray]] = []
    if clear.any():
        compiled = CompiledPairs(
            model, geometry, [pair for pair, has in zip(pairs, clear, strict=True) if has]
        )
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
    geometry = with_pairs(robot.collision_model, ())
    for item in obstacles:
        geometry.addGeometryObject(pin.GeometryObject(item.name, 0, item.X_WO, item.shape))
    return geometry


def self_pairs(robot: Robot) -> list[tuple[int, int]]:
    """Pairs of shapes on links that are no neighbours and stay apart in the stowed posture: others
    are built to touch.
    """
    joints = [int(shape.parentJoint) for shape in robot.collision_model.geometryObjects]
    parents = list(robot.model.parents)
    far = [
        (a, b)
        for a in range(len(joints))
        for b in range(a + 1, len(joints))
        if joints[a] != joints[b]
        and parents[joints[a]] != joints[b]
        and parents[joints[b]] != joints[a]
    ]
    distances = stowed_distances(robot, with_pairs(robot.collision_model, far))
    return [pair for pair, distance in zip(far, distances, strict=True) if distance > 0.0]


def _pair_reach(
    robot: Robot, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
) -> np.ndarray:
    """(n_v,) largest over all pairs; an axis that carries both shapes of a pair alike does not
    change its distance.
    """
    reaches = [kinematics.shape_reach(robot, shape) for shape in geometry.geometryObjects]
    both = [(reaches[a], reaches[b]) for a, b in pairs]
    apart = np.isin(
        np.arange(robot.n_v), [robot.joint(name).idx_v for name in robot.leading_joints]
    )
    moved = [
        np.where(apart, a + b, np.where((a > 0) != (b > 0), np.maximum(a, b), 0.0)) for a, b in both
    ]
    return np.asarray(np.max([np.zeros(robot.n_v), *moved], axis=0))


def _known(links: Sequence[str] | None, names: Sequence[str]) -> Sequence[str]:
    unknown = sorted(set(links or ()) - set(names))
    if unknown:
        raise InvalidInput(f"shapes {unknown} to check for collision; allowed: {', '.join(names)}")
    return names if links is None else links


# Room for the pairs of collision models in the memories of a tick, whose kernels measure them where
# they can.


def in_c(model: CollisionModel, robot: Robot | None) -> bool:
    """True where kernels measure its pairs: all of them have machine code, and are on this
    robot.
    """
    return robot is not None and not model.by_coal and model.is_of(robot)


def distance_layout_sizes(models: Iterable[CollisionModel], robot: Robot | None) -> dict[str, Any]:
    """Sizes for `structure_of` layouts with a `DistanceMemory` for any of the models; Python
    measures those not `in_c`.
    """
    known = list(models)
    n_pairs = max((model.n_pairs for model in known), default=0)
    measured = [model.n_solids for model in known if in_c(model, robot)]
    if robot is None or not measured:
        n_v = max([model.n_v for model in known] if robot is None else [robot.n_v], default=0)
        # Room for all axes, also where none is looked at: compilers see what a kernel could read.
        return {
            "places": _nothing(),
            "n_placements": 12,
            "n_twists": 6 * n_v,
            "n_axes": n_v,
            "n_solids": 1,
            "n_pairs": n_pairs,
        }
    return distance_kernels.distance_sizes(robot.model, n_solids=max(measured), n_pairs=n_pairs)


def without_c_form(model: CollisionModel, robot: Robot | None) -> str:
    """Describe why kernels cannot measure the pairs even where there is a compiler; empty where
    they can.
    """
    if model.without_c_form:
        return (
            f"distances of {', '.join(model.without_c_form)}; spheres, capsules, cylinders and"
            " boxes have"
        )
    return "" if robot is not None and model.is_of(robot) else "distances of another robot"


@cache
def _nothing() -> ca.Function:
    return ca.Function("places", [ca.SX.sym("q")], [ca.SX(ca.DM.zeros(1)), ca.SX(ca.DM.zeros(1))])
