"""An obstacle as plain values, as files and records keep it; `uvms_ocp.collision.obstacle_file` builds its shape."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from uvms_ocp.validation import one_line_errors

_MESH = "mesh"
N_SIZES: Mapping[str, int] = MappingProxyType(
    {"sphere": 1, "capsule": 2, "cylinder": 2, "cone": 2, "box": 3, "ellipsoid": 3, _MESH: 0}
)
"""How many sizes a shape has."""
FARTHEST = 1e5
"""[m] from the origin, and of a size: farther away single precision, which meshes are kept in, loses centimetres."""
_Metres = Annotated[FiniteFloat, Field(ge=-FARTHEST, le=FARTHEST)]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Point = tuple[_Metres, _Metres, _Metres]


@one_line_errors
class ObstacleData(BaseModel):
    """One obstacle: a primitive shape with its sizes, or a mesh with its triangles."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1)]
    shape: Literal["sphere", "capsule", "cylinder", "cone", "box", "ellipsoid", "mesh"]
    size: tuple[Annotated[FiniteFloat, Field(gt=0.0, le=FARTHEST)], ...] = ()
    """[m] (radius) of a sphere, (radius, length) of a capsule, cylinder or cone along z, (x, y, z) of a box, half axes of an
    ellipsoid; a capsule's length is that of its straight part."""
    vertices: tuple[Point, ...] = ()
    """(n, 3) [m] of a mesh, in its own frame."""
    triangles: tuple[tuple[int, int, int], ...] = ()
    """(m, 3) [-] indices of vertices."""
    position: Point
    """(3,) [m] of the middle in W."""
    rpy: Triple = (0.0, 0.0, 0.0)
    """(3,) [rad], R = Rz Ry Rx."""

    @model_validator(mode="after")
    def _has_its_sizes(self) -> ObstacleData:
        if len(self.size) != N_SIZES[self.shape]:
            raise ValueError(f"a {self.shape} has {N_SIZES[self.shape]} sizes, not {len(self.size)}")
        corners = [corner for triangle in self.triangles for corner in triangle]
        if (self.shape == _MESH) != bool(corners) or not all(0 <= corner < len(self.vertices) for corner in corners):
            raise ValueError("a mesh, and only a mesh, has triangles, with indices from 0 below the number of vertices")
        return self
