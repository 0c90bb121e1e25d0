"""Whether a load can be learnt at all: the controller refuses by it, and pre-flight says so before."""

from __future__ import annotations

from uvms_ocp.control.load.learning import LOAD_FRAME
from uvms_ocp.control.load.load_filter import require_limits
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import largest_force


def require_learnable(robot: Robot, *, observed: bool) -> None:
    """Raise `FrameNotFound` for a robot without a tool, and `InvalidInput` where it may not learn.

    That is where an axis bears no force or any, and where the disturbance is not observed.
    """
    if not observed:
        raise InvalidInput("a load is learnt from the disturbance observer; give it a bandwidth, or load=None")
    robot.frame_id(LOAD_FRAME)
    require_limits(largest_force(robot))
