"""Planes that part shapes: where coal finds two of them nearest, and the points that have to stay beyond.

A plane is fixed to the first shape of a pair and touches it, so it bounds that shape wherever the robot goes. What the
points of the second shape have to the plane is never more than the distance of two convex shapes, and equal to it in value
and gradient at the configuration where coal found the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array, Indices
from uvms_ocp.collision.coal_distances import Contacts
from uvms_ocp.collision.collision_scene import CollisionScene
from uvms_ocp.ocp.clearance.support_points import support_of


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Poses:
    """Of all joints at all samples."""

    R: Array
    """(n_samples, n_joints, 3, 3) [-] R_WJ, the world first."""
    p: Array
    """(n_samples, n_joints, 3) [m] p_WJ"""

    @staticmethod
    def of(model: pin.Model, q: Array) -> Poses:
        """At configurations q (n, n_q) [m, rad]."""
        data, R, p = model.createData(), np.empty((len(q), model.njoints, 3, 3)), np.empty((len(q), model.njoints, 3))
        for k, row in enumerate(q):
            pin.forwardKinematics(model, data, row)
            R[k], p[k] = [X.rotation for X in data.oMi], [X.translation for X in data.oMi]
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
    """(n, 3) [-] in the frame of the plane's joint."""
    centre: Array
    """(n, 3) [m] the point, in the frame of its joint."""
    offset: Array
    """(n,) [m] of the plane from the origin of its joint, and the radius of the ball around the centre."""

    def heights(self, poses: Poses) -> Array:
        """(n,) [m] of every point over its plane at `poses`, sample by sample."""
        a, b, k = self.joints[:, 0], self.joints[:, 1], self.sample
        normal = _turned(poses.R[k, a], self.normal)
        centre = _turned(poses.R[k, b], self.centre) + poses.p[k, b] - poses.p[k, a]
        return _dot(normal, centre) - self.offset

    def of(self, chosen: Indices) -> Planes:
        """Those of the given rows."""
        return Planes(**{name: getattr(self, name)[chosen] for name in self.__slots__})


def planes(scene: CollisionScene, contacts: Contacts, poses: Poses) -> Planes:
    """Of all contacts, with all that has to stay beyond of the second shapes."""
    pairs = scene.pairs
    joints = np.array([(pair.first_joint, pair.second_joint) for pair in pairs], dtype=np.intp).reshape(-1, 2)
    shapes, carried = np.array([pair.second for pair in pairs], dtype=np.intp), joints[contacts.pair]
    a, b, k = carried[:, 0], carried[:, 1], contacts.sample
    normal = _back(poses.R[k, a], contacts.normal)
    offset = _dot(normal, _back(poses.R[k, a], contacts.first - poses.p[k, a]))
    inward = _back(poses.R[k, b], contacts.normal)
    witness = _back(poses.R[k, b], contacts.second - poses.p[k, b])
    found = []
    for shape in np.unique(shapes[contacts.pair]).tolist():
        rows = np.flatnonzero(shapes[contacts.pair] == shape)
        found.append(_points(scene.geometry.geometryObjects[shape], rows, inward[rows], witness[rows], offset[rows]))
    return _planes(contacts, carried, normal, found)


_Found = tuple[Indices, Array, Array]
"""Row of the contact, point and offset."""


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


def _points(item: pin.GeometryObject, rows: Indices, inward: Array, witness: Array, offset: Array) -> _Found:
    """Of one shape, in the frame of its joint."""
    R, p = item.placement.rotation, item.placement.translation
    support = support_of(item.geometry, inward @ R, (witness - p) @ R)
    k, centres = support.centres.shape[1], support.centres.reshape(-1, 3) @ R.T + p
    return np.repeat(rows, k), centres, np.repeat(offset + support.radius, k)


def _turned(R: Array, x: Array) -> Array:
    return (R @ x[:, :, None])[:, :, 0]


def _back(R: Array, x: Array) -> Array:
    return (x[:, None, :] @ R)[:, 0]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))
