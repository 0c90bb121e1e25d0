"""Distances of pairs of shapes by coal: of any shapes, and the oracle of those in machine code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

_DISTANCE_TOLERANCE = 1e-9  # coal's default of 1e-6 shows as noise in the gradients
_MAX_ITERATIONS = 512
_FAILED = -1e3  # [m] what coal reports below it is no distance but a search that failed


class CoalPairs:
    """Some pairs of the shapes of a robot and its obstacles. Not for two threads at once.

    A triangle mesh has no inside: overlap with it counts as a distance of 0, and so does a depth that coal does not find.
    """

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]) -> None:
        """geometry: the shapes, whose pairs (by index) become these."""
        self._model, self._data, self._geometry = model, model.createData(), pin.GeometryModel(geometry)
        self._geometry.removeAllCollisionPairs()
        for first, second in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))
        shapes = geometry.geometryObjects
        self._joints = [(int(shapes[a].parentJoint), int(shapes[b].parentJoint)) for a, b in pairs]
        self._geometry_data = self._geometry.createData()
        for request in self._geometry_data.distanceRequests:
            request.gjk_tolerance, request.gjk_max_iterations = _DISTANCE_TOLERANCE, _MAX_ITERATIONS

    def values(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Distance (n,) [m] of each of the `pairs` (n,) [-] at q (n_q,) [m, rad]."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        results = [pin.computeDistance(self._geometry, self._geometry_data, int(k)) for k in pairs]
        found = np.array([result.min_distance for result in results])
        return np.where(found < _FAILED, 0.0, found)

    def gradients(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Gradient (n, n_v) [-, m] of each of the `pairs` (n,) [-]; their values were asked for last, at q (n_q,) [m, rad]."""
        pin.computeJointJacobians(self._model, self._data, q)
        return np.array([self._gradient(int(k)) for k in pairs]).reshape(-1, self._model.nv)

    def nearest_points(self, pairs: np.ndarray) -> np.ndarray:
        """Both points (n, 6) [m] in W where the `pairs` (n,) [-] are nearest, of each as it was asked for last."""
        results = [self._geometry_data.distanceResults[int(k)] for k in pairs]
        found = [[*result.getNearestPoint1(), *result.getNearestPoint2()] for result in results]
        return np.array(found).reshape(-1, 6)

    def _gradient(self, pair: int) -> np.ndarray:
        result = self._geometry_data.distanceResults[pair]
        (nx, ny, nz), (x, y, z) = result.normal, result.getNearestPoint1()
        wrench = np.array([nx, ny, nz, y * nz - z * ny, z * nx - x * nz, x * ny - y * nx])
        first, second = self._joints[pair]
        row = np.zeros(self._model.nv)
        for joint, sign in ((first, -1.0), (second, 1.0)):
            if joint:
                row += sign * wrench @ pin.getJointJacobian(self._model, self._data, joint, pin.WORLD)
        return row
