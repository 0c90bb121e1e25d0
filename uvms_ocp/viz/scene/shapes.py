"""Convert coal's shapes to meshcat's: primitives stay primitives, meshes become triangles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import coal
import numpy as np

from uvms_ocp.viz.scene.colours import TRIAD
from uvms_ocp.viz.scene.page import Visualizer, geometry as mg

# three.js draws cylinders along y, coal along z.
Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])

Part = tuple[mg.Geometry, np.ndarray]
"""A geometry and its homogeneous pose (4, 4) [-, m] in the shape's frame."""


def material(rgba: tuple[float, ...] | np.ndarray, **options: Any) -> mg.MeshPhongMaterial:
    """Return a softly shining material of colour rgba (4,) from 0 to 1."""
    red, green, blue, alpha = (float(x) for x in rgba)
    return mg.MeshPhongMaterial(
        color=_hex(red, green, blue), opacity=alpha, shininess=45, specular=0x333333, **options
    )


def _hex(red: float, green: float, blue: float) -> int:
    """Return a colour, of parts from 0 to 1, as one number of three bytes."""
    r, g, b = (round(255 * min(max(x, 0.0), 1.0)) for x in (red, green, blue))
    return (r << 16) + (g << 8) + b


def hex_of(rgb: tuple[float, ...]) -> str:
    """Return the colour rgb (3,) from 0 to 1 as style sheets write it."""
    return f"#{_hex(*rgb):06x}"


def glow(rgb: tuple[float, ...], opacity: float) -> mg.MeshBasicMaterial:
    """Return a material of colour rgb (3,) and `opacity`, from 0 to 1, that needs no light."""
    return mg.MeshBasicMaterial(color=_hex(*rgb), opacity=opacity, transparent=opacity < 1)


def draw_shape(node: Visualizer, shape: coal.CollisionGeometry, rgba: np.ndarray) -> bool:
    """Draw `shape` below `node` in rgba (4,); return whether meshcat can draw it, which it cannot
    for half-spaces and planes.
    """
    parts = [*_parts(shape)]
    for i, (geometry, pose) in enumerate(parts):
        node[str(i)].set_object(
            geometry, material(rgba, flatShading=isinstance(geometry, mg.TriangularMeshGeometry))
        )
        node[str(i)].set_transform(pose)
    return bool(parts)


def _parts(shape: Any) -> Iterator[Part]:
    """Yield the geometries that make up a shape."""
    if isinstance(shape, coal.Box):
        yield mg.Box((2 * shape.halfSide).tolist()), np.eye(4)
    elif isinstance(shape, coal.Ellipsoid):
        yield mg.Sphere(1.0), np.diag([*shape.radii, 1.0])
    elif isinstance(shape, coal.Cone):
        yield mg.Cylinder(2 * shape.halfLength, radiusTop=0.0, radiusBottom=shape.radius), Y_TO_Z
    elif isinstance(shape, coal.BVHModelBase):
        faces = []
        for k in range(shape.num_tris):
            triangle = shape.tri_indices(k)  # which can be indexed but not iterated over
            faces.append([triangle[0], triangle[1], triangle[2]])
        yield mg.TriangularMeshGeometry(shape.vertices(), faces), np.eye(4)
    elif isinstance(shape, coal.ConvexBase):  # of which coal gives the corners only
        from scipy.spatial import ConvexHull  # a quarter of a second, which few need

        yield (
            mg.TriangularMeshGeometry(shape.points(), ConvexHull(shape.points()).simplices),
            np.eye(4),
        )
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        yield mg.Cylinder(2 * shape.halfLength, shape.radius), Y_TO_Z
    if isinstance(shape, coal.Sphere):
        yield mg.Sphere(shape.radius), np.eye(4)
    if isinstance(shape, coal.Capsule):
        for end in (-shape.halfLength, shape.halfLength):
            yield mg.Sphere(shape.radius), shifted(np.array([0.0, 0.0, end]))


def shifted(position: np.ndarray) -> np.ndarray:
    """Return the homogeneous matrix (4, 4) [-, m] of a translation to `position` (3,) [m]."""
    matrix = np.eye(4)
    matrix[:3, 3] = position
    return matrix


def draw_triad(node: Visualizer, length: float) -> None:
    """Draw three solid arrows, x red, y green, z blue, of `length` [m] (lines are one pixel wide in
    WebGL).
    """
    for axis, rgb in enumerate(TRIAD):
        extent = np.full(3, 0.05 * length)
        extent[axis] = length
        node["xyz"[axis]].set_object(mg.Box(extent.tolist()), material((*rgb, 1.0)))
        node["xyz"[axis]].set_transform(shifted(np.eye(3)[axis] * length / 2))


def tube(points: np.ndarray, radius: float, sides: int = 6) -> mg.TriangularMeshGeometry:
    """Return a tube of `radius` [m] along points (n, 3) [m], ordered so that its first 6 * sides *
    k indices draw k segments.
    """
    rings = (points[:, None] + radius * _rings(points, sides)).reshape(-1, 3)
    corner = np.arange(sides)
    after = (corner + 1) % sides
    quad = np.stack(
        [corner, after, corner + sides, after, after + sides, corner + sides], axis=-1
    ).reshape(-1, 3)
    return mg.TriangularMeshGeometry(
        rings, (quad[None] + sides * np.arange(len(points) - 1)[:, None, None]).reshape(-1, 3)
    )


def _rings(points: np.ndarray, sides: int) -> np.ndarray:
    """Return unit circles (n, sides, 3) across the path, without twist from one to the next."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    first = np.empty_like(tangent)
    axis = np.eye(3)[int(np.argmin(np.abs(tangent[0])))]
    for i, direction in enumerate(tangent):
        axis = axis - direction * (axis @ direction)
        axis /= max(float(np.linalg.norm(axis)), 1e-12)
        first[i] = axis
    angle = 2 * np.pi * np.arange(sides) / sides
    second = np.cross(tangent, first)
    return (
        np.cos(angle)[None, :, None] * first[:, None]
        + np.sin(angle)[None, :, None] * second[:, None]
    )
