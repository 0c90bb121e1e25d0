"""Where the abort phase climbs to from where the robot is: straight up, upright."""

from __future__ import annotations

import math
from typing import Annotated, Any

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector
from uvms_ocp.functions.kernels.smooth import Smooth
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.symbolic.tree import SymbolicModel

N_POSE = 12  # position, then rotation column by column


class ClimbMemory(Layout):
    """The frame that climbs, and its goal."""

    pose: Smooth
    """q to position (3,) [m] and rotation (9,) [-] of the frame in W, column by column."""
    altitude: float
    """[m] as that of `Abort`."""
    place: Annotated[Vector, Sized(3)]
    """(3,) [m] of the frame in W."""
    rotation: Annotated[Vector, Sized(9)]
    """(9,) [-] of the frame in W, column by column."""
    goal: Annotated[Vector, Sized(N_POSE)]
    """(12,) [m, -] position and rotation in W that it climbs to."""


def aim(m: ClimbMemory, q: Vector, floor: float) -> None:
    """The goal from q [m, rad], which may show joints beyond their limits. A kernel.

    floor [m]: z in W of the highest that is known, NaN where none is to be believed.
    """
    m.pose(q, m.place, m.rotation)
    yaw = math.atan2(m.rotation[1], m.rotation[0])
    for i in range(len(m.goal)):
        m.goal[i] = 0.0
    m.goal[0] = m.place[0]
    m.goal[1] = m.place[1]
    m.goal[2] = max(m.place[2], floor + m.altitude) if math.isfinite(floor) else m.place[2] + m.altitude
    m.goal[3] = math.cos(yaw)
    m.goal[4] = math.sin(yaw)
    m.goal[6] = -m.goal[4]
    m.goal[7] = m.goal[3]
    m.goal[11] = 1.0


def climb_sizes(robot: Robot, mission: Mission) -> dict[str, ca.Function]:
    """Of a `ClimbMemory`; nothing climbs without an abort phase."""
    q = ca.SX.sym("q", robot.n_q)
    R_WF, p_WF = ca.SX.eye(3), ca.SX.zeros(3)
    if mission.abort is not None:
        R_WF, p_WF = SymbolicModel(robot.model).forward_kinematics(q).pose(mission.climb_frame)
    outputs = [ca.densify(p_WF), ca.densify(ca.vec(R_WF))]
    return {"pose": ca.Function("climb_frame", [q], outputs, {"cse": True})}


def climb_goal(memory: Any) -> pin.SE3:
    """The goal that `aim` has left in a `ClimbMemory`."""
    goal = np.array(memory.goal)
    return pin.SE3(goal[3:].reshape(3, 3, order="F"), goal[:3])
