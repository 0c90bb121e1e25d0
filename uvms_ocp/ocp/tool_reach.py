"""The most usual problem, ready-made: the tool moves to a pose and comes to rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import checked
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm
from uvms_ocp.tasks.pose import ToolPose


@checked
def tool_reach(
    robot: Robot,
    q: np.ndarray,
    goal: pin.SE3,
    *,
    duration: float,
    n_steps: int = 40,
    current: Sequence[float] = (0.0, 0.0, 0.0),
) -> OcpProblem:
    """From rest at q (n_q,) [m, rad] to the tool pose `goal` X_WT and rest, with the least effort below that priority.

    duration [s]; current (3,) [m/s] in W. Raises what `OcpProblem` raises.
    """
    return single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=duration,
        n_steps=n_steps,
        levels=[
            OcpLevel(name="tool", terms=(TaskTerm(task=ToolPose(goal=goal)),)),
            OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09))),
        ],
        constraints=(AtRest(),),
        current=np.asarray(current, dtype=float),
    )
