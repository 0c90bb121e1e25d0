"""Two solids at random poses, measured by the kernels and by coal."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.codegen.kernel_layout import structure_of, view
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.shapes.distance_kernels import (
    DistanceMemory,
    chosen_distances,
    chosen_gradients,
    places_function,
    with_distances,
    write_distances,
)

KINDS: Mapping[str, Callable[[np.ndarray], Any]] = {
    "sphere": lambda size: coal.Sphere(size[0]),
    "capsule": lambda size: coal.Capsule(size[0], 2.0 * size[1]),
    "cylinder": lambda size: coal.Cylinder(size[0], 2.0 * size[1]),
    "box": lambda size: coal.Box(*(2.0 * size)),
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Found:
    """Of the first solid to the second, in W."""

    distance: float
    normal: np.ndarray
    at: np.ndarray
    gradient: np.ndarray
    """(12,) per unit of the twists of both."""


class SolidPair:
    """Two free solids in one memory; `compiled` false: in Python."""

    def __init__(self, *, compiled: bool = True) -> None:
        self.model = pin.Model()
        for name in ("first", "second"):
            self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        dimensions = with_distances(Dimensions(), self.model, n_solids=2, n_pairs=1)
        self.memory: Any
        self.memory, kernels = make_memory(
            structure_of(DistanceMemory, dimensions, places=places_function(self.model)),
            (chosen_distances, chosen_gradients),
            compiled=compiled,
        )
        self._distances, self._gradients = kernels
        self.memory.n_chosen = 1

    def take(self, first: Any, second: Any) -> None:
        shapes = [
            pin.GeometryObject("", i + 1, pin.SE3.Identity(), shape)
            for i, shape in enumerate((first, second))
        ]
        write_distances(self.memory, self.model, shapes, [(0, 1)])

    def at(self, X_1: pin.SE3, X_2: pin.SE3) -> Found:
        return self.at_q(np.concatenate([pin.SE3ToXYZQUAT(X_1), pin.SE3ToXYZQUAT(X_2)]))

    def at_q(self, q: np.ndarray) -> Found:
        self._distances(self.memory, (ctypes.c_double * 14)(*q))
        self._gradients(self.memory)
        pair = self.memory.pairs[0]
        return Found(
            distance=self.memory.value[0],
            normal=view(pair.normal).copy(),
            at=view(pair.at).copy(),
            gradient=view(self.memory.gradient)[0].copy(),
        )


def by_coal(first: Any, X_1: pin.SE3, second: Any, X_2: pin.SE3) -> float:
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-9
    request.gjk_max_iterations = 512
    request.epa_tolerance = 1e-9
    request.epa_max_iterations = 512
    poses = [coal.Transform3s(X.rotation, X.translation) for X in (X_1, X_2)]
    return float(coal.distance(first, poses[0], second, poses[1], request, coal.DistanceResult()))


def random_pose(rng: np.random.Generator, spread: float) -> pin.SE3:
    quaternion = rng.normal(size=4)
    return pin.SE3(
        pin.Quaternion(quaternion / np.linalg.norm(quaternion)).matrix(),
        spread * rng.normal(size=3),
    )


def height(kind: str, size: np.ndarray, d: np.ndarray) -> float:
    """How far a solid is along d (3,) of length 1, in its frame [m]; written anew."""
    across = float(np.hypot(d[0], d[1]))
    along = size[1] * abs(d[2])
    return {
        "sphere": float(size[0]),
        "capsule": float(size[0] + along),
        "cylinder": float(size[0] * across + along),
        "box": float(np.abs(d) @ size),
    }[kind]
