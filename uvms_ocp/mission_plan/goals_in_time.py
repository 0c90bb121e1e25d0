"""Goals that move, as terms of a horizon see them: a phase's own begin with the phase."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from uvms_ocp.mission.phase import Phase
from uvms_ocp.tasks.task import Task


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Delayed:
    """A reference that begins later."""

    goal: Callable[[float], Any]
    """Of the time since its beginning."""
    start: float
    """[s]"""

    def __call__(self, t: float) -> Any:
        """Value and rate at t [s]."""
        return self.goal(max(t - self.start, 0.0))


def task_in_time(task: Task, phase: Phase, begin: float) -> Task:
    """A task of a phase that begins at `begin` [s] on the horizon."""
    goal = getattr(task, "goal", None)
    if task.name not in phase.goals or not callable(goal):
        return task
    return task.with_goal(Delayed(goal=goal, start=begin))
