"""Boxes around the shapes of links, and cylinders in them, for links of which nothing but the shapes
is known.
"""

from __future__ import annotations

from itertools import product

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.robot.description import Cylinder, LinkDescription, Pose, Vector3
from uvms_ocp.robot.robot import Robot

_MIN_RADIUS = 1e-4  # [m]; flatter links displace no water worth counting
_ALONG: tuple[Vector3, Vector3, Vector3] = (
    (0.0, np.pi / 2, 0.0),
    (-np.pi / 2, 0.0, 0.0),
    (0.0, 0.0, 0.0),
)
"""Roll, pitch and yaw [rad] that turn a cylinder's z axis to x, y, z."""


def cylinders_around_links(robot: Robot) -> dict[str, LinkDescription]:
    """Return one cylinder per frame that carries collision shapes (visual ones where there are
    none).

    The cylinder lies along the longest side of the box around the link's shapes; its diameter is
    the mean of the other two sides. It overestimates the volume of hollow or bent links: give
    measured data where there are any.
    """
    shapes = robot.collision_model if robot.collision_model.ngeoms else robot.visual_model
    descriptions = dict[str, LinkDescription]()
    for index in dict.fromkeys(shape.parentFrame for shape in shapes.geometryObjects):
        name = robot.model.frames[index].name
        cylinder = cylinder_in(box_around(robot.model, shapes, name))
        if cylinder is not None:
            descriptions[name] = LinkDescription(cylinder=cylinder)
    return descriptions


def box_around(
    model: pin.Model, shapes: pin.GeometryModel, frame: str, *, joint: int | None = None
) -> np.ndarray:
    """Return corners (2, 3) [m] of the box around the shapes of a link, in its frame; nan without
    shapes.

    joint: take the shapes of all links that this joint carries.
    """
    index = model.getFrameId(frame)
    X_JF = model.frames[index].placement
    corners = list[np.ndarray]()
    for shape in shapes.geometryObjects:
        if joint is None:
            is_included = shape.parentFrame == index
        else:
            is_included = shape.parentJoint == joint
        if is_included:
            for corner in box_corners(shape.geometry):
                corners.append(X_JF.actInv(shape.placement.act(corner)))
    if not corners:
        return np.full((2, 3), np.nan)
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])


def box_corners(geometry: coal.CollisionGeometry) -> np.ndarray:
    """Return corners (8, 3) [m] of the box around a shape, in its own frame."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return np.array(list(product(*zip(box.min_, box.max_, strict=True))))


def cylinder_in(corners: np.ndarray) -> Cylinder | None:
    """Return the cylinder along the longest side of a box with corners (n, 3) [m]; `None` for a
    flat one.
    """
    lower = corners.min(axis=0)
    upper = corners.max(axis=0)
    sides = upper - lower
    axis = int(np.argmax(sides))
    radius = float(np.delete(sides, axis).mean()) / 2.0
    if not radius >= _MIN_RADIUS:
        return None
    x, y, z = (0.5 * (lower + upper)).tolist()
    return Cylinder(
        radius=radius, length=float(sides[axis]), pose=Pose(position=(x, y, z), rpy=_ALONG[axis])
    )
