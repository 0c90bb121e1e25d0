"""Sea floors: a plane, or a height field with smooth protuberances, also as a table of heights, a
mesh and an obstacle.
"""

from __future__ import annotations

import math
from typing import Annotated, Protocol

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_constructor, checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.meta_values import FloorRelief
from uvms_ocp.robot.shapes.obstacles import Obstacle, mesh_shape
from uvms_ocp.types import Positive, Range, Shape, Vector3

LEVEL_RAY = 1e-9  # sine of the angle to the horizon below which a ray counts as level
_DEEPEST = 1e5  # [m] depth and height of a floor at most
_RELIEF_POINTS = 81  # of a record, along each side
_SLAB = 2.0  # [m] thickness of a flat floor as an obstacle
_FINEST = 3000  # cells a side of a mesh, more than can be drawn

Corner = Annotated[np.ndarray, Shape(2), Range(open=True)]
"""Point (2,) [m], x and y in W."""

Points = Annotated[np.ndarray, Shape("n", 2)]
"""Points (n, 2) [m], x and y in W."""


class Seafloor(Protocol):
    """A floor that can be seen by an altimeter and stood upon."""

    __slots__ = ()

    def height(self, x: float, y: float) -> float:
        """Return the height z [m] of the floor below or above the point (x, y) [m] in W."""

    def normal(self, x: float, y: float) -> np.ndarray:
        """Return the unit normal (3,) of the floor at (x, y) [m], upwards, in W."""

    def range_along(self, origin: Vector3, direction: Vector3) -> float:
        """Return the distance [m] from `origin` (3,) [m] along the unit vector `direction` (3,) in W to the
        floor; nan without a hit.

        0 or negative where the origin is at or below the floor and the ray points down.
        """


@checked_dataclass(check=checked_constructor)
class FlatSeafloor(Seafloor):
    """A horizontal plane. Raises `InvalidInput` for a height that is none, or very far from the
    origin.
    """

    z: float
    """[m] Height in W."""

    def __post_init__(self) -> None:
        if not abs(self.z) <= _DEEPEST:
            text = (
                f"seafloor at z = {self.z}; give a finite height [m] from -{_DEEPEST:g} to"
                f" {_DEEPEST:g}"
            )
            raise InvalidInput(f"{text}: farther from the origin millimetres are lost")

    def height(self, x: float, y: float) -> float:
        return self.z

    def normal(self, x: float, y: float) -> np.ndarray:
        return np.array([0.0, 0.0, 1.0])

    def ground_at(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (n,) [m] and unit normals (n, 3) of the floor at points (n, 2) [m], x and y in
        W.
        """
        normals = np.zeros((len(points), 3))
        normals[:, 2] = 1.0
        return np.full(len(points), self.z), normals

    def range_along(self, origin: Vector3, direction: Vector3) -> float:
        descent = -direction.item(2)
        if descent > LEVEL_RAY:
            return (origin.item(2) - self.z) / descent
        return math.nan


@checked_on_failure
def ground_at(seafloor: Seafloor, points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Return heights (n,) [m] and unit normals (n, 3) of the floor at points (n, 2) [m], x and y in W.

    In one pass where its own class has a method ``ground_at`` for that, else point by point.
    """
    if "ground_at" in vars(type(seafloor)):  # an inherited one would not know of another `height`
        return seafloor.ground_at(points)  # type: ignore[attr-defined]
    places = points.tolist()
    normals = np.array([seafloor.normal(x, y) for x, y in places])
    return np.array([seafloor.height(x, y) for x, y in places]), normals.reshape(-1, 3)


@checked
def floor_relief(seafloor: Seafloor, low: Corner, high: Corner) -> FloorRelief | None:
    """Sample a rectangle of the floor from `low` (2,) to `high` (2,) [m], rounded to a millimetre,
    for records; `None` for a plane.
    """
    if isinstance(seafloor, FlatSeafloor):
        return None
    x = np.linspace(low[0], high[0], _RELIEF_POINTS)
    y = np.linspace(low[1], high[1], _RELIEF_POINTS)
    rows = list[tuple[float, ...]]()
    for y_k in y.tolist():
        rows.append(tuple(round(seafloor.height(x_i, y_k), 3) for x_i in x.tolist()))
    return FloorRelief(x=tuple(x.round(3).tolist()), y=tuple(y.round(3).tolist()), z=tuple(rows))


@checked
def floor_mesh(
    seafloor: Seafloor, *, centre: tuple[float, float], extent: Positive, spacing: Positive
) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (n, 3) [m] in W and triangles (m, 3), counter-clockwise from above, of a square of
    the floor.

    centre [m] is x, y of the square, extent [m] its side, spacing [m] the distance between
    vertices. Raises `InvalidInput` unless 0 < spacing <= extent, and for more than a few thousand
    cells a side.
    """
    if spacing > extent:
        raise InvalidInput(
            f"mesh of extent {extent} m and spacing {spacing} m; give 0 < spacing <= extent"
        )
    if extent / spacing > _FINEST:
        raise InvalidInput(
            f"mesh of extent {extent:g} m and spacing {spacing:g} m; give at most {_FINEST} cells a"
            " side"
        )
    side = np.linspace(-extent / 2, extent / 2, 1 + math.ceil(extent / spacing))
    grid_x, grid_y = np.meshgrid(centre[0] + side, centre[1] + side)
    x = grid_x.ravel()
    y = grid_y.ravel()
    z = [seafloor.height(*point) for point in zip(x.tolist(), y.tolist(), strict=True)]
    corner = np.arange(len(x)).reshape(len(side), -1)
    a = corner[:-1, :-1]
    b = corner[:-1, 1:]
    c = corner[1:, 1:]
    d = corner[1:, :-1]
    triangles = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return np.stack([x, y, z], axis=1), triangles.reshape(-1, 3)


@checked
def floor_obstacle(
    seafloor: Seafloor, *, centre: tuple[float, float], extent: Positive, spacing: Positive = 0.25
) -> Obstacle:
    """Return a square of the floor as an obstacle named ``seafloor``: a slab if it is flat, else a
    mesh.

    centre [m]: x, y of the square. extent [m]: its side. spacing [m]: distance between vertices.
    Raises `InvalidInput` unless 0 < spacing <= extent, and for more than a few thousand cells a
    side.
    """
    if isinstance(seafloor, FlatSeafloor):
        middle = np.array([*centre, seafloor.z - 0.5 * _SLAB])
        return Obstacle(
            name="seafloor", shape=coal.Box(extent, extent, _SLAB), X_WO=pin.SE3(np.eye(3), middle)
        )
    vertices, triangles = floor_mesh(seafloor, centre=centre, extent=extent, spacing=spacing)
    return Obstacle(name="seafloor", shape=mesh_shape(vertices, triangles), X_WO=pin.SE3.Identity())
