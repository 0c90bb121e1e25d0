"""Move fixed frames, of sensors or tools, of a Pinocchio model without touching the original."""

from __future__ import annotations

import pinocchio as pin

from uvms_ocp.errors import InvalidInput


def check_movable(model: pin.Model, index: int) -> None:
    """Raise ``InvalidInput`` for a frame that is itself a moving link."""
    frame = model.frames[index]
    carrier = model.frames[frame.parentFrame] if frame.type == pin.FrameType.BODY else frame
    if carrier.type == pin.FrameType.JOINT:
        raise InvalidInput(
            f"frame {frame.name!r} is a moving link; only frames fixed to a link can be moved"
        )


def frames_fixed_to(model: pin.Model, index: int) -> frozenset[int]:
    """Return the frame and all frames rigidly attached to it."""
    fixed = {index}
    # Pinocchio appends children after their parents, so one pass finds all descendants.
    for i, frame in enumerate(model.frames[index + 1 :], start=index + 1):
        if frame.parentFrame in fixed and frame.type != pin.FrameType.JOINT:
            fixed.add(i)
    return frozenset(fixed)


def shifted_frames(model: pin.Model, moved: frozenset[int], shift: pin.SE3) -> pin.Model:
    """Return a copy of the model with the frames, and the joints they carry, moved by ``shift``."""
    model = model.copy()
    for i in moved:
        model.frames[i].placement = shift * model.frames[i].placement
    for frame in model.frames:
        if frame.type == pin.FrameType.JOINT and frame.parentFrame in moved:
            joint = frame.parentJoint
            model.jointPlacements[joint] = shift * model.jointPlacements[joint]
    return model


def shifted_shapes(
    shapes: pin.GeometryModel, moved: frozenset[int], shift: pin.SE3
) -> pin.GeometryModel:
    """Return a copy of the shapes with those on the given frames moved by ``shift``."""
    shapes = shapes.copy()
    for shape in shapes.geometryObjects:
        if shape.parentFrame in moved:
            shape.placement = shift * shape.placement
    return shapes
