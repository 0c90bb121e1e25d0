"""Rows that keep shapes apart where a motion is: planes through their nearest points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from truth.statement import Node, ShapeRows
from uvms_ocp.robot import Robot

_NEAR = 0.5  # [m] from which on a pair gets rows
_MOST = 14  # pairs with rows
_SIZE = 3 + 3 + 3 + 1  # normal, point of the plane, point beyond it, margin


class Distances:
    """Signed distances of the pairs of a statement, by coal through Pinocchio."""

    def __init__(self, robot: Robot, shapes: ShapeRows) -> None:
        self.robot = robot
        self.shapes = shapes
        self._geometry = pin.GeometryModel(shapes.geometry)  # its obstacles are moved
        self._data = robot.model.createData()
        self._found = self._geometry.createData()

    def measure(self, q: np.ndarray, t: float) -> np.ndarray:
        """(n_pairs,) [m] at q (n_q,) [m, rad] and time t [s]."""
        for name, place in self.shapes.moving.items():
            self._geometry.geometryObjects[self._geometry.getGeometryId(name)].placement = place(t)
        pin.computeDistances(self.robot.model, self._data, self._geometry, self._found, q)
        return np.array([result.min_distance for result in self._found.distanceResults])

    def nearest_points(self, pair: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (3,) [m] in W of both shapes of a pair, and the normal from the first to the
        second, where they were measured last.
        """
        result = self._found.distanceResults[pair]
        return result.getNearestPoint1(), result.getNearestPoint2(), np.array(result.normal)

    def joints(self, pair: int) -> tuple[int, int]:
        """Joints that carry the shapes of a pair; 0 is the world."""
        shapes = self._geometry.collisionPairs[pair]
        objects = self._geometry.geometryObjects
        return objects[shapes.first].parentJoint, objects[shapes.second].parentJoint

    def placement(self, joint: int) -> pin.SE3:
        """X_WJ where it was measured last."""
        return self._data.oMi[joint] if joint else pin.SE3.Identity()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlaneRows:
    """One row for each chosen pair: a point of one shape stays beyond a plane on the other."""

    distances: Distances
    pairs: tuple[int, ...]

    @property
    def n_parameters(self) -> int:
        """Parameters of a node."""
        return _SIZE * len(self.pairs)

    def rows(self, node: Node, parameters: ca.SX) -> ca.SX:
        """Heights over the planes [m] less margins (n_pairs,), >= 0."""
        rows = []
        for i, pair in enumerate(self.pairs):
            normal, foot, point, margin = ca.vertsplit(
                parameters[_SIZE * i : _SIZE * (i + 1)], [0, 3, 6, 9, 10]
            )
            first_joint, second_joint = self.distances.joints(pair)
            first_R, first_p = _pose(node, first_joint)
            second_R, second_p = _pose(node, second_joint)
            beyond = second_p + second_R @ point - first_p - first_R @ foot
            rows.append(ca.dot(first_R @ normal, beyond) - margin)
        return ca.vertcat(ca.SX(0, 1), *rows)

    def parameters(self, q: np.ndarray, times: Sequence[float]) -> np.ndarray:
        """(n, n_parameters) of nodes at q (n, n_q) [m, rad] and times (n,) [s]."""
        return np.array([self._at(row, t) for row, t in zip(q, times, strict=True)])

    def _at(self, q: np.ndarray, t: float) -> np.ndarray:
        self.distances.measure(q, t)
        parts = []
        for pair in self.pairs:
            foot, point, normal = self.distances.nearest_points(pair)
            first_joint, second_joint = self.distances.joints(pair)
            first = self.distances.placement(first_joint)
            second = self.distances.placement(second_joint)
            parts += [
                first.rotation.T @ normal,
                first.actInv(foot),
                second.actInv(point),
                self.distances.shapes.margins[[pair]],
            ]
        return np.concatenate(parts)


def _pose(node: Node, joint: int) -> tuple[ca.SX, ca.SX]:
    if joint == 0:
        return ca.SX.eye(3), ca.SX.zeros(3)
    pose = node.kinematics.joint_poses[joint]
    return pose.R, pose.p


def plane_rows(
    robot: Robot, shapes: ShapeRows, motions: Sequence[tuple[np.ndarray, Sequence[float]]]
) -> PlaneRows:
    """Choose the pairs that come near on any of the motions, of q (n, n_q) [m, rad] at times (n,)
    [s].
    """
    distances = Distances(robot, shapes)
    smallest = np.full(len(shapes.margins), np.inf)
    for q, times in motions:
        for row, t in zip(q, times, strict=True):
            smallest = np.minimum(smallest, distances.measure(row, t) - shapes.margins)
    order = np.argsort(smallest)[:_MOST]
    return PlaneRows(distances=distances, pairs=tuple(order[smallest[order] < _NEAR].tolist()))
