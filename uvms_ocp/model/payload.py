"""Something that the robot carries."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.coefficients import links_in_water
from uvms_ocp.model.description import TrimBody, checked_copy
from uvms_ocp.model.robot import Robot


@dataclass(frozen=True, kw_only=True, slots=True)
class Payload:
    """A body without drag, fixed to a frame. Raises `InvalidInput` for a mass or volume below 0."""

    mass: float  # [kg]
    volume: float = 0.0  # [m3] displaced
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] centre, in the frame
    frame: str = "tool"

    def __post_init__(self) -> None:
        for name in ("mass", "volume"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InvalidInput(f"payload {name} = {value}; give a finite number >= 0")


def with_payload(robot: Robot, payload: Payload) -> Robot:
    """A copy of the robot that carries the payload. Raises `FrameNotFound`.

    Give it to the plant alone to see how a controller copes that does not know.
    """
    frame = robot.model.frames[robot.frame_id(payload.frame)]
    model = robot.model.copy()
    inertia = pin.Inertia(payload.mass, np.array(payload.position), np.zeros((3, 3)))
    model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    name = f"payload_{len(robot.description.trim)}"
    body = TrimBody(
        name=name, link=payload.frame, position=payload.position, mass=payload.mass, volume=payload.volume
    )
    description = checked_copy(robot.description, trim=(*robot.description.trim, body))
    return replace(robot, model=model, description=description, hydrodynamics=links_in_water(description))
