"""Collision scene of a plan: the robot's shapes, the obstacles, and the pairs that must stay
apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.planning.planned_axes import Coordinates
from uvms_ocp.robot.kinematics import shape_reach
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle, require_distinct_names
from uvms_ocp.robot.shapes.shape_pairs import (
    self_pairs,
    shapes_among,
    stowed_distances,
    with_pairs,
)
from uvms_ocp.types import Array, Finite, Shape

_LINKS = "its own links"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pair:
    """Pair of shapes whose distance counts, by index in the geometry model, with the joints that
    carry them (0 is the world).
    """

    first: int
    second: int
    first_joint: int
    second_joint: int
    name: str


@dataclass(frozen=True, kw_only=True, slots=True)
class NearestPair:
    """The smallest of many distances."""

    distance: float
    """[m]; infinite where there are no pairs."""
    time: float
    """[s] Time of the smallest distance."""
    pair: str
    """The two shapes it is between; empty where there are no pairs."""


@checked_dataclass(eq=False)
class CollisionScene:
    """Collision scene of ``collision_scene``: a geometry model whose pairs are the ones checked."""

    coordinates: Coordinates
    geometry: pin.GeometryModel
    pairs: tuple[Pair, ...]
    moved: Array
    """(n_pairs, n_columns) -1, 0 or 1: does the column move the second shape minus does it move the
    first.
    """
    reach: Array
    """(n_pairs, n_axes) [m per unit of the axis] upper bound on |d distance / d axis| at any
    configuration.
    """
    carried: Array
    """(n_pairs, n_columns) 1 where the column moves the second shape."""
    follows: Array
    """(n_columns, n_columns) see ``Coordinates.follows``."""
    fold: Array
    """(n_columns, n_axes) see ``Coordinates.fold``."""
    gyration: Array
    """(n_pairs,) [m] radius of gyration of the ball around the second shape."""
    room: Array
    """(n_pairs,) [m] half the distance of two links at ``robot.home``, close by design; infinite
    for obstacles.
    """

    @property
    def n_pairs(self) -> int:
        """Number of pairs."""
        return len(self.pairs)

    @checked_on_failure
    def is_obstacle(self, shape: int) -> bool:
        """True for the index of an obstacle; the robot's own shapes come first."""
        return shape >= self.coordinates.robot.collision_model.ngeoms

    @checked_on_failure
    def nearest(
        self,
        t: Annotated[Array, Shape("n")],
        distances: Annotated[Array, Shape("n", "self.n_pairs")],
    ) -> NearestPair:
        """Return the smallest of the distances (n, n_pairs) [m] at times t (n,) [s]."""
        if not distances.size:
            return NearestPair(distance=np.inf, time=0.0, pair="")
        row, pair = np.unravel_index(int(np.argmin(distances)), distances.shape)
        return NearestPair(
            distance=float(distances[row, pair]), time=float(t[row]), pair=self.pairs[pair].name
        )

    def among(self, indices: Sequence[int]) -> CollisionScene:
        """Return the scene with only these of its pairs. Raises `InvalidInput` for an index that no
        pair has.
        """
        chosen = np.array(indices, dtype=int)
        if not ((chosen >= 0) & (chosen < len(self.pairs))).all():
            raise InvalidInput(
                f"indices are {indices}; give some of 0 to {len(self.pairs) - 1}, the pairs of the"
                " scene"
            )
        pairs = tuple(self.pairs[k] for k in indices)
        geometry = with_pairs(self.geometry, ((pair.first, pair.second) for pair in pairs))
        return replace(
            self,
            geometry=geometry,
            pairs=pairs,
            moved=self.moved[chosen],
            reach=self.reach[chosen],
            carried=self.carried[chosen],
            gyration=self.gyration[chosen],
            room=self.room[chosen],
        )

    def groups(self) -> dict[str, list[int]]:
        """Return the indices of pairs by the obstacle they are with, and those of two links."""
        groups: dict[str, list[int]] = {}
        for index, pair in enumerate(self.pairs):
            name = _LINKS
            if self.is_obstacle(pair.first):
                name = self.geometry.geometryObjects[pair.first].name
            groups.setdefault(name, []).append(index)
        return groups

    def per_pair(self, of_obstacles: Finite, of_links: Finite | None) -> Array:
        """Return (n_pairs,) numbers: `of_obstacles` for pairs with an obstacle, `of_links`, where
        given, for those of two links.
        """
        if of_links is None:
            return np.full(len(self.pairs), of_obstacles)
        is_with_obstacle = [self.is_obstacle(pair.first) for pair in self.pairs]
        return np.where(is_with_obstacle, of_obstacles, of_links)

    def check_no_overlap(
        self, distances: Annotated[Array, Shape("self.n_pairs")], place: str
    ) -> None:
        """Raise `InvalidInput` where two shapes touch, by the distances (n_pairs,) [m] at the place
        of that name.
        """
        if distances.min(initial=np.inf) <= 0.0:
            nearest = int(np.argmin(distances))
            overlap = (
                f"{place} is in collision: {self.pairs[nearest].name} overlap by"
                f" {abs(distances[nearest]):.3g} m"
            )
            raise InvalidInput(f"{overlap}; move it or the obstacle")


@checked
def collision_scene(
    coordinates: Coordinates, obstacles: Sequence[Obstacle], *, self_collision: bool = True
) -> CollisionScene:
    """Return all pairs link - obstacle, and the pairs of links of `self_pairs`, except those that
    no planned axis moves.

    Raises `InvalidInput` for two obstacles of one name.
    """
    require_distinct_names(obstacles)
    robot = coordinates.robot
    geometry = shapes_among(robot, obstacles)
    n_links = robot.collision_model.ngeoms
    names = [shape.name for shape in geometry.geometryObjects]
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    indices = list(product(range(n_links, geometry.ngeoms), range(n_links)))
    if self_collision:
        indices += self_pairs(robot)
    pairs = []
    for first, second in indices:
        pairs.append(
            Pair(
                first=first,
                second=second,
                first_joint=joints[first],
                second_joint=joints[second],
                name=f"{names[first]} - {names[second]}",
            )
        )
    return _with_moving_pairs(coordinates, geometry, pairs)


def _with_moving_pairs(
    coordinates: Coordinates, geometry: pin.GeometryModel, candidates: Sequence[Pair]
) -> CollisionScene:
    """Return the scene with those candidates between which a planned axis moves."""
    supports = _supports(coordinates)
    fold = coordinates.fold
    is_led = fold.sum(axis=0) > 1.0  # axes that other joints mimic
    shapes = geometry.geometryObjects
    reaches = [shape_reach(coordinates.robot, shape)[coordinates.planned] for shape in shapes]
    pairs = []
    motions = []
    reach_of_pairs = []
    for pair in candidates:
        motion = supports[pair.second_joint] - supports[pair.first_joint]
        if motion.any():
            first = reaches[pair.first]
            second = reaches[pair.second]
            pairs.append(pair)
            motions.append(motion)
            reach_of_pairs.append(np.where(is_led, first + second, np.maximum(first, second)))
    moved = np.array(motions).reshape(len(pairs), len(fold))
    reach = np.array(reach_of_pairs).reshape(len(pairs), coordinates.n_axes)
    carried = np.array([supports[pair.second_joint] for pair in pairs]).reshape(moved.shape)
    radii = np.array([shapes[pair.second].geometry.aabb_radius for pair in pairs])
    geometry = with_pairs(geometry, ((pair.first, pair.second) for pair in pairs))
    return CollisionScene(
        coordinates=coordinates,
        geometry=geometry,
        pairs=tuple(pairs),
        moved=moved,
        reach=np.where(np.abs(moved) @ fold > 0.0, reach, 0.0),
        carried=carried,
        follows=coordinates.follows(),
        fold=fold,
        gyration=radii * np.sqrt(0.4),
        room=_room(coordinates.robot, geometry, pairs),
    )


def _room(robot: Robot, geometry: pin.GeometryModel, pairs: Sequence[Pair]) -> Array:
    """Return (n_pairs,) [m] half the distance of two links at ``robot.home``; infinite for
    obstacles.
    """
    is_of_links = [pair.first_joint > 0 and pair.second_joint > 0 for pair in pairs]
    return np.where(is_of_links, stowed_distances(robot, geometry) / 2.0, np.inf)


def _supports(coordinates: Coordinates) -> Array:
    """Return (n_joints + 1, n_columns) 1 where the column moves the joint, else 0."""
    model = coordinates.robot.model
    supports = np.zeros((model.njoints, model.nvExtended))
    for joint in range(1, model.njoints):
        for carrier in list(model.supports[joint])[1:]:
            first = model.joints[carrier].idx_vExtended
            supports[joint, first : first + model.joints[carrier].nvExtended] = 1.0
    return supports[:, coordinates.columns]
