"""The most usual plan, ready-made: the tool moves to a pose and comes to rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.model.kinematics import Kinematics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import State
from uvms_ocp.planning.ocp import OcpLevel, OcpProblem, single_phase
from uvms_ocp.planning.plan import Plan
from uvms_ocp.planning.planner import Planner
from uvms_ocp.planning.terms import AtRest, Effort, Smoothness, TaskTerm
from uvms_ocp.solvers.lexicographic import NlpOptions
from uvms_ocp.tasks import ToolPose


def tool_reach(
    robot: Robot,
    q: np.ndarray,
    goal: pin.SE3,
    *,
    duration: float,
    n_steps: int = 40,
    current: Sequence[float] = (0.0, 0.0, 0.0),
) -> OcpProblem:
    """From rest at q (n_q,) to the tool pose `goal` X_WT and rest, with the least effort below that priority.

    duration [s]; current (3,) [m/s] in W. Raises what `OcpProblem` raises.
    """
    return single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=duration,
        n_steps=n_steps,
        levels=[
            OcpLevel(name="tool", terms=(TaskTerm(task=ToolPose(goal=goal)),)),
            OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.3))),
        ],
        constraints=(AtRest(),),
        current=np.asarray(current, dtype=float),
    )


def plan_tool_motion(
    robot: Robot,
    *,
    position: Sequence[float] = (0.0, 0.0, -5.0),
    rpy: Sequence[float] = (0.0, 0.0, 0.0),
    move: Sequence[float] = (1.0, 0.0, 0.0),
    turn: Sequence[float] = (0.0, 0.0, 0.0),
    duration: float = 8.0,
    n_steps: int = 40,
    current: Sequence[float] = (0.0, 0.0, 0.0),
    plugin: str = "ipopt",
) -> Plan:
    """Plan what ``uvms-ocp plan --method ocp`` asks for: the tool moves by `move` [m] and turns by `turn` [rad] in W.

    position [m] and rpy [rad] of the vehicle at the start, arm stowed.
    """
    q = robot.configuration(position=position, rpy=rpy)
    tool = Kinematics(robot, q).pose("tool")
    goal = pin.SE3(pin.rpy.rpyToMatrix(np.asarray(turn, dtype=float)) @ tool.rotation, tool.translation + move)
    problem = tool_reach(robot, q, goal, duration=duration, n_steps=n_steps, current=current)
    return Planner(problem, NlpOptions(plugin=plugin)).plan()
