"""Doubts about sizes of meshes, by the inertia of their body and by one another: a mesh in another
unit loads without a word.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.robot import Robot

_MAX_RATIO = 8.0  # of lengths, above which no coarse inertia or simple shape explains it
_BOX = np.sqrt(12.0)  # diagonal of a uniform box over its radius of gyration


def mesh_size_doubts(robot: Robot) -> Iterator[str]:
    """Yield one sentence for each body whose meshes are of another size than its inertia, or than
    its other shapes.
    """
    for joint in range(1, robot.model.njoints):
        visual = _diagonal(robot.visual_model, joint)
        collision = _diagonal(robot.collision_model, joint)
        name = _first_mesh(robot, joint)
        if name is None:
            continue
        if _are_far_apart(visual, collision):
            yield (
                f"mesh {name}: what is drawn of its body spans {visual:.3g} m, its collision shapes"
                f" {collision:.3g} m; mend the scale, or the unit of the mesh"
            )
            continue
        size = max(visual, collision)
        by_inertia = _size_by_inertia(robot.model.inertias[joint])
        if _are_far_apart(size, by_inertia):
            yield (
                f"mesh {name}: its body spans {size:.3g} m, and has the inertia of one of"
                f" {by_inertia:.3g} m; mend <inertia>, or the scale or the unit of the mesh"
            )


def _are_far_apart(a: float, b: float) -> bool:
    """Check whether of two lengths [m], 0 where there is none, one is many times the other."""
    if not (a > 0.0 and b > 0.0):
        return False
    return max(a, b) > _MAX_RATIO * min(a, b)


def _diagonal(shapes: pin.GeometryModel, joint: int) -> float:
    """Return the diagonal [m] of the box, along the joint's axes, around all shapes of a body; 0
    without any.
    """
    lower = np.full(3, np.inf)
    upper = np.full(3, -np.inf)
    for shape in shapes.geometryObjects:
        if shape.parentJoint != joint:
            continue
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        middle = shape.placement.act(np.asarray(box.center()))
        half = np.array([box.width(), box.height(), box.depth()]) / 2.0
        reach = np.abs(shape.placement.rotation) @ half
        lower = np.minimum(lower, middle - reach)
        upper = np.maximum(upper, middle + reach)
    if not (upper >= lower).all():
        return 0.0
    return float(np.linalg.norm(upper - lower))


def _size_by_inertia(inertia: pin.Inertia) -> float:
    """Return the diagonal [m] of a uniform box with this radius of gyration; 0 without mass."""
    if not inertia.mass > 0.0:
        return 0.0
    squared_gyration = np.trace(inertia.inertia) / 2.0 / inertia.mass
    return float(_BOX * np.sqrt(max(squared_gyration, 0.0)))


def _first_mesh(robot: Robot, joint: int) -> str | None:
    """Return the name of the file of a body's first mesh, quoted; `None` without any."""
    for shapes in (robot.collision_model, robot.visual_model):
        for shape in shapes.geometryObjects:
            file = Path(shape.meshPath)
            if shape.parentJoint == joint and file.suffix:  # a box has none
                return repr(file.name)
    return None
