"""Distances of pairs of shapes in machine code, from Python."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.functions.kernels.binding import memory_of
from uvms_ocp.functions.kernels.layout import structure_of, view
from uvms_ocp.model.shapes.distance_kernels.clear_pairs import distance_sizes, write_distances
from uvms_ocp.model.shapes.distance_kernels.distance_memory import (
    DistanceMemory,
    chosen_distances,
    chosen_gradients,
)


class CompiledPairs:
    """Some pairs of shapes that have a form in C. Not for two threads at once."""

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, pairs: Sequence[tuple[int, int]]) -> None:
        """geometry: the shapes, of which those of the pairs (by index) are measured."""
        n_solids = len({k for pair in pairs for k in pair})
        sizes = distance_sizes(model, n_solids=n_solids, n_pairs=len(pairs))
        self._memory, (self._distances, self._gradients) = memory_of(
            structure_of(DistanceMemory, **sizes), (chosen_distances, chosen_gradients)
        )
        self.compiled = self._distances is not chosen_distances
        """Whether there is a compiler: without, this is slower than coal."""
        write_distances(self._memory, model, geometry.geometryObjects, pairs)
        self._q: Any = (ctypes.c_double * model.nq)()
        self._configuration, self._chosen = view(self._q), view(self._memory.chosen)
        self._value, self._gradient = view(self._memory.value), view(self._memory.gradient)

    def values(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Distance (n,) [m] of each of the `pairs` (n,) [-] at q (n_q,) [m, rad]."""
        self._configuration[:] = q
        self._choose(pairs)
        self._distances(self._memory, self._q)
        return np.asarray(self._value[pairs])

    def gradients(self, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Gradient (n, n_v) [-, m] of each of the `pairs` (n,) [-]; their values were asked for last, at q (n_q,) [m, rad]."""
        self._choose(pairs)
        self._gradients(self._memory)
        return np.array(self._gradient[: len(pairs)])

    def _choose(self, pairs: np.ndarray) -> None:
        self._memory.n_chosen = len(pairs)
        self._chosen[: len(pairs)] = pairs
