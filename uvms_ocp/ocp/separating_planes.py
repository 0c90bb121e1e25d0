"""Separating planes where coal finds two shapes nearest, and the support points that have to stay
beyond.

Rows on all of them keep the shape on one side of a plane while it turns a little; of a round rim
only some are taken.

A plane is fixed to the first shape of a pair and touches it, so it bounds that shape wherever the
robot goes. What the points of the second shape have to the plane is never more than the distance of
two convex shapes, and equal to it in value and gradient at the configuration where coal found the
plane.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.planning.distances import Contacts
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.robot.robot import require_normalized
from uvms_ocp.types import Array, Indices

# Points of a convex shape of which one is the farthest against a direction, for directions near the
# one given.

_N_VERTICES = 6  # of a mesh, nearest to the plane first

_NO_LENGTH = 1e-9

_Found = tuple[Indices, Array, Array]
"""Row of the contact, point and offset."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Support:
    """For several directions of planes, in the frame of the shape."""

    centres: Array
    """(n, k, 3) [m]"""
    radius: float = 0.0
    """[m] of balls around them."""


def support_of(shape: coal.CollisionGeometry, normals: Array, witnesses: Array) -> Support:
    """Support a shape in planes with normals (n, 3) towards it.

    Of a mesh only the vertices nearest to each plane count. witnesses (n, 3) [m], points of the
    shape nearest to the planes, serve where a shape has no form of its own here.
    """
    for kind, points in _FORMS.items():
        if isinstance(shape, kind):
            return points(shape, normals)
    return Support(centres=witnesses[:, None])


def _of_cylinder(shape: coal.Cylinder, normals: Array) -> Support:
    rim = _rim(shape.radius, normals)
    up = np.array([0.0, 0.0, shape.halfLength])
    return Support(centres=np.concatenate([rim - up, rim + up], axis=1))


def _of_cone(shape: coal.Cone, normals: Array) -> Support:
    ends = _tiled(_ends(shape), normals)
    return Support(
        centres=np.concatenate([_rim(shape.radius, normals) + ends[:, :1], ends[:, 1:]], axis=1)
    )


def _rim(radius: float, normals: Array) -> Array:
    """(n, 4, 3) [m] of a circle about z: where a plane would touch it, across from there, and
    halfway.
    """
    length = np.linalg.norm(normals[:, :2], axis=1, keepdims=True)
    touch = np.where(
        length > _NO_LENGTH, -normals[:, :2] / np.maximum(length, _NO_LENGTH), [1.0, 0.0]
    )
    aside = np.stack([-touch[:, 1], touch[:, 0]], axis=1)
    rim = np.zeros((len(normals), 4, 3))
    rim[:, :, :2] = radius * np.stack([touch, aside, -aside, -touch], axis=1)
    return rim


def _of_box(shape: coal.Box, normals: Array) -> Support:
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return Support(centres=_tiled(signs * np.array(shape.halfSide), normals))


def _of_vertices(shape: coal.ConvexBase, normals: Array) -> Support:
    vertices = np.asarray(shape.points())
    return Support(
        centres=vertices[np.argsort(normals @ vertices.T, axis=1, kind="stable")[:, :_N_VERTICES]]
    )


def _ends(shape: coal.Cylinder | coal.Capsule | coal.Cone) -> Array:
    return shape.halfLength * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


def _tiled(points: Array, normals: Array) -> Array:
    return np.broadcast_to(points, (len(normals), *points.shape))


_FORMS: Mapping[type, Callable[..., Support]] = {
    coal.Sphere: lambda shape, normals: Support(
        centres=np.zeros((len(normals), 1, 3)), radius=float(shape.radius)
    ),
    coal.Capsule: lambda shape, normals: Support(
        centres=_tiled(_ends(shape), normals), radius=float(shape.radius)
    ),
    coal.Box: _of_box,
    coal.Cylinder: _of_cylinder,
    coal.Cone: _of_cone,
    coal.ConvexBase: _of_vertices,
}


# Planes that part shapes: where coal finds two of them nearest, and the points that have to stay
# beyond.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Poses:
    """Poses of all joints at all samples."""

    R: Array
    """(n_samples, n_joints, 3, 3) R_WJ, the world first."""
    p: Array
    """(n_samples, n_joints, 3) [m] p_WJ"""

    @staticmethod
    def of(model: pin.Model, q: Array) -> Poses:
        """At configurations q (n, n_q) [m, rad]."""
        require_normalized(model, q)
        data = model.createData()
        R = np.empty((len(q), model.njoints, 3, 3))
        p = np.empty((len(q), model.njoints, 3))
        for k, row in enumerate(q):
            pin.forwardKinematics(model, data, row)
            R[k] = [X.rotation for X in data.oMi]
            p[k] = [X.translation for X in data.oMi]
        return Poses(R=R, p=p)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Planes:
    """One row per plane and point, which stays beyond: ``n . c >= s`` in one frame."""

    sample: Indices
    """(n,)"""
    pair: Indices
    """(n,)"""
    joints: Indices
    """(n, 2) of the plane and of the point."""
    normal: Array
    """(n, 3) in the frame of the plane's joint."""
    centre: Array
    """(n, 3) [m] the point, in the frame of its joint."""
    offset: Array
    """(n,) [m] of the plane from the origin of its joint, and the radius of the ball around the
    centre.
    """

    def heights(self, poses: Poses) -> Array:
        """(n,) [m] of every point over its plane at `poses`, sample by sample."""
        a = self.joints[:, 0]
        b = self.joints[:, 1]
        k = self.sample
        normal = _turned(poses.R[k, a], self.normal)
        centre = _turned(poses.R[k, b], self.centre) + poses.p[k, b] - poses.p[k, a]
        return _dot(normal, centre) - self.offset

    @staticmethod
    def joined(*parts: Planes) -> Planes:
        """Return the rows of all parts, one after the other."""
        return Planes(
            **{
                name: np.concatenate([getattr(part, name) for part in parts])
                for name in Planes.__slots__
            }
        )

    def of(self, chosen: Indices) -> Planes:
        """Select the planes of the given rows."""
        return Planes(**{name: getattr(self, name)[chosen] for name in self.__slots__})


def planes(scene: CollisionScene, contacts: Contacts, poses: Poses) -> Planes:
    """Build the planes of all contacts, with the points of the second shapes that stay beyond
    them.
    """
    pairs = scene.pairs
    joints = np.array(
        [(pair.first_joint, pair.second_joint) for pair in pairs], dtype=np.intp
    ).reshape(-1, 2)
    shapes = np.array([pair.second for pair in pairs], dtype=np.intp)
    carried = joints[contacts.pair]
    a = carried[:, 0]
    b = carried[:, 1]
    k = contacts.sample
    normal = _back(poses.R[k, a], contacts.normal)
    offset = _dot(normal, _back(poses.R[k, a], contacts.first - poses.p[k, a]))
    inward = _back(poses.R[k, b], contacts.normal)
    witness = _back(poses.R[k, b], contacts.second - poses.p[k, b])
    found = []
    for shape in np.unique(shapes[contacts.pair]).tolist():
        rows = np.flatnonzero(shapes[contacts.pair] == shape)
        found.append(
            _points(
                scene.geometry.geometryObjects[shape],
                rows,
                inward[rows],
                witness[rows],
                offset[rows],
            )
        )
    return _planes(contacts, carried, normal, found)


def _planes(contacts: Contacts, carried: Indices, normal: Array, found: list[_Found]) -> Planes:
    nothing = (np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros(0))
    row, centre, offset = (np.concatenate(parts) for parts in zip(nothing, *found, strict=True))
    return Planes(
        sample=contacts.sample[row],
        pair=contacts.pair[row],
        joints=carried[row],
        normal=normal[row],
        centre=centre,
        offset=offset,
    )


def _points(
    item: pin.GeometryObject, rows: Indices, inward: Array, witness: Array, offset: Array
) -> _Found:
    """Return the points of one shape, in the frame of its joint."""
    R, p = item.placement.rotation, item.placement.translation
    support = support_of(item.geometry, inward @ R, (witness - p) @ R)
    k = support.centres.shape[1]
    centres = support.centres.reshape(-1, 3) @ R.T + p
    return np.repeat(rows, k), centres, np.repeat(offset + support.radius, k)


def _turned(R: Array, x: Array) -> Array:
    return (R @ x[:, :, None])[:, :, 0]


def _back(R: Array, x: Array) -> Array:
    return (x[:, None, :] @ R)[:, 0]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))
