"""Obstacles: solid shapes that stand in the water."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.arguments import Finite, Range, Shape, checked
from uvms_ocp.exceptions import InvalidInput


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Obstacle:
    """A coal shape at a fixed pose in W. Raises `InvalidInput` for an empty name or a pose that is not finite."""

    name: str
    shape: coal.CollisionGeometry
    X_WO: pin.SE3
    """[m] pose of the shape's own frame."""

    def __post_init__(self) -> None:
        if not self.name:
            raise InvalidInput("an obstacle needs a name; give one that is not empty")
        if not np.isfinite(self.X_WO.homogeneous).all():
            raise InvalidInput(f"pose of obstacle {self.name!r} has NaN or infinite entries; give finite numbers")


@checked
def obstacle(
    name: str,
    shape: coal.CollisionGeometry,
    position: Annotated[ArrayLike, Range(open=True)],
    rotation: Annotated[ArrayLike, Range(open=True)] | None = None,
) -> Obstacle:
    """An obstacle at `position` (3,) [m] p_WO with `rotation` (3, 3) [-] R_WO, identity by default.

    Raises `InvalidInput` for other shapes and what `Obstacle` refuses.
    """
    p = np.asarray(position, dtype=float)
    R = np.eye(3) if rotation is None else np.asarray(rotation, dtype=float)
    if p.shape != (3,) or R.shape != (3, 3):
        raise InvalidInput(f"obstacle {name!r} has position {p} and rotation {R.tolist()}; give (3,) and (3, 3)")
    return Obstacle(name=name, shape=shape, X_WO=pin.SE3(R, p))


@checked
def seafloor(height: Finite) -> Obstacle:
    """The obstacle ``seafloor``: all below a level floor at z = height [m] in W."""
    return obstacle("seafloor", coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), [0.0, 0.0, height])


@checked
def mesh_shape(
    vertices: Annotated[np.ndarray, Shape("n", 3)], triangles: Annotated[np.ndarray, Shape("m", 3)]
) -> coal.BVHModelOBBRSS:
    """coal shape of a surface, such as `uvms_ocp.sim.floor_mesh` gives, for clearances and drawings.

    vertices (n, 3) [m]; triangles (m, 3) [-] indices of vertices. Raises `InvalidInput` for indices of no vertex.
    """
    vertices, triangles = np.asarray(vertices, dtype=float), np.asarray(triangles, dtype=np.int64)
    if not (triangles.size and triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise InvalidInput(f"a mesh of {len(vertices)} vertices needs triangles with indices from 0 below that number")
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(len(triangles), len(vertices))
    shape.addVertices(vertices)
    shape.addTriangles(triangles)
    shape.endModel()
    shape.computeLocalAABB()
    return shape
