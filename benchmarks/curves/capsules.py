"""Cover the shapes of a robot with capsules, for closed forms of distances.

A capsule is the set of points within a radius of a segment; a sphere is one whose segment has no
length.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.robot import Robot
from uvms_ocp.types import Array


class Capsule(NamedTuple):
    """A capsule along z of its frame."""

    half_length: float
    """[m] of the segment; 0 for a sphere."""
    radius: float
    """[m]"""


def capsule_of(shape: coal.ShapeBase) -> Capsule:
    """The capsule that a coal sphere or capsule is. Raises InvalidInput for other shapes."""
    if isinstance(shape, coal.Sphere):
        return Capsule(0.0, float(shape.radius))
    if isinstance(shape, coal.Capsule):
        return Capsule(float(shape.halfLength), float(shape.radius))
    raise InvalidInput(
        f"shape {type(shape).__name__} has no closed form; allowed are Sphere and Capsule: cover"
        " the robot with capsule_robot, or use CoalDistances."
    )


def capsule_robot(robot: Robot) -> Robot:
    """Return the same robot with every cylinder and box of its collision model covered by capsules.

    A capsule covers a cylinder with its round ends beyond it; a box is cut into strips along its
    longest side. Links become larger, so what is free of collision for the result is so for the
    robot.
    """
    covered = pin.GeometryModel()
    for item in robot.collision_model.geometryObjects:
        for index, (X_shape, shape) in enumerate(cover(item.geometry)):
            placement = item.placement * X_shape
            name = item.name if index == 0 else f"{item.name}_{index}"
            covered.addGeometryObject(
                pin.GeometryObject(name, item.parentJoint, item.parentFrame, placement, shape)
            )
    return replace(robot, collision_model=covered)


def cover(shape: coal.ShapeBase) -> list[tuple[pin.SE3, coal.ShapeBase]]:
    """Capsules and spheres, with their places in the frame of the shape, that hold it. Raises
    InvalidInput.
    """
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
