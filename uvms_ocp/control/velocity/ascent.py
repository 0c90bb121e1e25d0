"""Aim the climb of the abort phase: straight up from where the robot is, upright."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.codegen.kernel_layout import FunctionField, Layout, Sized, Vector
from uvms_ocp.estimation import fallbacks
from uvms_ocp.mission import Mission
from uvms_ocp.robot import Robot, SymbolicModel
from uvms_ocp.robot.shapes.hull import lowest_point

N_POSE = 12  # position, then rotation column by column


class AscentMemory(Layout):
    """The frame that climbs, and its goal."""

    pose: FunctionField
    """Function of q that gives position (3,) [m] and rotation (9,) of the frame in W, column by
    column.
    """
    altitude: float
    """[m] height above the floor that is safe, or above the start of the phase where no floor is
    known.
    """
    place: Annotated[Vector, Sized(3)]
    """(3,) [m] position of the frame in W."""
    rotation: Annotated[Vector, Sized(9)]
    """(9,) rotation of the frame in W, column by column."""
    goal: Annotated[Vector, Sized(N_POSE)]
    """(12,) [m, -] position and rotation in W that it climbs to."""


def aim_ascent(ascent: AscentMemory, q: Vector, floor: float) -> None:
    """Write the goal of the climb from q [m, rad], which may show joints beyond their limits. A
    kernel.

    floor [m]: z in W of the highest floor that is known, NaN where none is to be believed.
    """
    ascent.pose(q, ascent.place, ascent.rotation)
    yaw = math.atan2(ascent.rotation[1], ascent.rotation[0])
    for i in range(len(ascent.goal)):
        ascent.goal[i] = 0.0
    ascent.goal[0] = ascent.place[0]
    ascent.goal[1] = ascent.place[1]
    if math.isfinite(floor):
        ascent.goal[2] = max(ascent.place[2], floor + ascent.altitude)
    else:
        ascent.goal[2] = ascent.place[2] + ascent.altitude
    ascent.goal[3] = math.cos(yaw)
    ascent.goal[4] = math.sin(yaw)
    ascent.goal[6] = -ascent.goal[4]
    ascent.goal[7] = ascent.goal[3]
    ascent.goal[11] = 1.0


def ascent_functions(
    robot: Robot, mission: Mission, altimeter: str | None
) -> dict[str, ca.Function]:
    """Return the functions of an `AscentMemory`, and what tells how low the robot is; nothing ascends
    without an abort phase.

    altimeter: its frame.
    """
    frame = None if mission.abort is None else mission.ascent_frame
    return {
        "pose": _climb_frame(robot, frame),
        "lowest": lowest_point(robot, fallbacks.UNSEEN_SLOPE, altimeter),
    }


@lru_cache(maxsize=8)
def _climb_frame(robot: Robot, frame: str | None) -> ca.Function:
    """Make the function ``q -> position (3,) [m], rotation (9,)`` of a frame in W; at the origin
    without a frame.
    """
    q = ca.SX.sym("q", robot.n_q)
    R_WF = ca.SX.eye(3)
    p_WF = ca.SX.zeros(3)
    if frame is not None:
        R_WF, p_WF = SymbolicModel(robot.model).forward_kinematics(q).pose(frame)
    return ca.Function(
        "climb_frame", [q], [ca.densify(p_WF), ca.densify(ca.vec(R_WF))], {"cse": True}
    )


def ascent_goal(memory: AscentMemory) -> pin.SE3:
    """Return the goal that `aim_ascent` has left in an `AscentMemory`."""
    goal = np.array(memory.goal)
    return pin.SE3(goal[3:].reshape(3, 3, order="F"), goal[:3])
