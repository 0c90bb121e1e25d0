"""Links of which no clearance tells."""

from __future__ import annotations

import pinocchio as pin

from uvms_ocp.model.robot import Robot

_NOTHING = 1e-9  # [kg] that rounding leaves


def links_without_shape(robot: Robot) -> tuple[str, ...]:
    """Return the names of the links that have a mass and no collision shape, in the order of the robot's frames."""
    shaped = {shape.parentFrame for shape in robot.collision_model.geometryObjects}
    return tuple(
        frame.name
        for index, frame in enumerate(robot.model.frames)
        if frame.type == pin.FrameType.BODY and index not in shaped and _mass(robot.model, frame) > _NOTHING
    )


def _mass(model: pin.Model, link: pin.Frame) -> float:
    """[kg] of a link, whose joint holds it: a fixed one by itself, a moving one with all that is fixed to it."""
    holder = model.frames[link.parentFrame]
    if holder.type == pin.FrameType.FIXED_JOINT:
        return float(holder.inertia.mass)
    fixed = sum(frame.inertia.mass for frame in model.frames if frame.parentJoint == link.parentJoint)
    return float(model.inertias[link.parentJoint].mass - fixed)
