"""Distances between the robot's shapes, and to solids in the world, with their gradients."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot

FAR = 100.0  # [m] stands in for a distance where there is no pair
_BUILT_TO_TOUCH = 0.02  # [m] links closer than this at home are so by design


class Solid(Protocol):
    """A shape that stands in the world."""

    @property
    def name(self) -> str: ...
    @property
    def shape(self) -> coal.CollisionGeometry: ...
    @property
    def X_WO(self) -> pin.SE3: ...


class ClearanceSensor:
    """The `nearest` smallest distances at a configuration and their gradients: ``sensor(q)``.

    The robot's cylinders are taken as capsules around them: the witness points of smooth shapes do not jump. Pairs are
    robot - solid, and links two or more joints apart that do not touch at ``robot.home``. They keep their order from
    tick to tick as long as the same ones are near.
    """

    def __init__(self, robot: Robot, solids: Sequence[Solid], *, nearest: int, self_clearance: bool = True) -> None:
        self._robot, self._nearest = robot, nearest
        self._geometry, links = _with_solids(robot, solids)
        pairs = [(i, j) for j in range(links, self._geometry.ngeoms) for i in range(links)]
        pairs += _self_pairs(robot, self._geometry, links) if self_clearance else []
        for i, j in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._data, self._distances = robot.model.createData(), self._geometry.createData()

    @property
    def n_pairs(self) -> int:
        """Pairs that are watched."""
        return len(self._geometry.collisionPairs)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """(nearest (1 + n_v),): distances [m], below 0 in penetration, then the rows of d distance = row @ v, by rows.

        Rows beyond the number of pairs are at `FAR` with a gradient of zero.
        """
        pin.computeJointJacobians(self._robot.model, self._data, q)
        pin.computeDistances(self._robot.model, self._data, self._geometry, self._distances, q)
        results = self._distances.distanceResults
        distances = np.array([result.min_distance for result in results])
        chosen = np.sort(np.argsort(distances, kind="stable")[: self._nearest])
        values, gradients = np.full(self._nearest, FAR), np.zeros((self._nearest, self._robot.n_v))
        for row, pair in enumerate(chosen):
            values[row], gradients[row] = distances[pair], self._gradient(int(pair))
        return np.concatenate([values, gradients.ravel()])

    def _gradient(self, pair: int) -> np.ndarray:
        result, names = self._distances.distanceResults[pair], self._geometry.collisionPairs[pair]
        first = self._normal_row(names.first, result.normal, result.getNearestPoint1())
        second = self._normal_row(names.second, result.normal, result.getNearestPoint2())
        return second - first

    def _normal_row(self, shape: int, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Row (n_v,) of the velocity along `normal` of the point of a shape that is at `point` in W now."""
        joint = self._geometry.geometryObjects[shape].parentJoint
        if joint == 0:
            return np.zeros(self._robot.n_v)
        J = pin.getJointJacobian(self._robot.model, self._data, joint, pin.LOCAL_WORLD_ALIGNED)
        arm = point - self._data.oMi[joint].translation
        return np.asarray(normal @ J[:3] + np.cross(arm, normal) @ J[3:])


def _with_solids(robot: Robot, solids: Sequence[Solid]) -> tuple[pin.GeometryModel, int]:
    """Shapes of the robot, smooth where possible, then the solids; and the number of the former."""
    geometry = pin.GeometryModel(robot.collision_model)
    geometry.removeAllCollisionPairs()
    for shape in geometry.geometryObjects:
        if isinstance(shape.geometry, coal.Cylinder):
            shape.geometry = coal.Capsule(shape.geometry.radius, 2.0 * shape.geometry.halfLength)
    links = geometry.ngeoms
    for solid in solids:
        geometry.addGeometryObject(pin.GeometryObject(f"solid {solid.name}", 0, solid.X_WO, solid.shape))
    return geometry, links


def _self_pairs(robot: Robot, geometry: pin.GeometryModel, links: int) -> list[tuple[int, int]]:
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    parents = robot.model.parents
    far = [
        (i, j)
        for i in range(links)
        for j in range(i + 1, links)
        if joints[i] != joints[j] and parents[joints[i]] != joints[j] and parents[joints[j]] != joints[i]
    ]
    watched = pin.GeometryModel(geometry)
    for i, j in far:
        watched.addCollisionPair(pin.CollisionPair(i, j))
    data, home = watched.createData(), robot.configuration(joints=robot.home)
    pin.computeDistances(robot.model, robot.model.createData(), watched, data, home)
    return [
        pair for pair, result in zip(far, data.distanceResults, strict=True) if result.min_distance > _BUILT_TO_TOUCH
    ]
