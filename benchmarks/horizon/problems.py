"""The problems of the benchmark: one function each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.tasks.pose import ToolPose

REACH = np.array([1.0, -0.5, -0.6])
"""(3,) [m] by which the tool moves."""


def tool_reach(n_steps: int = 40, **options: Any) -> OcpProblem:
    """13 DoF, water, thruster and joint limits: the tool moves by `REACH` and turns, and comes to
    rest.
    """
    robot = load_robot("girona_maris7_full")
    q = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))
    chosen: dict[str, Any] = {
        "duration": 8.0,
        "levels": [
            OcpLevel(name="tool", terms=(TaskTerm(task=ToolPose(goal=reach_goal(robot, q))),)),
            OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09))),
        ],
        "constraints": (AtRest(),),
    }
    start = State(q=q, v=np.zeros(robot.n_v))
    return single_phase(robot=robot, start=start, n_steps=n_steps, **(chosen | options))


def reach_goal(robot: Robot, q: np.ndarray) -> pin.SE3:
    """Return the pose where the tool is, moved by `REACH` and turned."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    X_WT = data.oMf[robot.frame_id("tool")]
    return pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.1, 0.3) @ X_WT.rotation, X_WT.translation + REACH)
