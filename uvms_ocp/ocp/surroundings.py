"""Describe what there is around the robot of a problem, as records keep it: goals of poses,
obstacles, a floor.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.terms import TaskTerm
from uvms_ocp.record.meta_values import FrameMeta, SurroundingsMeta
from uvms_ocp.tasks.goals import evaluate_pose
from uvms_ocp.tasks.pose import PoseTask, ToolPosition


def surroundings(problem: OcpProblem, t0: float) -> SurroundingsMeta:
    """Describe the surroundings at the end of the horizon, for goals and obstacles that move; t0
    [s] is the time of the first node.
    """
    end = t0 + float(problem.nominal_times()[-1])
    poses = [
        term
        for term in problem.terms
        if isinstance(term, TaskTerm) and isinstance(term.task, (PoseTask, ToolPosition))
    ]
    obstacles = [item for term in problem.terms for item in term.scenery(end)]
    seen: Counter[str] = Counter()
    named = []
    for item in obstacles:
        seen[item.name] += 1
        again = f" ({seen[item.name]})" if seen[item.name] > 1 else ""
        named.append(item.model_copy(update={"name": item.name + again}))
    return SurroundingsMeta(
        frames=tuple(_goal(term, end) for term in poses),
        obstacles=tuple(named),
        floor_z=float(problem.floor) if np.isfinite(problem.floor) else None,
    )


def _goal(term: TaskTerm, t: float) -> FrameMeta:
    assert isinstance(term.task, (PoseTask, ToolPosition))
    pose = evaluate_pose(term.name, term.task.goal, t)[0]
    return FrameMeta(name=f"goal of {term.name}", pose=tuple(pin.SE3ToXYZQUAT(pose).tolist()))
