"""Cylinders around the links of an arm of which nothing but its shapes is known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pinocchio as pin

from uvms_ocp.model.files.description import Cylinder, LinkDescription, Pose, Vector3
from uvms_ocp.model.robot import Robot

_SMALLEST = 1e-4  # [m]; flatter links displace no water worth counting

# Turns the cylinder's z axis to x, y, z.
_ALONG: tuple[Vector3, Vector3, Vector3] = ((0.0, np.pi / 2, 0.0), (-np.pi / 2, 0.0, 0.0), (0.0, 0.0, 0.0))


def cylinders_around_links(robot: Robot) -> dict[str, LinkDescription]:
    """Return one cylinder per frame that carries collision shapes (visual ones where there are none).

    The cylinder lies along the longest side of the box around the link's shapes; its diameter is the mean of the
    other two sides. It overestimates the volume of hollow or bent links: give measured data where there are any.
    """
    shapes = robot.collision_model if robot.collision_model.ngeoms else robot.visual_model
    boxes: dict[int, list[np.ndarray]] = {}
    for shape in shapes.geometryObjects:
        boxes.setdefault(int(shape.parentFrame), []).append(_corners(robot.model, shape))
    cylinders = {robot.model.frames[i].name: _cylinder(np.vstack(corners)) for i, corners in boxes.items()}
    return {name: LinkDescription(cylinder=cylinder) for name, cylinder in cylinders.items() if cylinder}


def _corners(model: pin.Model, shape: pin.GeometryObject) -> np.ndarray:
    """Corners (8, 3) of the box around a shape, in the frame that carries it."""
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    X_FG = model.frames[shape.parentFrame].placement.inverse() * shape.placement
    corners = product(*zip(box.min_, box.max_, strict=True))
    return np.array([X_FG.act(np.array(corner)) for corner in corners])


def _cylinder(corners: np.ndarray) -> Cylinder | None:
    low, high = corners.min(axis=0), corners.max(axis=0)
    sides = high - low
    axis = int(np.argmax(sides))
    radius = float(np.delete(sides, axis).mean()) / 2.0
    if radius < _SMALLEST:
        return None
    x, y, z = (0.5 * (low + high)).tolist()
    return Cylinder(radius=radius, length=float(sides[axis]), pose=Pose(position=(x, y, z), rpy=_ALONG[axis]))
