"""Check meshes for their size and axes, by the inertia of their body and by one another, and for
holes. A mesh in another unit, with another axis up, or open, loads without a word.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.link_boxes import box_corners
from uvms_ocp.robot.proposed_water import WATER_DENSITY, holds_too_much
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.signed_distance import Body
from uvms_ocp.robot.urdf_meshes import collada_asset

_MAX_RATIO = 8.0  # of lengths, above which no coarse inertia or simple shape explains it
_CLEAR_MISFIT = np.log(1.6)
"""Difference of proportions below which a body fits its inertia either way."""
_SIDES_TURNED = {"Y_UP": [0, 2, 1], "X_UP": [1, 0, 2]}
"""Order of the sides of a mesh once the axis that it states is up."""
_BOX = np.sqrt(12.0)  # diagonal of a uniform box over its radius of gyration


def mesh_size_doubts(robot: Robot) -> Iterator[str]:
    """Yield one sentence for each body whose meshes are of another size than its inertia, or than
    its other shapes.
    """
    for joint in range(1, robot.model.njoints):
        visual_sides = _sides(robot.visual_model, joint)
        collision_sides = _sides(robot.collision_model, joint)
        visual = float(np.linalg.norm(visual_sides))
        collision = float(np.linalg.norm(collision_sides))
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
            continue
        mass = float(robot.model.inertias[joint].mass)
        sides = max(visual_sides, collision_sides, key=lambda sides: float(np.prod(sides)))
        if mass > 0.0 and holds_too_much(sides, mass):
            held = WATER_DENSITY * float(np.prod(sides))
            yield (
                f"mesh {name}: the box around its body holds {held:.3g} kg of water, and it weighs"
                f" {mass:.3g} kg; one in feet holds 35 times as much as in metres: mend its scale or"
                " unit, or <mass>"
            )


def mesh_axis_doubts(robot: Robot) -> Iterator[str]:
    """Yield one sentence for each Collada mesh that states another axis up than z, and whose sides
    fit its body better when turned by that.
    """
    told = set[str]()
    for shapes in (robot.collision_model, robot.visual_model):
        for shape in shapes.geometryObjects:
            file = Path(shape.meshPath)
            up_axis = collada_asset(file).up_axis
            if up_axis == "Z_UP" or file.name in told or not file.is_file():
                continue
            expected = _sides_of_body(robot, shape.parentJoint)
            if expected is None:
                continue
            shape.geometry.computeLocalAABB()
            box = shape.geometry.aabb_local
            sides = np.array([box.width(), box.height(), box.depth()])
            as_read = _misfit(np.abs(shape.placement.rotation) @ sides, expected)
            turned_sides = sides[_SIDES_TURNED[up_axis]]
            turned = _misfit(np.abs(shape.placement.rotation) @ turned_sides, expected)
            if as_read > _CLEAR_MISFIT and turned < as_read / 2.0:
                told.add(file.name)
                yield (
                    f"mesh {file.name!r} states {up_axis}, and fits its body only when turned so; it"
                    " is read with z up: turn its <origin>, or save it with z up"
                )


def open_meshes(robot: Robot) -> Iterator[str]:
    """Yield the names of the files of collision meshes that are not closed: they are surfaces, and
    nothing is inside them.
    """
    told = set[str]()
    for shape in robot.collision_model.geometryObjects:
        body = Body(shape.geometry)
        file = Path(shape.meshPath)
        if file.name not in told and body.is_mesh and body.solid is None:
            told.add(file.name)
            yield repr(file.name)


def _misfit(sides: np.ndarray, expected: np.ndarray) -> float:
    """Return how far the proportions of two boxes with sides (3,) [m] are apart."""
    logs = np.log(np.maximum(sides, 1e-6) / np.maximum(expected, 1e-6))
    return float(np.ptp(logs))


def _sides_of_body(robot: Robot, joint: int) -> np.ndarray | None:
    """Return the sides (3,) [m], along the axes of a joint, of a body's primitive collision shapes,
    or of the uniform box that has its inertia; `None` where neither is there.
    """
    lower = np.full(3, np.inf)
    upper = np.full(3, -np.inf)
    for shape in robot.collision_model.geometryObjects:
        if shape.parentJoint == joint and not Path(shape.meshPath).suffix:
            for corner in box_corners(shape.geometry):
                lower = np.minimum(lower, shape.placement.act(corner))
                upper = np.maximum(upper, shape.placement.act(corner))
    if (upper > lower).all():
        return upper - lower
    inertia = robot.model.inertias[joint]
    if not inertia.mass > 0.0:
        return None
    xx, yy, zz = np.diag(inertia.inertia) * 6.0 / inertia.mass
    squares = np.array([yy + zz - xx, zz + xx - yy, xx + yy - zz])
    if not (squares > 0.0).all():
        return None
    return np.sqrt(squares)


def _are_far_apart(a: float, b: float) -> bool:
    """Check whether of two lengths [m], 0 where there is none, one is many times the other."""
    if not (a > 0.0 and b > 0.0):
        return False
    return max(a, b) > _MAX_RATIO * min(a, b)


def _sides(shapes: pin.GeometryModel, joint: int) -> np.ndarray:
    """Return the sides (3,) [m] of the box, along the joint's axes, around all shapes of a body; 0
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
        return np.zeros(3)
    return upper - lower


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
