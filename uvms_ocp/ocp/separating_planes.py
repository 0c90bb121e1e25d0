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

_N_VERTICES = 6  # of a mesh, nearest to the plane first
_NO_LENGTH = 1e-9  # of a direction in the plane of a circle that has none


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Planes:
    """One row per plane and point, which stays beyond: ``n . c >= s`` in one frame."""

    sample: Indices
    """(n,) index of the sample."""
    pair: Indices
    """(n,) index of the pair of shapes."""
    joints: Indices
    """(n, 2) joints of the plane and of the point."""
    normal: Array
    """(n, 3) normals in the frames of the planes' joints."""
    centre: Array
    """(n, 3) [m] the point, in the frame of its joint."""
    offset: Array
    """(n,) [m] distance of the plane from the origin of its joint, and the radius of the ball
    around the centre.
    """

    def heights(self, poses: Poses) -> Array:
        """Return the height (n,) [m] of every point over its plane at `poses`, sample by sample."""
        k = self.sample
        first = self.joints[:, 0]
        second = self.joints[:, 1]
        normal = _turned(poses.R[k, first], self.normal)
        centre = _turned(poses.R[k, second], self.centre) + poses.p[k, second] - poses.p[k, first]
        return _dot(normal, centre) - self.offset

    @staticmethod
    def joined(*parts: Planes) -> Planes:
        """Return the rows of all parts, one after the other."""
        return Planes(
            sample=np.concatenate([part.sample for part in parts]),
            pair=np.concatenate([part.pair for part in parts]),
            joints=np.concatenate([part.joints for part in parts]),
            normal=np.concatenate([part.normal for part in parts]),
            centre=np.concatenate([part.centre for part in parts]),
            offset=np.concatenate([part.offset for part in parts]),
        )

    def of(self, chosen: Indices) -> Planes:
        """Select the planes of the chosen rows."""
        return Planes(
            sample=self.sample[chosen],
            pair=self.pair[chosen],
            joints=self.joints[chosen],
            normal=self.normal[chosen],
            centre=self.centre[chosen],
            offset=self.offset[chosen],
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Poses:
    """Poses of all joints at all samples."""

    R: Array
    """(n_samples, n_joints, 3, 3) R_WJ, the world first."""
    p: Array
    """(n_samples, n_joints, 3) [m] p_WJ"""

    @staticmethod
    def of(model: pin.Model, q: Array) -> Poses:
        """Return the poses at configurations q (n, n_q) [m, rad]."""
        require_normalized(model, q)
        data = model.createData()
        R = np.empty((len(q), model.njoints, 3, 3))
        p = np.empty((len(q), model.njoints, 3))
        for k, row in enumerate(q):
            pin.forwardKinematics(model, data, row)
            R[k] = [X.rotation for X in data.oMi]
            p[k] = [X.translation for X in data.oMi]
        return Poses(R=R, p=p)


def planes(scene: CollisionScene, contacts: Contacts, poses: Poses) -> Planes:
    """Build the planes of all contacts, with the points of the second shapes that stay beyond
    them.
    """
    pairs = scene.pairs
    joints_of_pairs = np.array(
        [(pair.first_joint, pair.second_joint) for pair in pairs], dtype=np.intp
    )
    joints = joints_of_pairs.reshape(-1, 2)[contacts.pair]
    second_shape = np.array([pair.second for pair in pairs], dtype=np.intp)[contacts.pair]
    k = contacts.sample
    R_first = poses.R[k, joints[:, 0]]
    p_first = poses.p[k, joints[:, 0]]
    R_second = poses.R[k, joints[:, 1]]
    p_second = poses.p[k, joints[:, 1]]
    normal = _turned_back(R_first, contacts.normal)
    offset = _dot(normal, _turned_back(R_first, contacts.first - p_first))
    inward = _turned_back(R_second, contacts.normal)
    witness = _turned_back(R_second, contacts.second - p_second)
    contact_rows = [np.zeros(0, dtype=np.intp)]
    centres = [np.zeros((0, 3))]
    radii = [np.zeros(0)]
    for shape in np.unique(second_shape).tolist():
        rows = np.flatnonzero(second_shape == shape)
        item = scene.geometry.geometryObjects[shape]
        shape_centres, radius = _support_points(item, inward[rows], witness[rows])
        n_points = shape_centres.shape[1]
        contact_rows.append(np.repeat(rows, n_points))
        centres.append(shape_centres.reshape(-1, 3))
        radii.append(np.full(len(rows) * n_points, radius))
    row = np.concatenate(contact_rows)
    return Planes(
        sample=contacts.sample[row],
        pair=contacts.pair[row],
        joints=joints[row],
        normal=normal[row],
        centre=np.concatenate(centres),
        offset=offset[row] + np.concatenate(radii),
    )


def _support_points(item: pin.GeometryObject, inward: Array, witness: Array) -> tuple[Array, float]:
    """Return the points (n, k, 3) [m] of one shape in the frame of its joint, for planes with
    normals inward (n, 3), and the radius [m] of balls around them.
    """
    rotation = item.placement.rotation
    p = item.placement.translation
    support = support_of(item.geometry, inward @ rotation, (witness - p) @ rotation)
    centres = support.centres.reshape(-1, 3) @ rotation.T + p
    return centres.reshape(support.centres.shape), support.radius


def _turned(R: Array, x: Array) -> Array:
    return (R @ x[:, :, None])[:, :, 0]


def _turned_back(R: Array, x: Array) -> Array:
    return (x[:, None, :] @ R)[:, 0]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Support:
    """Points of a convex shape of which one is the farthest against a direction, for directions
    near each of n ones; in the frame of the shape.
    """

    centres: Array
    """(n, k, 3) [m] k points for each direction."""
    radius: float = 0.0
    """[m] radius of balls around them."""


def support_of(shape: coal.CollisionGeometry, normals: Array, witnesses: Array) -> Support:
    """Support a shape in planes with normals (n, 3) towards it.

    Of a mesh only the vertices nearest to each plane count. witnesses (n, 3) [m], points of the
    shape nearest to the planes, serve where a shape has no form of its own here.
    """
    for kind, support in _SUPPORTS.items():
        if isinstance(shape, kind):
            return support(shape, normals)
    return Support(centres=witnesses[:, None])


def _of_sphere(shape: coal.Sphere, normals: Array) -> Support:
    return Support(centres=np.zeros((len(normals), 1, 3)), radius=float(shape.radius))


def _of_capsule(shape: coal.Capsule, normals: Array) -> Support:
    return Support(centres=_tiled(_ends(shape), normals), radius=float(shape.radius))


def _of_cylinder(shape: coal.Cylinder, normals: Array) -> Support:
    rim = _rim(shape.radius, normals)
    up = np.array([0.0, 0.0, shape.halfLength])
    return Support(centres=np.concatenate([rim - up, rim + up], axis=1))


def _of_cone(shape: coal.Cone, normals: Array) -> Support:
    ends = _tiled(_ends(shape), normals)
    rim = _rim(shape.radius, normals) + ends[:, :1]
    apex = ends[:, 1:]
    return Support(centres=np.concatenate([rim, apex], axis=1))


def _rim(radius: float, normals: Array) -> Array:
    """Return points (n, 4, 3) [m] of a circle about z: where a plane would touch it, across from
    there, and halfway.
    """
    length = np.linalg.norm(normals[:, :2], axis=1, keepdims=True)
    direction = -normals[:, :2] / np.maximum(length, _NO_LENGTH)
    touch = np.where(length > _NO_LENGTH, direction, [1.0, 0.0])
    aside = np.stack([-touch[:, 1], touch[:, 0]], axis=1)
    rim = np.zeros((len(normals), 4, 3))
    rim[:, :, :2] = radius * np.stack([touch, aside, -aside, -touch], axis=1)
    return rim


def _of_box(shape: coal.Box, normals: Array) -> Support:
    sides = [-1.0, 1.0]
    signs = np.stack(np.meshgrid(sides, sides, sides, indexing="ij"), axis=-1).reshape(-1, 3)
    return Support(centres=_tiled(signs * np.array(shape.halfSide), normals))


def _of_vertices(shape: coal.ConvexBase, normals: Array) -> Support:
    vertices = np.asarray(shape.points())
    order = np.argsort(normals @ vertices.T, axis=1, kind="stable")
    nearest = order[:, :_N_VERTICES]
    return Support(centres=vertices[nearest])


def _ends(shape: coal.Cylinder | coal.Capsule | coal.Cone) -> Array:
    return shape.halfLength * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


def _tiled(points: Array, normals: Array) -> Array:
    return np.broadcast_to(points, (len(normals), *points.shape))


_SUPPORTS: Mapping[type, Callable[..., Support]] = {
    coal.Sphere: _of_sphere,
    coal.Capsule: _of_capsule,
    coal.Box: _of_box,
    coal.Cylinder: _of_cylinder,
    coal.Cone: _of_cone,
    coal.ConvexBase: _of_vertices,
}
"""Support of each kind of shape."""
