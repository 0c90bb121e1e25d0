"""Obstacles as data: a YAML file, words of a command line, and the values that a ``Record`` keeps of them.

    obstacles:
      - {name: pile, shape: cylinder, size: [0.2, 3.0], position: [1.5, 0.0, 0.0]}
      - {name: crate, shape: box, size: [0.4, 0.4, 0.8], position: [2.0, 1.0, -0.5], rpy: [0.0, 0.0, 0.3]}

``size`` [m] is (radius) of a sphere, (radius, length) of a capsule, cylinder or cone along z, (x, y, z) of a box, half axes
of an ellipsoid; a capsule's length is that of its straight part. ``position`` [m] and ``rpy`` [rad], R = Rz Ry Rx, are of its
middle in W. A mesh has ``vertices`` [m] and ``triangles``, three indices each, instead of a size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import coal
import numpy as np
import pinocchio as pin
import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator
from scipy.spatial import ConvexHull

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.shapes.obstacles import Obstacle, mesh_shape, obstacle

_MESH = "mesh"
_EXAMPLE = "obstacles: [{name: ball, shape: sphere, size: [0.3], position: [1.0, 0.0, 0.0]}]"
_N_SIZES: Mapping[str, int] = MappingProxyType(
    {"sphere": 1, "capsule": 2, "cylinder": 2, "cone": 2, "box": 3, "ellipsoid": 3, _MESH: 0}
)
_SHAPES: Mapping[str, Callable[..., coal.ShapeBase]] = MappingProxyType(
    {
        "sphere": coal.Sphere,
        "capsule": coal.Capsule,
        "cylinder": coal.Cylinder,
        "cone": coal.Cone,
        "box": coal.Box,
        "ellipsoid": coal.Ellipsoid,
    }
)
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class ObstacleData(BaseModel):
    """One obstacle; see the module."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1)]
    shape: Literal["sphere", "capsule", "cylinder", "cone", "box", "ellipsoid", "mesh"]
    size: tuple[Annotated[FiniteFloat, Field(gt=0.0)], ...] = ()
    vertices: tuple[Triple, ...] = ()
    triangles: tuple[tuple[int, int, int], ...] = ()
    position: Triple
    rpy: Triple = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _has_its_sizes(self) -> ObstacleData:
        if len(self.size) != _N_SIZES[self.shape]:
            raise ValueError(f"a {self.shape} has {_N_SIZES[self.shape]} sizes, not {len(self.size)}")
        corners = [corner for triangle in self.triangles for corner in triangle]
        if (self.shape == _MESH) != bool(corners) or not all(0 <= corner < len(self.vertices) for corner in corners):
            raise ValueError("a mesh, and only a mesh, has triangles, with indices from 0 below the number of vertices")
        return self

    @staticmethod
    def of(item: Obstacle) -> ObstacleData | None:
        """The data from which `build` makes the obstacle again, a convex shape as the mesh of its surface.

        `None` for a shape without an end, such as a plane.
        """
        form = _form(item.shape)
        if form is None:
            return None
        rpy = pin.rpy.matrixToRpy(item.X_WO.rotation)
        return ObstacleData(name=item.name, position=item.X_WO.translation.tolist(), rpy=rpy.tolist(), **form)

    def build(self) -> Obstacle:
        """The obstacle itself."""
        rotation = pin.rpy.rpyToMatrix(*self.rpy)
        if self.shape == _MESH:
            shape = mesh_shape(np.array(self.vertices), np.array(self.triangles))
        else:
            shape = _SHAPES[self.shape](*self.size)
        return obstacle(self.name, shape, self.position, rotation)


class ObstacleFile(BaseModel):
    """The whole file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    obstacles: tuple[ObstacleData, ...]


def read_obstacles(path: Path | str) -> tuple[ObstacleData, ...]:
    """Read a file of obstacles. Raises ``InvalidInput`` naming the file and the entry that is wrong."""
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        if not isinstance(content, dict) or "obstacles" not in content:
            raise InvalidInput(f"{path}: holds no obstacles; give a mapping such as {_EXAMPLE}")
        return ObstacleFile.model_validate(content).obstacles
    except ValidationError as error:
        raise InvalidInput(f"{path}: {_first(error)}") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InvalidInput(f"{path}: cannot be read as YAML ({' '.join(str(error).split())})") from error


def obstacle_from_words(shape: str, words: str, name: str) -> ObstacleData:
    """An obstacle from its position and sizes, numbers with commas or blanks between: ``"X,Y,Z,R"`` for a sphere.

    Raises:
        InvalidInput: words that are not numbers, too many or too few, or a size that is not positive.
    """
    given = words.replace(",", " ").split()
    wanted = 3 + _N_SIZES[shape]
    try:
        numbers = [float(word) for word in given]
    except ValueError:
        numbers = []
    if len(numbers) != wanted:
        raise InvalidInput(f"{shape} {words!r}: give {wanted} numbers, the position and the size, such as 1,0,0.5,0.3")
    try:
        return ObstacleData.model_validate({"name": name, "shape": shape, "size": numbers[3:], "position": numbers[:3]})
    except ValidationError as error:
        raise InvalidInput(f"{shape} {words!r}: {_first(error)}") from error


def build_obstacles(obstacles: Sequence[ObstacleData]) -> list[Obstacle]:
    """The obstacles themselves. Raises ``InvalidInput`` where two share a name."""
    names = [item.name for item in obstacles]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InvalidInput(f"two obstacles are called {twice[0]!r}; give each a name of its own")
    return [item.build() for item in obstacles]


def _form(shape: coal.CollisionGeometry) -> dict[str, Any] | None:
    """Shape and size of `ObstacleData`, or shape, vertices and triangles."""
    if isinstance(shape, coal.BVHModelBase):
        triangles = [[shape.tri_indices(k)[i] for i in range(3)] for k in range(shape.num_tris)]
        return {"shape": _MESH, "vertices": shape.vertices().tolist(), "triangles": triangles}
    if isinstance(shape, coal.ConvexBase):
        points = shape.points()  # coal gives the corners only
        return {"shape": _MESH, "vertices": points.tolist(), "triangles": ConvexHull(points).simplices.tolist()}
    for name, kind in _SHAPES.items():
        if isinstance(shape, kind):  # type: ignore[arg-type]
            return {"shape": name, "size": _size(shape)}
    return None


def _size(shape: Any) -> list[float]:
    if isinstance(shape, coal.Box):
        return (2 * shape.halfSide).tolist()
    if isinstance(shape, coal.Ellipsoid):
        return shape.radii.tolist()
    return [shape.radius] if isinstance(shape, coal.Sphere) else [shape.radius, 2 * shape.halfLength]


def _first(error: ValidationError) -> str:
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    text = first["msg"].removeprefix("Value error, ")
    return f"{place}: {text}" if place else text
