"""What the tasks of a phase keep all along it, as strictly as a plan keeps it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.mission_plan.margins import Margins, inside
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import AngleTask
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.joints import JointLimits
from uvms_ocp.tasks.task import Task, TaskClass
from uvms_ocp.tasks.velocity import UnderActuation

_ANGLES = ("tilt", "misalignment", "angle")


def active(phase: Phase, tasks: Collection[Task]) -> list[Task]:
    """Those that the phase has on."""
    return [task for task in tasks if phase.gates.get(task.name, 0.0) > 0]


def kept_tasks(
    phase: Phase, tasks: Collection[Task], out: Transition, before: Collection[str], margins: Margins
) -> list[Task]:
    """Constraints, what keeps the robot safe, and prerequisites that are established: stricter than the mission has them.

    tasks: that are on. out: the transition by which the mission leaves the phase. before: names of the prerequisites that
    were on in the phase before. Raises `InvalidInput` for a task without residual, by its name.
    """
    asked = {condition.quantity.rpartition(".")[0]: condition.limit for condition in out.when}
    kept = [task for task in tasks if _is_kept(task, asked, before) and not _kept_otherwise(task)]
    for task in kept:
        if type(task).residual is Task.residual:
            raise InvalidInput(
                f"phase {phase.name!r}: {task.name}, a {type(task).__name__}, has no residual over a horizon; "
                f"turn it off, or fly this mission without a plan"
            )
    return [_stricter(task, asked, margins) for task in kept]


def is_prerequisite(task: Task) -> bool:
    """Whether a task is one that is reached first and kept then."""
    return task.task_class is TaskClass.PREREQUISITE and not task.equality


def is_broken(task: Task, quantities: Mapping[str, float]) -> bool:
    """Whether quantities, by their names, are outside what a task of `kept_tasks` allows, as far as they tell."""
    if isinstance(task, MinimumAltitude):
        return quantities[f"{task.name}.altitude"] < task.threshold
    if isinstance(task, AngleTask):
        return any(quantities.get(f"{task.name}.{angle}", 0.0) > task.aim for angle in _ANGLES)
    return False


def _is_kept(task: Task, asked: Collection[str], before: Collection[str]) -> bool:
    """A prerequisite is kept where the phase before has reached it, or no transition out of this one waits for it."""
    if is_prerequisite(task):
        return task.name not in asked or task.name in before
    return task.task_class <= TaskClass.SAFETY


def _kept_otherwise(task: Task) -> bool:
    """By the dynamics, by the bounds on joints, and by clearances between shapes."""
    return isinstance(task, (UnderActuation, Clearance)) or (isinstance(task, JointLimits) and task.guard == 0)


def _stricter(task: Task, asked: Mapping[str, float], margins: Margins) -> Task:
    if isinstance(task, AngleTask):
        return replace(task, aim=inside(asked.get(task.name, task.bell.end), margins.angle))
    if isinstance(task, MinimumAltitude):
        return replace(task, threshold=task.threshold + margins.altitude)
    return task
