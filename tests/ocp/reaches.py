"""A tool reach of the full robot, as a problem and a patient planner of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import PLUGINS, NlpOptions
from uvms_ocp.tasks.pose import ToolPose
from uvms_ocp.tasks.task import Task

CHEAP = OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09)))
PATIENCE = 600.0  # [s] for other programs on the machine must not decide a verdict


def patient(problem: OcpProblem, plugin: str = PLUGINS[0]) -> Planner:
    return Planner(problem, NlpOptions(time_limit=PATIENCE, plugin=plugin))


def tool_goal(robot: Robot, q: np.ndarray, shift: tuple[float, float, float]) -> Task:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    X_WT = data.oMf[robot.frame_id("tool")]
    turn = pin.rpy.rpyToMatrix(0.2, 0.1, 0.3)
    return ToolPose(goal=pin.SE3(turn @ X_WT.rotation, X_WT.translation + np.array(shift)))


def reach(
    robot: Robot, *, shift: tuple[float, float, float] = (1.0, -0.5, -0.6), **options: object
) -> OcpProblem:
    q = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))
    tool = OcpLevel(name="tool", terms=(TaskTerm(task=tool_goal(robot, q, shift)),))
    chosen = {
        "start": State(q=q, v=np.zeros(robot.n_v)),
        "duration": 8.0,
        "n_steps": 20,
        "levels": [tool, CHEAP],
        "constraints": (AtRest(),),
    }
    return single_phase(robot=robot, **(chosen | options))  # type: ignore[arg-type]
