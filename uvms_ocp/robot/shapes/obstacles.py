"""Obstacles: solid shapes that stand in the water, from code, a YAML file or words of a command
line, and back to data.

    obstacles:
      - {name: pile, shape: cylinder, size: [0.2, 3.0], position: [1.5, 0.0, 0.0]}
      - {name: crate, shape: box, size: [0.4, 0.4, 0.8], position: [2.0, 1.0, -0.5], rpy: [0.0, 0.0,
        0.3]}

The entries are the fields of `uvms_ocp.record.meta_values.ObstacleMeta`, by which records and files
know an obstacle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pydantic import ValidationError

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.model_errors import FileModel, printable
from uvms_ocp.record.meta_values import N_SIZES, ObstacleMeta
from uvms_ocp.record.yaml_file import read_yaml
from uvms_ocp.robot.shapes.closed_mesh import mesh_triangles
from uvms_ocp.types import Finite, Range, Shape

Numbers = Annotated[ArrayLike, Range(open=True)]
"""Finite numbers."""

_MESH = "mesh"
_EXAMPLE = "obstacles: [{name: ball, shape: sphere, size: [0.3], position: [1.0, 0.0, 0.0]}]"
_KINDS = (coal.Sphere, coal.Capsule, coal.Cylinder, coal.Cone, coal.Box, coal.Ellipsoid)
_SHAPES: Mapping[str, Callable[..., coal.ShapeBase]] = {
    kind.__name__.lower(): kind for kind in _KINDS
}


@checked_dataclass(eq=False)
class Obstacle:
    """A coal shape at a fixed pose in W. Raises `InvalidInput` for an empty name or a pose that is
    not finite.
    """

    name: str
    shape: coal.CollisionGeometry
    X_WO: pin.SE3
    """Pose of the shape's own frame [m]."""

    def __post_init__(self) -> None:
        if not self.name:
            raise InvalidInput("an obstacle needs a name; give one that is not empty")


@checked
def obstacle(
    name: str, shape: coal.CollisionGeometry, position: Numbers, rotation: Numbers | None = None
) -> Obstacle:
    """Make an obstacle at `position` (3,) [m] p_WO with `rotation` (3, 3) R_WO, by default identity.

    Raises `InvalidInput` for other shapes and what `Obstacle` refuses.
    """
    p = np.asarray(position, dtype=float)
    R = np.eye(3)
    if rotation is not None:
        R = np.asarray(rotation, dtype=float)
    if p.shape != (3,) or R.shape != (3, 3):
        raise InvalidInput(
            f"obstacle {name!r} has position {p} and rotation {R.tolist()}; give (3,) and (3, 3)"
        )
    return Obstacle(name=name, shape=shape, X_WO=pin.SE3(R, p))


@checked
def seafloor(height: Finite) -> Obstacle:
    """Make the obstacle ``seafloor``: all below a level floor at z = height [m] in W."""
    up = np.array([0.0, 0.0, 1.0])
    return obstacle("seafloor", coal.Halfspace(up, 0.0), [0.0, 0.0, height])


@checked
def mesh_shape(
    vertices: Annotated[np.ndarray, Shape("n", 3)], triangles: Annotated[np.ndarray, Shape("m", 3)]
) -> coal.BVHModelOBBRSS:
    """Make the coal shape of a surface, such as `uvms_ocp.sim.floor_mesh` gives, for clearances and
    drawings.

    vertices (n, 3) [m]; triangles (m, 3) indices of vertices. Raises `InvalidInput` for indices of
    no vertex.
    """
    vertices = np.asarray(vertices, dtype=float)
    triangles = np.asarray(triangles, dtype=np.int64)
    if not (triangles.size and triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise InvalidInput(
            f"a mesh of {len(vertices)} vertices needs triangles with indices from 0 below that"
            " number"
        )
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(len(triangles), len(vertices))
    shape.addVertices(vertices)
    shape.addTriangles(triangles)
    shape.endModel()
    shape.computeLocalAABB()
    return shape


class ObstacleFile(FileModel):
    """Content of a YAML file of obstacles."""

    obstacles: tuple[ObstacleMeta, ...]


@checked
def read_obstacles(path: Path | str) -> tuple[Obstacle, ...]:
    """Read a file of obstacles. Raises ``InvalidInput`` naming the file and the entry that is
    wrong.
    """
    try:
        content = read_yaml(path)
        if not isinstance(content, dict) or "obstacles" not in content:
            raise InvalidInput(
                f"{printable(path)}: holds no obstacles; give a mapping such as {_EXAMPLE}"
            )
        entries = ObstacleFile.model_validate(content).obstacles
        return tuple(build_obstacle(entry) for entry in entries)
    except InvalidInput:
        raise
    except ValidationError as error:
        raise InvalidInput(f"{printable(path)}: {_first_problem(error)}") from error
    except (OSError, ValueError) as error:
        raise InvalidInput(
            f"{printable(path)}: cannot be read as YAML ({' '.join(str(error).split())})"
        ) from error


@checked
def parse_obstacle(shape: str, words: str, name: str) -> Obstacle:
    """Make an obstacle from its position and sizes, numbers with commas or blanks between:
    ``"X,Y,Z,R"`` for a sphere.

    Raises ``NameNotFound`` for an unknown shape, and ``InvalidInput``
    for words that are not numbers, too many or too few, or a size that is not positive.
    """
    require_known("shape", shape, N_SIZES)
    n_numbers = 3 + N_SIZES[shape]
    try:
        numbers = [float(word) for word in words.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != n_numbers:
        raise InvalidInput(
            f"{shape} {words!r}: give {n_numbers} numbers, the position and the size, such as"
            " 1,0,0.5,0.3"
        )
    try:
        data = {"name": name, "shape": shape, "size": numbers[3:], "position": numbers[:3]}
        return build_obstacle(ObstacleMeta.model_validate(data))
    except ValidationError as error:
        raise InvalidInput(f"{shape} {words!r}: {_first_problem(error)}") from error


@checked
def build_obstacle(data: ObstacleMeta) -> Obstacle:
    """Make the obstacle that the data describe."""
    if data.shape == _MESH:
        shape = mesh_shape(np.array(data.vertices), np.array(data.triangles))
    else:
        shape = _SHAPES[data.shape](*data.size)
    return obstacle(data.name, shape, data.position, pin.rpy.rpyToMatrix(*data.rpy))


@checked
def describe_obstacle(item: Obstacle) -> ObstacleMeta | None:
    """Return the data from which `build_obstacle` makes the obstacle again, a convex shape as the
    mesh of its surface.

    `None` for a shape without an end, such as a plane.
    """
    fields = _shape_fields(item.shape)
    if fields is None:
        return None
    rpy = pin.rpy.matrixToRpy(item.X_WO.rotation)
    return ObstacleMeta(
        name=item.name, position=item.X_WO.translation.tolist(), rpy=rpy.tolist(), **fields
    )


def describe_obstacles(obstacles: Iterable[Obstacle]) -> tuple[ObstacleMeta, ...]:
    """Return the obstacles that have an end, as a record keeps them."""
    descriptions = list[ObstacleMeta]()
    for item in obstacles:
        description = describe_obstacle(item)
        if description is not None:
            descriptions.append(description)
    return tuple(descriptions)


def require_distinct_names(obstacles: Sequence[Obstacle]) -> None:
    """Raise `InvalidInput` where two obstacles share a name."""
    names = [item.name for item in obstacles]
    for name in names:
        if names.count(name) > 1:
            raise InvalidInput(f"two obstacles are called {name!r}; give each a name of its own")


def _shape_fields(shape: coal.CollisionGeometry) -> dict[str, Any] | None:
    """Return shape and size of `ObstacleMeta`, or shape, vertices and triangles."""
    if isinstance(shape, coal.BVHModelBase):
        return {
            "shape": _MESH,
            "vertices": shape.vertices().tolist(),
            "triangles": mesh_triangles(shape),
        }
    if isinstance(shape, coal.ConvexBase):
        from scipy.spatial import ConvexHull  # a quarter of a second, which few need

        points = shape.points()  # coal gives the corners only
        return {
            "shape": _MESH,
            "vertices": points.tolist(),
            "triangles": ConvexHull(points).simplices.tolist(),
        }
    for name, kind in _SHAPES.items():
        if isinstance(shape, kind):  # type: ignore[arg-type]
            return {"shape": name, "size": _size(shape)}
    return None


def _size(shape: Any) -> list[float]:
    """Return the size [m] of a primitive shape in the order of `ObstacleMeta`."""
    if isinstance(shape, coal.Box):
        return [2 * float(half) for half in shape.halfSide]
    if isinstance(shape, coal.Ellipsoid):
        return [float(radius) for radius in shape.radii]
    if isinstance(shape, coal.Sphere):
        return [shape.radius]
    return [shape.radius, 2 * shape.halfLength]


def _first_problem(error: ValidationError) -> str:
    """Return the first problem on one line."""
    problem = error.errors()[0]
    place = ".".join(str(part) for part in problem["loc"])
    text = problem["msg"].removeprefix("Value error, ")
    if place:
        return f"{place}: {text}"
    return text
