"""Signed distances of pairs of shapes with their gradients: by coal, of any shapes, or in machine
code, of those that have a form in C.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.codegen.kernel_layout import structure_of, view
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.shapes import distance_kernels
from uvms_ocp.robot.shapes.shape_pairs import shapes_in, with_pairs
from uvms_ocp.robot.shapes.signed_distance import PairContact, SignedDistances

# coal's default of 1e-6 shows as noise in finite differences. 1e-12 made 4 of 264,000 distances
# fail or be wrong by centimetres; 1e-9 none of 2.6 million. The penetration solver keeps its
# default: with less it fails often, with it once in 10,000 overlaps, and then reports -1e308.
_DISTANCE_TOLERANCE = 1e-9
_MAX_ITERATIONS = 512
FAILED = -1e3
"""[m] value of coal below which it is no distance, but a search that failed."""


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
        """Return the distance (n,) [m] of each of the `pairs` (n,) at q (n_q,) [m, rad]."""
        pin.updateGeometryPlacements(
            self._model, self._data, self._geometry, self._geometry_data, q
        )
        for k in pairs:
            self._contacts[int(k)] = self._signed.contact(self._geometry_data, int(k))
        distances = np.array([self._contacts[int(k)].distance for k in pairs])
        return np.where(distances < FAILED, 0.0, distances)

    def gradients(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return the gradient (n, n_v) [-, m] of each of the `pairs` (n,); their values were asked
        for last, at q (n_q,) [m, rad].
        """
        pin.computeJointJacobians(self._model, self._data, q)
        return np.array([self._gradient(int(k)) for k in pairs]).reshape(-1, self._model.nv)

    def nearest_points(self, pairs: np.ndarray) -> np.ndarray:
        """Return both points (n, 6) [m] in W where the `pairs` (n,) are nearest, of each as it was
        asked for last.
        """
        contacts = [self._contacts[int(k)] for k in pairs]
        points = [[*contact.first, *contact.second] for contact in contacts]
        return np.array(points).reshape(-1, 6)

    def _gradient(self, pair: int) -> np.ndarray:
        """Return (n_v,) [-, m], the rate of the distance per unit of each velocity."""
        contact = self._contacts[pair]
        nx, ny, nz = contact.normal
        x, y, z = contact.first
        wrench = np.array([nx, ny, nz, y * nz - z * ny, z * nx - x * nz, x * ny - y * nx])
        first, second = self._joints[pair]
        gradient = np.zeros(self._model.nv)
        for joint, sign in ((first, -1.0), (second, 1.0)):
            if joint:
                J = pin.getJointJacobian(self._model, self._data, joint, pin.WORLD)
                gradient += sign * wrench @ J
        return gradient


def distance_data(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Make memory for distances of the pairs of shapes, which coal finds as exactly as their
    gradients need it.
    """
    data = geometry.createData()
    for request in data.distanceRequests:
        request.gjk_tolerance = _DISTANCE_TOLERANCE
        request.gjk_max_iterations = _MAX_ITERATIONS
    return data


class CompiledPairs:
    """Some pairs of shapes that have a form in C. Not for two threads at once."""

    def __init__(
        self, model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]
    ) -> None:
        """geometry: the shapes, of which those of the pairs (by index) are measured."""
        n_solids = len(shapes_in(pairs))
        dimensions = distance_kernels.with_distances(
            Dimensions(), model, n_solids=n_solids, n_pairs=len(pairs)
        )
        structure = structure_of(
            distance_kernels.DistanceMemory,
            dimensions,
            places=distance_kernels.places_function(model),
        )
        self._memory, (self._distances, self._gradients) = make_memory(
            structure,
            (distance_kernels.chosen_distances, distance_kernels.chosen_gradients),
        )
        self.compiled = self._distances is not distance_kernels.chosen_distances
        """True where there is a compiler: without, this is slower than coal."""
        distance_kernels.write_distances(self._memory, model, geometry.geometryObjects, pairs)
        self._q: Any = (ctypes.c_double * model.nq)()
        self._configuration = view(self._q)
        self._chosen = view(self._memory.chosen)
        self._value = view(self._memory.value)
        self._gradient = view(self._memory.gradient)

    def values(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return the distance (n,) [m] of each of the `pairs` (n,) at q (n_q,) [m, rad]."""
        self._configuration[:] = q
        self._choose(pairs)
        self._distances(self._memory, self._q)
        return np.asarray(self._value[pairs])

    def gradients(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return the gradient (n, n_v) [-, m] of each of the `pairs` (n,); their values were asked
        for last, at q (n_q,) [m, rad].
        """
        self._choose(pairs)
        self._gradients(self._memory)
        return np.array(self._gradient[: len(pairs)])

    def _choose(self, pairs: np.ndarray) -> None:
        self._memory.n_chosen = len(pairs)
        self._chosen[: len(pairs)] = pairs
