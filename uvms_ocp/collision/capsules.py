"""Capsules: covering a robot's shapes with them, and their signed distances in closed form.

A capsule is the set of points within a radius of a segment; a sphere is one whose segment has no length.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot


class Capsule(NamedTuple):
    """A capsule along z of its frame."""

    half_length: float
    """[m] of the segment; 0 for a sphere."""
    radius: float
    """[m]"""


class Witness(NamedTuple):
    """Closest points of segments, row by row."""

    distance: Array
    """(n,) [m] between the segments, not negative."""
    normal: Array
    """(n, 3) [-] unit vector from the first to the second."""
    first: Array
    """(n, 3) [m] closest point of the first segment."""


def capsule_of(shape: coal.ShapeBase) -> Capsule:
    """The capsule that a coal sphere or capsule is. Raises InvalidInput for other shapes."""
    if isinstance(shape, coal.Sphere):
        return Capsule(0.0, float(shape.radius))
    if isinstance(shape, coal.Capsule):
        return Capsule(float(shape.halfLength), float(shape.radius))
    raise InvalidInput(
        f"shape {type(shape).__name__} has no closed form; allowed are Sphere and Capsule: cover the robot with "
        "capsule_robot, or use CoalDistances."
    )


def capsule_robot(robot: Robot) -> Robot:
    """The same robot with every cylinder and box of its collision model covered by capsules.

    A capsule covers a cylinder with its round ends beyond it; a box is cut into strips along its longest side. Links
    become larger, so what is free of collision for the result is so for the robot.
    """
    covered = pin.GeometryModel()
    for item in robot.collision_model.geometryObjects:
        for index, (X_shape, shape) in enumerate(cover(item.geometry)):
            placement = item.placement * X_shape
            name = item.name if index == 0 else f"{item.name}_{index}"
            covered.addGeometryObject(pin.GeometryObject(name, item.parentJoint, item.parentFrame, placement, shape))
    return replace(robot, collision_model=covered)


def segment_distance(a0: Array, a1: Array, b0: Array, b1: Array) -> Witness:
    """Closest points of segments with the end points a0, a1, b0 and b1 (n, 3) [m] each ([Ericson2005] 5.1.9)."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv, uw, vw = _dot(u, u), _dot(v, v), _dot(u, v), _dot(u, w), _dot(v, w)
    s = _clipped(uv * vw - vv * uw, uu * vv - uv * uv)
    t = _clipped(uv * s + vw, vv)
    s = _clipped(uv * t - uw, uu)
    first = a0 + s[:, None] * u
    gap = b0 + t[:, None] * v - first
    distance = np.sqrt(_dot(gap, gap))
    touching = distance < _TOUCH
    crossing = _crossing_normal(u[touching], v[touching])
    normal = gap / np.where(touching, 1.0, distance)[:, None]
    normal[touching] = crossing
    return Witness(distance=distance, normal=normal, first=first)


def symbolic_segment_distance(a0: ca.SX, a1: ca.SX, b0: ca.SX, b1: ca.SX) -> ca.SX:
    """The same distance [m] as an expression; its derivatives are exact except where the closest feature changes."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv, uw, vw = ca.dot(u, u), ca.dot(v, v), ca.dot(u, v), ca.dot(u, w), ca.dot(v, w)
    s = _symbolic_clipped(uv * vw - vv * uw, uu * vv - uv * uv)
    t = _symbolic_clipped(uv * s + vw, vv)
    s = _symbolic_clipped(uv * t - uw, uu)
    gap = b0 + t * v - a0 - s * u
    return ca.sqrt(ca.dot(gap, gap) + _TOUCH**2)


_TOUCH = 1e-12
_PARALLEL = 1e-14


def _clipped(numerator: Array, denominator: Array) -> Array:
    safe = np.where(denominator > _PARALLEL, denominator, 1.0)
    return np.where(denominator > _PARALLEL, np.clip(numerator / safe, 0.0, 1.0), 0.0)


def _symbolic_clipped(numerator: ca.SX, denominator: ca.SX) -> ca.SX:
    safe = ca.fmax(denominator, _PARALLEL)
    return ca.if_else(denominator > _PARALLEL, ca.fmin(ca.fmax(numerator / safe, 0.0), 1.0), 0.0)


def _crossing_normal(u: Array, v: Array) -> Array:
    """A normal to both segments where they cross, and the distance has no gradient."""
    n = np.cross(u, v)
    n[np.linalg.norm(n, axis=1) < _TOUCH] = [0.0, 0.0, 1.0]
    unit: Array = n / np.linalg.norm(n, axis=1, keepdims=True)
    return unit


def _dot(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def cover(shape: coal.ShapeBase) -> list[tuple[pin.SE3, coal.ShapeBase]]:
    """Capsules and spheres, with their places in the frame of the shape, that hold it. Raises InvalidInput."""
    if isinstance(shape, coal.Cylinder):
        return [(pin.SE3.Identity(), coal.Capsule(shape.radius, 2.0 * shape.halfLength))]
    if isinstance(shape, coal.Box):
        return _box_strips(np.array(shape.halfSide))
    capsule_of(shape)
    return [(pin.SE3.Identity(), shape)]


def _box_strips(half: Array) -> list[tuple[pin.SE3, coal.ShapeBase]]:
    """Strips as wide as the box is thin, each covered by a capsule around its axis."""
    thin, wide, long = (int(i) for i in np.argsort(half, kind="stable"))
    n = max(1, round(half[wide] / half[thin]))
    radius = float(np.hypot(half[wide] / n, half[thin]))
    capsule = coal.Capsule(radius, 2.0 * float(half[long]))
    R = np.zeros((3, 3))
    R[thin, 0] = R[wide, 1] = R[long, 2] = 1.0
    R[:, 0] *= np.linalg.det(R)
    offsets = half[wide] * ((2.0 * np.arange(n) + 1.0) / n - 1.0)
    return [(pin.SE3(R, offset * np.eye(3)[wide]), capsule) for offset in offsets]
