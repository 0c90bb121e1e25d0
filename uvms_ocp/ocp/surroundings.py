"""Describe what there is around the robot of a problem, as records keep it: goals of poses,
obstacles, a floor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.terms import TaskTerm
from uvms_ocp.record.meta_values import FrameMeta, ObstacleMeta, SurroundingsMeta
from uvms_ocp.tasks.goals import evaluate_pose
from uvms_ocp.tasks.pose import PoseTask, ToolPosition


def surroundings(problem: OcpProblem, t0: float) -> SurroundingsMeta:
    """Describe the surroundings at the end of the horizon, for goals and obstacles that move; t0
    [s] is the time of the first node.
    """
    end = t0 + float(problem.nominal_times()[-1])
    goals = []
    obstacles: list[ObstacleMeta] = []
    for term in problem.terms:
        if isinstance(term, TaskTerm) and isinstance(term.task, (PoseTask, ToolPosition)):
            goals.append(_goal(term, end))
        obstacles += term.scenery(end)
    return SurroundingsMeta(
        frames=tuple(goals),
        obstacles=_with_unique_names(obstacles),
        floor_z=float(problem.floor) if np.isfinite(problem.floor) else None,
    )


def _with_unique_names(obstacles: Sequence[ObstacleMeta]) -> tuple[ObstacleMeta, ...]:
    """Number obstacles of one name from the second on."""
    count: Counter[str] = Counter()
    result = []
    for obstacle in obstacles:
        count[obstacle.name] += 1
        number = count[obstacle.name]
        name = f"{obstacle.name} ({number})" if number > 1 else obstacle.name
        result.append(obstacle.model_copy(update={"name": name}))
    return tuple(result)


def _goal(term: TaskTerm, t: float) -> FrameMeta:
    """Describe the goal of a pose or a place at time t [s] as a frame."""
    assert isinstance(term.task, (PoseTask, ToolPosition))
    pose = evaluate_pose(term.name, term.task.goal, t)[0]
    return FrameMeta(name=f"goal of {term.name}", pose=tuple(pin.SE3ToXYZQUAT(pose).tolist()))
