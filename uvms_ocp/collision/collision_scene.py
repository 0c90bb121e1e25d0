"""The robot's shapes, the obstacles, and the pairs of them that must stay apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Shape, checked, late
from uvms_ocp.arrays import Array
from uvms_ocp.collision.coordinates import Coordinates
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.axis_reach import shape_reach
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.collision_model import self_pairs, shapes_among
from uvms_ocp.model.shapes.obstacles import Obstacle

_LINKS = "its own links"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pair:
    """Two shapes by index in the geometry model, and the joints that carry them (0 is the world)."""

    first: int
    second: int
    first_joint: int
    second_joint: int
    name: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Nearest:
    """The smallest of many distances."""

    distance: float
    """[m]; infinite where there are no pairs."""
    time: float
    """[s] where it is."""
    pair: str
    """The two shapes it is between; empty where there are no pairs."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CollisionScene:
    """What ``collision_scene`` builds: a geometry model whose pairs are the ones checked."""

    coordinates: Coordinates
    geometry: pin.GeometryModel
    pairs: tuple[Pair, ...]
    moved: Array
    """(n_pairs, n_axes) [-] -1, 0 or 1: does the axis move the second shape minus does it move the first."""
    reach: Array
    """(n_pairs, n_axes) [m per unit of the axis] upper bound on |d distance / d axis| at any configuration."""
    carried: Array
    """(n_pairs, n_axes) [-] 1 where the axis moves the second shape."""
    follows: Array
    """(n_axes, n_axes) [-] see ``Coordinates.follows``."""
    gyration: Array
    """(n_pairs,) [m] radius of gyration of the ball around the second shape."""
    room: Array
    """(n_pairs,) [m] half the distance of two links at ``robot.home``, close by design; infinite for obstacles."""

    @property
    def n_pairs(self) -> int:
        return len(self.pairs)

    @late
    def is_obstacle(self, shape: int) -> bool:
        """True for the index of an obstacle; the robot's own shapes come first."""
        return shape >= self.coordinates.robot.collision_model.ngeoms

    @late
    def nearest(
        self, t: Annotated[Array, Shape("n")], distances: Annotated[Array, Shape("n", "self.n_pairs")]
    ) -> Nearest:
        """The smallest of the distances (n, n_pairs) [m] at times t (n,) [s]."""
        if not distances.size:
            return Nearest(distance=np.inf, time=0.0, pair="")
        row, pair = np.unravel_index(int(np.argmin(distances)), distances.shape)
        return Nearest(distance=float(distances[row, pair]), time=float(t[row]), pair=self.pairs[pair].name)

    def among(self, indices: Sequence[int]) -> CollisionScene:
        """The same scene with these of its pairs alone. Raises `InvalidInput` for an index that no pair has."""
        chosen = np.array(indices, dtype=int)
        if not ((chosen >= 0) & (chosen < len(self.pairs))).all():
            raise InvalidInput(
                f"indices are {indices}; give some of 0 to {len(self.pairs) - 1}, the pairs of the scene"
            )
        geometry = pin.GeometryModel(self.geometry)
        geometry.removeAllCollisionPairs()
        pairs = tuple(self.pairs[k] for k in indices)
        for pair in pairs:
            geometry.addCollisionPair(pin.CollisionPair(pair.first, pair.second))
        parts = {name: getattr(self, name)[chosen] for name in ("moved", "reach", "carried", "gyration", "room")}
        return replace(self, geometry=geometry, pairs=pairs, **parts)

    def groups(self) -> dict[str, list[int]]:
        """Indices of pairs by the obstacle they are with, and those of two links."""
        groups: dict[str, list[int]] = {}
        for index, pair in enumerate(self.pairs):
            name = self.geometry.geometryObjects[pair.first].name if self.is_obstacle(pair.first) else _LINKS
            groups.setdefault(name, []).append(index)
        return groups

    def check_apart(self, distances: Annotated[Array, Shape("self.n_pairs")], place: str) -> None:
        """Raise `InvalidInput` where two shapes touch, by the distances (n_pairs,) [m] at the place of that name."""
        if distances.min(initial=np.inf) <= 0.0:
            nearest = int(np.argmin(distances))
            raise InvalidInput(
                f"{place} is in collision: {self.pairs[nearest].name} overlap by {abs(distances[nearest]):.3g} m; "
                "move it or the obstacle"
            )


@checked
def collision_scene(
    coordinates: Coordinates, obstacles: Sequence[Obstacle], *, self_collision: bool = True
) -> CollisionScene:
    """All pairs link - obstacle, and the pairs of links of `self_pairs`, except those that no planned axis moves."""
    robot = coordinates.robot
    geometry, n_links = shapes_among(robot, obstacles), robot.collision_model.ngeoms
    names = [shape.name for shape in geometry.geometryObjects]
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    indices = [(o, i) for o in range(n_links, geometry.ngeoms) for i in range(n_links)]
    if self_collision:
        indices += self_pairs(robot)
    pairs = [
        Pair(first=a, second=b, first_joint=joints[a], second_joint=joints[b], name=f"{names[a]} - {names[b]}")
        for a, b in indices
    ]
    return _with_moving_pairs(coordinates, geometry, pairs)


def _with_moving_pairs(
    coordinates: Coordinates, geometry: pin.GeometryModel, candidates: Sequence[Pair]
) -> CollisionScene:
    supports = _supports(coordinates)
    reaches = np.stack([_reach(coordinates, shape) for shape in geometry.geometryObjects])
    pairs = [pair for pair in candidates if (supports[pair.second_joint] != supports[pair.first_joint]).any()]
    shape = (len(pairs), coordinates.n_axes)
    moved = np.array([supports[p.second_joint] - supports[p.first_joint] for p in pairs]).reshape(shape)
    reach = np.array([np.maximum(reaches[p.first], reaches[p.second]) for p in pairs]).reshape(shape)
    carried = np.array([supports[p.second_joint] for p in pairs]).reshape(shape)
    radii = np.array([geometry.geometryObjects[p.second].geometry.aabb_radius for p in pairs])
    for pair in pairs:
        geometry.addCollisionPair(pin.CollisionPair(pair.first, pair.second))
    return CollisionScene(
        coordinates=coordinates,
        geometry=geometry,
        pairs=tuple(pairs),
        moved=moved,
        reach=np.where(moved != 0.0, reach, 0.0),
        carried=carried,
        follows=coordinates.follows(),
        gyration=radii * np.sqrt(0.4),
        room=_room(coordinates.robot, geometry, pairs),
    )


def _room(robot: Robot, geometry: pin.GeometryModel, pairs: Sequence[Pair]) -> Array:
    data = geometry.createData()
    pin.computeDistances(robot.model, robot.model.createData(), geometry, data, robot.configuration())
    return np.array(
        [
            data.distanceResults[k].min_distance / 2.0 if pair.first_joint and pair.second_joint else np.inf
            for k, pair in enumerate(pairs)
        ]
    )


def _supports(coordinates: Coordinates) -> Array:
    """(n_joints + 1, n_axes) 1 where the axis moves the joint."""
    model = coordinates.robot.model
    supports = np.zeros((model.njoints, model.nv))
    for joint in range(1, model.njoints):
        for carrier in list(model.supports[joint])[1:]:
            first = model.joints[carrier].idx_v
            supports[joint, first : first + model.joints[carrier].nv] = 1.0
    return supports[:, coordinates.planned]


def _reach(coordinates: Coordinates, shape: pin.GeometryObject) -> Array:
    """(n_axes,) the farthest that one unit of each planned axis can move any point of a shape [m]."""
    return shape_reach(coordinates.robot, shape)[coordinates.planned]
