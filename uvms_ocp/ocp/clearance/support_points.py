"""Points of a convex shape of which one is the farthest against a direction, for directions near the one given.

Rows on all of them keep the shape on one side of a plane while it turns a little; of a round rim only some are taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import coal
import numpy as np

from uvms_ocp.arrays import Array

_N_VERTICES = 6  # of a mesh, nearest to the plane first


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Support:
    """For several directions of planes, in the frame of the shape."""

    centres: Array
    """(n, k, 3) [m]"""
    radius: float = 0.0
    """[m] of balls around them."""


def support_of(shape: coal.CollisionGeometry, normals: Array, witnesses: Array) -> Support:
    """Of planes with normals (n, 3) [-] towards the shape.

    Of a mesh only the vertices nearest to each plane count. witnesses (n, 3) [m], points of the shape nearest to the
    planes, serve where a shape has no form of its own here.
    """
    for kind, points in _FORMS.items():
        if isinstance(shape, kind):
            return points(shape, normals)
    return Support(centres=witnesses[:, None])


def _of_sphere(shape: coal.Sphere, normals: Array) -> Support:
    return Support(centres=np.zeros((len(normals), 1, 3)), radius=float(shape.radius))


def _of_capsule(shape: coal.Capsule, normals: Array) -> Support:
    return Support(centres=_tiled(_ends(shape), normals), radius=float(shape.radius))


def _of_cylinder(shape: coal.Cylinder, normals: Array) -> Support:
    rim, up = _rim(shape.radius, normals), np.array([0.0, 0.0, shape.halfLength])
    return Support(centres=np.concatenate([rim - up, rim + up], axis=1))


def _of_cone(shape: coal.Cone, normals: Array) -> Support:
    ends = _tiled(_ends(shape), normals)
    return Support(centres=np.concatenate([_rim(shape.radius, normals) + ends[:, :1], ends[:, 1:]], axis=1))


def _rim(radius: float, normals: Array) -> Array:
    """(n, 4, 3) [m] of a circle about z: where a plane would touch it, across from there, and halfway."""
    length = np.linalg.norm(normals[:, :2], axis=1, keepdims=True)
    touch = np.where(length > _NO_LENGTH, -normals[:, :2] / np.maximum(length, _NO_LENGTH), [1.0, 0.0])
    aside = np.stack([-touch[:, 1], touch[:, 0]], axis=1)
    rim = np.zeros((len(normals), 4, 3))
    rim[:, :, :2] = radius * np.stack([touch, aside, -aside, -touch], axis=1)
    return rim


_NO_LENGTH = 1e-9


def _of_box(shape: coal.Box, normals: Array) -> Support:
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return Support(centres=_tiled(signs * np.array(shape.halfSide), normals))


def _of_vertices(shape: coal.ConvexBase, normals: Array) -> Support:
    vertices = np.asarray(shape.points())
    nearest = np.argsort(normals @ vertices.T, axis=1, kind="stable")[:, :_N_VERTICES]
    return Support(centres=vertices[nearest])


def _ends(shape: coal.Cylinder | coal.Capsule | coal.Cone) -> Array:
    return shape.halfLength * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


def _tiled(points: Array, normals: Array) -> Array:
    return np.broadcast_to(points, (len(normals), *points.shape))


_FORMS: MappingProxyType[type, Callable[..., Support]] = MappingProxyType(
    {
        coal.Sphere: _of_sphere,
        coal.Capsule: _of_capsule,
        coal.Box: _of_box,
        coal.Cylinder: _of_cylinder,
        coal.Cone: _of_cone,
        coal.ConvexBase: _of_vertices,
    }
)
